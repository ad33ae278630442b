"""Files as a stranger's exporter writes them import by command, joints where they truly are."""

from dataclasses import replace

import numpy as np
import pytest
import rigs
from mocap_files import standing, write_bvh
from rig_strangers import RUSSIAN, SMPL_FBX, STRANGERS
from rig_styles import RIGS
from rigs import Rig, write_rig
from test_recognise import chain

from questsim import rotations as rot
from questsim.cli import main
from questsim.motion.bvh import read_bvh
from questsim.motion.joint_names import understand
from questsim.motion.library import load_library
from questsim.motion.motion import Motion
from questsim.motion.reading import ReadOptions, read_motion
from questsim.motion.recognise import find_roles
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


def person(name: str, x: float) -> list[tuple[str, str, tuple[float, float, float]]]:
    """Joints of one of several people that hang on one scene."""
    return [
        (f"{name}_Hips", "Scene", (x, 92, 0)), (f"{name}_Spine", f"{name}_Hips", (0, 20, 0)),
        (f"{name}_Head", f"{name}_Spine", (0, 35, 0)),
        (f"{name}_{{}}_UpLeg", f"{name}_Hips", (9, -5, 0)),
        (f"{name}_{{}}_Leg", f"{name}_{{}}_UpLeg", (0, -42, 0)),
        (f"{name}_{{}}_Foot", f"{name}_{{}}_Leg", (0, -41, 0)),
        (f"{name}_{{}}_Arm", f"{name}_Spine", (16, 22, 0)),
        (f"{name}_{{}}_ForeArm", f"{name}_{{}}_Arm", (28, 0, 0)),
        (f"{name}_{{}}_Hand", f"{name}_{{}}_ForeArm", (25, 0, 0)),
    ]  # fmt: skip


def test_two_people_in_one_hierarchy_are_refused(tmp_path, capsys):
    both = chain(("Scene", "", (0, 0, 0)), *person("Ann", 0.0), *person("Bob", 100.0))
    path = write_bvh(tmp_path / "a.bvh", both, standing(20, 0.0))
    assert main(["motions", "import", str(path), "--out", str(tmp_path / "lib.npz")]) == 2
    assert "several people are in one hierarchy" in capsys.readouterr().err
    one = chain(("Scene", "", (0, 0, 0)), *person("Ann", 0.0), *person("Rig", 0.0))
    write_bvh(path, one, standing(20, 0.0))  # two sets of bones of one person
    assert main(["motions", "import", str(path), "--out", str(tmp_path / "lib.npz")]) == 0


def test_a_headset_beside_the_performer_is_not_the_head(tmp_path):
    joints = chain(("Scene", "", (0, 0, 0)), ("Headset", "Scene", (80, 160, 0)), *person("A", 0.0))
    path = write_bvh(tmp_path / "a.bvh", joints, standing(20, 0.0))
    assert find_roles(read_bvh(path)).joints["head"] == "A_Head"


def test_a_hierarchy_that_begins_at_the_chest_turns_chest_and_hips(tmp_path):
    joints = chain(
        ("Chest", "", (0, 0, 0)), ("Head", "Chest", (0, 35, 2)),
        ("{}Arm", "Chest", (16, 22, 0)), ("{}ForeArm", "{}Arm", (28, 0, 0)),
        ("{}Hand", "{}ForeArm", (25, 0, 0)), ("Hips", "Chest", (0, -25, 0)),
        ("{}UpLeg", "Hips", (9, -5, 0)), ("{}Leg", "{}UpLeg", (0, -42, 0)),
        ("{}Foot", "{}Leg", (0, -41, 0)),
    )  # fmt: skip
    turns = {
        "Chest": np.linspace([0, 0, 0], [0, 50, 0], 30),
        "Hips": np.linspace([0, 0, 0], [0, -50, 0], 30),
    }
    path = write_bvh(tmp_path / "a.bvh", joints, standing(30, 117), turns)
    assert main(["motions", "import", str(path), "--out", str(tmp_path / "lib.npz")]) == 0
    (motion,) = load_library(tmp_path / "lib.npz").motions
    place = motion.forward_kinematics()[0][-1]
    left = {
        j: place[JOINTS.index(f"left_{j}")] - place[JOINTS.index(f"right_{j}")]
        for j in ("hip", "shoulder")
    }
    degrees = {j: np.degrees(np.arctan2(-v[0], v[1])) for j, v in left.items()}
    assert degrees["shoulder"] - degrees["hip"] == pytest.approx(50.0, abs=0.5)


def test_feet_of_someone_who_lies_first_are_level_when_they_stand(tmp_path, monkeypatch):
    """Without a rest pose, how the feet stand shows the axes of their joints."""
    made = rigs.true_motion

    def lies_first(rig: Rig) -> Motion:
        motion = made(rig)
        lies = np.arange(len(motion)) < len(motion) // 3
        turns, root = motion.rotations.copy(), motion.root_position.copy()
        on_back = rot.from_rotvec(np.array([0.0, -np.pi / 2, 0.0]))
        turns[lies, 0] = rot.as_quat(on_back * rot.as_rotation(turns[lies, 0]))
        root[lies] = [0.0, 0.0, 0.15]
        return replace(motion, rotations=turns, root_position=root)

    monkeypatch.setattr(rigs, "true_motion", lies_first)
    rig = replace(RIGS["Mixamo"], pose="own", frames=120)
    truth = write_rig(tmp_path / "a.bvh", rig)
    motion, _ = read_motion(tmp_path / "a.bvh", ReadOptions(accept=True))
    (_, found), (_, true) = motion.forward_kinematics(), truth.forward_kinematics()
    for ankle in (JOINTS.index("left_ankle"), JOINTS.index("right_ankle")):
        assert np.degrees(rot.angle_between(found[:, ankle], true[:, ankle])).mean() < 8.0


def test_bones_that_stretch_are_refused_where_a_file_gives_all_positions(tmp_path, capsys):
    path = tmp_path / "a.bvh"
    write_rig(path, RIGS["100STYLE"])
    assert_right(RIGS["100STYLE"], tmp_path)  # rigid bones with positions of all joints
    lines = path.read_text().splitlines()
    names = [line.split()[1] for line in lines if line.split()[0] in ("ROOT", "JOINT")]
    row = lines[-10].split()
    column = 6 * names.index("LeftKnee") + 1  # its place below the hip
    row[column] = str(1.2 * float(row[column]))
    lines[-10] = " ".join(row)
    path.write_text("\n".join(lines))
    assert main(["motions", "import", str(path), "--out", str(tmp_path / "b.npz")]) == 2
    said = capsys.readouterr().err
    assert "'LeftKnee' is 8.6 cm further" in said and "bones are not rigid" in said
