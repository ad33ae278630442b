"""Files in the styles of many producers import without a mapping, joints where they truly are."""

import itertools
import re
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mocap_files import LAFAN1_JOINTS, SMPL_JOINTS, standing, write_bvh
from rig_styles import MIXAMO, RIGS
from rigs import TIPS, Rig, write_rig

from questsim import rotations as rot
from questsim.cli import main
from questsim.errors import InputError
from questsim.motion.bvh import read_bvh
from questsim.motion.doubts import doubts
from questsim.motion.families import load_mapping
from questsim.motion.joint_names import understand
from questsim.motion.many import MAX_ERROR_CM, read_and_retarget
from questsim.motion.motion import Motion
from questsim.motion.reading import ReadOptions, read_motion
from questsim.motion.recognise import find_roles
from questsim.motion.retarget import retargeting_error, to_clip
from questsim.skeleton import JOINTS


def in_file(rig: Rig) -> list[int]:
    """Our joints that a rig has."""
    return [i for i, j in enumerate(JOINTS) if j.replace("right_", "left_") in rig.joints]


def compare(got: Motion, truth: Motion, rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Distances in metres and angles in degrees of the rig's joints, largest and mean over time."""
    if rig.rest_frame:
        truth = Motion("t", rig.fps, truth.root_position[1:], truth.rotations[1:], truth.offsets)
    (place, turn), (true_place, true_turn) = got.forward_kinematics(), truth.forward_kinematics()
    joints = in_file(rig)
    distance = np.linalg.norm(place - true_place, axis=-1).max(axis=0)
    angle = np.degrees(rot.angle_between(turn, true_turn)).mean(axis=0)
    return distance[joints], angle[joints]


@pytest.mark.parametrize("name", RIGS)
def test_a_producers_file_imports_with_every_joint_in_its_place(name, tmp_path):
    rig = RIGS[name]
    truth = write_rig(tmp_path / "a.bvh", rig)
    motion, _ = read_motion(tmp_path / "a.bvh")
    distance, angle = compare(motion, truth, rig)
    names = [JOINTS[joint] for joint in in_file(rig)]
    assert distance.max() < 0.005, names[int(distance.argmax())]
    # Axes from a rest pose are exact; from how someone moves, feet are as level as they stand. A
    # trunk that leans all the time keeps its lean.
    assert angle.max() < 6.0, (names[int(angle.argmax())], angle.max())
    assert all(a < 3.0 for a, joint in zip(angle, names, strict=True) if "spine" in joint)
    assert max(retargeting_error(motion, to_clip(motion)).values()) < MAX_ERROR_CM


def test_a_rest_pose_before_the_motion_is_left_out_and_said(tmp_path):
    rig = RIGS["MotionBuilder"]
    write_rig(tmp_path / "a.bvh", rig)
    motion, report = read_motion(tmp_path / "a.bvh")
    assert len(motion) == rig.frames - 1
    assert "the first frame, a rest pose, is left out" in str(report)


def test_a_motion_that_begins_in_a_t_pose_and_moves_out_of_it_is_kept_whole(tmp_path):
    arms = np.linspace(0, -70, 40)
    angles = {"L_Shoulder": np.stack([arms, 0 * arms, 0 * arms], axis=-1)}
    path = write_bvh(tmp_path / "a.bvh", SMPL_JOINTS, standing(40, 0.95), angles)
    assert len(read_motion(path)[0]) == 40


def without_sides(path: Path, style: str, *, mirror: str = "") -> None:
    """Rename the joints of a file; ``mirror`` is the order of rotations of one to be mirrored."""
    numbers, seen = itertools.count(1), Counter[str]()

    def name(match: re.Match) -> str:
        part = re.sub("Left|Right|mixamorig:|\\d", "", match[2])
        seen[part] += 1
        again = f".{seen[part] - 1:03d}" if seen[part] > 1 else ""
        return f"{match[1]} " + (f"Bone{next(numbers):02d}" if style == "bone" else part + again)

    text = re.sub(r"(ROOT|JOINT) (.*)", name, path.read_text())
    if mirror:
        head, rows = text.split("Frame Time")
        head = re.sub(r"OFFSET (\S+)", lambda m: f"OFFSET {-float(m[1])}", head)
        first, *lines = rows.splitlines()
        signs = np.array([-1.0, 1, 1] + [1.0 if axis == "X" else -1.0 for axis in mirror])
        table = np.array([[float(v) for v in line.split()] for line in lines])
        table[:, :3] *= signs[:3]
        table[:, 3:] *= np.tile(signs[3:], (table.shape[1] - 3) // 3)
        lines = [" ".join(f"{v:.6f}" for v in row) for row in table]
        text = head + "Frame Time" + "\n".join([first, *lines]) + "\n"
    path.write_text(text)


@pytest.mark.parametrize(
    ("rig", "style", "mirror"),
    [("Mixamo", "bone", False), ("Mixamo", "blender", True), ("own axes, z up", "bone", False),
     ("SMPL-X", "bone", False), ("Rigify", "bone", False)],
)  # fmt: skip
def test_left_is_left_in_a_file_whose_names_do_not_say_it(rig, style, mirror, tmp_path):
    path, made = tmp_path / "a.bvh", RIGS[rig]
    truth = write_rig(path, made)
    without_sides(path, style, mirror=made.order if mirror else "")
    motion, report = read_motion(path)
    distance, angle = compare(motion, truth.mirrored() if mirror else truth, made)
    assert distance.max() < 0.005 and angle.max() < 6.0
    assert "left is known from feet and knees and travel" in "".join(report.explanation)


def test_names_of_unknown_words_give_the_sides_alone(tmp_path):
    path = tmp_path / "a.bvh"
    write_rig(path, RIGS["Character Creator"])
    known = find_roles(read_bvh(path))
    words = dict.fromkeys(re.findall(r"(?:ROOT|JOINT) CC_Base_(?:[LR]_)?(\w+)", path.read_text()))
    number = {word: f"os{i}" for i, word in enumerate(words)}

    def other(match: re.Match) -> str:
        return f"{match[1]} {number[match[3]]}{'_' + match[2] if match[2] else ''}"

    path.write_text(re.sub(r"(ROOT|JOINT) CC_Base_(?:([LR])_)?(\w+)", other, path.read_text()))
    got = find_roles(read_bvh(path))
    assert got.reasons["left_knee"] == "place and length; its side by name"
    limbs = [j for j in JOINTS if j.startswith(("left", "right"))]
    for joint in limbs:
        side, word = known.joints[joint].removeprefix("CC_Base_").split("_")
        assert got.joints[joint] == f"{number[word]}_{side}"


def test_a_limb_of_many_bones_without_sides_that_never_bends_is_refused(tmp_path):
    joints = [("hips", -1, (0, 90, 0)), ("chest", 0, (0, 40, 0)), ("skull", 1, (0, 25, 0))]
    for side in (1, -1):
        for above, way in ((0, (0, -15, 0)), (1, (side * 12, 0, 0))):
            joints.append((f"j{len(joints)}", above, (side * 10, 0, 0)))
            for _ in range(6):
                joints.append((f"j{len(joints)}", len(joints) - 1, way))
    write_bvh(tmp_path / "a.bvh", joints, standing(30, 0.0))
    with pytest.raises(InputError, match=r"do not say left and right"):
        read_motion(tmp_path / "a.bvh")


def test_missing_toes_are_put_in_front_of_the_ankles(tmp_path):
    # Without an End Site a foot of the legs' length, with one where it says.
    for name in ("Axis Neuron", "Biovision"):
        rig = RIGS[name]
        write_rig(tmp_path / "a.bvh", rig)
        motion, _ = read_motion(tmp_path / "a.bvh")
        for side in ("left", "right"):
            ahead, left, up = motion.offsets[JOINTS.index(f"{side}_toe")]
            assert 0.08 < ahead < 0.2 and abs(left) < 0.03 and -0.08 < up < 0.0


@pytest.mark.parametrize("pose", ["I", "own"])
def test_ends_of_feet_straight_under_the_ankles_are_not_taken_for_toes(pose, tmp_path, monkeypatch):
    monkeypatch.setitem(TIPS, "ankle", (0.004, 0.0, -0.08))
    rig = replace(RIGS["Biovision"], pose=pose)
    truth = write_rig(tmp_path / "a.bvh", rig)
    motion, _ = read_motion(tmp_path / "a.bvh")
    assert compare(motion, truth, rig)[1].max() < 6.0
    for side in ("left", "right"):
        ahead, left, up = motion.offsets[JOINTS.index(f"{side}_toe")]
        assert 0.08 < ahead < 0.2 and abs(left) < 0.03 and -0.08 < up < 0.0


def test_swapped_sides_are_refused_and_not_imported_mirrored(tmp_path):
    write_rig(tmp_path / "a.bvh", RIGS["Mixamo"])
    text = (tmp_path / "a.bvh").read_text()
    swap = {"Left": "Right", "Right": "Left"}
    (tmp_path / "b.bvh").write_text(re.sub("Left|Right", lambda m: swap[m[0]], text))
    with pytest.raises(InputError, match=r"left and right are swapped|bends backwards"):
        read_motion(tmp_path / "b.bvh")


def radians(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values[:, :3], np.radians(values[:, 3:])], axis=1)


def metres(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values[:, :3] / 100.0, values[:, 3:]], axis=1)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (radians, "error.*no rotation is above 1.., but the performer travels: these are radians"),
        (metres, r"warning.*moved by \+0.9. m onto the floor: perhaps the root's positions have"),
        (lambda v: np.repeat(v, 3, axis=0), "warning.*67 % of the frames repeat .* about 10"),
        (lambda v: v[:1].repeat(len(v), axis=0), "warning.*nothing moves: all frames are the same"),
    ],
)  # fmt: skip
def test_values_that_are_not_what_they_seem_are_refused_or_warned_of(
    change, says, tmp_path, capsys
):
    path = tmp_path / "a.bvh"
    write_rig(path, RIGS["Mixamo"])
    head, rows = re.split(r"Frames: \d+\nFrame Time: .*\n", path.read_text())
    values = change(np.array([[float(v) for v in row.split()] for row in rows.splitlines()]))
    lines = [" ".join(f"{v:.6f}" for v in row) for row in values]
    path.write_text(f"{head}Frames: {len(lines)}\nFrame Time: 0.0333333\n" + "\n".join(lines))
    code = main(["motions", "import", str(path), "--out", str(tmp_path / "lib.npz")])
    assert re.search(says, capsys.readouterr().err)
    assert code == (2 if change is radians else 0)


