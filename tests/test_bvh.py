import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mocap_files import (
    BANDAI_ROOT,
    BANDAI_ZIP,
    CMU_JOINTS,
    LAFAN1_JOINTS,
    LAFAN1_T_POSE,
    SMPL_JOINTS,
    standing,
    write_bvh,
)
from scipy.spatial.transform import Rotation

from questsim import rotations as rot
from questsim.errors import InputError
from questsim.motion.bvh import read_bvh
from questsim.motion.convert import global_pose, world_axes
from questsim.motion.families import FAMILIES, OPTIONAL, Family, family_of, load_mapping
from questsim.motion.reading import ReadOptions, read_motion
from questsim.skeleton import JOINTS

SKELETONS = {
    "LAFAN1": (LAFAN1_JOINTS, LAFAN1_T_POSE, 93.6),
    "CMU": (CMU_JOINTS, {}, 17.0),
    "SMPL": (SMPL_JOINTS, {}, 0.95),
}


def joint(name: str) -> int:
    return JOINTS.index(name)


@pytest.fixture(params=SKELETONS)
def family_file(request, tmp_path) -> tuple[str, Path]:
    joints, pose, height = SKELETONS[request.param]
    rng = np.random.default_rng(7)
    base = {name: np.array(pose.get(name, (0, 0, 0)), float) for name, _, _ in joints}
    still = ("LHipJoint", "RHipJoint", "Neck1")
    moved = {
        name: angles + rng.normal(0, 0 if name in still else 6, (25, 3))
        for name, angles in base.items()
    }
    path = write_bvh(tmp_path / "person.bvh", joints, standing(25, height), moved)
    return request.param, path


@pytest.fixture(scope="module")
def bandai(tmp_path_factory) -> Path:
    if not BANDAI_ZIP.is_file():
        pytest.skip(f"{BANDAI_ZIP} is not here")
    folder = tmp_path_factory.mktemp("bandai")
    with zipfile.ZipFile(BANDAI_ZIP) as archive:
        for clip in ("walk_normal_001", "run_normal_001", "wave-right-hand_normal_001"):
            name = f"dataset-2_{clip}.bvh"
            (folder / name).write_bytes(archive.read(f"{BANDAI_ROOT}data/{name}"))
    return folder


def recognise(names, path) -> Family:
    family = family_of(names)
    assert family, path
    return family


def assert_positions_kept(path: Path, metres: float, up: str) -> None:
    recording = read_bvh(path)
    family = recognise(recording.names, path)
    motion, _ = read_motion(path)
    expected = global_pose(recording)[0] * metres @ world_axes(up).T
    got, _ = motion.forward_kinematics()
    for ours, theirs in family.joints.items():
        distance = np.linalg.norm(
            got[:, joint(ours)] - expected[:, recording.names.index(theirs)], axis=-1
        )
        assert distance.max() < 1e-3, (ours, theirs)


def test_each_family_is_recognised_and_keeps_the_positions_of_its_joints(family_file):
    name, path = family_file
    assert recognise(read_bvh(path).names, path).name == name
    assert_positions_kept(path, {"LAFAN1": 0.01, "CMU": 0.0254 / 0.45, "SMPL": 1.0}[name], "y")


@pytest.mark.parametrize("name", SKELETONS)
def test_identity_rotations_of_each_family_are_a_t_pose_that_faces_x(name, tmp_path):
    joints, pose, height = SKELETONS[name]
    path = write_bvh(tmp_path / "person.bvh", joints, standing(2, height), pose)
    offsets = read_motion(path)[0].offsets
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for part in ("knee", "ankle"):
            bone = offsets[joint(f"{side}_{part}")]
            np.testing.assert_allclose(bone, [0, 0, -float(np.linalg.norm(bone))], atol=1e-4)
        for part in ("elbow", "wrist"):
            bone = offsets[joint(f"{side}_{part}")]
            np.testing.assert_allclose(bone, [0, sign * float(np.linalg.norm(bone)), 0], atol=1e-4)
        assert offsets[joint(f"{side}_hip")][1] * sign > 0.04
        assert offsets[joint(f"{side}_toe")][0] > 0.1
    for part in ("spine2", "spine3", "head"):
        assert offsets[joint(part)][2] > 0.04


