"""Files as a stranger's exporter writes them import by command, joints where they truly are."""

import numpy as np
import pytest
import rigs
from rig_strangers import RUSSIAN, SMPL_FBX, STRANGERS
from rig_styles import RIGS
from rigs import Rig, write_rig

from questsim.cli import main
from questsim.motion.joint_names import understand
from questsim.motion.library import load_library
from questsim.skeleton import JOINTS

CMU_ARMS = {
    "left_clavicle": (0.0, 0.0, 0.0), "left_shoulder": (-0.014, 0.199, 0.047),
    "left_elbow": (0.0, 0.279, 0.0), "left_wrist": (0.0, 0.19, 0.0),
}  # fmt: skip


def assert_right(rig: Rig, tmp_path) -> None:
    """Imports a file of the rig by command and compares it with the truth."""
    truth = write_rig(tmp_path / "a.bvh", rig)
    command = ["motions", "import", str(tmp_path / "a.bvh"), "--out", str(tmp_path / "lib.npz")]
    assert main(command) == 0
    (motion,) = load_library(tmp_path / "lib.npz").motions
    start = len(truth) - len(motion)  # a rest pose before the motion
    assert start == int(rig.rest_frame) and motion.fps == pytest.approx(rig.fps)
    ours = [i for i, j in enumerate(JOINTS) if j.replace("right_", "left_") in rig.joints]
    place, true_place = motion.forward_kinematics()[0], truth.forward_kinematics()[0][start:]
    distance = np.linalg.norm(place - true_place, axis=-1).max(axis=0)[ours]
    assert distance.max() < 0.005, JOINTS[ours[int(distance.argmax())]]


@pytest.mark.parametrize("name", STRANGERS)
def test_a_strangers_file_imports_with_every_joint_in_its_place(name, tmp_path):
    assert_right(STRANGERS[name], tmp_path)


@pytest.mark.parametrize("rig", [RIGS["OptiTrack Motive"], SMPL_FBX, RUSSIAN])
def test_a_long_collarbone_and_a_short_forearm_are_not_taken_for_an_arm(rig, tmp_path, monkeypatch):
    for joint, place in CMU_ARMS.items():
        monkeypatch.setitem(rigs.OFFSETS, joint, place)
    assert_right(rig, tmp_path)


def test_a_performers_name_before_all_joints_is_no_part_of_the_body():
    joints = ["Hips", "Spine", "Chest", "Neck", "Head", "LeftArm", "RightArm", "LeftLeg"]
    for performer in ("Springer", "Headley", "Armin_Footman"):
        names = understand([f"{performer}_{joint}" for joint in [*joints, "RightLeg", "LeftFoot"]])
        assert all(name.part for name in names)
        assert [name.key for name in names[:6]] == ["hips", "spine", "chest", "neck", "head", "arm"]


def test_a_vertebra_is_of_no_side_and_a_numbered_bone_is():
    trunk = ["Fred_L5", "Fred_L3", "Fred_T8", "Fred_Head", "Fred_Neck"]
    limbs = [f"Fred_{side}{part}" for side in "LR" for part in ("Arm", "Leg", "Foot", "Hand")]
    names = understand([*trunk, *limbs])
    assert [name.side for name in names] == [""] * 5 + ["left"] * 4 + ["right"] * 4
    assert {n.side for n in understand([f"Bone_{s}{i}" for s in "LR" for i in range(9)])} == {
        "left", "right"
    }  # fmt: skip