def test_a_known_skeleton_in_poses_that_no_one_takes_is_refused(tmp_path):
    path = write_bvh(tmp_path / "a.bvh", LAFAN1_JOINTS, standing(30, 93.6))  # all angles zero
    with pytest.raises(
        InputError, match=r"the .* is \d+ cm off on average: no person moves like this"
    ):
        read_and_retarget(path, ReadOptions())


def test_a_skeleton_without_arms_is_refused_with_the_reason(tmp_path):
    # The first 14 joints are pelvis, legs, spine, neck and head.
    path = write_bvh(tmp_path / "a.bvh", SMPL_JOINTS[:14], standing(3, 0.95))
    with pytest.raises(InputError, match=r"there is no left arm.*mapping"):
        read_motion(path)


def test_twice_as_long_forearms_are_refused_wherever_the_feet_and_in_all_units(tmp_path):
    joints = [
        (n + "X", p, tuple(3 * v for v in o) if n.endswith("_Wrist") else o)
        for n, p, o in SMPL_JOINTS
    ]
    tall = [(n, p, tuple(3 * v for v in o)) for n, p, o in joints]
    for rig, height in ((joints, 0.95), (joints, 3.0), (tall, 2.85)):
        path = write_bvh(tmp_path / "a.bvh", rig, standing(3, height))
        with pytest.raises(InputError, match="forearm and upper arm are as"):
            read_motion(path)


