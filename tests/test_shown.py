"""Agents that are shown an estimate in place of what the user did."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from helpers import swaying_clip

from agents.loading import load_agent
from agents.policy.policy_agent import Tracker
from agents.shipping.provenance import commands, stages_behind
from agents.training import run_stage, train_policy
from agents.training.dagger import Dagger
from agents.training.options import TrainArgs
from agents.training.ppo import AdaptivePPO
from agents.training.start_estimates import start_estimates
from agents.training.train_policy import train
from agents.training.training_clips import estimate_pairs
from envs import BatchSim, EnvConfig, QuestVecEnv, Terrain
from envs.starts import Starts
from questsim.errors import InputError
from questsim.motion.clip import Clip
from questsim.motion.kinematics import clip_from_qpos
from questsim.motion.library import save_library
from questsim.motion.retarget import to_clip
from questsim.motion.retarget_back import to_motion

CLIPS = [swaying_clip("a", 1.75), swaying_clip("b", 1.6, frames=50)]
PRIVILEGED = EnvConfig(privileged=True, fixed_start=True)


def estimate_of(clip: Clip, off_rad: float = 0.2, name: str | None = None) -> Clip:
    qpos = clip.qpos.copy()
    qpos[:, 7:] += off_rad
    qpos[:, 0] += 0.05
    return clip_from_qpos(name or f"{clip.name}@somebody", qpos, clip.height_m, kind=clip.kind)


SHOWN = [estimate_of(clip) for clip in CLIPS]


@pytest.mark.parametrize("terrain", [None, Terrain("waves", size_m=24.0)])
def test_an_agent_observes_the_shown_clips_and_is_scored_against_the_true_ones(terrain) -> None:
    config = replace(PRIVILEGED, terrain=terrain)
    shown = BatchSim(CLIPS, config, shown=SHOWN)
    plain, other = BatchSim(CLIPS, config), BatchSim(SHOWN, config)
    for sim in (shown, plain, other):
        sim.reset()
    np.testing.assert_array_equal(shown.qpos, plain.qpos)
    for _ in range(5):
        np.testing.assert_array_equal(shown.true_observation, plain.observation)
        action = np.full((2, 33), 0.1)
        shown.step(action)
        plain.step(action)
    np.testing.assert_array_equal(shown.error, plain.error)
    np.testing.assert_array_equal(shown.reward, plain.reward)
    np.testing.assert_array_equal(plain.true_observation, plain.observation)
    for name in ("reference_joint_angles", "midway_joint_angles", "reference_torques"):
        assert not np.allclose(
            shown.observation[:, shown.layout[name]], plain.observation[:, plain.layout[name]]
        )
    for name in ("joint_angles", "joint_velocities", "link_positions", "contact_forces"):
        np.testing.assert_array_equal(
            shown.observation[:, shown.layout[name]], plain.observation[:, plain.layout[name]]
        )
    for _ in range(5):
        other.step(np.full((2, 33), 0.1))
    angles = shown.layout["reference_joint_angles"]
    if terrain is None:  # there the pose decides how the legs stand on the ground
        np.testing.assert_allclose(shown.observation[:, angles], other.observation[:, angles])


def test_shown_clips_must_belong_to_the_clips() -> None:
    with pytest.raises(InputError, match="1 clips, motions have 2"):
        BatchSim(CLIPS, PRIVILEGED, shown=SHOWN[:1])
    with pytest.raises(InputError, match=r"a: 50 frames of 1.600 m are shown for \d+ of 1.750 m"):
        BatchSim(CLIPS, PRIVILEGED, shown=SHOWN[::-1])


@pytest.fixture
def library(tmp_path: Path, monkeypatch) -> Path:
    monkeypatch.setattr(train_policy, "load_clips", lambda args: CLIPS)
    path = tmp_path / "estimates.npz"
    save_library(path, [to_motion(clip) for clip in SHOWN], SHOWN)
    return path


def tiny(out: Path, **options) -> TrainArgs:
    return TrainArgs(
        **({"out": out, "preset": "smoke", "steps": 128, "envs": 8, "threads": 1} | options)
    )


def test_a_student_of_estimates_learns_from_a_teacher_of_the_true_motion(
    library, tmp_path, monkeypatch
) -> None:
    assert train(tiny(tmp_path / "teacher", stage="teacher")) == 0
    labelled: list[tuple[torch.Tensor, torch.Tensor]] = []
    mean = run_stage.make_learner

    def watched(*args):
        learner = mean(*args)
        assert isinstance(learner, Dagger) and isinstance(learner.env, QuestVecEnv)
        env = learner.env
        teacher = learner.teacher.action_mean
        monkeypatch.setattr(
            learner.teacher,
            "action_mean",
            lambda obs: labelled.append((obs, env.true_observation)) or teacher(obs),
        )
        return learner

    monkeypatch.setattr(run_stage, "make_learner", watched)
    out = tmp_path / "student"
    sizes = ("stages.student.policy.hidden=[40,30]",)
    args = tiny(
        out, stage="student", teacher=tmp_path / "teacher", estimates=str(library), set=sizes
    )
    assert train(args) == 0
    assert labelled and all(np.shares_memory(seen.numpy(), truth) for seen, truth in labelled)
    agent = load_agent(str(out))
    assert isinstance(agent, Tracker) and agent.needs.privileged
    assert agent.policy.spec.hidden == (40, 30)
    record = yaml.safe_load((out / "run.yaml").read_text())
    assert record["args"]["estimates"] == str(library) and record["data"]["clips"] == 4
    assert train(replace(args, steps=256, resume=True)) == 0
    again = commands(stages_behind(out / "student" / "last"))
    assert any("--estimates" in line and "--stage student" in line for line in again)


def test_estimates_of_one_system_with_other_devices_are_all_observed(library, tmp_path) -> None:
    more = tmp_path / "more.npz"
    save_library(more, [to_motion(clip) for clip in SHOWN], SHOWN)
    args = tiny(tmp_path / "run", stage="student", estimates=f"{library},{more}")
    pairs = estimate_pairs(args, CLIPS)
    assert pairs is not None
    users, twice = {clip.name for clip in CLIPS}, {clip.name for clip in SHOWN}
    assert set(pairs) == users | twice | {f"{name} 2" for name in twice}
    for name, (truth, _) in pairs.items():
        assert truth.name == name or name in users


def test_episodes_begin_in_the_estimate_that_is_observed(library, tmp_path) -> None:
    args = tiny(
        tmp_path / "run", stage="student", estimates=str(library), starts=Starts(estimate=1.0)
    )
    pairs = estimate_pairs(args, CLIPS)
    begin_at = start_estimates(args, CLIPS, pairs)
    assert pairs is not None and begin_at is not None
    assert set(begin_at) == {clip.name for clip in SHOWN}
    name = SHOWN[0].name
    truth, seen = pairs[name]
    config = replace(PRIVILEGED, starts=args.starts)
    sim = BatchSim([truth], config, shown=[seen], begin_at={name: begin_at[name]})
    sim.reset(np.array([0]), 0, 5)
    np.testing.assert_allclose(sim.qpos[0, 7:], seen.qpos[5, 7:], atol=1e-6)
    assert np.abs(seen.qpos[5, 7:] - truth.qpos[5, 7:]).max() > 1e-3
    with pytest.raises(InputError, match="does not go with --estimates"):
        start_estimates(replace(args, start_estimates=str(library)), CLIPS, pairs)


def test_pairs_end_with_the_shorter_of_motion_and_estimate(tmp_path) -> None:
    def pairs_of(frames: int):
        seen = SHOWN[0].first(frames)
        path = tmp_path / f"{frames}.npz"
        save_library(path, [to_motion(seen)], [seen])
        args = tiny(tmp_path / "run", stage="student", estimates=str(path))
        pairs = estimate_pairs(args, CLIPS)
        assert pairs is not None
        return pairs[seen.name]

    whole = len(SHOWN[0])
    truth, seen = pairs_of(whole - 1)
    assert len(truth) == len(seen) == whole - 1
    np.testing.assert_array_equal(truth.contacts, CLIPS[0].contacts[: whole - 1])
    with pytest.raises(InputError, match=f"{whole - 5} frames for {whole}"):
        pairs_of(whole - 5)


def test_a_tracker_of_estimates_is_fine_tuned_by_the_true_motion(
    library, tmp_path, monkeypatch
) -> None:
    made = []
    make = run_stage.make_learner
    monkeypatch.setattr(
        run_stage, "make_learner", lambda *args: made.append(make(*args)) or made[-1]
    )
    options = {"preset": "cpu", "stage": "finetune", "estimates": str(library)}
    assert train(tiny(tmp_path, start=Path("estimate-tracker"), **options)) == 0
    (learner,) = made
    assert isinstance(learner, AdaptivePPO)
    env = learner.env
    assert isinstance(env, QuestVecEnv)
    assert env.true_observation is not env.observation and learner.num_timesteps == 128
    shipped = load_agent("estimate-tracker")
    assert isinstance(shipped, Tracker)
    assert learner.policy.spec.actor_blocks == shipped.policy.spec.actor_blocks
    for name, weights in shipped.policy.actor.named_parameters():
        # The critic learns alone at first: what is not better than the start is not kept.
        torch.testing.assert_close(learner.policy.actor.get_parameter(name), weights)


def test_true_motions_are_scaled_to_the_stature_of_their_estimates(
    library, tmp_path, monkeypatch
) -> None:
    recorded = to_clip(to_motion(CLIPS[0]))
    assert recorded.height_m != CLIPS[0].height_m
    path = tmp_path / "recorded.npz"
    save_library(path, [to_motion(recorded)], [estimate_of(recorded)])
    learnt = []
    monkeypatch.setattr(
        "agents.training.rollout_worker.QuestVecEnv",
        lambda clips, *rest, **others: learnt.extend(clips) or QuestVecEnv(clips, *rest, **others),
    )
    args = tiny(tmp_path / "run", stage="student", teacher=Path("tracker"), estimates=str(path))
    assert train(args) == 0
    assert len(learnt) == 2
    for clip in learnt:
        np.testing.assert_allclose(clip.qpos, recorded.qpos)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"stage": "teacher", "teacher": None}, "--estimates: does not go with --stage teacher"),
        ({"mirrored": True}, "--estimates: does not go with --mirrored"),
        ({"sensors": "H"}, "--estimates: does not go with --sensors"),
    ],
)
def test_options_that_contradict_estimates_are_refused(options, message, library, tmp_path) -> None:
    options = {"stage": "student", "teacher": Path("tracker")} | options
    with pytest.raises(InputError, match=message):
        train(tiny(tmp_path / "run", estimates=str(library), **options))
    assert not (tmp_path / "run").exists()


def test_estimates_of_other_motions_are_refused(library, tmp_path) -> None:
    other = tmp_path / "other.npz"
    strange = [estimate_of(CLIPS[0], name="zzz@somebody")]
    save_library(other, [to_motion(clip) for clip in strange], strange)
    with pytest.raises(InputError, match=r"other.npz: 'zzz@somebody' is not an estimate of one of"):
        train(
            tiny(tmp_path / "run", stage="student", teacher=Path("tracker"), estimates=str(other))
        )
    assert not (tmp_path / "run").exists()
