"""Ids, imports and worker processes: what a program needs before it has an environment."""

from __future__ import annotations

import importlib.metadata
import os
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import pytest

from envs.registration import ENVIRONMENTS, register

ROOT = Path(__file__).parents[1]


def run(code: str) -> str:
    """What a fresh process prints."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_importing_envs_registers_the_ids_and_imports_nothing_heavy() -> None:
    code = """
import sys
import envs, gymnasium
print(all(name in gymnasium.registry for name in envs.registration.ENVIRONMENTS))
print([name for name in ("torch", "stable_baselines3", "mujoco", "numba") if name in sys.modules])
"""
    assert run(code).split("\n") == ["True", "[]"]


def test_making_an_environment_imports_neither_torch_nor_stable_baselines3() -> None:
    code = """
import sys
import gymnasium
env = gymnasium.make("envs:QuestSim-v0", motions="synthetic:stand")
env.reset(seed=0)
print([name for name in ("torch", "stable_baselines3") if name in sys.modules])
"""
    assert run(code) == "[]"


def test_every_name_of_the_package_is_there() -> None:
    import envs

    for name in envs.__all__:
        assert getattr(envs, name).__name__ == name
    assert set(envs.__all__) <= set(dir(envs))
    with pytest.raises(AttributeError, match="no_such_name"):
        envs.no_such_name  # noqa: B018


def test_registering_twice_warns_of_nothing(recwarn: pytest.WarningsRecorder) -> None:
    register()
    assert not recwarn.list


def test_the_entry_point_for_plug_ins_registers_the_ids(monkeypatch: pytest.MonkeyPatch) -> None:
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    (value,) = project["entry-points"]["gymnasium.envs"].values()
    point = importlib.metadata.EntryPoint("__root__", value, "gymnasium.envs")
    for name in ENVIRONMENTS:
        monkeypatch.delitem(gym.registry, name)
    point.load()()
    assert set(ENVIRONMENTS) <= set(gym.registry)


def test_the_command_runs_as_a_module() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "questsim", "--version"], cwd=ROOT, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout.split()[0]) == (0, "questsim")
