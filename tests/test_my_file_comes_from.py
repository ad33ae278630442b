"""Every row of the table "my file comes from ..." in docs/motion.md does what it says."""

import re
import shlex
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mocap_files import (
    CMU_JOINTS,
    LAFAN1_JOINTS,
    LAFAN1_T_POSE,
    SMPL_JOINTS,
    standing,
    write_amass,
    write_bvh,
)
from rig_styles import RIGS
from rigs import write_rig
from test_formats import BONES, still_frame, write_amc, write_asf, write_deepmimic
from test_recognise import without_sides
from test_strides import write_twisted

from questsim.cli import main
from questsim.errors import InputError
from questsim.motion.library import load_library
from questsim.motion.sources import motion_files
from questsim.skeleton import LINKS

PAGE = Path(__file__).parents[1] / "docs" / "motion.md"
SHARED_CASES = Path(__file__).parents[2] / "shared" / "cases"


def rig(name: str) -> Callable[[Path], object]:
    return lambda folder: write_rig(folder / "walk.bvh", RIGS[name])


def rigs(*names: str) -> list[Callable[[Path], object]]:
    return [rig(name) for name in names]


def nameless(style: str) -> Callable[[Path], object]:
    def make(folder: Path) -> None:
        write_rig(folder / "walk.bvh", RIGS[style])
        without_sides(folder / "walk.bvh", "bone")

    return make


def twisted(folder: Path) -> None:
    write_twisted(folder / "walk.bvh")


def subject(folder: Path) -> None:
    write_asf(folder / "02.asf")
    still = {bone[0]: np.zeros((20, len(bone[5].split()))) for bone in BONES}
    root = np.tile([0, 17.0, 0, 0, 0, 0], (20, 1))
    write_amc(folder / "02_01.amc", root, still)
    with zipfile.ZipFile(folder / "subjects.zip", "w") as archive:
        for name in ("02.asf", "02_01.amc"):
            archive.write(folder / name)


def slow_rate(folder: Path) -> None:
    write_bvh(folder / "walk.bvh", SMPL_JOINTS, standing(30, 0.95), frame_time=1.0)


def odd_units(folder: Path) -> None:
    joints = [(n, p, tuple(3 * v for v in o)) for n, p, o in SMPL_JOINTS]
    write_bvh(folder / "walk.bvh", joints, standing(30, 2.85))


def odd_names(folder: Path) -> None:
    joints = [(f"bone{i}", p, o) for i, (_, p, o) in enumerate(SMPL_JOINTS)]
    write_bvh(folder / "walk.bvh", joints, standing(30, 0.95))


def known_families(folder: Path) -> None:
    write_bvh(folder / "walk.bvh", LAFAN1_JOINTS, standing(30, 93.6), LAFAN1_T_POSE)


def cmu(folder: Path) -> None:
    write_bvh(folder / "walk.bvh", CMU_JOINTS, standing(30, 17.0))


def fbx(folder: Path) -> None:
    (folder / "walk.fbx").write_bytes(b"Kaydara FBX Binary")
    with pytest.raises(InputError, match="export it as BVH first"):
        motion_files(folder / "walk.fbx")
    write_rig(folder / "walk.bvh", RIGS["Mixamo"])


# What the user has, by the beginning of the row; each of several files is tried.
FILES: dict[str, list[Callable[[Path], object]]] = {
    "BVH of": [
        *rigs("Mixamo", "MotionBuilder", "Rokoko", "Xsens", "Xsens segments", "100STYLE"),
        *rigs("Axis Neuron", "OptiTrack Motive", "Character Creator", "Rigify", "MakeHuman"),
        *rigs("DAZ Genesis", "DAZ for Poser", "3ds Max Biped", "Unity humanoid", "VRM"),
        *rigs("Unreal mannequin", "SMPL-X", "SOMA", "Second Life", "DeepMotion", "Kinect"),
        *rigs("MikuMikuDance"),
        known_families,
        cmu,
    ],
    "a program that made rotations": [twisted],
    "a program that names no sides": [nameless("Mixamo"), nameless("Rigify")],
    "CMU, HDM05": [subject],
    "DeepMimic": [
        lambda folder: write_deepmimic(folder / "humanoid3d_walk.txt", [still_frame()] * 30)
    ],
    "AMASS (": [lambda folder: write_amass(folder / "walk_poses.npz")],
    "AMASS-like": [lambda folder: write_amass(folder / "walk_poses.npz", mocap_framerate=None)],
    "a BVH with": [slow_rate],
    "a program with units other": [odd_units],
    "a program whose skeleton": [odd_names],
    "anything": [fbx],
}


def table() -> list[tuple[str, str]]:
    text = PAGE.read_text().split("## My file comes from ...")[1].split("\nThen look")[0]
    return [
        (cells[1].strip(), cells[2])
        for cells in (line.split("|") for line in text.splitlines() if line.startswith("|"))
        if cells[1].strip() not in ("my file comes from", "---")
    ]


def fill_in(rig_file: Path) -> None:
    """What the user does with the mapping file: SMPL's order of joints, by number."""
    from questsim.motion.families import SMPL

    index = {name: i for i, (name, _, _) in enumerate(SMPL_JOINTS)}
    text = rig_file.read_text()
    for ours, theirs in SMPL.joints.items():
        text = text.replace(f'# {ours} = ""', f'{ours} = "bone{index[theirs]}"')
    rig_file.write_text(text)


def test_the_table_has_a_row_for_each_kind_of_file():
    rows = [name for name, _ in table()]
    for beginning in FILES:
        assert sum(row.startswith(beginning) for row in rows) == 1, beginning
    assert len(rows) == len(FILES)