def test_a_quadruped_is_refused_because_it_is_no_person(tmp_path):
    joints = chain(
        ("Hips", "", (0, 0, 0)),
        ("{} Thigh", "Hips", (11, 0, 0)), ("{} Calf", "{} Thigh", (0, -35, 5)),
        ("{} Foot", "{} Calf", (0, -35, -5)), ("{} Toe", "{} Foot", (0, -5, 8)),
        ("Spine", "Hips", (0, 0, 40)), ("Chest", "Spine", (0, 0, 45)),
        ("Neck", "Chest", (0, 15, 10)), ("Head", "Neck", (0, 20, 15)),
        ("{} UpperArm", "Chest", (7, 0, 0)), ("{} Forearm", "{} UpperArm", (0, -30, -5)),
        ("{} Hand", "{} Forearm", (0, -30, 5)),
    )  # fmt: skip
    path = write_bvh(tmp_path / "a.bvh", joints, standing(20, 75))
    with pytest.raises(InputError, match=r"trunk and leg are as 1.2. to 1.*not a person"):
        read_motion(path)


@pytest.mark.parametrize("rest_frame", [True, False])
def test_a_person_who_lies_all_the_time_is_refused_and_not_put_upright(rest_frame, tmp_path):
    joints = [(n + "X", p, o) for n, p, o in SMPL_JOINTS]
    turn = np.array([[0, 0, 0 if rest_frame else -88]] + [[0, 0, -88]] * 19)
    path = write_bvh(tmp_path / "a.bvh", joints, standing(20, 0.12), {"PelvisX": turn})
    with pytest.raises(InputError, match=r"never stands upright: up is not y .* only lies"):
        read_motion(path)


