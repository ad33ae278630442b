"""A package of somebody else adds one thing of each kind and uses all on the command lines."""

from __future__ import annotations

import csv
import gzip
import hashlib
import importlib
import pickle
import sys
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest
import yaml

from agents.kinematic import registry, store
from agents.run_folder import versions
from envs import terrain
from questsim import extensions, reward
from questsim.cli import main
from questsim.errors import InputError
from questsim.extensions import load_extensions
from questsim.motion import datasets, families
from questsim.motion.spec import load_motions
from questsim.skeleton import JOINTS
from tests.bvh_files import BvhText

MODULE = """
from dataclasses import replace
from pathlib import Path

import numpy as np

from agents.kinematic.registry import AGENTS, register_system
from envs.terrain import register_terrain
from questsim.motion.datasets import Dataset, register_dataset
from questsim.motion.families import CMU, register_family
from questsim.reward import register_term

register_term("outside_energy", lambda m, k: -k * np.abs(m.torque).mean(axis=-1), k=0.01)
register_terrain("dune", lambda t, x, y, rng: t.amplitude_m * np.sin(x), amplitude_m=0.1)
register_family(replace(CMU, name="Shouting", joints={k: v.upper() for k, v in CMU.joints.items()}))
register_dataset(Dataset("outside", "Outside", "file:nowhere.zip", "Outside", "CC0-1.0", "nobody",
                         data=Path(__file__).parent))
register_system("outsider", replace(AGENTS["lgsik"], title="Outsider (nobody, 2026)"))
"""


