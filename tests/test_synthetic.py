"""Synthetic motion: the feet stand still, the body obeys physics, the values asked for are met."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from questsim.body import build_body
from questsim.errors import InputError
from questsim.motion.clip import FPS, Clip
from questsim.motion.synthesis.synthetic import KINDS, synthesise, synthetic_clips
from questsim.rotations import heading
from questsim.skeleton import LINKS

FEET = [LINKS.index("left_foot"), LINKS.index("right_foot")]
HANDS = [LINKS.index("left_hand"), LINKS.index("right_hand")]


@pytest.fixture(scope="module")
def library() -> list[Clip]:
    return synthetic_clips()


def sole_balls(clip: Clip) -> tuple[np.ndarray, float]:
    """Centres ``(2, T, 4, 3)`` of the soles' four round ends, and their radius."""
    model = build_body(clip.height_m).model
    centers, radius = [], 0.0
    for side, link in zip(("left", "right"), FEET, strict=True):
        local = []
        for geom in (model.geom(f"{side}_heel_ball_{w}") for w in ("outer", "inner")):
            radius = float(geom.size[0])
            axis = Rotation.from_quat(geom.quat, scalar_first=True).apply([0.0, 0.0, 1.0])
            local += [geom.pos + end * geom.size[1] * axis for end in (-1.0, 1.0)]
        turn = Rotation.from_quat(clip.link_quat[:, link], scalar_first=True)
        points = [clip.link_position[:, link] + turn.apply(p) for p in local]
        centers.append(np.stack(points, axis=1))
    return np.stack(centers), radius


def clearance(clip: Clip) -> np.ndarray:
    """Lowest point ``(2, T)`` of each foot above the floor."""
    centers, radius = sole_balls(clip)
    return centers[..., 2].min(axis=-1) - radius


def slides(clip: Clip) -> list[float]:
    """For every stance, metres that the foot's touching material moves along the floor."""
    centers, radius = sole_balls(clip)
    found = []
    for foot, link in enumerate(FEET):
        turn = Rotation.from_quat(clip.link_quat[:, link], scalar_first=True)
        spin = (turn[1:] * turn[:-1].inv()).as_rotvec()
        low = centers[foot, :, :, 2] - radius < 0.002
        moved = np.diff(centers[foot], axis=0) + np.cross(spin, [0.0, 0.0, -radius])[:, None]
        step = np.linalg.norm(moved[..., :2], axis=-1)
        both = low[1:] & low[:-1]
        least = np.where(both, step, np.inf).min(axis=-1)
        total = 0.0
        for metres in least:
            if np.isfinite(metres):
                total += metres
            elif total:
                found.append(total)
                total = 0.0
        found.append(total)
    return found


def mean_speed(clip: Clip) -> float:
    return float(np.linalg.norm(clip.qpos[-1, :2] - clip.qpos[0, :2]) / clip.duration)


def assert_within_limits(clip: Clip) -> None:
    limits = build_body(clip.height_m).model.jnt_range[1:]
    angles = clip.qpos[:, 7:]
    assert (angles > limits[:, 0]).all() and (angles < limits[:, 1]).all(), clip.name


def test_library_has_every_kind_once_named(library):
    assert 40 <= len(library) <= 60
    assert {clip.kind for clip in library} == set(KINDS)
    assert len({clip.name for clip in library}) == len(library)
    assert all(4.0 <= clip.duration <= 10.0 for clip in library)
    assert all(clip.licence == "MIT" and "synthetic" in clip.source for clip in library)


def test_stance_feet_do_not_slide(library):
    for clip in library:
        assert max(slides(clip)) < 0.01, clip.name


def test_feet_stay_above_the_floor(library):
    for clip in library:
        assert clearance(clip).min() > -0.005, clip.name


def test_some_foot_stands_unless_jogging(library):
    for clip in library:
        if clip.kind != "jog" and "2.4" not in clip.name:
            assert clearance(clip).min(axis=0).max() < 0.002, clip.name


def test_joint_angles_stay_within_the_limits(library):
    for clip in library:
        assert_within_limits(clip)


def test_joints_move_at_human_speeds_without_jumps(library):
    for clip in library:
        assert np.abs(np.diff(clip.qpos[:, 7:], axis=0)).max() * FPS < 15.0, clip.name
        assert np.abs(np.diff(clip.qvel[:, :3], axis=0)).max() * FPS < 25.0, clip.name


