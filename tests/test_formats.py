"""ASF/AMC and DeepMimic files: positions against an independent computation, and bad files."""

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from mocap_files import SHARED

from questsim import rotations as rot
from questsim.errors import InputError
from questsim.motion.asf_amc import read_asf_amc, skeleton_of
from questsim.motion.checks import stature
from questsim.motion.convert import global_pose
from questsim.motion.deepmimic import read_deepmimic
from questsim.motion.reading import ReadOptions, read_motion
from questsim.motion.sources import motion_files
from questsim.skeleton import JOINTS

MORE = SHARED / "more-motions.zip"

# Bone, parent, direction, length, axis in degrees, degrees of freedom; as CMU's skeletons are.
BONES = [
    ("lhipjoint", "root", (0.65, -0.71, 0.25), 2.5, (0, 0, 0), ""),
    ("lfemur", "lhipjoint", (0.34202, -0.939693, 0), 7.6, (0, 0, 20), "rx ry rz"),
    ("ltibia", "lfemur", (0.34202, -0.939693, 0), 7.3, (0, 0, 20), "rx"),
    ("lfoot", "ltibia", (0.09, -0.24, 0.966), 2.2, (-90, 0, 20), "rx rz"),
    ("ltoes", "lfoot", (0, 0, 1), 1.1, (-90, 0, 20), "rx"),
    ("rhipjoint", "root", (-0.65, -0.71, 0.25), 2.5, (0, 0, 0), ""),
    ("rfemur", "rhipjoint", (-0.34202, -0.939693, 0), 7.6, (0, 0, -20), "rx ry rz"),
    ("rtibia", "rfemur", (-0.34202, -0.939693, 0), 7.3, (0, 0, -20), "rx"),
    ("rfoot", "rtibia", (-0.09, -0.24, 0.966), 2.2, (-90, 0, -20), "rx rz"),
    ("rtoes", "rfoot", (0, 0, 1), 1.1, (-90, 0, -20), "rx"),
    ("lowerback", "root", (0, 1, 0), 2.06, (0, 0, 0), "rx ry rz"),
    ("upperback", "lowerback", (0, 1, 0), 2.07, (0, 0, 0), "rx ry rz"),
    ("thorax", "upperback", (0, 1, 0), 2.07, (0, 0, 0), "rx ry rz"),
    ("lowerneck", "thorax", (0, 1, 0), 1.57, (0, 0, 0), "rx ry rz"),
    ("upperneck", "lowerneck", (0, 1, 0), 1.57, (0, 0, 0), "rx ry rz"),
    ("head", "upperneck", (0, 1, 0), 1.6, (0, 0, 0), "rx ry rz"),
    ("lclavicle", "thorax", (0.97, 0.25, 0), 3.66, (0, 0, 0), "ry rz"),
    ("lhumerus", "lclavicle", (1, 0, 0), 4.9, (180, -30, -90), "rx ry rz"),
    ("lradius", "lhumerus", (1, 0, 0), 3.4, (180, -30, -90), "rx"),
    ("lwrist", "lradius", (1, 0, 0), 1.7, (0, 90, 90), "ry"),
    ("rclavicle", "thorax", (-0.97, 0.25, 0), 3.66, (0, 0, 0), "ry rz"),
    ("rhumerus", "rclavicle", (-1, 0, 0), 5.0, (180, 30, 90), "rx ry rz"),
    ("rradius", "rhumerus", (-1, 0, 0), 3.4, (180, 30, 90), "rx"),
    ("rwrist", "rradius", (-1, 0, 0), 1.7, (0, -90, -90), "ry"),
]


