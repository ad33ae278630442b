# A CPU image: `docker build -t questsim .`, then `docker run --rm -p 127.0.0.1:8080:8080 questsim`.
FROM python:3.12-slim AS build
WORKDIR /src
RUN python -m venv /venv
# Wheels of PyTorch without CUDA, where the builder names their index: --build-arg PIP_FLAGS="..."
ARG PIP_FLAGS=""
COPY constraints.txt pyproject.toml README.md LICENSE ./
COPY questsim questsim
COPY envs envs
COPY agents agents
COPY assets assets
RUN /venv/bin/pip install --no-cache-dir ${PIP_FLAGS} -c constraints.txt .

FROM python:3.12-slim
RUN apt-get update \
    && apt-get install -y --no-install-recommends libosmesa6 \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --create-home questsim
COPY --from=build /venv /venv
ENV PATH=/venv/bin:$PATH MUJOCO_GL=osmesa
USER questsim
WORKDIR /home/questsim
EXPOSE 8080
# Inside a container all interfaces are the container's own; publish the port on 127.0.0.1.
CMD ["questsim", "demo", "--host", "0.0.0.0"]
