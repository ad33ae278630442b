"""The worlds table, the examples of the documentation, and terrains on the command lines."""

from __future__ import annotations

import json
import runpy
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_bad_input import assert_refused, questsim
from test_terrain import gliding_clip

from agents.agent import ZeroAgent
from agents.commands.evaluate import evaluate_worlds
from agents.evaluation import worlds
from agents.evaluation.follow import evaluation_sim
from agents.evaluation.options import WorldsArgs
from agents.evaluation.rollout import env_config, roll_out
from agents.evaluation.worlds import WORLDS, format_worlds, group_of, run_worlds
from agents.training.options import TrainArgs
from agents.training.train_policy import _outcome, train
from envs.terrain import SHAPES, TERRAINS, Terrain, height_field
from questsim import reward
from questsim.cli import main
from questsim.errors import InputError
from questsim.motion.datasets import DATASETS
from questsim.motion.library import save_library
from questsim.motion.retarget_back import to_motion
from questsim.motion.spec import load_motions

ROOT = Path(__file__).parents[1]
CLIPS = [
    gliding_clip(0.8, frames=160),
    replace(gliding_clip(0.0, frames=20), name="wave", kind="wave-left-hand"),
    replace(gliding_clip(0.0, frames=20), name="squat", kind="squat"),
]

KNOWN = {clip.name: clip for clip in [*CLIPS, *load_motions("synthetic:stand")]}
"""What the table plays; who stands is pushed in copies of a clip, numbered behind its name."""


class Ghost:
    """Takes the avatar along with the reference, as nothing real could."""

    name, needs = "ghost", ZeroAgent.needs

    def bind(self, env) -> None:
        self._sim = env

    def reset(self, n: int) -> None:
        self._down = False

    def act(self, obs: np.ndarray) -> np.ndarray:
        sim = self._sim
        for i, clip in enumerate(sim.reference.names):
            placed = sim.placed_clip(i, KNOWN.get(clip) or KNOWN[clip.rpartition("-")[0]])
            row = min(sim.frame[i] - sim.reference.start[i] + 1, len(placed) - 1)
            sim.qpos[i, :40], sim.qvel[i, :39] = placed.qpos[row], placed.qvel[row]
        return np.zeros((len(obs), 33))


def table(agent) -> dict:
    return run_worlds(agent, CLIPS, env_config(agent))


@pytest.fixture(scope="module")
def of_ghost() -> dict:
    return table(Ghost())


def test_the_table_has_every_row_of_walks_and_gestures(of_ghost: dict) -> None:
    rows = {row["name"]: row for row in of_ghost["rows"]}
    pushes = ["standing_push_60n", "standing_push_100n", "standing_push_150n"]
    assert list(rows) == [*(world.name for world in WORLDS), *pushes]
    counts = {name: row["clips"] for name, row in rows.items()}
    assert counts == {
        "flat": 2,
        "rough_4cm": 2,
        "rough_8cm": 2,
        "slope_8deg": 6,
        "other_height": 4,
        "push_100n": 1,
        "ball": 1,
        "standing_push_60n": 16,
        "standing_push_100n": 16,
        "standing_push_150n": 16,
    }
    assert set(rows["slope_8deg"]["settings"]) == {"up", "down", "across"}
    assert 0.1 < of_ghost["speed"]["ratio_to_flat"] < 3.0
    # Intervals need more than ten clips.
    assert [name for name, row in rows.items() if row["interval"] is not None] == pushes


def test_a_clip_followed_to_its_end_succeeds_and_a_fall_does_not(of_ghost: dict) -> None:
    success = {row["name"]: row["success"] for row in of_ghost["rows"]}
    assert {success[name] for name in success if name != "ball"} == {1.0}
    fallen = {row["name"]: row for row in table(ZeroAgent())["rows"]}
    assert fallen["push_100n"]["success"] == 0.0 and fallen["ball"]["success"] == 0.0
    assert fallen["flat"]["by_group"]["walking"] == 0.0
    assert fallen["rough_4cm"]["reached"] is False and fallen["flat"]["reached"] is None


def test_a_ball_that_is_not_touched_is_no_success(monkeypatch) -> None:
    far = replace(worlds.BALL, aside_m=(3.0, 3.0))
    row = next(w for w in WORLDS if w.name == "ball")
    monkeypatch.setattr(worlds, "WORLDS", (replace(row, settings={"ball": {"objects": (far,)}}),))
    assert table(Ghost())["rows"][0]["success"] == 0.0


def test_the_table_reads_as_text(of_ghost: dict) -> None:
    text = format_worlds(of_ghost)
    assert "rough ground, ±4 cm" in text and "90%  reached" in text
    assert "100.0%  100.0 to 100.0     100%  reached" in text
    assert len(text.splitlines()) == len(WORLDS) + 3 + 2


def test_kinds_fall_into_the_four_groups() -> None:
    groups = {
        "walk": "walking",
        "walk-turn-left": "turning",
        "turn-right": "turning",
        "run": "running",
        "jog": "running",
        "raise-up-both-hands": "gesture",
        "wave": "gesture",
        "side-left": None,
        "squat": None,
    }
    assert {kind: group_of(kind) for kind in groups} == groups