def write_asf(path: Path) -> Path:
    lines = [
        ":version 1.10", ":units", "  length 0.45", "  angle deg", ":root",
        "  order TX TY TZ RX RY RZ", "  axis XYZ", "  position 0 0 0", "  orientation 0 0 0",
        ":bonedata",
    ]  # fmt: skip
    for name, _, direction, length, axis, dof in BONES:
        lines += ["  begin", f"    name {name}", f"    length {length}"]
        lines += [f"    direction {' '.join(map(str, direction))}"]
        lines += [f"    axis {' '.join(map(str, axis))} XYZ", *([f"    dof {dof}"] if dof else [])]
        lines += ["    limits (-180 180)", "  end"]
    lines += [":hierarchy", "  begin"]
    for parent in dict.fromkeys(bone[1] for bone in BONES):
        lines.append(f"    {parent} {' '.join(b[0] for b in BONES if b[1] == parent)}")
    path.write_text("\n".join([*lines, "  end"]) + "\n")
    return path


def write_amc(path: Path, root: np.ndarray, angles: dict[str, np.ndarray]) -> Path:
    lines = ["# comment", ":FULLY-SPECIFIED", ":DEGREES"]
    for frame, values in enumerate(root):
        lines += [str(frame + 1), "root " + " ".join(f"{v:.6f}" for v in values)]
        lines += [
            f"{n} " + " ".join(f"{v:.6f}" for v in a[frame]) for n, a in angles.items() if a.size
        ]
    path.write_text("\n".join(lines) + "\n")
    return path


