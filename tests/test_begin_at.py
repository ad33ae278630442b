"""Episodes that begin in an estimate, and avatars of another size than their user."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import swaying_clip

from agents.kinematic.first_answers import (
    SETTLED_FRAMES,
    first_answers,
    settled_after,
    settled_answers,
)
from agents.training.options import TrainArgs
from agents.training.rollout_worker import BatchSpec
from agents.training.start_estimates import start_estimates
from envs import BatchSim, EnvConfig, Terrain
from envs.randomisation import Randomisation
from envs.starts import WHOLLY, Starts
from envs.terrain import TERRAINS
from questsim.bodies import read_body
from questsim.errors import InputError
from questsim.motion.kinematics import clip_from_qpos
from questsim.motion.library import save_library
from questsim.motion.spec import load_motions
from questsim.skeleton import LINKS

CLIPS = [swaying_clip("a", 1.75), swaying_clip("b", 1.6)]


def shifted(name: str, height_m: float, frames: int):
    qpos = swaying_clip(name, height_m).qpos[:frames].copy()
    qpos[:, :2] += 0.07
    return clip_from_qpos(name, qpos, height_m)


@pytest.mark.parametrize("terrain", [None, Terrain("rough", size_m=16.0)])
def test_episodes_begin_in_the_estimate_of_their_frame_and_else_in_the_reference(terrain) -> None:
    config = EnvConfig(starts=Starts(estimate=1.0), terrain=terrain)
    sim = BatchSim(CLIPS, config, begin_at={"b": shifted("b", 1.6, 10)}, seed=1)
    plain = BatchSim(CLIPS, EnvConfig(terrain=terrain), seed=1)
    for clip, frame, off in ((1, 0, 0.07), (1, 9, 0.07), (1, 10, 0.0), (0, 0, 0.0)):
        for each in (sim, plain):
            each.reset(np.array([1]), clip, frame)
        apart = np.linalg.norm(sim.qpos[1, :2] - plain.qpos[1, :2])
        assert apart == pytest.approx(off * np.sqrt(2.0), abs=1e-6)
        assert -1e-4 < sim.foot_clearance[1].min() < 0.03


def test_estimates_that_do_not_fit_their_motions_are_refused() -> None:
    config = EnvConfig(starts=Starts(estimate=0.5))
    with pytest.raises(InputError, match="belong together"):
        BatchSim(CLIPS, config)
    with pytest.raises(InputError, match="belong together"):
        BatchSim(CLIPS, EnvConfig(), begin_at={"a": CLIPS[0]})
    with pytest.raises(InputError, match="no estimate of these"):
        BatchSim(CLIPS, config, begin_at={"c": CLIPS[0]})
    with pytest.raises(InputError, match="estimate has 72 frames, the motion 60"):
        BatchSim([swaying_clip("a", frames=60)], config, begin_at={"a": CLIPS[0]})


@pytest.mark.parametrize("difference", [0.15, -0.15])
def test_devices_are_not_scaled_to_an_avatar_of_another_size(difference: float) -> None:
    config = EnvConfig(fixed_start=True)
    sim = BatchSim(CLIPS, replace(config, unscaled_m=difference))
    own = BatchSim(CLIPS, config)
    for each in (sim, own):
        each.reset()
    np.testing.assert_allclose(sim.heights, [1.75 + difference, 1.6 + difference])
    user = sim.layout["o_user"]
    heights = [s.observation[:, user].reshape(2, 6, 3, 9)[..., 2] for s in (sim, own)]
    np.testing.assert_allclose(heights[0], heights[1], atol=1e-6)
    assert np.abs(sim.foot_clearance.min(axis=-1) - own.foot_clearance.min(axis=-1)).max() < 0.005
    head = (sim.link_positions - own.link_positions)[:, LINKS.index("head"), 2]
    assert (np.sign(difference) * head > 0.1).all()
    for i, clip in enumerate(CLIPS):
        np.testing.assert_allclose(sim.placed_clip(i, clip).qpos, clip.qpos, atol=1e-6)
    on = [BatchSim(CLIPS, replace(c.config, terrain=TERRAINS["rough"])) for c in (sim, own)]
    for each in on:
        each.reset()
    lowest = [each.foot_clearance.min(axis=-1) for each in on]
    assert np.abs(lowest[0] - lowest[1]).max() < 0.02


def test_differences_of_stature_are_drawn_for_each_simulation() -> None:
    drawn = Randomisation(unscaled_m=(-0.2, 0.1))
    sim = BatchSim(CLIPS[:1], EnvConfig(randomisation=drawn), num_envs=40, seed=3)
    taller = sim.heights - sim.user_heights
    assert taller.min() < -0.15 and 0.05 < taller.max() <= 0.1
    np.testing.assert_allclose(sim.user_heights, CLIPS[0].height_m)
    with pytest.raises(InputError, match=r"unscaled_m .*-0.4"):
        Randomisation(unscaled_m=(-0.5, 0.0))
    small = EnvConfig(randomisation=drawn, heights=(1.2, 1.3))
    with pytest.raises(InputError, match=r"unscaled_m: the users would be 1\.1"):
        BatchSim(CLIPS[:1], small, num_envs=40, seed=3)
    with pytest.raises(InputError, match="unscaled_m does not go with a body of your own"):
        EnvConfig(randomisation=drawn, body=read_body("gymnasium-humanoid"))


def test_first_estimates_are_near_their_user() -> None:
    (estimate,) = first_answers(CLIPS[:1]).values()
    assert estimate.height_m == CLIPS[0].height_m and 2 < len(estimate) < 10
    apart = np.linalg.norm(estimate.link_position[0] - CLIPS[0].link_position[0], axis=-1)
    assert 1e-3 < apart.mean() < 0.15


def test_avatars_begin_in_an_estimate_that_has_settled_and_knows_no_later_frame() -> None:
    clips = load_motions("synthetic:walk+jog")[:3]
    begun, estimates = settled_answers(clips)
    first = first_answers(clips)
    errors, speeds = [], []
    for clip, rest in zip(clips, begun, strict=True):
        assert len(rest) == len(clip) - SETTLED_FRAMES
        np.testing.assert_array_equal(rest.qpos[0], clip.qpos[SETTLED_FRAMES])
        now, before = estimates[clip.name], first[clip.name]
        assert len(now) == 1
        errors.append([np.abs(now.link_position[0] - rest.link_position[0]).mean(),
                       np.abs(before.link_position[0] - clip.link_position[0]).mean()])  # fmt: skip
        speeds.append([np.abs(now.link_velocity[0] - rest.link_velocity[0]).mean(),
                       np.abs(before.link_velocity[0] - clip.link_velocity[0]).mean()])  # fmt: skip
    assert np.mean(errors, axis=0)[0] < np.mean(errors, axis=0)[1]
    assert np.mean(speeds, axis=0)[0] < np.mean(speeds, axis=0)[1]
    # What comes later does not change it.
    cut = [clip.first(SETTLED_FRAMES + 9) for clip in clips]
    for name, estimate in settled_answers(cut)[1].items():
        np.testing.assert_allclose(estimate.qpos, estimates[name].qpos, atol=1e-6)
        np.testing.assert_allclose(estimate.qvel, estimates[name].qvel, atol=1e-4)
    # The avatar is there.
    config = EnvConfig(starts=WHOLLY["estimate"], fixed_start=True)
    sim = BatchSim(begun, config, begin_at=estimates)
    sim.reset()
    np.testing.assert_allclose(
        sim.qpos[:, 7:40], [estimates[clip.name].qpos[0, 7:] for clip in clips], atol=1e-6
    )


def test_an_avatar_of_a_short_clip_begins_earlier() -> None:
    clip = CLIPS[0]
    assert settled_after(clip) == SETTLED_FRAMES
    assert settled_after(clip.first(11)) == 3 and settled_after(clip.first(5)) == 0
    begun, estimates = settled_answers([clip.first(11), replace(clip.first(8), name="short")])
    assert [len(each) for each in begun] == [8, 8] and list(estimates) == [clip.name, "short"]


def test_a_training_takes_the_estimates_of_its_motions_and_refuses_others(tmp_path) -> None:
    path, far = tmp_path / "estimates.npz", tmp_path / "far.npz"
    near = shifted("b@hmdposer", 1.6, 72)
    save_library(path, [], [near])
    qpos = near.qpos.copy()
    qpos[:, 0] += 3.0
    save_library(far, [], [clip_from_qpos("b@hmdposer", qpos, 1.6)])
    args = TrainArgs(tmp_path / "run", starts=Starts(estimate=0.5), start_estimates=str(path))
    found = start_estimates(args, CLIPS)
    assert found is not None and list(found) == ["b"]
    spec = BatchSpec(CLIPS, EnvConfig(starts=args.starts), 2, 0, begin_at=found)
    env = spec.make()
    env.change_clips(CLIPS[::-1], 1)
    env.reset()
    env.close()
    for changed, message in (
        ({"start_estimates": None}, "needs estimates"),
        ({"starts": Starts()}, "not used without a share"),
        ({"start_estimates": str(far)}, "not an estimate of this motion"),
    ):
        with pytest.raises(InputError, match=message):
            start_estimates(replace(args, **changed), CLIPS)
    with pytest.raises(InputError, match="not an estimate of one of --motions"):
        start_estimates(args, CLIPS[:1])
