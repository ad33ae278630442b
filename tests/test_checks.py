import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
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

from questsim.errors import InputError
from questsim.motion.checks import centre_of_mass, check, free_fall, jumps, refuse, stature
from questsim.motion.doubts import doubts
from questsim.motion.families import LAFAN1
from questsim.motion.motion import Motion
from questsim.motion.reading import ReadOptions, read_motion
from questsim.rotations import quat_multiply, yaw_quat
from questsim.skeleton import JOINTS, MIRROR_JOINTS


@pytest.fixture
def person(tmp_path) -> Path:
    return write_bvh(tmp_path / "a.bvh", LAFAN1_JOINTS, standing(30, 93.6), LAFAN1_T_POSE)


def scaled_file(path: Path, scale: float) -> Path:
    joints = [(n, p, tuple(scale * x for x in o)) for n, p, o in LAFAN1_JOINTS]
    return write_bvh(path, joints, standing(30, 93.6 * scale), LAFAN1_T_POSE)


@pytest.mark.parametrize(
    ("scale", "units"),
    [(1, "cm"), (0.01, "m"), (10, "mm"), (1 / 2.54, "inch"), (0.45 / 2.54, "cmu")],
)
def test_units_are_detected_from_a_persons_height(scale, units, tmp_path):
    motion, report = read_motion(scaled_file(tmp_path / "a.bvh", scale))
    assert report.units.startswith(units + " ")
    assert stature(motion) == pytest.approx(1.81, abs=0.01)


def test_units_that_make_no_person_are_refused(tmp_path, person):
    with pytest.raises(InputError, match=r"181 m tall in m .*wrong units.*--accept"):
        read_motion(person, ReadOptions(units="m"))


@pytest.mark.parametrize("scale", [0.04, 1 / 30.48, 3000])
def test_a_known_family_in_unknown_units_is_scaled_to_the_usual_height_with_a_warning(
    scale, tmp_path
):
    motion, report = read_motion(scaled_file(tmp_path / "a.bvh", scale))
    assert stature(motion) == pytest.approx(1.7, abs=1e-3)
    assert motion.forward_kinematics()[0][0, :, 2].min() == pytest.approx(0.0, abs=0.1)
    assert any("scaled to 1.7 m; declare" in doubt for doubt in doubts(motion, report))


def test_a_child_of_a_known_family_is_scaled_to_the_smallest_avatar(tmp_path):
    motion, report = read_motion(scaled_file(tmp_path / "a.bvh", 0.6))
    assert stature(motion) == pytest.approx(1.2, abs=1e-3)
    assert "cm (as LAFAN1 files; 1.09 m tall, scaled to 1.2 m)" in str(report)


def test_units_of_a_mapping_file_that_make_no_person_are_refused(tmp_path):
    rig = tmp_path / "rig.toml"
    rows = [f'{ours} = "{theirs}"' for ours, theirs in LAFAN1.joints.items()]
    axes = [f'{ours} = "{axes}"' for ours, axes in LAFAN1.axes.items()]
    rig.write_text("\n".join(['units = "cm"', "[joints]", *rows, "[axes]", *axes]))
    with pytest.raises(InputError, match="wrong units"):
        read_motion(scaled_file(tmp_path / "a.bvh", 0.04), ReadOptions(mapping=str(rig)))


@pytest.mark.parametrize("up", ["y", "z", "x", "-z"])
def test_the_up_axis_is_detected(up, tmp_path):
    # The whole person is turned so that the file's y axis becomes another one.
    turn = {"y": (0, 0, 0), "z": (0, 0, 90), "x": (-90, 0, 0), "-z": (0, 0, -90)}[up]
    root = {"y": [0, 0.95, 0], "z": [0, 0, 0.95], "x": [0.95, 0, 0], "-z": [0, 0, -0.95]}[up]
    path = write_bvh(
        tmp_path / "a.bvh", SMPL_JOINTS, np.tile(root, (5, 1)), {"Pelvis": np.array(turn)}
    )
    motion, report = read_motion(path)
    assert report.up.split()[0] == up
    height = motion.forward_kinematics()[0][0, :, 2]
    assert height[JOINTS.index("head")] > 1.4 and height.min() > -0.05
    wrong = "z" if up == "y" else "y"
    with pytest.raises(InputError, match="never stands upright"):
        read_motion(path, ReadOptions(up=wrong))


def test_swapped_left_and_right_are_noticed(person):
    motion, _ = read_motion(person)
    swapped = replace(
        motion, rotations=motion.rotations[:, MIRROR_JOINTS], offsets=motion.offsets[MIRROR_JOINTS]
    )
    assert any("swapped" in problem for problem in check(swapped).problems)
    assert not check(motion.mirrored()).problems


def test_a_person_far_from_the_floor_is_put_on_it_and_the_report_says_so(tmp_path):
    for height, moved in ((300, "-2.0"), (0, "+0.9")):
        path = write_bvh(tmp_path / "a.bvh", LAFAN1_JOINTS, standing(9, height), LAFAN1_T_POSE)
        motion, report = read_motion(path)
        assert f"moved by {moved}" in str(report)
        assert abs(motion.forward_kinematics()[0][..., 2].min()) < 0.01