def turn(axis: str, degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return {
        "x": np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
        "y": np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
        "z": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
    }[axis]


def fixed_axes(values: dict[str, float]) -> np.ndarray:
    """The matrix of turns about fixed axes, the first named first."""
    out = np.eye(3)
    for axis, value in values.items():
        out = turn(axis, value) @ out
    return out


def bone_starts(root: np.ndarray, angles: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Where bones begin in one frame, by Lander's recursion over bones' ends."""
    matrix = {"root": fixed_axes(dict(zip("xyz", root[3:], strict=True)))}
    end, start = {"root": root[:3]}, {"root": root[:3]}
    for name, parent, direction, length, axis, dof in BONES:
        own = fixed_axes(dict(zip("xyz", axis, strict=True)))
        moved = fixed_axes(dict(zip((d[1] for d in dof.split()), angles[name], strict=True)))
        matrix[name] = matrix[parent] @ own @ moved @ own.T
        start[name] = end[parent]
        end[name] = end[parent] + matrix[name] @ (np.array(direction) * length)
    return start


@pytest.fixture
def take(tmp_path) -> tuple[Path, np.ndarray, dict[str, np.ndarray]]:
    """A take of subject 07, whose bones all turn a little."""
    rng = np.random.default_rng(3)
    root = np.concatenate([rng.normal([0, 17, 0], 0.2, (20, 3)), rng.normal(0, 9, (20, 3))], 1)
    root[:, :3] = np.sort(root[:, :3], axis=0)
    angles = {b[0]: rng.normal(0, 12, (20, len(b[5].split()))) for b in BONES}
    write_asf(tmp_path / "07.asf")
    return write_amc(tmp_path / "07_01.amc", root, angles), root, angles


def test_an_amc_files_joints_are_where_its_skeletons_recursion_puts_them(take):
    path, root, angles = take
    recording = read_asf_amc(path)
    position, _ = global_pose(recording)
    for frame in (0, 7, 19):
        expected = bone_starts(root[frame], {n: a[frame] for n, a in angles.items()})
        got = dict(zip(recording.names, position[frame], strict=True))
        for name, place in expected.items():
            np.testing.assert_allclose(got[name], place, atol=1e-5, err_msg=name)


def test_an_amc_file_becomes_a_person_with_its_joints_in_metres(take):
    path, root, angles = take
    motion, report = read_motion(path)
    assert report.units.startswith("cmu") and motion.fps == 120.0
    assert 1.6 < stature(motion) < 1.85
    got, _ = motion.forward_kinematics()
    start = bone_starts(root[5], {n: a[5] for n, a in angles.items()})
    for ours, theirs in (("left_ankle", "lfoot"), ("right_elbow", "rradius"), ("head", "head")):
        x, y, z = start[theirs] * 0.0254 / 0.45
        np.testing.assert_allclose(got[5, JOINTS.index(ours)], [z, x, y], atol=1e-3)


def test_amc_takes_find_their_subjects_skeleton_in_folders_and_zips(take, tmp_path, monkeypatch):
    path, *_ = take
    monkeypatch.setenv("QUESTSIM_CACHE", str(tmp_path / "cache"))
    write_asf(tmp_path / "08.asf")
    assert skeleton_of(path).name == "07.asf"
    archive = tmp_path / "all.zip"
    with zipfile.ZipFile(archive, "w") as out:
        for file in (path, tmp_path / "07.asf", tmp_path / "08.asf"):
            out.write(file, f"subjects/{file.name}")
        out.writestr("subjects/README.txt", "no motion")
        out.writestr("../outside.bvh", "HIERARCHY")
    files = motion_files(archive)
    assert [file.name for file in files] == ["07_01.amc"]
    a, b = read_motion(files[0])[0], read_motion(path)[0]
    np.testing.assert_array_equal(a.rotations, b.rotations)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("\nlfemur", "\nlthigh", r"07_01.amc, line \d+: the skeleton has no bone 'lthigh'"),
        ("\nltoes ", "\nltoes 1 ", r"ltoes has 2 values, its skeleton asks for 1"),
        ("\nltoes ", "\nltoes nan #", r"ltoes has \d values"),
        ("\n1\n", "\n", r"a frame's number expected"),
    ],
)
def test_bad_amc_lines_are_named(take, old, new, message):
    path, *_ = take
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        read_motion(path)


def test_an_amc_frame_that_lacks_a_bone_or_a_number_is_refused(take):
    path, *_ = take
    text = path.read_text()
    lines = text.splitlines()
    path.write_text("\n".join(lines[:-1]) + "\n")
    with pytest.raises(InputError, match="frame 20 has no line of rwrist"):
        read_motion(path)
    path.write_text("\n".join([*lines[:-1], "rwrist nan"]) + "\n")
    with pytest.raises(InputError, match="rwrist of frame 20: 'nan' is not 1 finite"):
        read_motion(path)
    (path.parent / "07.asf").unlink()
    with pytest.raises(InputError, match="put the subject's"):
        read_motion(path)


def still_frame(**changes: float) -> list[float]:
    """A row of someone who stands with hanging arms; keys ``v8`` and so on change numbers."""
    row = [0.0] * 44
    row[0], row[2] = 1 / 30, 0.9
    for quat in (4, 8, 12, 16, 21, 25, 30, 35, 39):
        row[quat] = 1.0
    for key, value in changes.items():
        row[int(key[1:])] = value
    return row


def write_deepmimic(path: Path, frames: list, **keys) -> Path:
    path.write_text(json.dumps({"Loop": "wrap", "Frames": frames} | keys))
    return path


def test_a_deepmimic_files_joints_are_where_the_published_skeleton_puts_them(tmp_path):
    # The right knee bends by 90 degrees, the left elbow too; z is to the right, x forward.
    frame = still_frame(v20=-np.pi / 2, v43=np.pi / 2)
    motion, report = read_motion(write_deepmimic(tmp_path / "a.txt", [frame] * 3))
    assert motion.fps == 30.0 and report.units.startswith("m")
    got = motion.forward_kinematics()[0][0]

    def place(name: str) -> np.ndarray:
        # Our world faces the file's z, left of which is its x.
        z, x, y = got[JOINTS.index(name)]
        return np.array([x, y, z])

    hip = np.array([0, 0.9, 0.084887])
    np.testing.assert_allclose(place("right_hip"), hip, atol=1e-6)
    knee = hip - [0, 0.421546, 0]
    np.testing.assert_allclose(place("right_knee"), knee, atol=1e-6)
    np.testing.assert_allclose(place("right_ankle"), knee - [0.40987, 0, 0], atol=1e-6)
    shoulder = np.array([-0.02405, 0.9 + 0.236151 + 0.2435, -0.18311])
    np.testing.assert_allclose(place("left_shoulder"), shoulder, atol=1e-6)
    elbow = shoulder - [0, 0.274788, 0]
    np.testing.assert_allclose(place("left_elbow"), elbow, atol=1e-6)
    np.testing.assert_allclose(place("left_wrist"), elbow + np.array([0.258947, 0, 0]), atol=1e-6)
    turns = rot.as_rotation(motion.rotations[0]).as_rotvec(degrees=True)
    np.testing.assert_allclose(turns[JOINTS.index("right_knee")], [0, 90, 0], atol=1e-4)
    np.testing.assert_allclose(turns[JOINTS.index("left_elbow")], [0, 0, -90], atol=1e-4)


def test_deepmimic_frames_of_unequal_duration_are_put_on_even_times(tmp_path):
    frames = [still_frame(v1=float(x)) for x in (0.0, 0.1, 0.2, 0.4, 0.5)]
    frames[2][0] = 2 / 30
    recording = read_deepmimic(write_deepmimic(tmp_path / "a.json", frames))
    np.testing.assert_allclose(recording.positions[:, 0, 0], [0, 0.1, 0.2, 0.3, 0.4, 0.5])
    assert recording.fps == 30.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not JSON"),
        ('{"Frames": 3}', "has no list 'Frames'"),
        ('{"Frames": [[1, 2]]}', "frame 0 has 2 numbers, the humanoid's have 44"),
        ('{"Frames": [["a"]]}', "frame 0 is not a list of numbers"),
        (json.dumps({"Frames": [still_frame(v8=0.0)]}), "chest of frame 0 is not a unit"),
        (json.dumps({"Frames": [still_frame(v0=0.0)] * 2}), "frame 0 lasts 0 s; declare"),
        (json.dumps({"Frames": [still_frame(v1=float("inf"))]}), "frame 0 holds a number that"),
        ("[" * 100_000, "is not JSON"),
    ],
)
def test_bad_deepmimic_files_are_refused_in_one_line(tmp_path, text, message):
    path = tmp_path / "a.txt"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_motion(path)


def test_an_archive_that_is_broken_or_has_no_motion_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("QUESTSIM_CACHE", str(tmp_path / "cache"))
    (tmp_path / "a.zip").write_bytes(b"PK nothing")
    with pytest.raises(InputError, match="cannot be unpacked"):
        motion_files(tmp_path / "a.zip")
    with zipfile.ZipFile(tmp_path / "b.zip", "w") as archive:
        archive.writestr("README.txt", "no motion")
    with pytest.raises(InputError, match="there is no motion in it"):
        motion_files(tmp_path / "b.zip")


def test_a_folder_of_texts_gives_only_the_motions(tmp_path):
    write_deepmimic(tmp_path / "b.txt", [still_frame()] * 2)
    (tmp_path / "README.txt").write_text("Frames of ours")
    (tmp_path / "settings.json").write_text("{}")
    assert [path.name for path in motion_files(tmp_path)] == ["b.txt"]


@pytest.mark.skipif(not MORE.is_file(), reason=f"{MORE} is not here")
def test_real_amc_and_deepmimic_walks_go_the_way_they_face(tmp_path):
    with zipfile.ZipFile(MORE) as archive:
        wanted = ("02.asf", "02_01.amc", "humanoid3d_walk.txt")
        for name in archive.namelist():
            if name.endswith(wanted):
                (tmp_path / Path(name).name).write_bytes(archive.read(name))
    for name in wanted[1:]:
        motion, _ = read_motion(tmp_path / name, ReadOptions(accept=True))
        yaw = rot.heading(motion.rotations[:, 0])
        velocity = np.diff(motion.root_position, axis=0)[:, :2] * motion.fps
        ahead = np.sum(velocity * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)[:-1], axis=-1)
        assert 0.5 < np.median(ahead) < 2.0
        for side in ("left", "right"):
            knee = rot.as_rotation(motion.rotations[:, JOINTS.index(f"{side}_knee")])
            bend = knee.as_rotvec(degrees=True)[:, 1]
            assert np.percentile(bend, 95) > 40 and bend.min() > -8
