"""What the sheets of falls tell: where the avatar was, how it leant, how late its hands were."""

from __future__ import annotations

import numpy as np
import pytest
from rollouts import moving_clip, rollout, shifted, still_clip, turned
from scipy.spatial.transform import Rotation

from docs.figures.falls import hands_late_ms, leaning_deg, lost_at, offsets_cm
from questsim.motion.clip import FPS
from questsim.motion.kinematics import clip_from_qpos
from questsim.skeleton import LINKS


def test_offsets_are_along_the_users_heading() -> None:
    qpos = still_clip(3).qpos.copy()
    qpos[:, 3:7] = Rotation.from_euler("z", 90, degrees=True).as_quat(scalar_first=True)
    facing_left = clip_from_qpos("left", qpos, 1.75, None)
    moved = rollout(facing_left, link_position=shifted(facing_left, (0.0, 0.1, -0.02)))
    np.testing.assert_allclose(offsets_cm(moved, 1, 0), [10.0, 0.0, -2.0], atol=1e-6)


def test_a_user_is_lost_when_the_error_stays_large() -> None:
    clip = still_clip(20)
    off = np.zeros((20, 1, 3))
    off[3:5, 0, 0] = off[12:, 0, 0] = 0.2
    assert lost_at(rollout(clip, link_position=clip.link_position + off)) == 12


def test_leaning_forward_is_positive() -> None:
    clip = still_clip(4)
    leaning = turned(clip.link_quat, [LINKS.index("chest")], 12.0)
    assert leaning_deg(rollout(clip, link_quat=leaning)) == pytest.approx(12.0, abs=0.01)


def test_hands_that_are_three_frames_late_are_told_so() -> None:
    clip = moving_clip(60)
    late = np.concatenate([clip.link_position[:1].repeat(3, axis=0), clip.link_position[:-3]])
    hands = [LINKS.index(f"{side}_hand") for side in ("left", "right")]
    position = clip.link_position.copy()
    position[:, hands] = (late[:, hands] - late[:, :1]) + position[:, :1]
    short = rollout(moving_clip(5))
    assert hands_late_ms([rollout(clip, link_position=position), short]) == pytest.approx(3e3 / FPS)