@pytest.mark.parametrize("name", SKELETONS)
def test_someone_who_stands_with_the_arms_out_is_near_the_identity_pose(name, tmp_path):
    joints, pose, height = SKELETONS[name]
    motion, _ = read_motion(write_bvh(tmp_path / "person.bvh", joints, standing(2, height), pose))
    angle = np.degrees(rot.angle_between(motion.rotations, np.array([1.0, 0, 0, 0])))
    # CMU's zero pose splays the legs by 20 degrees, SMPL's bends the knees a little.
    limit = {"CMU": 25, "SMPL": 12, "LAFAN1": 5}[name]
    assert angle.max() < limit, JOINTS[int(angle.max(axis=0).argmax())]


def test_a_bent_lafan1_knee_and_elbow_bend_about_our_hinge_axes(tmp_path):
    pose = LAFAN1_T_POSE | {
        "LeftLeg": (-40, 0, 0), "RightLeg": (-40, 0, 0),
        "LeftForeArm": (-50, 0, 0), "RightForeArm": (-50, 0, 0),
    }  # fmt: skip
    path = write_bvh(tmp_path / "person.bvh", LAFAN1_JOINTS, standing(2, 93.6), pose)
    motion, _ = read_motion(path, ReadOptions(accept=True))
    turns = Rotation.from_quat(motion.rotations[0], scalar_first=True).as_rotvec(degrees=True)
    np.testing.assert_allclose(turns[joint("left_knee")], [0, 40, 0], atol=0.1)
    np.testing.assert_allclose(turns[joint("right_knee")], [0, 40, 0], atol=0.1)
    np.testing.assert_allclose(turns[joint("left_elbow")], [0, 0, -50], atol=0.1)
    np.testing.assert_allclose(turns[joint("right_elbow")], [0, 0, 50], atol=0.1)


def test_bandai_clips_keep_their_joint_positions(bandai):
    for path in bandai.iterdir():
        assert_positions_kept(path, 0.01, "y")


def test_a_bandai_walk_goes_the_way_it_faces_with_knees_that_bend_backwards(bandai):
    motion, report = read_motion(bandai / "dataset-2_walk_normal_001.bvh")
    assert (motion.kind, motion.style, motion.fps) == ("walk", "normal", 30.0)
    assert not report.problems
    yaw = rot.heading(motion.rotations[:, 0])
    velocity = np.diff(motion.root_position, axis=0)[:, :2]
    ahead = np.sum(velocity * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)[:-1], axis=-1)
    assert np.percentile(ahead * motion.fps, 20) > 0.3
    for side in ("left", "right"):
        knee = rot.as_rotation(motion.rotations[:, joint(f"{side}_knee")]).as_rotvec(degrees=True)
        assert np.percentile(knee[:, 1], 95) > 50 and knee[:, 1].min() > -5
        assert abs(knee[:, [0, 2]]).max() < 5


def test_bandai_elbows_flex_forward_from_the_t_pose(bandai):
    motion, _ = read_motion(bandai / "dataset-2_run_normal_001.bvh")
    for side, sign in (("left", -1), ("right", 1)):
        elbow = rot.as_rotation(motion.rotations[:, joint(f"{side}_elbow")]).as_rotvec(degrees=True)
        assert np.median(sign * elbow[:, 2]) > 60 and (sign * elbow[:, 2]).min() > -5
        assert abs(np.median(elbow[:, :2], axis=0)).max() < 15


def test_waving_the_right_hand_raises_the_right_hand(bandai):
    motion, _ = read_motion(bandai / "dataset-2_wave-right-hand_normal_001.bvh")
    height = motion.forward_kinematics()[0][..., 2].max(axis=0)
    assert height[joint("right_wrist")] > height[joint("head")] + 0.15
    assert height[joint("left_wrist")] < height[joint("head")] - 0.3


def test_bandai_soles_are_level_while_the_performer_stands(bandai):
    motion, _ = read_motion(bandai / "dataset-2_wave-right-hand_normal_001.bvh")
    _, world = motion.forward_kinematics()
    for side in ("left", "right"):
        up = rot.quat_rotate(world[:, joint(f"{side}_ankle")], np.array([0.0, 0.0, 1.0]))
        assert np.degrees(np.arccos(np.median(up[:, 2]))) < 8


