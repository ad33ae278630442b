"""Files whose declarations or joint rotations are wrong although the joints' names are right."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rigs
from rig_styles import RIGS
from rigs import Rig, true_motion, write_rig

from questsim import rotations as rot
from questsim.errors import InputError
from questsim.exporting.bvh_file import write_joint_bvh
from questsim.motion.motion import Motion
from questsim.motion.reading import read_motion
from questsim.motion.retarget import retargeting_error, to_clip
from questsim.motion.spec import load_recordings
from questsim.motion.strides import FEET
from questsim.motion.twist import ARBITRARY
from questsim.skeleton import JOINT_PARENTS, JOINTS

RIG = RIGS["Mixamo"]


def planted(rig: Rig) -> Motion:
    """The walk of the rigs, with a root that moves so that the lowest joint stands still."""
    motion = true_motion(rig)
    position, _ = motion.forward_kinematics()
    feet = [JOINTS.index(joint) for joint in FEET]
    lowest = position[:, feet, 2].argmin(axis=1)[1:]
    own = position[:, feet] - position[:, :1]
    step = -np.diff(own, axis=0)[np.arange(len(lowest)), lowest]
    root = motion.root_position.copy()
    root[1:, :2] = root[0, :2] + np.cumsum(step[:, :2], axis=0)
    return replace(motion, root_position=root)


@pytest.fixture
def walk(tmp_path, monkeypatch):
    monkeypatch.setattr(rigs, "true_motion", planted)
    path = tmp_path / "walk.bvh"
    write_rig(path, RIG)
    head, rows = re.split(r"(?<=Frame Time: 0.0333333)\n", path.read_text())
    return path, head, np.array([[float(v) for v in row.split()] for row in rows.splitlines()])


def write(path, head: str, values: np.ndarray) -> None:
    head = re.sub(r"Frames: \d+", f"Frames: {len(values)}", head)
    rows = [" ".join(f"{value:.6f}" for value in row) for row in values]
    path.write_text("\n".join([head, *rows]) + "\n")


def test_declarations_with_which_the_feet_slide_are_refused(walk):
    path, head, values = walk
    assert not read_motion(path)[1].notes
    turns = " ".join(f"{letter}rotation" for letter in RIG.order)
    other = head.replace(turns, "Xrotation Zrotation Yrotation")
    place, angles = values[:, :3], values[:, 3:]
    for text, frames, says in (
        (other, values, f"with channels in the order {RIG.order} they would"),
        (head, np.hstack([place, angles / 2]), "angles twice as large|steps? .* times as far"),
        (head, np.hstack([place, angles * 2]), "half the angles|the legs step .* times as far"),
        (head, np.hstack([place * 2.54, angles]), "the legs step 0.3.* other units"),
        (head, np.hstack([place / 100, angles]), "the legs step 1?[09].* other units"),
    ):
        write(path, text, frames)
        with pytest.raises(InputError, match=says):
            read_motion(path)


def test_a_root_that_comes_from_the_origin_begins_at_its_place(walk):
    path, head, values = walk
    far = values + np.eye(len(values[0]))[0] * 400
    far[:3, :3] *= np.array([0.0, 0.4, 0.8])[:, None]
    write(path, head, far)
    motion, report = read_motion(path)
    assert len(motion) == len(values) - 3
    assert "the root jumps in the first 3 frames: they are left out" in report.notes


def write_twisted(path: Path) -> tuple[Motion, np.ndarray]:
    """Writes a walk whose thighs, shins and neck are turned about themselves; returns the truth."""
    truth = planted(RIG)
    _, quat = truth.forward_kinematics()
    turned = quat.copy()
    time = np.arange(len(truth)) / truth.fps
    for joint, end in (("hip", "knee"), ("knee", "ankle")):
        for side, start in (("left", 1.6), ("right", 1.9)):
            row, below = (JOINTS.index(f"{side}_{part}") for part in (joint, end))
            half = (start + 0.3 * np.sin(time)) / 2
            bone = truth.offsets[below] / np.linalg.norm(truth.offsets[below])
            roll = np.concatenate([np.cos(half)[:, None], np.sin(half)[:, None] * bone], axis=-1)
            turned[:, row] = rot.quat_multiply(quat[:, row], roll)
    local = turned.copy()
    above = rot.quat_conjugate(turned[:, JOINT_PARENTS[1:]])
    local[:, 1:] = rot.quat_multiply(above, turned[:, 1:])
    write_joint_bvh(path, replace(truth, rotations=local))
    return truth, quat


def test_limbs_of_arbitrary_twist_bend_as_their_joints_lie(tmp_path):
    truth, quat = write_twisted(tmp_path / "a.bvh")
    motion, report = read_motion(tmp_path / "a.bvh")
    assert ARBITRARY in report.notes
    place, found = motion.forward_kinematics()
    np.testing.assert_allclose(place, truth.forward_kinematics()[0], atol=2e-3)
    for joint in ("left_hip", "right_hip", "left_knee", "right_knee"):
        row = JOINTS.index(joint)
        assert np.degrees(rot.angle_between(found[:, row], quat[:, row])).mean() < 12, joint
    assert max(retargeting_error(motion, to_clip(motion)).values()) < 15


def declared(path: Path, motion: Motion, order: str) -> Path:
    """A BVH of the motion, written in the order ZYX, that declares another order."""
    write_joint_bvh(path, motion)
    text, turns = path.read_text(), " ".join(f"{letter}rotation" for letter in order)
    path.write_text(text.replace("Zrotation Yrotation Xrotation", turns))
    return path


@pytest.mark.parametrize("order", ["XYZ", "XZY", "YXZ", "YZX", "ZXY"])
def test_a_wrong_order_shows_in_the_feet_of_someone_who_squats_in_place(tmp_path, order):
    (squat,) = load_recordings("synthetic:squat")[:1]
    read_motion(declared(tmp_path / "a.bvh", squat, "ZYX"))
    with pytest.raises(InputError) as refused:
        read_motion(declared(tmp_path / "a.bvh", squat, order))
    assert "rise and sink" in str(refused.value) and "order ZYX they would" in str(refused.value)
    assert "correct the CHANNELS lines" in str(refused.value)


def test_fingers_of_another_order_hide_no_wrong_order(tmp_path):
    (squat,) = load_recordings("synthetic:squat")[:1]
    path = declared(tmp_path / "a.bvh", squat, "XYZ")
    text = path.read_text()
    hand = text.index("CHANNELS 3", text.index("LeftHand"))
    other = text[hand:].replace("Xrotation Yrotation Zrotation", "Yrotation Xrotation Zrotation", 1)
    path.write_text(text[:hand] + other)
    with pytest.raises(InputError, match="order ZYX they would"):
        read_motion(path)


def test_a_wrong_order_shows_in_shoulders_whose_angles_jump(tmp_path):
    # The arms go up in front, past the pole of the order ZYX, where Z and X jump by half a turn.
    (stand,) = load_recordings("synthetic:stand")[:1]
    rotations = np.repeat(stand.rotations[:1], len(stand), axis=0)
    turn = np.zeros((len(stand), 3))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        turn[:, 0], turn[:, 2] = 0.2, -sign * np.linspace(1.0, 2.4, len(stand))
        rotations[:, JOINTS.index(f"{side}_shoulder")] = rot.as_quat(rot.from_rotvec(turn))
    root = np.repeat(stand.root_position[:1], len(stand), axis=0)
    reach = replace(stand, rotations=rotations, root_position=root)
    read_motion(declared(tmp_path / "a.bvh", reach, "ZYX"))
    with pytest.raises(InputError, match=r"shoulders jerk.* order \w+ they would by only"):
        read_motion(declared(tmp_path / "a.bvh", reach, "XYZ"))


@pytest.mark.parametrize("style", ["Mixamo", "Rokoko", "Xsens"])
def test_a_walk_on_the_spot_is_not_taken_for_a_wrong_order(tmp_path, style):
    path = tmp_path / "walk.bvh"
    write_rig(path, RIGS[style])
    head, rows = re.split(r"(?<=Frame Time: 0.0333333)\n", path.read_text())
    values = np.array([[float(v) for v in row.split()] for row in rows.splitlines()])
    values[:, [0, 2]] = values[0, [0, 2]]
    write(path, head, values)
    read_motion(path)
