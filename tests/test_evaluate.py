"""Rolling clips from their first frame, and the evaluation command around it."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers import swaying_clip

from agents.agent import Needs, RandomAgent, ZeroAgent
from agents.commands.evaluate import _config_of
from agents.evaluation import EvaluateArgs, evaluate
from agents.evaluation.follow import evaluation_sim, follow
from agents.evaluation.rollout import env_config, roll_out
from agents.loading import load_agent
from agents.policy.checkpoint import save_policy
from agents.policy.policy_agent import PolicyAgent, new_policy
from agents.policy.spec import Layout, PolicySpec
from envs.config import EnvConfig
from envs.layout import observation_layout
from envs.objects import objects_named
from questsim.cli import main, run
from questsim.errors import InputError
from questsim.metrics import evaluate as metrics_of
from questsim.motion.clip import Clip
from questsim.motion.library import save_library
from questsim.motion.retarget_back import to_motion
from questsim.skeleton import NUM_DOFS

START = EnvConfig(fixed_start=True)


@pytest.fixture(scope="module")
def clips() -> list[Clip]:
    return [
        swaying_clip("long", frames=60, height_m=1.75),
        swaying_clip("short", frames=12, height_m=1.60, kind="wave"),
        swaying_clip("middle", frames=30, height_m=1.85),
    ]


@pytest.fixture(scope="module")
def library(clips, tmp_path_factory):
    path = tmp_path_factory.mktemp("motions") / "sway.npz"
    save_library(path, [to_motion(clip) for clip in clips], clips)
    return path


def sparse_agent(sensors: str = "H+2C", **head) -> PolicyAgent:
    torch.manual_seed(0)
    config = EnvConfig(sensors=sensors)
    layout = Layout.of(observation_layout(config))
    policy = new_policy(PolicySpec(critic_blocks=(), hidden=(16,)), layout, **head)
    return PolicyAgent(policy, Needs(sensors=sensors))


def test_rollout_starts_at_the_clips_first_frame_in_the_clips_order(clips):
    rollouts = roll_out(ZeroAgent(), clips, START)
    assert [r.name for r in rollouts] == ["long", "short", "middle"]
    for rollout, clip in zip(rollouts, clips, strict=True):
        assert rollout.height_m == pytest.approx(clip.height_m)
        np.testing.assert_allclose(rollout.joint_angles[0], clip.qpos[0, 7:], atol=1e-5)
        np.testing.assert_allclose(rollout.link_position[0], clip.link_position[0], atol=2e-3)
        assert rollout.link_error_m[0] < 2e-3


def test_short_clip_is_followed_to_its_end_and_a_long_one_until_the_fall(clips):
    long, short, _ = roll_out(ZeroAgent(), clips, START)
    assert not short.fell
    assert len(short) == 12
    # Without torques, one and a half seconds are enough to fall.
    assert long.fell
    assert len(long) < 60
    assert long.link_error_m[-1] > 0.5 > long.link_error_m[-2]


def test_a_rollout_does_not_depend_on_its_batch(clips, monkeypatch):
    together = roll_out(ZeroAgent(), clips, START)
    monkeypatch.setattr("agents.evaluation.rollout.BATCH_CLIPS", 1)
    alone = roll_out(ZeroAgent(), clips, START)
    for a, b in zip(together, alone, strict=True):
        np.testing.assert_array_equal(a.link_position, b.link_position)
        np.testing.assert_array_equal(a.contact_force, b.contact_force)


def test_score_is_the_reward_a_frame_of_the_clip(clips):
    sim = evaluation_sim(clips, START)
    followed = follow(ZeroAgent(), sim, clips)
    np.testing.assert_array_equal(followed.length, [59, 11, 29])
    assert followed.frames[0] < 59
    assert followed.frames[1] == 11
    expected = np.mean(followed.total_reward / followed.length)
    assert followed.score == pytest.approx(expected)
    assert followed.tracked == pytest.approx(1 - followed.fell.mean())


def test_random_agent_is_the_same_after_each_reset():
    agent = RandomAgent(3)
    obs = np.zeros((2, 475), np.float32)
    agent.reset(2)
    first = agent.act(obs)
    assert np.abs(first).max() <= 1.0
    assert not np.array_equal(agent.act(obs), first)
    agent.reset(2)
    np.testing.assert_array_equal(agent.act(obs), first)


def test_agent_gets_the_environment_it_was_trained_in():
    agent = PolicyAgent(sparse_agent("H").policy, Needs("H", 2, True, "paper"))
    config = env_config(agent)
    assert (config.sensors, config.future_frames) == ("H", 2)
    assert config.privileged
    assert config.body_preset == "paper"
    assert config.fixed_start
    assert env_config(agent, height_m=1.5).heights == (1.5, 1.5)
    assert env_config(ZeroAgent(), "QuestSimHeadset-v0").sensors == "H"


def test_unknown_environment_lists_the_known_ones():
    with pytest.raises(InputError, match="QuestSimHeadset-v0"):
        env_config(ZeroAgent(), "QuestSim-v9")


def test_agent_for_controllers_is_refused_where_there_are_none(clips):
    agent = sparse_agent("H+2C")
    with pytest.raises(InputError, match=r"observes H\+2C with 6 future frames, not H with 6"):
        roll_out(agent, clips, env_config(agent, "QuestSimHeadset-v0"))


def test_height_scales_avatar_and_reference(clips):
    (rollout,) = roll_out(ZeroAgent(), clips[:1], replace(START, heights=(1.4, 1.4)))
    assert rollout.height_m == pytest.approx(1.4)
    expected = clips[0].link_position[0] * 1.4 / 1.75
    np.testing.assert_allclose(rollout.link_position[0], expected, atol=2e-3)
    np.testing.assert_allclose(rollout.reference.link_position[0], expected, atol=1e-5)


def test_rollouts_keep_where_the_objects_were_and_what_they_look_like(clips):
    config = replace(START, heights=(1.4, 1.4), objects=objects_named(("ball", "chair")))
    rollout = roll_out(ZeroAgent(), clips[:1], config)[0]
    ball, chair = rollout.objects
    assert [part.shape for part in ball.parts] == ["ball"] and len(chair.parts) == 6
    assert ball.position.shape == (len(rollout), 3) and chair.quat.shape == (len(rollout), 4)
    sim = evaluation_sim(clips[:1], config)
    sim.reset()
    np.testing.assert_allclose(ball.position[0], sim.objects.pose[0, 0, :3], atol=1e-6)
    seat = chair.parts[0]
    assert seat.place[2] + seat.size[2] == pytest.approx(0.45 * 1.4 / 1.75)
    for _ in range(len(rollout) - 1):
        sim.step(np.zeros((1, NUM_DOFS)))
    np.testing.assert_allclose(ball.position[-1], sim.objects.pose[0, 0, :3], atol=1e-6)
    assert roll_out(ZeroAgent(), clips[:1], START)[0].objects == ()


def test_motion_shorter_than_the_future_window_is_refused_by_name(clips):
    with pytest.raises(InputError, match="tiny"):
        roll_out(ZeroAgent(), [*clips, swaying_clip("tiny", frames=4)], START)


def test_stiff_joints_stand_longer_than_limp_ones(clips):
    """A policy that is nothing but its torque head holds the knees up for a while."""
    stiff = sparse_agent(gains=np.full(NUM_DOFS, 1.0))
    zero, held = (roll_out(agent, clips[:1], START)[0] for agent in (ZeroAgent(), stiff))
    assert len(held) > len(zero)


def test_command_prints_the_table_and_writes_the_report(library, tmp_path, capsys):
    save_policy(tmp_path / "agent", sparse_agent().policy, Needs(), {"licence": "MIT"})
    out = tmp_path / "report"
    args = EvaluateArgs(str(tmp_path / "agent"), str(library), out=out, threads=1)
    assert evaluate(args) == 0
    assert "MPJPE" in capsys.readouterr().out
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["all"]["clips"] == 3
    assert metrics["context"]["training"] == {"licence": "MIT"}
    assert len(metrics["context"]["data"]["sha256"]) == 64
    assert (out / "clips.csv").exists()


def test_the_height_of_the_command_line_is_that_of_avatar_and_clips(
    clips, library, tmp_path, capsys
):
    command = ["--agent", "zero", "--motions", str(library), "--out", str(tmp_path), "--threads"]
    assert run(evaluate, EvaluateArgs, [*command, "1", "--height", "1.45"]) == 0
    lines = (tmp_path / "clips.csv").read_text().splitlines()
    column = lines[0].split(",").index("height_m")
    assert [line.split(",")[column] for line in lines[1:]] == ["1.45"] * 3
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["context"]["config"]["heights"] == [1.45, 1.45]
    own, small = (
        metrics_of(roll_out(ZeroAgent(), clips, replace(START, heights=heights)))
        for heights in (None, (1.45, 1.45))
    )
    error = metrics["all"]["mpjpe_cm"]
    assert error == pytest.approx(small["all"]["mpjpe_cm"], rel=1e-3)
    assert abs(error - own["all"]["mpjpe_cm"]) > 0.1


def test_command_without_folder_writes_nothing(library, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert evaluate(EvaluateArgs("zero", str(library), max_clips=2, threads=1)) == 0
    assert "success" in capsys.readouterr().out
    assert [p.name for p in tmp_path.iterdir() if p.name != "MUJOCO_LOG.TXT"] == []


def test_begin_and_noise_change_how_avatars_begin_and_what_they_are_shown(clips):
    plain = env_config(ZeroAgent())
    standing = _config_of(EvaluateArgs("zero", begin="standing"), plain)
    noisy = _config_of(EvaluateArgs("zero", begin="standing", noise=True), plain)
    sims = [evaluation_sim(clips, config) for config in (plain, noisy, standing)]
    for sim in sims:
        sim.reset()
    assert not sims[1].joint_angles.any()
    assert sims[0].joint_angles.any()
    devices = sims[1].layout["o_user"]
    moved = (sims[1].observation - sims[2].observation)[:, devices]
    assert 0.005 < np.abs(moved).mean() < 0.1
    assert _config_of(EvaluateArgs("zero"), plain) == plain


def test_video_without_folder_and_unknown_agents_are_refused(library, tmp_path):
    with pytest.raises(InputError, match="--out"):
        evaluate(EvaluateArgs("zero", str(library), video=True))
    with pytest.raises(InputError, match="zero, random"):
        evaluate(EvaluateArgs("nobody", str(library), out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("options", [{"threads": 0}, {"max_clips": 0}, {"seed": -1}])
def test_numbers_that_are_too_small_are_refused_by_option(options, library):
    with pytest.raises(InputError, match=f"--{next(iter(options)).replace('_', '-')}: is"):
        evaluate(EvaluateArgs("zero", str(library), **options))


def test_baselines_go_by_name():
    assert load_agent("zero").name == "zero"
    assert load_agent("random").name == "random"


def test_groups_of_a_mixture_are_counted_under_each_condition(library, clips, tmp_path, capsys):
    save_library(tmp_path / "more.npz", [], [replace(clips[0], kind="more")])
    entries = [f'[[test]]\nmotions = "{file}"\n' for file in (library, tmp_path / "more.npz")]
    (tmp_path / "mine.toml").write_text("".join(entries))
    out, line = tmp_path / "out", "evaluate --by-group --agent zero --threads 1"
    line += f" --motions {tmp_path / 'mine.toml'} --out {out} --under"
    assert main([*line.split(), "noon"]) == 2
    assert "--under: there is no condition 'noon'; choose from reference" in capsys.readouterr().err
    assert main([*line.split(), "noise", "noise"]) == 2
    assert "--under: has a value twice" in capsys.readouterr().err
    assert main([*line.split(), "--seed", "3", "--under", "noise"]) == 2
    assert "--seed: has no effect" in capsys.readouterr().err
    assert not out.exists()
    assert main([*line.split(), "reference", "standing"]) == 0
    assert "standing" in capsys.readouterr().out
    found = json.loads((out / "groups.json").read_text())["groups"]
    assert list(found) == ["reference", "standing"]
    for name, groups in found.items():
        rows = list(csv.DictReader((out / name / "clips.csv").open()))
        assert {group: each["clips"] for group, each in groups.items()} == {
            "all": 4, str(library): 3, "more.npz": 1,
        }  # fmt: skip
        completed = [int(row["completed"]) for row in rows]
        assert groups["all"]["completed"] == sum(completed)
        assert groups["more.npz"]["completed"] == completed[-1]


def test_a_ground_given_as_the_environment_says_which_option_takes_it(capsys) -> None:
    """train.py's --env takes a ground."""
    assert main(["evaluate", "--agent", "zero", "--env", "stairs:step_height_m=0.1"]) == 2
    error = capsys.readouterr().err
    assert "there is no environment 'stairs:step_height_m=0.1'" in error
    assert "write --terrain stairs:step_height_m=0.1, or choose from QuestSim-v0" in error