@given(
    order=st.permutations("XYZ"),
    angles=st.lists(st.floats(-179, 179), min_size=9, max_size=9),
)
def test_euler_angles_of_any_channel_order_become_the_same_rotations(
    order, angles, tmp_path_factory
):
    names = ["Pelvis", "L_Hip", "Head"]
    turns = dict(zip(names, np.reshape(angles, (3, 3)), strict=True))
    path = write_bvh(
        tmp_path_factory.mktemp("bvh") / "person.bvh", SMPL_JOINTS, standing(1, 1), turns,
        order="".join(order),
    )  # fmt: skip
    recording = read_bvh(path)
    for name in names:
        matrix = np.eye(3)
        for axis, angle in zip(order, turns[name], strict=True):
            matrix = matrix @ Rotation.from_euler(axis.lower(), angle, degrees=True).as_matrix()
        got = rot.quat_to_matrix(recording.rotations[0, recording.names.index(name)])
        np.testing.assert_allclose(got, matrix, atol=1e-6)


def test_rounded_frame_times_mean_whole_frame_rates(tmp_path):
    for frame_time, fps in ((0.0333333, 30.0), (0.008333, 120.0), (1001 / 30000, 29.97003)):
        path = write_bvh(tmp_path / "a.bvh", SMPL_JOINTS, standing(3, 1), frame_time=frame_time)
        assert read_bvh(path).fps == pytest.approx(fps, abs=1e-4)


def test_blank_lines_and_odd_spacing_are_read_like_the_plain_file(tmp_path, family_file):
    _, path = family_file
    text = path.read_text().replace("Frames: ", "Frames:").replace("\nMOTION", "\n\n MOTION ")
    odd = tmp_path / "odd.bvh"
    odd.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode() + b"\r\n\r\n")
    np.testing.assert_array_equal(read_bvh(odd).rotations, read_bvh(path).rotations)


def _line(text: str, start: str, new: str) -> str:
    lines = text.splitlines()
    index = next(i for i, line in enumerate(lines) if line.strip().startswith(start))
    lines[index] = new
    return "\n".join(lines)


BROKEN: dict[str, tuple[Callable[[str], str], str]] = {
    "empty": (lambda t: " \n", "is empty"),
    "git lfs": (lambda t: "version https://git-lfs.github.com/spec/v1\noid", "run 'git lfs pull'"),
    "web page": (lambda t: "\n<!DOCTYPE html><html>", "is a web page, not the file"),
    "no bvh": (lambda t: "hello\n" + t, "line 1: HIERARCHY expected"),
    "no motion": (lambda t: t[: t.index("MOTION")], "no MOTION block"),
    "truncated frames": (lambda t: "\n".join(t.splitlines()[:-3]), "ends after 22 of 25 frames"),
    "truncated line": (lambda t: t[:-60], "values, the channels ask for"),
    "too many frames": (lambda t: t + t.splitlines()[-1] + "\n", "26 frames follow"),
    "nan": (lambda t: t.replace("MOTION", "MOTION").rsplit(" ", 1)[0] + " nan\n", "finite number"),
    "text": (lambda t: t.rsplit(" ", 1)[0] + " abc\n", "finite number"),
    "no frames": (lambda t: _line(t, "Frames:", "Frames: 0"), "not a whole number above zero"),
    "bad frames": (lambda t: _line(t, "Frames:", "Frames: many"), "'Frames: NUMBER' expected"),
    "no time": (lambda t: _line(t, "Frame Time:", "Frame Time: 0"), "not above zero"),
    "two people": (lambda t: t[: t.index("MOTION")] + t, "exactly one ROOT; keep one person"),
    "one channel": (lambda t: _line(t, "CHANNELS 3", "CHANNELS 1 Xrotation"), "channels ask for"),
    "foreign channel": (lambda t: _line(t, "CHANNELS 3", "CHANNELS 1 Scale"), "are not channels"),
    "same channel": (
        lambda t: _line(t, "CHANNELS 3", "CHANNELS 2 Xrotation Xrotation"), "are not channels"
    ),
    "still root": (
        lambda t: _line(t, "CHANNELS 6", "CHANNELS 3 Zrotation Yrotation Xrotation"),
        "values, the channels|no position channels",
    ),
    "brace": (lambda t: _line(t, "JOINT", ""), "unexpected {"),
    "giant": (lambda t: _line(t, "OFFSET", "OFFSET 1e308 0 0"), "too large for a bone"),
    "rate as time": (lambda t: _line(t, "Frame Time:", "Frame Time: 30"), "0.0333 frames.*--fps"),
    "too fast": (lambda t: _line(t, "Frame Time:", "Frame Time: 5e-324"), "frames a second.*--fps"),
    "frames nan": (lambda t: _line(t, "Frames:", "Frames: nan"), "not a whole number"),
    "no channels": (lambda t: _line(t, "CHANNELS 3", ""), "CHANNELS expected"),
    "long count": (lambda t: _line(t, "CHANNELS 3", "CHANNELS " + "3" * 5000), "needs a number"),
    "offset": (lambda t: _line(t, "OFFSET", "OFFSET 1 2"), "not 3 finite numbers"),
    "unclosed": (lambda t: t.replace("}\nMOTION", "MOTION"), "MOTION before the end"),
}  # fmt: skip


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_file_is_refused_with_the_reason(case, family_file, tmp_path):
    _, path = family_file
    broken, reason = BROKEN[case]
    file = tmp_path / "broken.bvh"
    file.write_text(broken(path.read_text()))
    with pytest.raises(InputError, match=reason) as error:
        read_motion(file)
    assert "broken.bvh" in str(error.value) and "\n" not in str(error.value)


