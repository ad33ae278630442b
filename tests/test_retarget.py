"""Motion to clip and back: feet, hands, mirrors, floor."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from helpers import swaying_clip

from questsim import rotations as rot
from questsim.body import build_body
from questsim.errors import InputError
from questsim.motion.kinematics import sole_positions
from questsim.motion.retarget import mirror_clip, retargeting_error, to_clip
from questsim.motion.retarget_back import to_motion
from questsim.skeleton import FOOT_LINKS, LINKS

SHARED = Path(__file__).parents[2] / "shared" / "mocap" / "bandai-namco-2.zip"


def test_forward_kinematics_agree_with_mujoco() -> None:
    clip = swaying_clip(height_m=1.6)
    model = build_body(1.6).model
    data = mujoco.MjData(model)
    for frame in (0, 31):
        data.qpos[:] = clip.qpos[frame]
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(data.xpos[1:], clip.link_position[frame], atol=1e-9)
        angle = rot.angle_between(data.xquat[1:], clip.link_quat[frame])
        np.testing.assert_allclose(angle, 0.0, atol=1e-7)


def test_velocities_agree_with_mujocos_over_one_frame() -> None:
    clip = swaying_clip()
    model = build_body().model
    velocity = np.zeros(model.nv)
    mujoco.mj_differentiatePos(model, velocity, 2 / 36.0, clip.qpos[10], clip.qpos[12])
    np.testing.assert_allclose(clip.qvel[11], velocity, atol=1e-6)


def test_a_clip_survives_the_way_to_a_motion_and_back() -> None:
    clip = swaying_clip(height_m=1.75)
    motion = to_motion(clip)
    back = to_clip(motion)
    scale = back.height_m / clip.height_m
    np.testing.assert_allclose(back.qpos[:, 7:], clip.qpos[:, 7:], atol=0.02)
    np.testing.assert_allclose(back.qpos[:, :2], clip.qpos[:, :2] * scale, atol=1e-9)
    assert max(retargeting_error(motion, back).values()) < 0.5


def test_a_stature_that_no_avatar_has_is_refused_by_name() -> None:
    giant = to_motion(swaying_clip("giant"))
    giant = replace(giant, offsets=2.0 * giant.offsets)
    with pytest.raises(InputError, match=r"giant: the skeleton is 3\.\d+ m tall"):
        to_clip(giant)


def test_mirroring_a_clip_is_mirroring_its_motion() -> None:
    clip = swaying_clip()
    mirrored = mirror_clip(clip)
    again = mirror_clip(mirrored)
    np.testing.assert_allclose(again.qpos, clip.qpos, atol=1e-12)
    flipped = mirrored.link_position * [1.0, -1.0, 1.0]
    left, right = LINKS.index("left_hand"), LINKS.index("right_hand")
    np.testing.assert_allclose(flipped[:, left], clip.link_position[:, right], atol=1e-9)


def test_scaling_a_clip_scales_lengths_and_keeps_angles() -> None:
    clip = swaying_clip(height_m=1.75)
    small = clip.scaled(1.4)
    np.testing.assert_allclose(small.link_position, clip.link_position * 0.8)
    np.testing.assert_array_equal(small.qpos[:, 7:], clip.qpos[:, 7:])
    direct = swaying_clip(height_m=1.4)
    np.testing.assert_allclose(small.link_position, direct.link_position, atol=1e-9)


def _recorded(*names: str):
    from questsim.motion.spec import load_recordings

    return [m for name in names for m in load_recordings(name)]


@pytest.mark.skipif(not SHARED.exists(), reason="needs the shared Bandai-Namco archive")
@pytest.mark.parametrize(
    "name", ["walk_normal_001", "run_active_001", "wave-left-hand_elderly_002"]
)
def test_real_clips_stand_on_the_floor_within_joint_limits(name: str, tmp_path: Path) -> None:
    import zipfile

    with zipfile.ZipFile(SHARED) as archive:
        member = next(n for n in archive.namelist() if n.endswith(f"dataset-2_{name}.bvh"))
        (tmp_path / Path(member).name).write_bytes(archive.read(member))
    (motion,) = _recorded(str(tmp_path / Path(member).name))
    clip = to_clip(motion)
    feet = list(FOOT_LINKS)
    soles = sole_positions(clip.link_position[:, feet], clip.link_quat[:, feet], clip.height_m)
    assert soles[..., 2].min() > -0.01
    assert np.percentile(soles[..., 2].min(axis=(1, 2)), 10) < 0.02
    limits = build_body().model.jnt_range[1:]
    assert (clip.qpos[:, 7:] >= limits[:, 0]).all() and (clip.qpos[:, 7:] <= limits[:, 1]).all()
    # The avatar's ankles are lower over the sole, so a pitched foot's ankle lies elsewhere.
    errors = retargeting_error(motion, clip)
    assert errors["left_ankle"] < 6.0 and errors["right_knee"] < 4.0