@pytest.mark.parametrize("height", [1.4, 1.75, 2.0])
@pytest.mark.parametrize("speed", [2.4, 3.5])
def test_jogging_flies_freely(height, speed):
    clip = synthesise("jog", speed=speed, height_m=height, duration=5.0)
    z = clip.qpos[:, 2]
    acceleration = (z[2:] - 2.0 * z[1:-1] + z[:-2]) * FPS**2
    airborne = np.min(clearance(clip), axis=0) > 0.004
    flight = airborne[2:] & airborne[1:-1] & airborne[:-2]
    assert flight.sum() >= 5
    assert acceleration[flight] == pytest.approx(-9.81, abs=0.2)


@pytest.mark.parametrize(
    ("kind", "speed"), [("walk", 1.3), ("backwards", 0.8), ("side-left", 0.5), ("side-right", 0.3)]
)
def test_speed_asked_for_is_reached(kind, speed):
    clip = synthesise(kind, speed=speed, duration=8.0)
    assert mean_speed(clip) == pytest.approx(speed, rel=0.05)
    x, y = clip.qpos[-1, :2] - clip.qpos[0, :2]
    main = {"walk": x, "backwards": -x, "side-left": y, "side-right": -y}[kind]
    assert main == pytest.approx(speed * clip.duration, rel=0.05)


@settings(max_examples=12, deadline=None)
@given(
    speed=st.floats(0.5, 3.5),
    height=st.floats(1.4, 2.0),
    seed=st.integers(0, 1000),
)
def test_any_speed_and_height_makes_a_sound_clip(speed, height, seed):
    kind = "walk" if speed < 1.9 else "jog"
    clip = synthesise(kind, speed=speed, height_m=height, seed=seed, duration=4.0)
    assert np.isfinite(clip.qpos).all() and np.isfinite(clip.qvel).all()
    assert mean_speed(clip) == pytest.approx(speed, rel=0.05)
    assert max(slides(clip)) < 0.01
    assert clearance(clip).min() > -0.005
    assert_within_limits(clip)


@pytest.mark.parametrize("kind", KINDS)
def test_same_seed_same_bits_other_seed_other_motion(kind):
    first, again = (synthesise(kind, duration=3.0, seed=5) for _ in range(2))
    other = synthesise(kind, duration=3.0, seed=6)
    assert first.qpos.tobytes() == again.qpos.tobytes()
    assert first.qvel.tobytes() == again.qvel.tobytes()
    assert not np.array_equal(first.qpos, other.qpos)


def test_taller_people_take_longer_slower_steps():
    """At equal Froude number lengths grow with height and times with its root (Alexander)."""
    small = synthesise("walk", speed=1.2, height_m=1.4, duration=6.0)
    ratio = 2.0 / 1.4
    tall = synthesise("walk", speed=1.2 * ratio**0.5, height_m=2.0, duration=6.0 * ratio**0.5)
    share = np.linspace(0.0, 1.0, 200)

    def path(clip: Clip) -> np.ndarray:
        times = np.linspace(0.0, 1.0, len(clip))
        return np.stack([np.interp(share, times, x) for x in clip.qpos[:, :3].T], axis=-1)

    assert path(tall) / ratio == pytest.approx(path(small), abs=0.04)
    assert tall.qpos[:, 2].mean() / small.qpos[:, 2].mean() == pytest.approx(ratio, rel=1e-3)


@pytest.mark.parametrize("kind", ["walk", "jog"])
def test_arms_swing_against_the_legs(kind):
    clip = synthesise(kind, duration=5.0)
    forward = clip.link_position[..., 0] - clip.qpos[:, :1]
    for hand, foot in zip(HANDS, FEET, strict=True):
        assert np.corrcoef(forward[:, hand], forward[:, foot])[0, 1] < -0.7


def test_walking_rolls_from_heel_to_ball_and_bends_the_swing_knee():
    clip = synthesise("walk", speed=1.3, duration=5.0)
    up = Rotation.from_quat(clip.link_quat[:, FEET[0]], scalar_first=True).apply([1.0, 0.0, 0.0])
    pitch = np.rad2deg(np.arcsin(up[:, 2]))
    low = clearance(clip)[0] < 0.002
    assert pitch[low].max() > 10.0, "toes up at heel strike"
    assert pitch[low].min() < -30.0, "heel up at toe-off"
    knee = np.rad2deg(clip.qpos[:, 7 + 3])
    assert 45.0 < knee.max() < 70.0 and knee.min() < 12.0


