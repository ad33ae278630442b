"""Torques by inverse dynamics are those that make the avatar move as its clip does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import swaying_clip

from envs.config import EnvConfig
from envs.core import BatchSim
from questsim.body import build_body
from questsim.motion import inverse_dynamics
from questsim.motion.clip import FPS
from questsim.motion.inverse_dynamics import InverseDynamics, reference_torques
from questsim.motion.kinematics import clip_from_qpos
from questsim.motion.synthesis.synthetic import seated_clips
from questsim.skeleton import DOFS, NUM_DOFS

GRAVITY = 9.81


def test_free_fall_takes_no_torques() -> None:
    time = np.arange(12) / FPS
    qpos = np.zeros((12, 7 + NUM_DOFS))
    qpos[:, 2], qpos[:, 3] = 3.0 - 0.5 * GRAVITY * time**2, 1.0
    torques = InverseDynamics().torques(clip_from_qpos("fall", qpos, 1.75))
    # Differences of velocities are exact for a parabola but at the ends.
    assert np.abs(torques[2:-2]).max() < 0.1


def drift(torques: np.ndarray, frames: int = 6) -> float:
    """RMS difference in rad of the joints from a swaying clip, driven by torques alone."""
    clip = swaying_clip()
    sim = BatchSim([clip], EnvConfig(fixed_start=True))
    sim.reset()
    for t in range(frames):
        sim.step(0.5 * (torques[t] + torques[t + 1])[None])
    return float(np.sqrt(np.mean((sim.joint_angles[0] - clip.qpos[frames, 7:]) ** 2)))


def test_the_torques_carry_the_avatar_along_its_clip_for_a_while() -> None:
    torques = reference_torques([swaying_clip()])
    assert drift(torques) < 0.25 * drift(np.zeros_like(torques))


@pytest.mark.parametrize("height", [1.4, 1.9])
def test_torques_are_of_the_body_of_the_clips_height(height: float) -> None:
    """A standing body's knees carry a weight of s^3 on an arm of s."""
    knee = DOFS.index("left_knee_y")
    own = InverseDynamics(height).torques(swaying_clip(height_m=height))[10, knee]
    middle = InverseDynamics().torques(swaying_clip())[10, knee]
    assert own / middle == pytest.approx((height / 1.75) ** 4, rel=0.1)


def test_inverse_dynamics_of_a_seated_clip_is_carried_by_the_chair() -> None:
    """Feet alone cannot carry a seated person: the centre of mass is behind the heels."""
    clip, dynamics = seated_clips()[0], InverseDynamics()
    sits = clip.qpos[:, 2] < 0.55
    with_chair, without = dynamics.forces(clip), dynamics.forces(replace(clip, kind="squat"))
    assert np.abs(with_chair[:, :6]).max() < 5.0 and with_chair[:, 6:].shape == (len(clip), 33)
    assert np.abs(without[sits, :6]).max() > 50.0
    np.testing.assert_array_equal(with_chair[~sits][:20], without[~sits][:20])


def test_torques_are_kept_by_motion_and_body(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("QUESTSIM_CACHE", str(tmp_path))
    clip = swaying_clip(frames=12)
    moved = replace(clip, qpos=clip.qpos + 0.01)
    first, second = reference_torques([clip]), reference_torques([moved])
    assert not np.array_equal(second, first)
    with monkeypatch.context() as other:
        other.setattr(inverse_dynamics, "InverseDynamics", None)  # not to be computed again
        both = reference_torques([moved, clip])
    np.testing.assert_array_equal(both, np.concatenate([second, first]))
    files = list((tmp_path / "torques").iterdir())
    assert len(files) == 2
    files[0].write_bytes(b"damaged")
    np.testing.assert_array_equal(reference_torques([moved, clip]), both)


def test_the_shared_model_is_left_as_it_is() -> None:
    before = int(build_body().model.opt.disableflags)
    InverseDynamics()
    assert int(build_body().model.opt.disableflags) == before