def shouting(frames: int = 90) -> str:
    """A BVH file whose joints have CMU's names in capitals."""
    text = str(BvhText(frames=frames))
    for name in families.CMU.joints.values():
        text = text.replace(f" {name}\n", f" {name.upper()}\n")
    return text


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An installed package with an entry point; what it registers is taken back afterwards."""
    monkeypatch.setenv("QUESTSIM_CACHE", str(tmp_path / "cache"))
    (tmp_path / "outside_questsim.py").write_text(MODULE)
    info = tmp_path / "outside-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: outside\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[questsim.extensions]\nall = outside_questsim\n")
    with zipfile.ZipFile(tmp_path / "mirror.zip", "w") as file:
        file.writestr("Outside/sway.bvh", shouting())
    with gzip.open(tmp_path / "outside.sha256.gz", "wt") as file:
        file.write(f"{hashlib.sha256(shouting().encode()).hexdigest()}  sway.bvh\n")
    (tmp_path / "outside-test.txt").write_text("sway\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    tables: tuple[dict[str, Any], ...] = (
        reward.TERMS,
        terrain.TERRAINS,
        terrain.SHAPES,
        datasets.DATASETS,
        registry.AGENTS,
    )
    before = [dict(table) for table in tables]
    yield tmp_path
    for table, entries in zip(tables, before, strict=True):
        table.clear()
        table.update(entries)  # type: ignore
    del families.FAMILIES[families._OWN :]
    reward.RewardConfig.__dataclass_fields__ = reward._options()
    datasets.manifest.cache_clear()
    extensions._imported.clear()
    sys.modules.pop("outside_questsim", None)


def test_a_data_set_and_its_skeleton_are_fetched_and_read(package: Path, capsys) -> None:
    assert main(["motions", "fetch", "outside", "--mirror", str(package / "mirror.zip")]) == 0
    assert main(["motions", "list", "outside:test", "--clips"]) == 0
    out = capsys.readouterr().out
    assert "Outside: licence CC0-1.0. nobody" in out
    assert "sway  " in out and "licence: CC0-1.0" in out
    (package / "sway.bvh").write_text(shouting())
    library = str(package / "library.npz")
    assert (
        main(["motions", "import", str(package / "sway.bvh"), "--out", library, "--explain"]) == 0
    )
    assert "Shouting" in capsys.readouterr().out


def test_a_terrain_and_a_reward_term_are_trained_on(package: Path, capsys) -> None:
    assert main(["envs", "--name", "dune"]) == 0
    assert "amplitude_m = 0.1" in capsys.readouterr().out
    options = ["--motions", "synthetic:stand", "--preset", "smoke", "--stage", "teacher"]
    options += ["--steps", "64", "--envs", "4", "--threads", "1", "--env", "dune:amplitude_m=0.02"]
    options += ["--set", "stages.teacher.reward.outside_energy=0.1"]
    assert main(["train", "--out", str(package / "run"), *options]) == 0
    record = yaml.safe_load((package / "run" / "run.yaml").read_text())
    assert record["preset"]["stages"]["teacher"]["reward"]["outside_energy"] == 0.1
    with (package / "run" / "teacher" / "tensorboard" / "progress-1.csv").open() as file:
        curve = [row["reward/outside_energy"] for row in csv.DictReader(file)]
    assert any(float(value) < 0.0 for value in curve if value)
    assert record["versions"]["extension outside_questsim"] == "1.0"


def test_gym_make_finds_a_terrain_and_a_reward_term_without_the_command_line(package: Path) -> None:
    options = {"terrain": "dune:amplitude_m=0.02", "reward": {"outside_energy": 0.1}}
    env = gym.make("envs:QuestSim-v0", motions="synthetic:stand", **options)
    env.reset(seed=0)
    *_, info = env.step(env.action_space.sample())
    assert "outside_energy" in str(info)
    config = env.unwrapped.sim.config  # type: ignore[attr-defined]
    assert config.terrain == replace(terrain.TERRAINS["dune"], amplitude_m=0.02)
    assert gym.spec("QuestSimDune-v0").kwargs == {"terrain": "dune"}


def test_python_finds_a_data_set_without_the_command_line(package: Path) -> None:
    with pytest.raises(InputError, match="dataset outside has not been fetched"):
        load_motions("outside:test")
    with pytest.raises(InputError, match="no motions 'outsider'"):
        load_motions("outsider")


def test_python_finds_the_family_of_a_trained_system(package: Path) -> None:
    card = {"format": store.FORMAT, "format_version": store.FORMAT_VERSION, "agent": "outsider"}
    card |= {"fps": 60.0, "joints": list(JOINTS), "training": {"trained": ["network"]}}
    (package / store.CARD_FILE).write_text(yaml.safe_dump(card))
    assert store.read_system_card(package)["agent"] == "outsider"
    (package / store.CARD_FILE).write_text(yaml.safe_dump(card | {"agent": "nobody"}))
    with pytest.raises(InputError, match="'nobody' is not a known family"):
        store.read_system_card(package)


def test_a_reward_term_in_another_process_is_found_or_refused(package: Path) -> None:
    load_extensions()
    sent = pickle.dumps(reward.RewardConfig(outside_energy=0.5))
    forget_term()
    assert "outside_energy" in pickle.loads(sent).terms
    forget_term()
    (package / "outside-1.0.dist-info" / "entry_points.txt").unlink()
    importlib.invalidate_caches()
    with pytest.raises(InputError, match="outside_energy"):
        pickle.loads(sent)


def forget_term() -> None:
    """Be as in a process that has not loaded the extension."""
    del reward.TERMS["outside_energy"], sys.modules["outside_questsim"]
    reward.RewardConfig.__dataclass_fields__ = reward._options()


def test_a_module_without_a_package_is_recorded_by_its_content(package: Path, monkeypatch) -> None:
    (package / "bare_questsim.py").write_text("x = 1\n")
    monkeypatch.setenv("QUESTSIM_EXTENSIONS", "bare_questsim")
    load_extensions()
    digest = hashlib.sha256(b"x = 1\n").hexdigest()
    assert versions()["extension bare_questsim"] == f"sha256 {digest}"


def test_a_system_is_listed_with_the_others(package: Path, capsys) -> None:
    assert main(["agents"]) == 0
    text = capsys.readouterr().out
    assert text.startswith("agent ") and "Outsider (nobody, 2026)" in text


def test_an_extension_that_is_not_there_is_refused(monkeypatch, capsys) -> None:
    monkeypatch.setenv("QUESTSIM_EXTENSIONS", "no_such_module")
    assert main(["envs"]) == 2
    assert "cannot import 'no_such_module'" in capsys.readouterr().err


def test_names_that_are_taken_are_refused(package: Path) -> None:
    load_extensions()
    with pytest.raises(InputError, match="already"):
        terrain.register_terrain("rough", lambda t, x, y, rng: x)
    with pytest.raises(InputError, match="an id QuestSimHeadset-v0 already"):
        terrain.register_terrain("headset", lambda t, x, y, rng: x)
    with pytest.raises(InputError, match="already"):
        registry.register_system("lgsik", registry.AGENTS["outsider"])
    with pytest.raises(InputError, match="lacks"):
        families.register_family(families.Family("half", {"root": "Hips"}))