def test_a_child_is_scaled_to_the_smallest_avatar_and_the_report_says_so(tmp_path):
    joints = [(n + "X", p, tuple(27 * v for v in o)) for n, p, o in SMPL_JOINTS]
    path = write_bvh(tmp_path / "a.bvh", joints, standing(3, 25.65))
    motion, report = read_motion(path)
    assert "units inch (detected; 1.1" in str(report) and "scaled to 1.2 m" in str(report)
    assert to_clip(motion).height_m == 1.2


def test_explain_prints_which_joint_was_taken_for_what(tmp_path, capsys):
    write_rig(tmp_path / "a.bvh", RIGS["Character Creator"])
    out = tmp_path / "lib.npz"
    assert main(["motions", "import", str(tmp_path / "a.bvh"), "--out", str(out), "--explain"]) == 0
    printed = capsys.readouterr().out
    assert re.search(r"left_knee +CC_Base_L_Calf +place in its chain", printed)
    assert "axes from the pose of all rotations zero" in printed
    assert "CC_Base_L_CalfTwist01" not in printed


def test_a_mapping_file_can_be_written_out_and_gives_the_same_motion(tmp_path, capsys):
    write_rig(tmp_path / "a.bvh", RIGS["3ds Max Biped"])
    rig = tmp_path / "rig.toml"
    assert main(["motions", "mapping", str(tmp_path / "a.bvh"), "--out", str(rig)]) == 0
    assert "check it, and import with --mapping" in capsys.readouterr().out
    assert load_mapping(rig).joints["left_knee"] == "Bip01 L Calf"
    mapped, _ = read_motion(tmp_path / "a.bvh", ReadOptions(mapping=str(rig)))
    plain, _ = read_motion(tmp_path / "a.bvh")
    np.testing.assert_allclose(mapped.rotations, plain.rotations, atol=1e-9)


