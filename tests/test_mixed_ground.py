"""Training on several grounds at once: the mixed terrain, pushes and randomisation."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from helpers import swaying_clip
from test_terrain import gliding_clip

from agents.evaluation import EvaluateArgs, evaluate
from agents.loading import load_agent
from agents.policy.checkpoint import load_resume
from agents.policy.policy_agent import PolicyAgent
from agents.shipping.provenance import commands, options_of, stages_behind
from agents.shipping.ship import ShipArgs, ship
from agents.training import rollout_worker, run_stage, train_policy
from agents.training.options import TrainArgs
from agents.training.train_policy import train
from envs import BatchSim, EnvConfig, Pushes, Randomisation, Terrain
from envs.objects import WorldObject
from envs.placement import Placement
from envs.reference import Reference
from envs.terrain import TERRAINS, height_field, terrain_named, tile_centre
from questsim.cli import run
from questsim.errors import InputError
from questsim.motion.clip import Clip

MIXED = TERRAINS["mixed"]


def placed(clip: Clip, terrain: Terrain, count: int) -> Placement:
    reference = Reference.of([clip], EnvConfig(), 0)
    placement = Placement(reference, terrain, np.ones(count), 0, False)
    placement.draw(np.arange(count), np.zeros(count, np.int64))
    return placement


@pytest.mark.parametrize("share", [0.25, 0.4, 1.0])
def test_a_given_share_of_episodes_is_on_level_floor_and_the_rest_evenly_on_tiles(share) -> None:
    tile = placed(swaying_clip(), replace(MIXED, flat_share=share), 4000).tile
    assert (tile[:, 0] == 0).mean() == pytest.approx(share, abs=0.03)
    assert not (tile[:, 0] == 1).any()  # between floor and tiles nobody begins
    for column in (2, 3, 4):
        assert (tile[:, 0] == column).mean() == pytest.approx((1.0 - share) / 3, abs=0.03)
    for level in range(4):
        assert (tile[:, 1] == level).mean() == pytest.approx(0.25, abs=0.03)


def test_an_episode_that_begins_on_level_floor_stays_on_it() -> None:
    clip = gliding_clip(3.0, frames=144)  # 12 m
    sim = BatchSim([clip], EnvConfig(terrain=MIXED), num_envs=40)
    sim.reset()
    field = sim.placement.field
    assert field is not None
    heights = [np.ptp(field.height_at(sim.placed_clip(i, clip).qpos[:, :2])) for i in range(40)]
    flat = sim.placement.tile[:, 0] == 0
    assert 5 < flat.sum() < 35
    assert max(np.array(heights)[flat]) == 0.0
    assert min(np.array(heights)[~flat]) > 0.005


def test_mixed_tiles_are_rough_and_sloping_ground_up_to_the_tables() -> None:
    field = height_field(MIXED)
    assert field.cell_m == TERRAINS["rough"].cell_m
    reach = np.linspace(-6.0, 6.0, 49)
    around = np.stack(np.meshgrid(reach, reach), -1)
    line = np.stack([np.linspace(2.0, 6.0, 9), np.zeros(9)], -1)
    for level in range(4):
        rough, slope = (tile_centre(MIXED, np.array(c), np.array(level)) for c in (3, 4))
        most = np.abs(field.height_at(around + rough)).max()
        assert most == pytest.approx(0.02 * (level + 1), rel=0.05)
        fall = -np.diff(field.height_at(line + slope)) / 0.5
        np.testing.assert_allclose(fall, np.tan(np.deg2rad(2.0 * (level + 1))), atol=0.01)


def test_a_course_is_as_hard_as_its_difficulty() -> None:
    half = height_field(replace(TERRAINS["course"], difficulty=0.5, tiles=("waves",))).height
    whole = height_field(replace(TERRAINS["course"], tiles=("waves",))).height
    np.testing.assert_allclose(half, 0.5 * whole, atol=1e-7)


def test_a_tile_with_an_unknown_option_is_refused() -> None:
    with pytest.raises(InputError, match="'amplitude=1' is not an option"):
        Terrain("course", tiles=("rough:amplitude=1",))
    with pytest.raises(InputError, match=r"flat_share is 1\.5"):
        terrain_named("mixed:flat_share=1.5")


def test_a_start_of_a_relative_path_is_recorded_so_that_it_means_the_same_everywhere(
    clips, tmp_path, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    train(tiny(Path("t"), stage="teacher"))
    taught = tiny(Path("s"), stage="student", teacher=Path("t"))
    train(taught)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    parts = stages_behind(tmp_path / "s" / "student" / "best")
    assert [part.run for part in parts] == [tmp_path / "t", tmp_path / "s"]
    assert commands(parts)[1].endswith("--out runs/NAME --teacher runs/TEACHER")
    # It goes on with the path told either way, and from a record of before this was so.
    record = yaml.safe_load((tmp_path / "s" / "run.yaml").read_text())
    assert record["args"]["teacher"] == str(tmp_path / "t")
    record["args"]["teacher"] = "t"
    (tmp_path / "s" / "run.yaml").write_text(yaml.safe_dump(record))
    for steps, teacher in ((256, Path("../t")), (384, tmp_path / "t")):
        again = replace(taught, out=Path("../s"), teacher=teacher, steps=steps, resume=True)
        assert train(again) == 0


def test_a_teacher_begun_with_a_shipped_one_is_not_mistaken_for_it(
    clips, tmp_path, monkeypatch
) -> None:
    weights = tmp_path / "weights"
    monkeypatch.setattr("agents.resolve.SHIPPED", weights)
    train(tiny(tmp_path / "a", stage="teacher"))
    ship(ShipArgs(tmp_path / "a", "tracker", into=weights))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tracker").mkdir()  # a folder that merely has the name, as questsim/ here has
    train(tiny(tmp_path / "b", start=Path("tracker")))
    lines = commands(stages_behind(tmp_path / "b" / "student" / "best"))
    assert len(lines) == 3
    assert lines[1].endswith("--out runs/NAME --start runs/tracker")
    assert lines[2].endswith("--out runs/NAME --resume")
    # The name means another policy by now; what b began with stays what it was.
    train(tiny(tmp_path / "c", stage="teacher", seed=9))
    ship(ShipArgs(tmp_path / "c", "tracker", into=weights))
    assert commands(stages_behind(tmp_path / "b" / "student" / "best")) == lines


@pytest.fixture
def clips(monkeypatch):
    found = [swaying_clip(f"sway{i}", frames=40, height_m=1.6 + 0.1 * i) for i in range(3)]
    monkeypatch.setattr(train_policy, "load_clips", lambda args: found)
    return found


def tiny(out: Path, **options) -> TrainArgs:
    return TrainArgs(
        **({"out": out, "preset": "smoke", "steps": 128, "envs": 8, "threads": 1} | options)
    )


FEW = ["--steps", "128", "--envs", "8", "--threads", "1"]
WILD = {
    "env": "mixed:flat_share=0.5",
    "pushes": (0.0, 80.0),
    "objects": ("ball",),
    "randomisation": Randomisation(friction=(0.7, 1.2), latency_frames=(0, 2)),
}


def test_teacher_and_student_learn_on_mixed_ground_under_pushes(
    clips, tmp_path, monkeypatch
) -> None:
    made: list[EnvConfig] = []
    vec_env, sim = rollout_worker.QuestVecEnv, run_stage.evaluation_sim

    def see_env(clips, config, *rest, **others):
        made.append(config)
        return vec_env(clips, config, *rest, **others)

    def see_sim(clips, config, *rest, **others):
        made.append(config)
        return sim(clips, config, *rest, **others)

    monkeypatch.setattr(rollout_worker, "QuestVecEnv", see_env)
    monkeypatch.setattr(run_stage, "evaluation_sim", see_sim)
    out = tmp_path / "run"
    assert train(tiny(out, **WILD)) == 0
    assert len(made) == 4  # of teacher and student, to learn and to compare checkpoints
    for config in made:
        assert config.terrain == terrain_named("mixed:flat_share=0.5")
        assert config.pushes == Pushes((0.0, 80.0), pause_s=(1.0, 4.0))
        assert config.objects == (WorldObject("ball"),)
        assert config.randomisation == WILD["randomisation"]
    args = yaml.safe_load((out / "run.yaml").read_text())["args"]
    words = " ".join(options_of(args))
    assert "--pushes 0.0 80.0 --objects ball --randomisation.friction 0.7 1.2" in words
    assert train(tiny(out, resume=True, steps=256, **WILD)) == 0
    with pytest.raises(InputError, match="--pushes was"):
        train(tiny(out, resume=True, **(WILD | {"pushes": None})))


@pytest.mark.parametrize("env", ["course", "mixed"])
def test_a_policy_learnt_on_tiles_is_saved_and_evaluated_there(
    env, clips, tmp_path, monkeypatch
) -> None:
    monkeypatch.setattr("questsim.motion.spec.load_motions", lambda motions, **_: clips)
    out = tmp_path / "run"
    assert run(train, TrainArgs, [*f"--preset smoke --env {env} --out {out}".split(), *FEW]) == 0
    assert yaml.safe_load((out / "run.yaml").read_text())["args"]["env"] == env
    for stage in ("teacher", "student"):
        last = load_agent(str(out / stage / "last"))
        assert isinstance(last, PolicyAgent) and last.card["training"]["steps"] >= 128
    world = f"--env QuestSim{env.title()}-v0 --threads 1"
    scores = tmp_path / "scores"
    command = f"--agent {out} --motions sways {world} --out {scores}".split()
    assert run(evaluate, EvaluateArgs, command) == 0
    metrics = json.loads((scores / "metrics.json").read_text())
    assert metrics["all"]["clips"] == 3
    assert metrics["context"]["config"]["terrain"]["tiles"] == list(TERRAINS[env].tiles)
    assert metrics["context"]["training"]["stage"] == "student"


def test_a_run_from_before_there_was_an_option_goes_on(clips, tmp_path) -> None:
    out = tmp_path / "run"
    train(tiny(out, stage="teacher", steps=64))
    record = yaml.safe_load((out / "run.yaml").read_text())
    for option in ("pushes", "randomisation"):
        del record["args"][option]
    (out / "run.yaml").write_text(yaml.safe_dump(record))
    assert train(tiny(out, stage="teacher", resume=True)) == 0
    with pytest.raises(InputError, match=r"--randomisation\.friction was"):
        train(tiny(out, stage="teacher", resume=True, randomisation=WILD["randomisation"]))


def test_a_student_goes_on_from_another_students_weights(clips, tmp_path) -> None:
    train(tiny(tmp_path / "a", seed=5))
    learnt = load_resume(tmp_path / "a" / "student" / "last")["learner"]["policy"]
    begun = tiny(
        tmp_path / "b", stage="student", teacher=tmp_path / "a", start=tmp_path / "a" / "student",
        steps=64,
    )  # fmt: skip
    train(begun)
    weights = load_resume(tmp_path / "b" / "student" / "last")["learner"]["policy"]
    for name, tensor in learnt.items():
        if "layers" in name:  # a few steps of 1e-3 away from them
            assert (tensor - weights[name]).abs().max() < 0.03, name
    assert not all(torch.equal(tensor, weights[name]) for name, tensor in learnt.items())
    parts = stages_behind(tmp_path / "b" / "student" / "best")
    assert [(part.run.name, part.training["stage"]) for part in parts] == [
        ("a", "teacher"), ("a", "student"), ("b", "student"),
    ]  # fmt: skip
    with pytest.raises(InputError, match="networks do not fit"):
        train(replace(begun, out=tmp_path / "c", start=tmp_path / "a" / "teacher"))
