"""Exported motions, read back: the same poses to 1e-3."""

import csv
import subprocess
import sys

import numpy as np
import pygltflib
import pytest

from questsim import rotations as rot
from questsim.cli import main
from questsim.exporting import write_clip, write_motion
from questsim.motion.amass import read_amass
from questsim.motion.bvh import read_bvh
from questsim.motion.convert import global_pose, world_axes
from questsim.motion.reading import ReadOptions, read_motion
from questsim.motion.retarget_back import to_motion
from questsim.motion.spec import load_motions
from questsim.skeleton import DOFS, LINK_PARENTS, LINKS

TOLERANCE = 1e-3


@pytest.fixture(scope="module")
def walk():
    """Two seconds of a walk that turns, begun away from the origin."""
    clip = load_motions("synthetic:walk")[0]
    return clip


def test_bvh_of_22_joints_is_read_back_as_the_same_motion(walk, tmp_path):
    motion = to_motion(walk)
    write_motion(tmp_path / "walk.bvh", motion)
    again, _ = read_motion(tmp_path / "walk.bvh")
    assert again.fps == motion.fps
    position, quat = motion.forward_kinematics()
    position_again, quat_again = again.forward_kinematics()
    assert abs(position - position_again).max() < TOLERANCE
    assert rot.angle_between(quat, quat_again).max() < TOLERANCE


def test_avatars_bvh_is_read_back_as_the_same_links(walk, tmp_path):
    write_clip(tmp_path / "walk.bvh", walk, "avatar")
    recording = read_bvh(tmp_path / "walk.bvh")
    assert set(recording.names) == set(LINKS)
    position, quat = global_pose(recording)
    order = [recording.names.index(link) for link in LINKS]
    world = world_axes("y")
    turn = rot.matrix_to_quat(world)
    quat = rot.quat_multiply(rot.quat_multiply(turn, quat), rot.quat_conjugate(turn))
    assert abs(position[:, order] @ world.T / 100.0 - walk.link_position).max() < TOLERANCE
    assert rot.angle_between(quat[:, order], walk.link_quat).max() < TOLERANCE


def test_amass_file_is_read_back_with_the_same_turns_and_path(walk, tmp_path):
    motion = to_motion(walk)
    write_motion(tmp_path / "walk.npz", motion)
    assert read_amass(tmp_path / "walk.npz").fps == motion.fps
    again, _ = read_motion(tmp_path / "walk.npz", ReadOptions(height_m=1.75, accept=True))
    _, quat = motion.forward_kinematics()
    _, quat_again = again.forward_kinematics()
    assert rot.angle_between(quat, quat_again).max() < TOLERANCE
    moved = again.root_position - motion.root_position
    assert abs(moved - moved[0]).max() < TOLERANCE
    assert abs(moved[0, :2]).max() < TOLERANCE


def accessor(file: pygltflib.GLTF2, index: int) -> np.ndarray:
    about, blob = file.accessors[index], file.binary_blob()
    assert about.bufferView is not None and blob is not None
    blob = blob[file.bufferViews[about.bufferView].byteOffset :]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[about.type]
    return np.frombuffer(blob, np.float32, about.count * width).reshape(about.count, width)


def test_glb_animation_moves_each_link_to_where_the_clip_has_it(walk, tmp_path):
    write_clip(tmp_path / "walk.glb", walk)
    file = pygltflib.GLTF2().load(tmp_path / "walk.glb")
    assert file is not None
    animation = file.animations[0]
    moved = {
        (c.target.node, c.target.path): accessor(file, animation.samplers[c.sampler].output)
        for c in animation.channels
    }
    times = accessor(file, animation.samplers[0].input)[:, 0]
    assert times == pytest.approx(np.arange(len(walk)) / 36.0, abs=1e-5)
    position, quat = np.empty((len(walk), 16, 3)), np.empty((len(walk), 16, 4))
    for link, node in enumerate(file.nodes):
        assert node.name == LINKS[link]
        place = moved.get((link, "translation"), np.array([node.translation]))
        turn = moved[link, "rotation"][:, [3, 0, 1, 2]]
        parent = LINK_PARENTS[link]
        if link == 0:
            position[:, 0], quat[:, 0] = place, turn
            continue
        position[:, link] = position[:, parent] + rot.quat_rotate(quat[:, parent], place)
        quat[:, link] = rot.quat_multiply(quat[:, parent], turn)
    # x of glTF is our left, y our up, z our forward.
    assert abs(position[..., [2, 0, 1]] - walk.link_position).max() < TOLERANCE
    back = quat[..., [0, 3, 1, 2]]
    assert rot.angle_between(back, walk.link_quat).max() < TOLERANCE


def test_csv_holds_the_pose_under_named_columns(walk, tmp_path):
    write_clip(tmp_path / "walk.csv", walk)
    with (tmp_path / "walk.csv").open() as file:
        reader = csv.DictReader(file)
        rows = list(reader)
    assert len(set(reader.fieldnames or ())) == 1 + 7 + 33 + 16 * 7 + 2
    assert len(rows) == len(walk)
    row = {name: float(value) for name, value in rows[30].items()}
    assert row["time_s"] == pytest.approx(30 / 36)
    assert [row[dof] for dof in DOFS] == pytest.approx(walk.qpos[30, 7:], abs=1e-5)
    assert row["link_right_hand_z"] == pytest.approx(walk.link_position[30, 15, 2], abs=1e-5)
    assert row["left_foot_contact"] == float(walk.contacts[30, 0])


@pytest.mark.parametrize("kind", ["bvh", "glb", "npz", "csv"])
def test_command_writes_a_file_for_each_motion(kind, tmp_path, capsys):
    assert (
        main(["motions", "export", "synthetic:wave", "--out", str(tmp_path), "--format", kind]) == 0
    )
    count = len(load_motions("synthetic:wave"))
    assert len(list(tmp_path.glob(f"*.{kind}"))) == count
    assert f"{count} motions in" in capsys.readouterr().out


@pytest.mark.parametrize(
    "words, fault",
    [
        (["--format", "fbx"], "--format"),
        (["--format", "glb", "--skeleton", "joints"], "--skeleton"),
        (["--skeleton", "bones"], "--skeleton"),
        (["--out", __file__], "a file is in the way"),
    ],
)
def test_command_refuses_what_it_cannot_write(words, fault, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["motions", "export", "synthetic:wave", "--out", str(out), *words]) == 2
    assert fault in capsys.readouterr().err
    assert not out.exists()


def test_evaluation_saves_what_the_avatar_did(tmp_path):
    command = [sys.executable, "-m", "questsim", "evaluate", "--agent", "zero", "--motions"]
    command += ["synthetic:stand", "--max-clips", "1", "--out", str(tmp_path)]
    subprocess.run([*command, "--save-motion", "bvh"], check=True, capture_output=True)
    (file,) = (tmp_path / "motions").glob("*.bvh")
    assert len(read_bvh(file).rotations) > 5