def test_an_import_says_where_the_soles_of_feet_that_are_never_still_come_from(tmp_path, capsys):
    slides = standing(20, 0.95) + np.linspace([0, 0, 0], [0, 0, 2], 20)
    path, rig = write_bvh(tmp_path / "a.bvh", SMPL_JOINTS, slides), tmp_path / "rig.toml"
    command = ["motions", "import", str(path), "--out", str(tmp_path / "a.npz"), "--explain"]
    assert main(command) == 0
    assert "soles not measured, and no pitch is known for SMPL files" in capsys.readouterr().out
    assert main(["motions", "mapping", str(path), "--out", str(rig)]) == 0
    rig.write_text("foot_pitch = 0.1\n" + rig.read_text())
    assert main([*command, "--mapping", str(rig)]) == 0
    assert "soles pitched by 6 deg, as declared for rig files" in capsys.readouterr().out


def test_a_mapping_file_of_an_unknown_skeleton_lists_the_joints_to_fill_in(tmp_path, capsys):
    # All joints in one plane: neither feet nor knees show the front.
    joints = [(f"bone{i}", p, (*o[:2], 0.0)) for i, (_, p, o) in enumerate(SMPL_JOINTS)]
    path = write_bvh(tmp_path / "a.bvh", joints, standing(3, 0.95))
    with pytest.raises(InputError, match=r"no human skeleton is recognised.*front is not certain"):
        read_motion(path)
    rig = tmp_path / "rig.toml"
    assert main(["motions", "mapping", str(path), "--out", str(rig)]) == 0
    assert "fill in what is missing" in capsys.readouterr().out
    text = rig.read_text()
    assert "#   bone7\n" in text and '# left_knee = ""\n' in text


def test_a_file_of_unknown_units_is_scaled_to_the_usual_or_the_declared_height(tmp_path):
    joints = [(n, p, tuple(3 * v for v in o)) for n, p, o in SMPL_JOINTS]
    path = write_bvh(tmp_path / "b.bvh", joints, standing(3, 2.85))
    motion, report = read_motion(path)
    assert report.stature_m == pytest.approx(1.7, abs=1e-3)
    assert any("scaled to 1.7 m; declare" in doubt for doubt in doubts(motion, report))
    motion, report = read_motion(path, ReadOptions(height_m=1.8))
    assert report.stature_m == pytest.approx(1.8, abs=1e-3)
    assert len(motion) == 3


def test_joints_of_a_mapping_that_the_file_lacks_are_named(tmp_path):
    write_rig(tmp_path / "a.bvh", RIGS["Mixamo"])
    rig = tmp_path / "rig.toml"
    lines = ["[joints]"]
    for ours, theirs in MIXAMO.items():
        lines.append(f'{ours} = "mixamorig:{theirs.format("Left")}"')
        if "{}" in theirs:
            right = theirs.format("Right").replace("Hand", "Paw")
            lines.append(f'{ours.replace("left", "right")} = "mixamorig:{right}"')
    for axes in ("", 'zero_axes = "z x y"\n'):
        rig.write_text(axes + "\n".join(lines))
        with pytest.raises(InputError, match="there is no joint 'mixamorig:RightPaw'"):
            read_motion(tmp_path / "a.bvh", ReadOptions(mapping=str(rig)))


def chain(*joints: tuple[str, str, tuple[float, float, float]]) -> list[tuple]:
    """Joints with their parents' names as ``write_bvh`` takes them, sides in both ways."""
    out: list[tuple] = []
    names: list[str] = []
    for name, parent, offset in joints:
        for side, sign in (("L", 1), ("R", -1)) if "{}" in name else (("", 1),):
            mine, above = name.format(side), parent.format(side)
            number = names.index(above) if above else -1
            out.append((mine, number, (sign * offset[0], *offset[1:])))
            names.append(mine)
    return out