def test_a_root_that_jumps_is_refused(tmp_path):
    root = standing(9, 93.6)
    root[5:, 0] = 500.0
    with pytest.raises(InputError, match="150 m/s at frame 4"):
        read_motion(write_bvh(tmp_path / "a.bvh", LAFAN1_JOINTS, root, LAFAN1_T_POSE))


def test_a_pelvis_that_turns_faster_than_anyone_is_named(person):
    motion, _ = read_motion(person)
    assert jumps(motion) == ""
    rotations = motion.rotations.copy()
    half_turn = yaw_quat(np.radians(150.0))
    rotations[12:20, 0] = quat_multiply(half_turn, rotations[12:20, 0])
    found = jumps(replace(motion, rotations=rotations))
    assert (
        found == "the pelvis turns by 150 deg from frame 11 to the next: the file jumps in 2 places"
    )


def jump(person: Path, fps: float) -> Motion:
    """Someone who jumps 30 cm high, three times, from a dead stop."""
    motion, _ = read_motion(person)
    seconds = np.arange(int(4 * fps)) / fps
    rise = np.sqrt(2 * 0.30 / 9.81)
    phase = (seconds % 1.3) - 0.3
    height = np.where(
        (phase > 0) & (phase < 2 * rise), 0.30 - 0.5 * 9.81 * (phase - rise) ** 2, 0.0
    )
    root = motion.root_position[0] + np.stack([0 * seconds, 0 * seconds, height], axis=-1)
    rotations = np.tile(motion.rotations[:1], (len(seconds), 1, 1))
    return replace(motion, fps=fps, root_position=root, rotations=rotations)


@pytest.mark.parametrize("fps", [30.0, 120.0])
def test_free_fall_is_measured_and_tells_a_wrong_frame_rate(fps, person):
    motion = jump(person, fps)
    assert free_fall(motion, motion.forward_kinematics()[0]) == pytest.approx(9.81, rel=1e-6)
    assert not check(motion).problems
    slow = check(replace(motion, fps=fps / 2))
    with pytest.raises(InputError, match=rf"true frame rate may be about {fps:.0f}"):
        refuse(slow, "jump")


def test_a_person_who_never_leaves_the_floor_shows_no_free_fall(person):
    motion, report = read_motion(person)
    assert report.gravity is None
    # Standing on a box for a second is no flight either.
    root = motion.root_position.copy()
    root[10:20, 2] += 0.4
    motion = replace(motion, root_position=root)
    assert free_fall(motion, motion.forward_kinematics()[0]) is None


def test_feet_that_dangle_for_seconds_are_no_flight(person):
    motion, _ = read_motion(person)
    seconds = np.arange(120) / motion.fps
    root = np.tile(motion.root_position[0], (120, 1))
    root[30:90, 2] += 0.4 + 0.2 * np.sin(2 * seconds[:60])
    rotations = np.tile(motion.rotations[:1], (120, 1, 1))
    motion = replace(motion, root_position=root, rotations=rotations)
    assert free_fall(motion, motion.forward_kinematics()[0]) is None


def test_the_centre_of_mass_of_a_standing_person_is_a_little_above_the_hips(person):
    motion, _ = read_motion(person)
    position, _ = motion.forward_kinematics()
    share = centre_of_mass(position)[0, 2] / stature(motion)
    assert 0.52 < share < 0.60  # 0.55-0.57 of the stature when the arms hang


def test_statures_are_plausible_for_each_skeleton(tmp_path):
    for joints, height, pose in (
        (LAFAN1_JOINTS, 93.6, LAFAN1_T_POSE), (CMU_JOINTS, 17.0, {}), (SMPL_JOINTS, 0.95, {})
    ):  # fmt: skip
        motion, _ = read_motion(write_bvh(tmp_path / "a.bvh", joints, standing(2, height), pose))
        assert 1.6 < stature(motion) < 1.85


@pytest.fixture(scope="module")
def bandai_runs(tmp_path_factory) -> list[Path]:
    if not BANDAI_ZIP.is_file():
        pytest.skip(f"{BANDAI_ZIP} is not here")
    folder = tmp_path_factory.mktemp("runs")
    with zipfile.ZipFile(BANDAI_ZIP) as archive:
        for style in ("normal", "active", "feminine", "youthful"):
            for number in ("001", "009", "017"):
                name = f"dataset-2_run_{style}_{number}.bvh"
                (folder / name).write_bytes(archive.read(f"{BANDAI_ROOT}data/{name}"))
    return sorted(folder.iterdir())


def test_real_running_shows_free_fall_and_one_stature(bandai_runs):
    read = [read_motion(path) for path in bandai_runs]
    measured = [report.gravity for _, report in read if report.gravity is not None]
    assert len(measured) >= 3 and all(8 < g < 14 for g in measured)
    statures = {round(stature(motion), 3) for motion, _ in read}
    assert len(statures) == 1 and 1.55 < statures.pop() < 1.7


def test_real_running_at_a_wrong_frame_rate_is_refused(bandai_runs):
    flying = [p for p in bandai_runs if read_motion(p)[1].gravity is not None]
    for fps in (15.0, 60.0):
        with pytest.raises(InputError, match="free fall"):
            read_motion(flying[0], ReadOptions(fps=fps))
