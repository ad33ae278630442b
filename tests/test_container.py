"""The image and the devcontainer: checked here, built only where Docker runs."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

from agents.live.options import DemoArgs
from questsim.cli import COMMANDS
from questsim.parsing import parse

ROOT = Path(__file__).parents[1]
KNOWN = {"FROM", "WORKDIR", "RUN", "ARG", "COPY", "ENV", "USER", "EXPOSE", "CMD"}


def instructions() -> list[tuple[str, str]]:
    """Names and arguments of the Dockerfile's instructions; continued lines are one."""
    lines = (ROOT / "Dockerfile").read_text().splitlines()
    text = "\n".join(line for line in lines if not line.startswith("#")).replace("\\\n", " ")
    found = [line.partition(" ") for line in text.splitlines() if line.strip()]
    return [(name, " ".join(rest.split())) for name, _, rest in found]


def stages() -> list[list[tuple[str, str]]]:
    found: list[list[tuple[str, str]]] = []
    for name, rest in instructions():
        if name == "FROM":
            found.append([])
        found[-1].append((name, rest))
    return found


def fits_python(image: str) -> bool:
    version = re.fullmatch(r"python:(3\.\d+)(-slim)?", image)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    classifiers = {text.rpartition(" ")[2] for text in project["classifiers"]}
    return version is not None and version[1] in classifiers


def test_the_dockerfile_has_two_stages_of_a_pinned_python_and_known_instructions():
    assert {name for name, _ in instructions()} <= KNOWN
    build, final = stages()
    assert build[0][1].endswith(" AS build")
    assert all(fits_python(stage[0][1].removesuffix(" AS build")) for stage in (build, final))
    assert ("COPY", "--from=build /venv /venv") in final


def test_everything_that_is_installed_is_copied_into_the_image_and_nothing_is_missing():
    build, _ = stages()
    copied = [word for name, rest in build if name == "COPY" for word in rest.split()[:-1]]
    ignored = (ROOT / ".dockerignore").read_text().split()
    assert all((ROOT / path).exists() and path not in ignored for path in copied)
    setup = tomllib.loads((ROOT / "pyproject.toml").read_text())
    setuptools, project = setup["tool"]["setuptools"], setup["project"]
    folders = {
        setuptools["package-dir"].get(package, package).partition("/")[0].partition(".")[0]
        for package in setuptools["packages"]
    }
    needed = folders | {project["readme"], *project["license-files"]}
    assert needed | {"pyproject.toml", "constraints.txt"} == set(copied)


def test_the_image_runs_the_command_of_make_demo_as_a_user_without_rights():
    _, final = stages()
    names = [name for name, _ in final]
    user = next(rest for name, rest in final if name == "USER")
    assert user not in ("root", "0")
    assert any(name == "RUN" and f"useradd --create-home {user}" in rest for name, rest in final)
    assert names.index("USER") < names.index("CMD")
    assert "RUN" not in names[names.index("USER") :]
    command = json.loads(final[-1][1])
    make = re.search(r"^demo:.*\n\t\$\(VENV\)/bin/(\w+ \w+)", (ROOT / "Makefile").read_text(), re.M)
    assert make is not None and " ".join(command[:2]) == make[1] and command[1] in COMMANDS
    args = parse(DemoArgs, command[2:])
    assert ("EXPOSE", str(args.port)) in final
    assert args.host == "0.0.0.0"  # else the published port reaches nothing


def test_packages_of_the_system_leave_no_lists_behind():
    for name, rest in instructions():
        if name == "RUN" and "apt-get install" in rest:
            assert "--no-install-recommends" in rest and "rm -rf /var/lib/apt/lists/*" in rest


def test_the_devcontainer_installs_the_checkout_and_forwards_the_page():
    described = json.loads((ROOT / ".devcontainer" / "devcontainer.json").read_text())
    assert fits_python(described["image"])
    assert described["forwardPorts"] == [parse(DemoArgs, []).port]
    steps = [shlex.split(step) for step in described["postCreateCommand"].split("&&")]
    targets = [step[1] for step in steps if step[0] == "make"]
    makefile = (ROOT / "Makefile").read_text()
    assert targets and all(re.search(rf"^{t}:", makefile, re.M) for t in targets)
    settings = described["customizations"]["vscode"]["settings"]
    assert settings["python.defaultInterpreterPath"] == ".venv/bin/python"


def docker_runs() -> bool:
    if shutil.which("docker") is None:
        return False
    return subprocess.run(["docker", "info"], capture_output=True, timeout=60).returncode == 0


@pytest.mark.slow
def test_the_image_can_be_built():
    if not docker_runs():
        pytest.skip("Docker does not run here")
    done = subprocess.run(
        ["docker", "build", "-q", str(ROOT)], capture_output=True, text=True, timeout=1800
    )
    assert done.returncode == 0, done.stderr[-2000:]
