"""The wheel, installed into an empty folder, works outside the checkout."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SHIPPED = ("questsim", "envs", "agents", "assets")
METADATA = ("pyproject.toml", "README.md", "LICENSE")


def shipped_files() -> set[str]:
    """Every file of the shipped folders under the name that it has in the wheel."""
    names = set()
    for folder in SHIPPED:
        for path in (ROOT / folder).rglob("*"):
            relative = path.relative_to(ROOT).as_posix()
            hidden = any(part.startswith((".", "__pycache__")) for part in path.parts[-3:])
            if path.is_file() and not hidden and path.suffix != ".pyc":
                names.add(relative.replace("assets/mjcf/", "questsim/_mjcf/"))
    return names


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """The wheel that QUESTSIM_WHEEL names, or one built from a copy of the sources.

    A copy, because setuptools puts whatever an earlier build left in ``build/`` into the wheel.
    """
    if "QUESTSIM_WHEEL" in os.environ:
        return Path(os.environ["QUESTSIM_WHEEL"]).resolve()
    source = tmp_path_factory.mktemp("source")
    for folder in SHIPPED:
        shutil.copytree(
            ROOT / folder, source / folder, ignore=shutil.ignore_patterns("__pycache__")
        )
    for file in METADATA:
        shutil.copy(ROOT / file, source)
    out = tmp_path_factory.mktemp("dist")
    command = "pip wheel --quiet --no-deps --no-build-isolation --wheel-dir"
    subprocess.run([sys.executable, "-m", *command.split(), out, source], check=True)
    return next(out.glob("questsim-*.whl"))


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory) -> Path:
    """A folder with the wheel alone; its dependencies come from the running environment."""
    target = tmp_path_factory.mktemp("installed")
    command = "pip install --quiet --no-deps --target"
    subprocess.run([sys.executable, "-m", *command.split(), target, wheel], check=True)
    return target


def run_outside(installed: Path, code: str) -> str:
    """What the code prints, run in an empty folder with the installed wheel first on the path."""
    environment = os.environ | {"PYTHONPATH": str(installed), "PYTHONSAFEPATH": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=installed.parent,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_wheel_contains_every_file_of_its_packages_and_no_other(wheel):
    names = {n for n in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in n}
    assert names == shipped_files()


def test_wheel_declares_licence_and_command(wheel):
    archive = zipfile.ZipFile(wheel)
    info = next(n.partition("/")[0] for n in archive.namelist() if ".dist-info/" in n)
    assert b"License-Expression: MIT AND CC-BY-NC-4.0" in archive.read(f"{info}/METADATA")
    entry_points = archive.read(f"{info}/entry_points.txt")
    assert b"questsim = questsim.cli:main" in entry_points
    assert b"[gymnasium.envs]" in entry_points


@pytest.mark.parametrize("package", ["questsim", "envs", "agents"])
def test_package_is_imported_from_the_wheel(installed, package):
    path = run_outside(installed, f"import {package}; print({package}.__file__)")
    assert Path(path).is_relative_to(installed)


def test_body_is_built_from_the_wheels_mjcf(installed):
    code = """
from questsim.assets import mjcf_path
from questsim.body import build_body
print(mjcf_path("humanoid.xml"), build_body(1.6).model.nu)
"""
    path, actuators = run_outside(installed, code).rsplit(" ", 1)
    assert Path(path).is_relative_to(installed)
    assert actuators == "33"


def test_embedded_motions_load_from_the_wheel(installed):
    code = 'from questsim.motion.spec import load_motions; print(len(load_motions("synthetic")))'
    assert int(run_outside(installed, code)) > 10
