import numpy as np
import pytest
from mocap_files import SMPL_JOINTS, write_amass
from scipy.spatial.transform import Rotation

from questsim import rotations as rot
from questsim.errors import InputError
from questsim.motion.amass import SMPL_NAMES, SMPL_PARENTS, mean_offsets, read_amass
from questsim.motion.checks import stature
from questsim.motion.families import SMPL
from questsim.motion.reading import ReadOptions, read_motion
from questsim.skeleton import JOINT_PARENTS, JOINTS


def joint(name: str) -> int:
    return JOINTS.index(name)


def test_zero_rotations_stand_in_a_t_pose_on_the_floor_facing_x(tmp_path):
    motion, report = read_motion(write_amass(tmp_path / "a.npz"))
    position, _ = motion.forward_kinematics()
    body = position[0] - position[0, 0]
    assert abs(report.facing_deg) < 1
    assert body[joint("left_wrist"), 1] > 0.6 and body[joint("right_wrist"), 1] < -0.6
    assert body[joint("left_toe"), 0] > 0.05
    assert body[joint("head"), 2] > 0.4
    assert 0 < position[0, :, 2].min() < 0.05
    np.testing.assert_allclose(position[0, 0], [-0.2, 0.3, 0.97], atol=1e-9)


def test_the_stature_is_estimated_from_the_root_height_or_declared(tmp_path):
    # The mean skeleton's root is 0.555 of the stature above the floor.
    path = write_amass(tmp_path / "a.npz", trans=np.tile([0, 0, 0.555 * 1.62], (40, 1)))
    assert stature(read_motion(path)[0]) == pytest.approx(1.62, abs=0.01)
    declared, _ = read_motion(path, ReadOptions(height_m=1.85))
    assert stature(declared) == pytest.approx(1.85, abs=0.001)
    floating = write_amass(tmp_path / "b.npz", trans=np.zeros((40, 3)))
    assert stature(read_motion(floating, ReadOptions(accept=True))[0]) == pytest.approx(1.70)


def test_a_bent_knee_and_a_turned_body_are_read_as_such(tmp_path):
    poses = np.zeros((10, 156))
    turn = Rotation.from_euler("z", 30, degrees=True) * Rotation.from_euler("x", 90, degrees=True)
    poses[:, :3] = turn.as_rotvec()
    knee = SMPL_NAMES.index("L_Knee")
    poses[:, 3 * knee] = np.radians(50)  # about SMPL's x axis, which points left
    motion, _ = read_motion(
        write_amass(tmp_path / "a.npz", poses=poses, trans=np.tile([0, 0, 0.97], (10, 1)))
    )
    turns = rot.as_rotation(motion.rotations[0]).as_rotvec(degrees=True)
    np.testing.assert_allclose(turns[joint("left_knee")], [0, 50, 0], atol=1e-6)
    np.testing.assert_allclose(turns[0], [0, 0, 30], atol=1e-6)


@pytest.mark.parametrize(("width", "key"), [(72, "mocap_framerate"), (165, "mocap_frame_rate")])
def test_smpl_and_smplx_files_are_read_like_smplh(width, key, tmp_path):
    poses = np.zeros((40, width))
    poses[:, 0] = np.pi / 2
    path = write_amass(
        tmp_path / "a.npz", poses=poses, **{"mocap_framerate": None, key: np.array(60.0)}
    )
    reference, _ = read_motion(write_amass(tmp_path / "b.npz"))
    motion, _ = read_motion(path)
    assert motion.fps == 60.0
    np.testing.assert_array_equal(motion.rotations, reference.rotations)


def test_a_smpl_file_gives_the_subject_its_own_skeleton(tmp_path):
    joints = {name: np.array(offset) for name, _, offset in SMPL_JOINTS}
    placed = np.zeros((22, 3))
    for i, (name, parent) in enumerate(zip(SMPL_NAMES, SMPL_PARENTS, strict=True)):
        placed[i] = joints[name] + (placed[parent] if parent >= 0 else 0)
    directions = np.zeros((22, 3, 2))
    directions[..., 0] = 0.1 * placed  # the first shape parameter makes all 10 % larger
    model = tmp_path / "model.npz"
    np.savez(model, J_regressor=np.eye(22), v_template=placed, shapedirs=directions)
    plain = write_amass(tmp_path / "a.npz")
    larger = write_amass(tmp_path / "b.npz", betas=np.array([1.0, 0.0]))
    options = ReadOptions(smpl_file=str(model))
    small, large = (stature(read_motion(path, options)[0]) for path in (plain, larger))
    assert large == pytest.approx(1.1 * small)
    knee = read_motion(plain, options)[0].offsets[joint("left_knee")]
    assert np.linalg.norm(knee) == pytest.approx(np.linalg.norm(joints["L_Knee"]))
    for betas in ([1e200, 0.0], [1e308, 1e308], [500.0, 0.0]):
        wild = write_amass(tmp_path / "c.npz", betas=np.array(betas))
        with pytest.raises(InputError, match="further than 10 m"):
            read_motion(wild, options)