def test_other_spellings_of_the_format_give_the_same_recording(tmp_path, family_file):
    _, path = family_file
    text = path.read_text()
    expected = read_bvh(path)
    spellings = {
        "case": text.replace("End Site", "End site").replace("Xposition", "XPosition"),
        "brace": re.sub(r"(ROOT|JOINT) (\S+)\n\s*\{", r"\1 \2 {", text),
        "time": text.replace("Frame Time:", "Frame time :"),
    }
    for name, spelling in spellings.items():
        (tmp_path / "other.bvh").write_text(spelling)
        got = read_bvh(tmp_path / "other.bvh")
        np.testing.assert_array_equal(got.rotations, expected.rotations, err_msg=name)
        assert got.names == expected.names


def test_channels_in_any_number_and_order_are_read(tmp_path):
    lines = [
        "HIERARCHY", "ROOT Hip bone", "{", "OFFSET 0 0 0",
        "CHANNELS 6 Zrotation Yrotation Xrotation Zposition Xposition Yposition",
        "JOINT Knee", "{", "OFFSET 0 -4 0", "CHANNELS 1 Xrotation",
        "JOINT Fixed", "{", "OFFSET 0 -3 0", "CHANNELS 0",
        "JOINT Fixed", "{", "OFFSET 0 -2 0", "CHANNELS 3 Xposition Yposition Zposition",
        "JOINT Shifted", "{", "OFFSET 1 0 0", "CHANNELS 3 Xposition Yposition Zposition",
        "End Site", "{", "OFFSET 0 -1 0", "}", "}", "}", "}", "}", "}",
        "MOTION", "Frames: 1", "Frame Time: 0.02",
        "90 0 0 3 1 2  30  0 -5 0  0.01 0 0",
    ]  # fmt: skip
    (tmp_path / "a.bvh").write_text("\n".join(lines))
    got = read_bvh(tmp_path / "a.bvh")
    assert got.names == ("Hip bone", "Knee", "Fixed", "Fixed-2", "Shifted")
    np.testing.assert_allclose(
        got.positions[0], [[1, 2, 3], [0, -4, 0], [0, -3, 0], [0, -5, 0], [1.01, 0, 0]]
    )
    turns = rot.as_rotation(got.rotations[0]).as_euler("zyx", degrees=True)
    np.testing.assert_allclose(
        turns, [[90, 0, 0], [0, 0, 30], [0] * 3, [0] * 3, [0] * 3], atol=1e-9
    )
    np.testing.assert_allclose(got.tips[4], [0, -1, 0])


@pytest.mark.parametrize(
    ("encoding", "name"), [("latin-1", "Hüfte"), ("shift_jis", "左ひざ"), ("utf-16", "Hüfte")]
)
def test_joint_names_in_older_encodings_are_read(tmp_path, encoding, name):
    joints = [(n.replace("L_Knee", name), p, o) for n, p, o in SMPL_JOINTS]
    path = write_bvh(
        tmp_path / "a.bvh",
        [(n if n.isascii() else "NAME", p, o) for n, p, o in joints],
        standing(2, 1),
    )
    path.write_bytes(path.read_text().replace("NAME", name).encode(encoding))
    assert name in read_bvh(path).names