def test_legs_that_hang_on_the_spine_and_arms_on_the_neck_are_found(tmp_path):
    # As 3ds Max's Biped has them.
    joints = chain(
        ("Bip01", "", (0, 0, 0)),
        ("Bip01 Pelvis", "Bip01", (0, 0, 0)),
        ("Bip01 Spine", "Bip01 Pelvis", (0, 10, 0)),
        ("Bip01 {} Thigh", "Bip01 Spine", (9, -12, 0)),
        ("Bip01 {} Calf", "Bip01 {} Thigh", (0, -42, 0)),
        ("Bip01 {} Foot", "Bip01 {} Calf", (0, -41, 0)),
        ("Bip01 {} Toe0", "Bip01 {} Foot", (0, -6, 13)),
        ("Bip01 Spine1", "Bip01 Spine", (0, 15, 0)),
        ("Bip01 Spine2", "Bip01 Spine1", (0, 15, 0)),
        ("Bip01 Neck", "Bip01 Spine2", (0, 15, 0)),
        ("Bip01 Head", "Bip01 Neck", (0, 9, 2)),
        ("Bip01 {} Clavicle", "Bip01 Neck", (3, -3, 0)),
        ("Bip01 {} UpperArm", "Bip01 {} Clavicle", (14, 0, 0)),
        ("Bip01 {} Forearm", "Bip01 {} UpperArm", (28, 0, 0)),
        ("Bip01 {} Hand", "Bip01 {} Forearm", (25, 0, 0)),
    )
    nod = {"Bip01 Neck": np.linspace([0] * 3, [0, 20, 0], 20)}
    path = write_bvh(tmp_path / "a.bvh", joints, standing(20, 92), nod)
    roles = find_roles(read_bvh(path)).joints
    expected = {
        "root": "Bip01 Spine", "spine1": "Bip01 Spine1", "spine2": "Bip01 Spine2",
        "neck": "Bip01 Neck", "head": "Bip01 Head", "left_hip": "Bip01 L Thigh",
        "right_clavicle": "Bip01 R Clavicle", "right_wrist": "Bip01 R Hand",
    }  # fmt: skip
    assert expected.items() <= roles.items()
    motion, _ = read_motion(path)
    assert motion.forward_kinematics()[0][0, JOINTS.index("head"), 2] == pytest.approx(
        1.56, abs=0.01
    )


def test_a_helper_with_the_name_of_the_joint_below_is_not_taken_for_it(tmp_path):
    # As in MakeHuman's older exports.
    joints = chain(
        ("Hips", "", (0, 0, 0)), ("Spine", "Hips", (0, 30, 0)), ("Head", "Spine", (0, 35, 0)),
        ("UpLeg_{}", "Hips", (9, -5, 0)), ("LoLeg_{}", "UpLeg_{}", (0, -42, 0)),
        ("Foot_{}", "LoLeg_{}", (0, -41, 0)),
        ("__Clavicle_{}", "Spine", (0, 20, 0)), ("Clavicle_{}", "__Clavicle_{}", (2, -3, 0)),
        ("UpArm_{}", "Clavicle_{}", (14, 0, 0)), ("LoArm_{}", "UpArm_{}", (28, 0, 0)),
        ("Hand_{}", "LoArm_{}", (25, 0, 0)),
    )  # fmt: skip
    path = write_bvh(tmp_path / "a.bvh", joints, standing(3, 92))
    assert find_roles(read_bvh(path)).joints["left_clavicle"] == "Clavicle_L"


def test_vertebrae_called_l5_and_l3_are_not_of_the_left_side():
    names = understand(
        ["L5", "L3", "T12", "L_Hip", "LThigh", "RThigh", "lhip", "rhip", "LUArm", "RUArm"]
    )
    sides = [name.side for name in names]
    assert sides == ["", "", "", "left", "left", "right", "left", "right", "left", "right"]


def test_no_warning_of_gimbal_lock_reaches_the_user(tmp_path):
    # The chest turns by 90 degrees about x: the middle of its three hinges.
    lean = {"Spine1": (90, 0, 0)}
    path = write_bvh(tmp_path / "a.bvh", SMPL_JOINTS, standing(20, 0.95), lean)
    command = [sys.executable, "-m", "questsim", "motions", "import", str(path), "--accept"]
    command += ["--out", str(tmp_path / "a.npz")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "imbal" not in done.stderr, done.stderr