def test_the_mean_skeleton_is_symmetric_and_as_tall_as_it_says():
    offsets = dict(zip(SMPL_NAMES, mean_offsets(), strict=True))
    for name, offset in offsets.items():
        if name.startswith("L_"):
            np.testing.assert_array_equal(offset * [-1, 1, 1], offsets[f"R_{name[2:]}"])
    ours = np.array([offsets[SMPL.joints[name]][[2, 0, 1]] for name in JOINTS])
    height = np.zeros(22)
    for i in range(1, 22):
        height[i] = height[JOINT_PARENTS[i]] + ours[i, 2]
    ankle = height[joint("left_ankle")]
    # Heights above the floor as drawn by Drillis and Contini: shoulder, head base, hip, knee.
    for name, drawn in (
        ("left_shoulder", 0.818), ("head", 0.870), ("left_hip", 0.530), ("left_knee", 0.285)
    ):  # fmt: skip
        assert height[joint(name)] - ankle + 0.039 == pytest.approx(drawn, abs=1e-9)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"trans": None}, "no array 'trans'"),
        ({"poses": None}, "neither an array 'poses' nor 'root_orient' and 'pose_body'"),
        ({"mocap_framerate": None}, "does not say its frame rate .*--fps"),
        ({"mocap_framerate": np.array(0.0)}, "means 0 frames a second, not 10-1000"),
        ({"mocap_framerate": np.array(1e-9)}, "means 1e-09 frames a second.*--fps"),
        ({"mocap_framerate": np.zeros(0)}, "does not say its frame rate"),
        ({"poses": np.zeros((2_000_000, 156), np.float16)}, "more than (512|256 MiB)|unpacks"),
        ({"poses": np.zeros((40, 50))}, r"poses has shape \(40, 50\)"),
        ({"trans": np.zeros((39, 3))}, r"trans has shape \(39, 3\)"),
        ({"poses": np.full((40, 156), np.nan)}, "not finite in frame 0"),
        ({"poses": np.zeros((0, 156)), "trans": np.zeros((0, 3))}, "no frames"),
        ({"poses": np.array([{"a": 1}] * 40)}, "poses holds object, not numbers"),
        ({"poses": np.array(["a"] * 40)}, "poses holds <U1, not numbers"),
        (
            {"poses": None, "root_orient": np.zeros((40, 3)), "pose_body": np.zeros((39, 63))},
            "not .T, 3. and",
        ),
    ],
)
def test_a_wrong_file_is_refused_with_the_reason(changes, reason, tmp_path):
    path = write_amass(tmp_path / "wrong.npz", **changes)
    with pytest.raises(InputError, match=reason):
        read_motion(path)


def test_a_file_that_is_not_npz_is_refused(tmp_path):
    (tmp_path / "a.npz").write_bytes(b"not a zip archive")
    with pytest.raises(InputError, match="cannot be read"):
        read_amass(tmp_path / "a.npz")
    with pytest.raises(InputError, match="no such file"):
        read_motion(tmp_path / "none.npz")


def test_root_orient_and_pose_body_give_what_poses_give(tmp_path):
    rng = np.random.default_rng(1)
    poses = np.concatenate([np.tile([np.pi / 2, 0, 0], (40, 1)), rng.normal(0, 0.1, (40, 63))], 1)
    whole = np.concatenate([poses, np.zeros((40, 90))], axis=1)
    a = read_motion(write_amass(tmp_path / "a.npz", poses=whole), ReadOptions(accept=True))[0]
    split = {"root_orient": poses[:, :3], "pose_body": poses[:, 3:], "poses": None}
    b = read_motion(write_amass(tmp_path / "b_stageii.npz", **split), ReadOptions(accept=True))[0]
    np.testing.assert_array_equal(a.rotations, b.rotations)


@pytest.mark.parametrize("key", ["mocap_frame_rate", "framerate", "frame_rate"])
def test_the_frame_rate_is_found_under_each_of_its_names_or_declared(key, tmp_path):
    path = write_amass(tmp_path / "a.npz", mocap_framerate=None, **{key: np.array(100.0)})  # type: ignore
    assert read_motion(path)[0].fps == 100.0
    path = write_amass(tmp_path / "b.npz", mocap_framerate=None)
    assert read_motion(path, ReadOptions(fps=50.0))[0].fps == 50.0


def test_a_small_file_that_unpacks_to_much_memory_is_refused_before_it_is_unpacked(tmp_path):
    poses = np.zeros((200_000, 156), np.float32)
    np.savez_compressed(
        tmp_path / "bomb.npz", poses=poses, trans=poses[:, :3], mocap_framerate=30.0
    )
    assert (tmp_path / "bomb.npz").stat().st_size < 1_000_000
    with pytest.raises(InputError, match=r"poses unpacks 0\.\d MiB to 119 MiB"):
        read_motion(tmp_path / "bomb.npz")