@pytest.mark.parametrize("row", FILES)
def test_a_row_of_the_table_imports_the_file(row, tmp_path, monkeypatch):
    monkeypatch.setenv("QUESTSIM_CACHE", str(tmp_path / "cache"))
    advice = next(advice for name, advice in table() if name.startswith(row))
    commands = [c for c in re.findall(r"`([^`]+)`", advice) if c.startswith("questsim ")]
    assert commands
    for number, make in enumerate(FILES[row]):
        folder = tmp_path / str(number)
        folder.mkdir()
        monkeypatch.chdir(folder)
        make(folder)
        for command in commands:
            assert main(shlex.split(command)[1:]) == 0, command
            if " mapping " in command:
                fill_in(folder / "rig.toml")
        clips = load_library(folder / "mine.npz").clips
        assert len(clips) == 1 and len(clips[0]) >= 5
        # Upright: the head is above the feet.
        heights = clips[0].link_position[..., 2].mean(axis=0)
        assert heights.max() - heights.min() > 1.0


CASES = {
    "base_ok.bvh": "1.72 m tall",
    "channel_case.bvh": "1.72 m tall",
    "end_site_lowercase.bvh": "1.72 m tall",
    "latin1_name.bvh": "1.72 m tall",
    "names_other_axes.bvh": "recognised skeleton",
    "no_toe_joints.bvh": "recognised skeleton",
    "z_up_offsets.bvh": "up z (detected)",
    "tpose_first.bvh": "the first frame, a rest pose, is left out",
    "zero_length_forearm.bvh": "the bone from 'left_elbow' to 'left_wrist' has no length",
    "frame_time_1s.bvh": "Frame Time of 1 s means 1 frames a second.*--fps",
    "frame_time_is_fps.bvh": "Frame Time of 30 s means 0.0333 frames a second.*--fps",
    "no_frame_rate.npz": "does not say its frame rate.*--fps",
    "hardening/amass-1-flip2.npz": "cannot be read as .npz",
    "hardening/amass-19-lie_poses__10000000000__156_.npz": "poses takes .* more than 256 MiB",
    "hardening/amass-5-flip46.npz": "cannot be read as .npz",
    "hardening/array.npz": "cannot be read as .npz",
    "hardening/flipped-deflate.npz": "cannot be read as .npz",
    "hardening/fps-1e-9.npz": "means 1e-09 frames a second",
    "hardening/frames-nan.bvh": "Frames is nan",
    "hardening/frametime-1e5.bvh": "Frame Time of 100000 s means 1e-05 frames a second",
    "hardening/frametime-5e-324.bvh": "frames a second, not 10-1000",
    "hardening/no-channels.bvh": "line 6: unexpected {",
    "hardening/offset-1e308.bvh": "line 56: OFFSET 1e308 .* is too large for a bone",
    "hardening/zero.npz": "is empty",
}
IMPORTED = tuple(list(CASES)[:8])


@pytest.mark.skipif(not SHARED_CASES.is_dir(), reason=f"{SHARED_CASES} is not here")
@pytest.mark.parametrize("name", CASES)
def test_a_reported_file_is_imported_or_refused_for_its_true_reason(name, tmp_path, capsys):
    command = ["motions", "import", str(SHARED_CASES / name), "--out", str(tmp_path / "a.npz")]
    code = main([*command, "--explain"])
    printed = capsys.readouterr()
    assert code == (0 if name in IMPORTED else 2)
    assert re.search(CASES[name].replace("(", r"\(").replace(")", r"\)"), "".join(printed))
    if code:
        assert printed.err.count("\n") == 1 and not (tmp_path / "a.npz").exists()
    else:
        assert_stands(tmp_path / "a.npz")


def assert_stands(library: Path) -> None:
    """The reported files are of one person of about 1.7 m, who stands and walks."""
    (clip,) = load_library(library).clips
    head, foot = (clip.link_position[:, LINKS.index(link), 2] for link in ("head", "left_foot"))
    assert 1.6 < clip.height_m < 1.8
    assert (head > 1.3).all() and foot.min() < 0.15


AS_ADVISED = {
    "no_frame_rate.npz": "--fps 60",
    "frame_time_1s.bvh": "--fps 30",
    "frame_time_is_fps.bvh": "--fps 30",
    "no_toe_joints.bvh": f"--mapping {SHARED_CASES / 'no_toe_joints.toml'}",
}


@pytest.mark.skipif(not SHARED_CASES.is_dir(), reason=f"{SHARED_CASES} is not here")
@pytest.mark.parametrize("name", AS_ADVISED)
def test_a_reported_file_imports_as_its_message_says(name, tmp_path):
    command = ["motions", "import", str(SHARED_CASES / name), "--out", str(tmp_path / "a.npz")]
    assert main([*command, *AS_ADVISED[name].split()]) == 0
    assert_stands(tmp_path / "a.npz")


@pytest.mark.skipif(not SHARED_CASES.is_dir(), reason=f"{SHARED_CASES} is not here")
def test_reported_files_of_one_name_and_a_wrong_mapping(tmp_path, capsys):
    out = ["--out", str(tmp_path / "a.npz")]
    assert main(["motions", "import", str(SHARED_CASES / "same_stem"), *out]) == 0
    names = [clip.name for clip in load_library(tmp_path / "a.npz").clips]
    assert len(names) == 2 and names[0].startswith("a-") and names[1].startswith("b-")
    capsys.readouterr()
    mapping = SHARED_CASES / "hardening" / "mapping-1-foot_pitch__nan.toml"
    command = ["motions", "import", str(SHARED_CASES / "base_ok.bvh"), "--mapping", str(mapping)]
    assert main([*command, "--out", str(tmp_path / "b.npz")]) == 2
    said = capsys.readouterr().err
    assert "foot_pitch is nan" in said and said.count("\n") == 1
