"""Feet that float or lean in a file stand on the avatar; stairs and flight stay as they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import swaying_clip

from questsim import rotations as rot
from questsim.motion import footing as footing_module
from questsim.motion.clip import FPS, Clip
from questsim.motion.footing import measure_footing
from questsim.motion.kinematics import clip_from_qpos, sole_points, sole_positions
from questsim.motion.motion import Motion
from questsim.motion.retarget import to_clip
from questsim.motion.retarget_back import to_motion
from questsim.motion.retarget_stream import StreamRetargeter
from questsim.motion.spec import load_motions
from questsim.motion.stance import Soles, from_lean, lean, lowest_point, measure_soles, plant
from questsim.motion.stance_figures import stance_figures
from questsim.motion.stance_stream import StancePlanter
from questsim.skeleton import DOFS, FOOT_LINKS, JOINTS, LINKS

HEIGHT = 1.75
ANKLE_M = float(-sole_points()[..., 2].mean())
ANKLES = [JOINTS.index("left_ankle"), JOINTS.index("right_ankle")]
FLOAT_M, PITCH, ROLL = (0.045, 0.02), np.radians([6.0, -4.0]), np.radians([-5.0, 7.0])


@pytest.fixture(scope="module")
def walk() -> Clip:
    return load_motions("synthetic:walk")[0]


def spoiled(motion: Motion) -> Motion:
    """The motion with feet that lean by ``PITCH`` and ``ROLL`` on shins of other lengths."""
    rotations, offsets = motion.rotations.copy(), motion.offsets.copy()
    for foot, ankle in enumerate(ANKLES):
        turn = from_lean(np.zeros(()), PITCH[foot], ROLL[foot])
        rotations[:, ankle] = rot.quat_multiply(rotations[:, ankle], turn)
        offsets[ankle, 2] += FLOAT_M[foot]
    return replace(motion, rotations=rotations, offsets=offsets)


def soles(clip: Clip) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lowest point and tilt of each sole ``(T, 2)`` in metres, and whether its foot is still."""
    feet = list(FOOT_LINKS)
    points = sole_positions(clip.link_position[:, feet], clip.link_quat[:, feet], clip.height_m)
    still = np.linalg.norm(clip.link_velocity[:, feet], axis=-1) < 0.25
    return points[..., 2].min(axis=-1), np.ptp(points[..., 2], axis=-1), still