@pytest.mark.parametrize(("kind", "sign"), [("turn-left", 1.0), ("turn-right", -1.0)])
def test_turns_reach_the_angle_asked_for(kind, sign):
    clip = synthesise(kind, speed=1.0, turn_rate=0.6, duration=5.0)
    turned = np.unwrap(heading(clip.qpos[:, 3:7]))
    assert turned[-1] - turned[0] == pytest.approx(sign * 3.0, rel=0.1)


def test_starts_and_stops_are_at_rest():
    clip = synthesise("walk", speed=1.2, duration=8.0, start=True, stop=True)
    speed = np.linalg.norm(clip.qvel[:, :2], axis=-1)
    assert speed[0] < 0.05 and speed[-1] < 0.05
    assert speed[len(speed) // 2] > 0.9
    feet = clip.link_position[:, FEET]
    for end in (0, -1):
        assert abs(feet[end, 0, 0] - feet[end, 1, 0]) < 0.02, "feet side by side"


def pressure_misses(clip: Clip) -> np.ndarray:
    """Metres by which the floor's reaction, by inverse dynamics, leaves the touching soles."""
    model = copy.deepcopy(build_body(clip.height_m).model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data = mujoco.MjData(model)
    velocity = np.zeros((len(clip), model.nv))
    for t in range(1, len(clip) - 1):
        mujoco.mj_differentiatePos(
            model, velocity[t], 2.0 / FPS, clip.qpos[t - 1], clip.qpos[t + 1]
        )
    acceleration = np.gradient(velocity, 1.0 / FPS, axis=0)
    centers, _ = sole_balls(clip)
    points = centers.transpose(1, 0, 2, 3).reshape(len(clip), -1, 3)
    misses = []
    for t in range(3, len(clip) - 3):
        data.qpos[:], data.qvel[:], data.qacc[:] = clip.qpos[t], velocity[t], acceleration[t]
        mujoco.mj_inverse(model, data)
        force = data.qfrc_inverse[:3]
        torque = data.xmat[1].reshape(3, 3) @ data.qfrc_inverse[3:6]
        x, y, z = clip.qpos[t, :3]
        spot = [
            x - (torque[1] + force[0] * z) / force[2],
            y + (torque[0] - force[1] * z) / force[2],
        ]
        touching = points[t][points[t, :, 2] < 0.04][:, :2]
        if len(touching) > 2:
            hull = ConvexHull(touching).equations
            misses.append((hull[:, :2] @ spot + hull[:, 2]).max())
        else:
            misses.append(np.linalg.norm(touching - spot, axis=-1).min())
    return np.array(misses)


@pytest.mark.parametrize("kind", ["stand", "squat", "boxing", "raise-both-hands"])
def test_standing_kinds_are_balanced(kind):
    assert pressure_misses(synthesise(kind, duration=4.0)).max() < 0.0


def test_walking_pushes_the_floor_where_the_feet_are():
    misses = pressure_misses(synthesise("walk", speed=1.1, duration=4.0))
    assert np.mean(misses < 0.03) > 0.9


def test_a_library_of_another_height_has_people_of_that_height():
    clips = synthetic_clips(seed=3, heights=(1.5,), kinds=("stand", "walk"))
    assert {clip.kind for clip in clips} == {"stand", "walk"}
    assert {clip.height_m for clip in clips} == {1.5}
    standing = next(clip for clip in clips if clip.kind == "stand")
    assert standing.qpos[0, 2] == pytest.approx(0.9245 * 1.5 / 1.75, abs=0.01)


@pytest.mark.parametrize(
    ("kind", "options", "says"),
    [
        ("moonwalk", {}, "moonwalk"),
        ("walk", {"speed": 0.2}, "walking speed"),
        ("walk", {"speed": 3.4}, "walking speed"),
        ("walk", {"speed": float("nan")}, "walking speed"),
        ("jog", {"speed": 4.0}, "jogging speed"),
        ("jog", {"start": True}, "jog"),
        ("squat", {"speed": 1.0}, "no speed"),
        ("walk", {"turn_rate": 1.0}, "turn rate"),
        ("turn-left", {"turn_rate": -1.0}, "turn rate"),
        ("walk", {"height_m": 1.2}, "height"),
        ("walk", {"duration": 0.5}, "duration"),
        ("stand", {"seed": -1}, "seed"),
    ],
)
def test_bad_values_are_refused(kind, options, says):
    with pytest.raises(InputError, match=says):
        synthesise(kind, **options)