def test_a_declared_rate_replaces_an_absurd_frame_time(tmp_path):
    path = write_bvh(tmp_path / "a.bvh", SMPL_JOINTS, standing(3, 0.95), frame_time=30.0)
    with pytest.raises(InputError, match=r"Frame Time of 30 s means 0.0333 .*--fps"):
        read_motion(path)
    assert read_motion(path, ReadOptions(fps=30.0))[0].fps == 30.0


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_bvh(tmp_path / "none.bvh")


@given(data=st.data())
def test_a_file_with_a_piece_cut_out_is_read_or_refused_but_never_crashes(data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("bvh")
    text = write_bvh(folder / "a.bvh", SMPL_JOINTS, standing(2, 0.95)).read_text()
    start = data.draw(st.integers(0, len(text)))
    length = data.draw(st.integers(0, 400))
    (folder / "b.bvh").write_text(text[:start] + text[start + length :])
    try:
        recording = read_bvh(folder / "b.bvh")
    except InputError:
        return
    assert np.isfinite(recording.rotations).all() and len(recording.rotations) == 2


def test_a_mapping_file_makes_an_unknown_skeleton_known(tmp_path):
    joints = [(f"bone{i}", p, o) for i, (_, p, o) in enumerate(SMPL_JOINTS)]
    smpl = next(f for f in FAMILIES if f.name == "SMPL")
    index = {name: i for i, (name, _, _) in enumerate(SMPL_JOINTS)}
    # Without a third spine joint and without collarbones: they are put in between.
    left_out = ("spine3", "left_clavicle", "right_clavicle")
    mapping = tmp_path / "rig.toml"
    mapping.write_text(
        "[joints]\n"
        + "".join(
            f'{ours} = "bone{index[theirs]}"\n'
            for ours, theirs in smpl.joints.items()
            if ours not in left_out
        )
    )
    path = write_bvh(tmp_path / "a.bvh", joints, standing(3, 0.95))
    motion, _ = read_motion(path, ReadOptions(mapping=str(mapping)))
    original, _ = read_motion(write_bvh(tmp_path / "b.bvh", SMPL_JOINTS, standing(3, 0.95)))
    got, expected = motion.forward_kinematics()[0], original.forward_kinematics()[0]
    kept = [i for i, name in enumerate(JOINTS) if name not in left_out]
    np.testing.assert_allclose(got[:, kept], expected[:, kept], atol=1e-6)


def test_the_mapping_file_of_the_documentation_is_one(tmp_path):
    page = (Path(__file__).parents[1] / "docs" / "motion.md").read_text()
    (tmp_path / "rig.toml").write_text(page.split("```toml\n")[1].split("```")[0])
    family = load_mapping(tmp_path / "rig.toml")
    assert (family.units, family.up) == ("cm", "y")
    assert set(JOINTS) - set(family.joints) <= set(OPTIONAL)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("joints = 3 = 4", "cannot be read"),
        ("[joints]\nroot = 'a'\n", "lacks left_hip"),
        ("[joints]\ntail = 'a'\n", "unknown key 'tail'"),
        ("colour = 'red'\n", "unknown key 'colour'"),
        ("joints = 3\n", "'joints' is of the wrong type"),
        ("[joints]\nroot = 3\n", "'joints.root' is of the wrong type"),
        ("foot_pitch = 'flat'\n", "'foot_pitch' is of the wrong type"),
        ("up = 'w'\n", "up axis 'w'"),
        ("foot_pitch = nan\n", "foot_pitch is nan, not radians"),
        ("name = " + "[" * 100_000, "cannot be read"),
    ],
)
def test_a_wrong_mapping_file_is_refused(text, reason, tmp_path):
    (tmp_path / "rig.toml").write_text(text)
    path = write_bvh(tmp_path / "a.bvh", SMPL_JOINTS, standing(3, 0.95))
    with pytest.raises(InputError, match=reason):
        read_motion(path, ReadOptions(mapping=str(tmp_path / "rig.toml")))