def standing(frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Targets of two flat feet that stand 20 cm apart."""
    ankles = np.zeros((frames, 2, 3))
    ankles[:, 0, 1], ankles[:, 1, 1], ankles[..., 2] = 0.1, -0.1, ANKLE_M
    feet = np.zeros((frames, 2, 4))
    feet[..., 0] = 1.0
    return ankles, feet


def test_feet_that_float_and_lean_are_planted(walk: Clip) -> None:
    motion = to_motion(walk)
    low, tilt, still = soles(to_clip(spoiled(motion)))
    assert np.abs(low[still]).mean() < 0.007 and np.percentile(np.abs(low[still]), 90) < 0.015
    assert tilt[still].mean() < 0.01
    assert (low.min(axis=1) < 0.01).mean() > 0.97


def test_a_stream_plants_feet_as_whole_motions_do(walk: Clip) -> None:
    motion = spoiled(to_motion(walk))
    whole = to_clip(motion)
    put = StreamRetargeter(motion, whole.height_m)
    poses = [
        replace(motion, root_position=motion.root_position[i : i + 1], rotations=turned[None])
        for i, turned in enumerate(motion.rotations[:90])
    ]
    rows = np.concatenate([put(pose) for pose in poses])
    stream = clip_from_qpos("stream", rows, whole.height_m)
    low, tilt, still = soles(stream)
    assert np.abs(low[still]).mean() < 0.007 and tilt[still].mean() < 0.01
    apart = np.linalg.norm(stream.link_position - whole.link_position[:90], axis=-1)
    assert apart.mean() < 0.01 and np.percentile(apart, 99) < 0.06
    put.reset()
    np.testing.assert_array_equal(put(poses[0])[0], rows[0])


def test_an_estimate_floats_over_the_footing_of_another_recording(walk: Clip) -> None:
    user = to_motion(walk)
    footing = measure_footing(user, walk.height_m)
    lift = np.array([0.0, 0.0, 0.1])
    for sign in (1.0, -1.0):
        lifted = replace(user, root_position=user.root_position + sign * lift)
        moved = to_clip(lifted, footing).link_position - to_clip(user).link_position
        np.testing.assert_allclose(moved.mean(axis=(0, 1))[2], sign * 0.1, atol=0.005)


def test_arms_and_trunk_do_not_notice_that_feet_are_planted(
    walk: Clip, monkeypatch: pytest.MonkeyPatch
) -> None:
    motion = spoiled(to_motion(walk))
    planted = to_clip(motion)
    monkeypatch.setattr(footing_module, "measure_soles", lambda *_: Soles())
    floating = to_clip(motion)
    legs = [7 + i for i, dof in enumerate(DOFS) if any(j in dof for j in ("hip", "knee", "ankle"))]
    rest = [i for i in range(3, 40) if i not in legs]
    np.testing.assert_array_equal(planted.qpos[:, rest], floating.qpos[:, rest])
    assert np.abs(planted.qpos[:, legs] - floating.qpos[:, legs]).max() > 0.05


def test_feet_that_stand_already_are_left_alone(walk: Clip) -> None:
    feet = list(FOOT_LINKS)
    assert not measure_soles(walk.link_position[:, feet], walk.link_quat[:, feet], HEIGHT).flat


def test_each_soles_lean_and_height_are_measured() -> None:
    ankles, feet = standing(40)
    ankles[..., 2] += FLOAT_M
    feet = np.tile(from_lean(np.zeros(2), PITCH, ROLL), (40, 1, 1))
    found = measure_soles(ankles, feet, HEIGHT)
    assert found.flat
    np.testing.assert_allclose(rot.quat_multiply(feet[0], found.turn)[:, 0], 1.0, atol=1e-9)
    np.testing.assert_allclose(found.level_m, FLOAT_M, atol=2e-3)
    planted, flat, rise, stands = plant(found, ankles, feet, HEIGHT)
    assert stands.all()
    np.testing.assert_allclose(sole_positions(planted, flat, HEIGHT)[..., 2], 0.0, atol=2e-3)
    np.testing.assert_allclose(rise, -np.mean(FLOAT_M), atol=2e-3)


def test_stairs_and_ramps_are_left_alone() -> None:
    ankles, feet = standing(240)
    step = (np.arange(240)[:, None] + [0, 15]) // 30  # each foot a step a second, in turn
    for rise in (0.15, 0.03):  # m a step of 0.3 m: stairs, a ramp of 5.7 degrees
        climbing = ankles + np.stack([0.3 * step, 0.0 * step, rise * step + 0.03], axis=-1)
        assert not measure_soles(climbing, feet, HEIGHT).flat


def test_ground_is_level_for_someone_on_tiptoe() -> None:
    ankles, feet = standing(100)
    ankles[..., 2] += 0.065
    feet[40:60] = from_lean(np.zeros(()), np.radians(50.0), np.zeros(()))
    # The toes bend, the avatar's sole does not: it sinks to what looks like the floor.
    sunk = lowest_point(ankles, feet, HEIGHT)[40:60]
    ankles[40:60, :, 2] -= sunk
    found = measure_soles(ankles, feet, HEIGHT)
    assert found.flat
    np.testing.assert_allclose(found.level_m, 0.065, atol=0.01)


def test_a_capture_whose_floor_slopes_a_little_is_levelled() -> None:
    ankles, feet = standing(240)
    step = (np.arange(240)[:, None] + [0, 15]) // 30
    walking = ankles + np.stack([0.3 * step, 0.0 * step, 0.01 * step + 0.03], axis=-1)
    planted, flat, _, stands = plant(measure_soles(walking, feet, HEIGHT), walking, feet, HEIGHT)
    low = sole_positions(planted, flat, HEIGHT)[..., 2].min(axis=-1)
    assert stands.mean() > 0.8 and np.abs(low[stands]).max() < 0.003


def test_flight_keeps_its_acceleration() -> None:
    ankles, feet = standing(60)
    time = np.arange(21) / 36.0
    ankles[20:41, :, 2] += (0.5 * 9.81 * time * (time[-1] - time))[:, None]
    ankles[..., 2] += 0.03
    ankles[40:, :, 2] += 0.02  # lands higher than it took off
    found = measure_soles(ankles, feet, HEIGHT)
    planted, _, rise, _ = plant(found, ankles, feet, HEIGHT)
    flight = slice(25, 36)
    before, after = (np.diff(a[flight, :, 2], 2, axis=0) * 36.0**2 for a in (ankles, planted))
    np.testing.assert_allclose(after, before, atol=1e-6)
    np.testing.assert_allclose(np.diff(rise[flight], 2), 0.0, atol=2e-4)


def test_a_foot_that_rolls_keeps_its_pitch() -> None:
    ankles, feet = standing(60)
    ankles[..., 2] += 0.03
    heel_up = np.radians(np.clip(np.arange(60) - 30, 0, 30))
    feet[:, 0] = from_lean(np.zeros(60), heel_up, np.zeros(60))
    _, flat, _, _ = plant(measure_soles(ankles, feet, HEIGHT), ankles, feet, HEIGHT)
    _, pitch, _ = lean(flat[:, 0])
    np.testing.assert_allclose(pitch[50:], heel_up[50:], atol=np.radians(0.5))
    np.testing.assert_allclose(pitch[:28], 0.0, atol=np.radians(0.5))


def test_feet_that_a_file_turns_but_whose_ankles_are_low_lie_flat(walk: Clip) -> None:
    """As in SIE's runs: the sole points down by 25 degrees, but the ankle is as low as if flat."""
    ankles, _ = standing(60)
    tiptoe = np.tile(from_lean(np.zeros(2), np.radians([25.0, 21.0]), np.zeros(2)), (60, 1, 1))
    found = measure_soles(ankles, tiptoe, HEIGHT, ANKLE_M)
    planted, flat, _, stands = plant(found, ankles, tiptoe, HEIGHT)
    assert stands.all()
    np.testing.assert_allclose(sole_positions(planted, flat, HEIGHT)[..., 2], 0.0, atol=2e-3)
    raised = ankles + np.array([0.0, 0.0, 0.07])  # with the toes on the floor
    on_toes = measure_soles(raised, tiptoe, HEIGHT, ANKLE_M)
    np.testing.assert_array_equal(on_toes.turn[:, 0], 1.0)
    _, kept, _, _ = plant(on_toes, raised, tiptoe, HEIGHT)
    np.testing.assert_allclose(lean(kept)[1], np.tile(np.radians([25.0, 21.0]), (60, 1)))


def test_a_foot_touches_the_floor_in_a_walk_whose_feet_slide() -> None:
    ankles, feet = standing(240)
    along = np.arange(240) / 36.0 * 1.2
    lift = 0.06 * np.maximum(0.0, np.sin(np.arange(240)[:, None] / 6.0 + [0.0, np.pi]))
    ankles[..., 0] += np.where(np.arange(240) < 40, 0.0, along - along[40])[:, None]
    ankles[..., 2] += 0.03 + np.where(np.arange(240)[:, None] < 40, 0.0, 0.02 + lift)
    found = measure_soles(ankles, feet, HEIGHT)
    planted, flat, _, _ = plant(found, ankles, feet, HEIGHT)
    low = sole_positions(planted, flat, HEIGHT)[..., 2].min(axis=(1, 2))
    assert found.flat and (low < 0.005).mean() > 0.97
    hips = ankles.mean(axis=1, keepdims=True) + np.array([[0.0, 0.1, 0.7], [0.0, -0.1, 0.7]])
    stream, turned, *_ = StancePlanter(found, HEIGHT)(hips, ankles, feet, 0.8)
    low = sole_positions(stream, turned, HEIGHT)[..., 2].min(axis=(1, 2))
    assert np.percentile(np.abs(low[60:]), 90) < 0.015
    flight = ankles.copy()  # 0.25 s without a foot on the floor is a flight, whatever its height
    flight[:, :, 0] = 0.0
    flight[:, :, 2] = ANKLE_M + 0.03
    flight[100:109, :, 0] += np.linspace(0.0, 0.5, 9)[:, None]
    flight[109:, :, 0] += 0.5
    flight[101:108, :, 2] += 0.05
    planted, _, _, stands = plant(measure_soles(flight, feet, HEIGHT), flight, feet, HEIGHT)
    assert not stands[103:106].any()
    np.testing.assert_allclose(planted[103:106, :, 2] - ANKLE_M, 0.05, atol=2e-3)


def test_figures_tell_feet_that_float_from_feet_that_stand(
    walk: Clip, monkeypatch: pytest.MonkeyPatch
) -> None:
    motion = spoiled(to_motion(walk))
    planted = stance_figures(motion, to_clip(motion))
    assert planted.warnings() == []
    assert planted.contact > 0.97 and planted.bears > 0.9
    assert planted.skate_cm_s < planted.file_skate_cm_s + 2.0
    monkeypatch.setattr(footing_module, "measure_soles", lambda *_: Soles())
    floating = stance_figures(motion, to_clip(motion))
    assert floating.sole_cm > 1.0 and floating.tilt_cm > 2.0
    assert "still soles tilt by" in "; ".join(floating.warnings())


def test_figures_are_those_of_a_foot_lifted_by_hand() -> None:
    clip = swaying_clip()
    qpos = clip.qpos.copy()
    qpos[:, 2] += 0.02
    lifted = clip_from_qpos("lifted", qpos, clip.height_m)
    found = stance_figures(to_motion(clip), lifted)
    assert found.sole_cm == pytest.approx(2.0, abs=0.05) and found.tilt_cm < 0.05
    assert found.still == 1.0 and np.isnan(found.contact)
    assert found.warnings() == ["still soles are 2.0 cm off the floor"]


def skating(clip: Clip) -> float:
    """Mean speed in m/s of the centres of still soles."""
    feet = list(FOOT_LINKS)
    points = sole_positions(clip.link_position[:, feet], clip.link_quat[:, feet], clip.height_m)
    speed = np.linalg.norm(np.gradient(points.mean(axis=-2), 1 / 36, axis=0), axis=-1)
    return float(speed[soles(clip)[2]].mean())


def test_feet_of_a_stream_that_point_outwards_skate_no_more_than_a_whole_motions(
    walk: Clip,
) -> None:
    motion = spoiled(to_motion(walk))
    rotations = motion.rotations[:90].copy()
    for ankle, outwards in zip(ANKLES, (0.6, -0.6), strict=True):
        rotations[:, ankle] = rot.quat_multiply(
            rotations[:, ankle], rot.yaw_quat(np.array(outwards))
        )
    motion = replace(motion, root_position=motion.root_position[:90], rotations=rotations)
    whole = to_clip(motion)
    rows = StreamRetargeter(motion, whole.height_m)(motion)
    stream = clip_from_qpos("stream", rows, whole.height_m)
    assert skating(stream) < 1.1 * skating(whole)


def kneeling(walk: Clip, frames: int = 40) -> Motion:
    """Someone who squats with the trunk and the pelvis bent forward by 90 degrees."""
    motion = to_motion(walk)
    bends = {"root": 90, "left_hip": -175, "left_knee": 95, "left_ankle": -10}
    bends |= {joint.replace("left", "right"): bend for joint, bend in bends.items()}
    rotations = np.zeros((frames, len(JOINTS), 4))
    rotations[..., 0] = 1.0
    for joint, bend in bends.items():
        half = np.radians(bend) / 2.0
        rotations[:, JOINTS.index(joint)] = [np.cos(half), 0.0, np.sin(half), 0.0]
    still = replace(motion, rotations=rotations, root_position=np.zeros((frames, 3)), fps=FPS)
    toes = still.forward_kinematics()[0][:, JOINTS.index("left_toe")]
    return replace(still, root_position=-toes + [0.0, 0.0, 0.03])


def test_hips_at_the_end_of_their_range_press_no_foot_into_the_floor(walk: Clip) -> None:
    motion = kneeling(walk)
    clip = to_clip(motion)
    stream = StreamRetargeter(to_motion(walk), clip.height_m)(motion)
    streamed = clip_from_qpos("stream", stream, clip.height_m)
    _, quat = motion.forward_kinematics()
    for each in (clip, streamed):
        lowest = soles(each)[0]
        assert lowest[5:].min() > -0.01
        chest = each.link_quat[5:, LINKS.index("chest")]
        turned = rot.angle_between(chest, quat[5:, JOINTS.index("spine3")])
        assert np.degrees(turned).max() < 10.0