@pytest.fixture(scope="module")
def library(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("motions") / "walks.npz"
    save_library(path, [to_motion(clip) for clip in CLIPS], CLIPS)
    return path


def test_the_command_writes_the_table(library, tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.setattr(worlds, "WORLDS", WORLDS[:2])
    args = WorldsArgs(agent="zero", motions=str(library), out=tmp_path / "w", max_clips=2)
    assert evaluate_worlds(args) == 0
    written = json.loads((tmp_path / "w" / "worlds.json").read_text())
    assert [row["name"] for row in written["rows"][:2]] == ["flat", "rough_4cm"]
    assert written["schema"] == "questsim-worlds" and written["context"]["agent"] == "zero"
    assert "rough ground" in capsys.readouterr().out


def test_the_table_needs_a_walk_long_enough() -> None:
    with pytest.raises(InputError, match=r"no clip of walking lasts 4\.2 s"):
        run_worlds(ZeroAgent(), CLIPS[1:], env_config(ZeroAgent()))


def test_rollouts_on_a_terrain_are_scored_against_the_clip_on_its_feet_there() -> None:
    config = replace(env_config(ZeroAgent()), terrain=TERRAINS["slope"])
    rollout = roll_out(ZeroAgent(), CLIPS[1:2], config)[0]
    field = height_field(TERRAINS["slope"])
    pelvis = rollout.reference.link_position[:, 0]
    lift = pelvis[:, 2] - CLIPS[1].link_position[:, 0, 2]
    # Lower only where a standing foot would not reach its ground.
    below = field.ground_at(pelvis) - lift
    assert below.min() > -1e-6 and below.max() < 0.08
    assert rollout.link_error_m[0] < 0.15
    assert np.abs(rollout.foot_clearance[0]).max() < 0.2


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (("evaluate", "--agent", "zero", "--terrain", "lava"), "unknown terrain 'lava'"),
        (("evaluate", "--agent", "zero", "--objects", "ball", "lava"), "unknown object 'lava'"),
        (("evaluate", "--agent", "zero", "--height", "3"), "1.2 to 2.2 m"),
        (("train", "--out", "run", "--env", "rough:amplitude_m=9"), "amplitude_m is 9"),
        (("envs", "--name", "QuestSimMoon-v0"), "there is no 'QuestSimMoon-v0'"),
    ],
)
def test_impossible_worlds_are_refused_in_one_line(words, wanted, library, tmp_path) -> None:
    motions = () if words[0] == "envs" else ("--motions", library)
    assert_refused(questsim(tmp_path, *words, *motions), wanted)


def test_environments_are_listed_and_described(capsys) -> None:
    assert main(["envs"]) == 0
    assert "QuestSimStairs-v0   flights of five steps" in capsys.readouterr().out
    assert main(["envs", "--name", "QuestSimSlope-v0"]) == 0
    described = capsys.readouterr().out
    assert "475 numbers" in described and "slope_deg = 8.0  (0 to 30)" in described


def test_a_policy_is_trained_further_on_a_terrain(library, tmp_path, monkeypatch) -> None:
    made = []
    monkeypatch.setattr(
        "agents.training.run_stage.evaluation_sim",
        lambda clips, config, *rest, **others: (
            made.append(config) or evaluation_sim(clips, config, *rest, **others)
        ),
    )
    args = TrainArgs(
        out=tmp_path / "run",
        motions=str(library),
        stage="finetune",
        start=Path("demo"),
        env="rough:amplitude_m=0.06",
        steps=64,
        envs=4,
        threads=1,
    )
    assert train(args) == 0
    assert made[0].terrain == Terrain(amplitude_m=0.06)
    record = (tmp_path / "run" / "run.yaml").read_text()
    assert "env: rough:amplitude_m=0.06" in record


def test_a_fine_tuning_that_found_nothing_better_says_so(tmp_path) -> None:
    assert "no better than its start yet; continue with --resume" in _outcome(TrainArgs(tmp_path))


@pytest.fixture
def registries() -> Iterator[None]:
    """Terms and terrains, as other tests expect them, after this one."""
    known: list[dict[str, Any]] = [reward.TERMS, TERRAINS, SHAPES, DATASETS]
    before = [dict(registry) for registry in known]
    yield
    for registry, kept in zip(known, before, strict=True):
        registry.clear()
        registry.update(kept)
    reward.RewardConfig.__dataclass_fields__ = reward._options()


@pytest.mark.parametrize("name", ["new_terrain", "new_reward", "new_agent", "new_dataset"])
@pytest.mark.usefixtures("registries")
def test_the_examples_run_and_are_short(name: str) -> None:
    path = ROOT / "docs" / "examples" / f"{name}.py"
    assert len(path.read_text().splitlines()) < 40
    main = runpy.run_path(str(path))["main"]
    # An extension registers when it is imported: commands do not call its main.
    added: dict[str, bool] = {
        "new_terrain": "ridges" in TERRAINS,
        "new_reward": "energy" in reward.TERMS,
        "new_dataset": "standing" in DATASETS,
    }
    assert added.get(name, True)
    result = main()
    if name == "new_terrain":
        assert result.floor.max() > 0.0 and result.placement.field.height.max() > 0.02
    elif name == "new_reward":
        assert (result[0] > result[1]).all()
    elif name == "new_dataset":
        assert [clip.name for clip in result] == ["synthetic-stand-2", "synthetic-stand-3"]
    else:
        assert result["all"]["clips"] == 1
