"""The kinematic systems as they run: sizes, streams, bad input, solvers."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from agents.kinematic.data import MotionBank
from agents.kinematic.dragposer.constraints import joint_distance, weighted
from agents.kinematic.dragposer.model import DragModel
from agents.kinematic.dragposer.networks import PAST, DragPoserModule, joints_from_root
from agents.kinematic.dragposer.published import PublishedDragPoser
from agents.kinematic.dragposer.solver import LOST_FRAMES, DragPoser
from agents.kinematic.dragposer.together import ManyDragPoser
from agents.kinematic.ik import InverseKinematics
from agents.kinematic.interface import Poses, UserBody, device_names
from agents.kinematic.recurrent.features import DEVICES, features
from agents.kinematic.recurrent.lgsik import group_mask
from agents.kinematic.recurrent.lstm import LstmBank
from agents.kinematic.recurrent.poser import RecurrentModule, RecurrentPoser
from agents.kinematic.registry import AGENTS
from agents.kinematic.skeletal import POOLINGS, SIZES, neighbour_mask
from agents.kinematic.sparseposer.networks import SparsePoserModule
from agents.kinematic.sparseposer.poser import SparsePoser
from agents.training.hold_out import without_styles
from questsim import differentiable as diff
from questsim import rotations as rot
from questsim.errors import InputError
from questsim.joint_sensors import readings
from questsim.motion.limbs import SIDES
from questsim.motion.retarget_back import to_motion
from questsim.skeleton import JOINTS
from tests.helpers import swaying_clip

MOTION = to_motion(swaying_clip(frames=90)).resampled(60.0)
BODY = UserBody.of(MOTION)
BANK_WINDOWS = {"avatarposer": 18, "sparseposer": 64, "dragposer": 3, "hmdposer": 18, "lgsik": 18}
SETS = {
    "avatarposer": "H+2C", "hmdposer": "H+2C+2IMU", "lgsik": "H+2C+3IMU", "sparseposer": "6T",
    "dragposer": "6T",
}  # fmt: skip


def module_of(agent: str) -> Any:
    """An untrained module of the smallest preset, its normalisers measured."""
    torch.manual_seed(0)
    entry = AGENTS[agent]
    config = entry.presets["smoke"]
    module = entry.build(config.spec)
    bank = MotionBank([MOTION], BANK_WINDOWS[agent])
    stage = next(iter(config.stages))
    entry.task(module, stage, config.stages[stage], bank, 4)
    return module


def system_of(agent: str, **options):
    trained = list(AGENTS[agent].presets["smoke"].stages)[:1]
    return AGENTS[agent].system(module_of(agent), agent, trained, options)


def stream(sensors, frames: int = 12):
    seen = readings(MOTION, device_names(sensors))
    return replace(
        seen,
        **{
            name: getattr(seen, name)[:frames]
            for name in ("time_s", "position", "quat", "acceleration", "present")
        },
    )


def count(module: torch.nn.Module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


# -- sizes -----------------------------------------------------------------------------------


def test_paper_presets_have_the_published_numbers_of_parameters():
    def built(agent: str) -> Any:
        return AGENTS[agent].build(AGENTS[agent].presets["paper"].spec)

    sparse, drag = built("sparseposer"), built("dragposer")
    assert count(sparse.generator) == 7_141_420
    assert count(sparse.ik) == 110_176
    assert count(drag.vae) == 65_872
    assert count(drag.predictor) == pytest.approx(1.28e6, rel=0.01)
    assert count(built("avatarposer")) == 4_124_804
    assert count(built("hmdposer")) == 17_444_484
    # Its leg heads read 15 numbers of their leg, not 18 of a hand: 2 heads x 3 x 512 fewer.
    assert count(built("lgsik")) == 7_283_988 - 2 * 3 * 512


@pytest.mark.parametrize("agent", AGENTS)
def test_cpu_presets_fit_into_ten_megabytes(agent):
    assert 4 * count(AGENTS[agent].build(AGENTS[agent].presets["cpu"].spec)) < 10e6


def test_the_skeleton_is_pooled_from_22_to_14_to_9_to_6_joints():
    assert SIZES == (22, 14, 9, 6)
    kept = {group[0]: group[1:] for group in POOLINGS[0].merged}
    assert kept[0] == (1, 5, 9) and kept[14] == (11, 15) and kept[13] == () and kept[20] == (19,)


def test_a_joint_reads_joints_two_bones_away_and_no_farther():
    mask = neighbour_mask(POOLINGS[0].parents)
    assert mask.shape == (14, 14) and torch.equal(mask, mask.T)
    full = neighbour_mask((0, 0, 1, 2))
    assert full[0].tolist() == [1, 1, 1, 0]


def test_the_shape_group_feeds_all_and_receives_nothing():
    mask = group_mask(9)
    assert mask[:, -1].all() and mask[-1].sum() == 1
    assert mask[0, :8].all()


def test_a_bank_of_lstms_computes_what_pytorchs_lstm_does():
    torch.manual_seed(0)
    bank, lstm = LstmBank(2, 8), torch.nn.LSTM(8, 8, batch_first=True)
    parameters = dict(lstm.named_parameters())
    x = torch.randn(3, 5, 2, 8)
    with torch.no_grad():
        into, across = bank._weights()[0][1].split(8, dim=-1)
        parameters["weight_ih_l0"].copy_(into)
        parameters["weight_hh_l0"].copy_(across)
        parameters["bias_ih_l0"].copy_(bank.input_bias[1])
        parameters["bias_hh_l0"].copy_(bank.hidden_bias[1])
        assert torch.allclose(bank(x)[0][:, :, 1], lstm(x[:, :, 1])[0], atol=1e-6)


def test_a_bank_of_lstms_gives_the_same_frame_by_frame_as_in_one_piece():
    torch.manual_seed(0)
    bank, x = LstmBank(3, 8), torch.randn(2, 7, 3, 8)
    with torch.no_grad():
        whole, (hidden, cell) = bank(x)
        parts, state = [], None
        for t in range(7):
            part, state = bank(x[:, t : t + 1], state)
            parts.append(part)
    assert state is not None
    assert torch.allclose(torch.cat(parts, dim=1), whole, atol=1e-6)
    assert torch.allclose(state[0], hidden, atol=1e-6) and torch.allclose(state[1], cell, atol=1e-6)


# -- streams -----------------------------------------------------------------------------------


@pytest.mark.parametrize("agent", AGENTS)
def test_streaming_and_offline_give_the_same_poses(agent):
    system, seen = system_of(agent), stream(SETS[agent])
    whole = system.predict(seen, BODY)
    system.reset(BODY, seen.names)
    one_by_one = Poses.joined([system.step(seen[t]) for t in range(len(seen))])
    assert np.abs(whole.root_position - one_by_one.root_position).max() < 1e-4
    assert np.abs(whole.rotations - one_by_one.rotations).max() < 1e-4
    assert np.abs(whole.offsets - one_by_one.offsets).max() < 1e-4


def test_sparseposer_with_seven_future_frames_answers_seven_frames_late():
    system = SparsePoser(module_of("sparseposer"), future_frames=7)
    seen = stream("6T", 20)
    offline = system.predict(seen, BODY)
    system.reset(BODY, seen.names)
    streamed = [system.step(seen[t]) for t in range(20)]
    assert np.allclose(streamed[19].root_position[0], offline.root_position[12], atol=1e-6)
    assert np.allclose(streamed[3].root_position, streamed[0].root_position, atol=1e-6)


@pytest.mark.parametrize("agent", ["avatarposer", "hmdposer", "sparseposer"])
def test_turning_the_world_turns_the_poses(agent):
    system, seen = system_of(agent), stream(SETS[agent], 6)
    turn = rot.yaw_quat(np.array(1.1))
    turned = replace(
        seen,
        position=rot.quat_rotate(turn, seen.position) + np.array([3.0, -2.0, 0.0]),
        quat=rot.quat_multiply(turn, seen.quat),
        acceleration=rot.quat_rotate(turn, seen.acceleration),
    )
    a, b = system.predict(seen, BODY), system.predict(turned, BODY)
    moved = rot.quat_rotate(turn, a.forward_kinematics()[0]) + np.array([3.0, -2.0, 0.0])
    assert np.abs(moved - b.forward_kinematics()[0]).max() < 1e-3


def test_avatarposer_begins_near_the_rest_pose_and_not_half_a_turn_off():
    entry = AGENTS["avatarposer"]
    module: Any = entry.build(entry.presets["cpu"].spec)
    inputs = torch.randn(4, 40, 135)
    turned = diff.six_d_to_matrix(module(inputs))
    cosine = (turned.diagonal(dim1=-2, dim2=-1).sum(-1) - 1.0) / 2.0
    assert float(cosine.detach().min()) > 0.5


def test_avatarposers_refinement_brings_the_hands_to_the_controllers_and_moves_arms_alone():
    seen = stream("H+2C", 50)
    plain, refined = (
        system_of("avatarposer", refined=refined).predict(seen, BODY) for refined in (False, True)
    )
    want, hands = MOTION.forward_kinematics()[0][:50], [JOINTS.index(f"{s}_wrist") for s in SIDES]
    off = [
        np.linalg.norm(poses.forward_kinematics()[0] - want, axis=-1)[:, hands].mean()
        for poses in (plain, refined)
    ]
    assert off[1] < off[0] - 0.05
    moved = np.abs(refined.rotations - plain.rotations).max(axis=(0, 2)) > 1e-9
    arms = {f"{side}_{part}" for side in SIDES for part in ("shoulder", "elbow")}
    assert {JOINTS[i] for i in np.flatnonzero(moved)} == arms


def test_the_head_is_where_the_headset_says():
    system, seen = system_of("hmdposer"), stream("H+2C")
    head = JOINTS.index("head")
    got = system.predict(seen, BODY).forward_kinematics()[0][:, head]
    assert np.allclose(got, MOTION.forward_kinematics()[0][: len(seen), head], atol=1e-4)


def test_missing_imus_are_zeros_and_nothing_else_is():
    position = torch.randn(1, 4, 3, 3)
    rotation = torch.eye(3).expand(1, 4, 6, 3, 3)
    seen = torch.tensor([[True, True, False]])
    told, _ = features(position, rotation, torch.ones(1, 4, 3, 3), seen)
    assert not told[..., 30:36].any() and not told[..., 132:135].any()
    assert told[..., 18:24].any() and told[..., 126:129].any()


def test_features_of_a_frame_use_no_later_frame():
    torch.manual_seed(0)
    position = torch.randn(1, 6, 3, 3)
    rotation = torch.linalg.qr(torch.randn(1, 6, 6, 3, 3)).Q
    acceleration, seen = torch.randn(1, 6, 3, 3), torch.ones(1, 3, dtype=torch.bool)
    whole, _ = features(position, rotation, acceleration, seen)
    early, _ = features(position[:, :3], rotation[:, :3], acceleration[:, :3], seen)
    assert torch.equal(whole[:, :3], early)


# -- bad input ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("agent", "sensors", "message"),
    [
        ("sparseposer", "4T", "needs left_toe_tracker"),
        ("hmdposer", "6T", "cannot use pelvis_tracker"),
        ("hmdposer", "H+9C", "unknown sensor set"),
        ("dragposer", ("headset", "left_ear", "pelvis_tracker"), "unknown tracker 'left_ear'"),
        ("dragposer", "H", "three trackers"),
        ("lgsik", (*DEVICES[:3], "pelvis_imu"), "no IMUs, both knees"),
    ],
)
def test_sensors_a_system_cannot_use_are_refused_by_name(agent, sensors, message):
    with pytest.raises(InputError, match=message):
        system_of(agent).reset(BODY, sensors)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"position": np.full((6, 3), np.nan)}, "position of headset is not finite"),
        ({"quat": np.full((6, 4), 0.7)}, "quaternion of headset has length 1.4"),
        ({"time_s": 0.0}, "time goes from"),
        ({"names": ("headset",)}, "instead of"),
        ({"quat": np.zeros((5, 4))}, r"quat has shape \(5, 4\)"),
    ],
)
@pytest.mark.parametrize("agent", ["sparseposer", "dragposer"])
def test_a_bad_frame_is_refused_and_the_stream_goes_on(agent, change, message):
    system, seen = system_of(agent), stream("6T")
    system.reset(BODY, "6T")
    system.step(seen[0])
    system.step(seen[1])
    with pytest.raises(InputError, match=message):
        system.step(replace(seen[2], **change))
    assert system.step(seen[2]).finite()


def test_step_before_reset_is_refused():
    with pytest.raises(InputError, match="step was called before reset"):
        system_of("hmdposer").step(stream("H+2C")[0])


def test_a_short_gap_is_bridged_by_as_many_frames_as_are_missing():
    system, seen = system_of("sparseposer"), stream("6T")
    system.reset(BODY, "6T")
    steps = []
    original = system._next
    system._next = lambda signals: (steps.append(1), original(signals))[1]
    system.step(seen[0])
    system.step(seen[4])
    assert len(steps) == 5


def test_a_long_gap_begins_the_stream_anew():
    system, seen = system_of("hmdposer"), stream("H+2C")
    system.reset(BODY, "H+2C")
    for t in range(5):
        system.step(seen[t])
    late = replace(seen[6], time_s=9.0)
    after_gap = system.step(late)
    system.reset(BODY, "H+2C")
    assert np.allclose(after_gap.rotations, system.step(late).rotations)


def test_a_silent_device_keeps_its_pose_for_systems_that_need_it():
    system, seen = system_of("sparseposer"), stream("6T")
    system.reset(BODY, "6T")
    system.step(seen[0])
    hidden = replace(
        seen[1],
        present=np.array([True, True, False, True, True, True]),
        position=np.where(np.arange(6)[:, None] == 2, np.nan, seen[1].position),
    )
    held = np.where(np.arange(6)[:, None] == 2, seen[0].position, seen[1].position)
    turned = np.where(np.arange(6)[:, None] == 2, seen[0].quat, seen[1].quat)
    a = system.step(hidden)
    system.reset(BODY, "6T")
    system.step(seen[0])
    b = system.step(replace(seen[1], position=held, quat=turned))
    assert np.allclose(a.rotations, b.rotations)


@pytest.mark.parametrize("agent", ["hmdposer", "sparseposer"])
def test_a_pose_is_never_nan_even_if_the_network_is(agent):
    module = module_of(agent)
    system = AGENTS[agent].system(module, agent, [], {})
    seen = stream(SETS[agent])
    system.reset(BODY, SETS[agent])
    good = system.step(seen[0])
    with torch.no_grad():
        for parameter in module.parameters():
            parameter.fill_(torch.nan)
    module.train().eval()
    again = system.step(seen[1])
    assert again.finite() and np.allclose(again.rotations, good.rotations)


# -- DragPoser -----------------------------------------------------------------------------------


def tracker_error(poses: Poses) -> np.ndarray:
    """Mean distance in metres ``(T,)`` of pelvis and head from the recording's."""
    at = [JOINTS.index("root"), JOINTS.index("head")]
    want = MOTION.forward_kinematics()[0][: len(poses), at]
    return np.linalg.norm(poses.forward_kinematics()[0][:, at] - want, axis=-1).mean(-1)


def test_one_newton_iteration_comes_closer_than_one_of_adam():
    module, seen = module_of("dragposer"), stream("6T", 6)
    errors = {}
    for solver in ("newton", "adam"):
        system = DragPoser(module, iterations=1, solver=solver, predictor=False)
        errors[solver] = tracker_error(system.predict(seen, BODY)).mean()
    assert errors["newton"] < 0.5 * errors["adam"]


def test_dragposer_as_published_moves_the_latent_alone_and_its_root_to_the_hips_tracker():
    torch.manual_seed(0)
    entry = AGENTS["dragposer"]
    spec = replace(entry.presets["smoke"].spec, published=True)
    module = entry.build(spec)
    bank = MotionBank([MOTION], 129)
    for stage, learning in entry.presets["smoke"].stages.items():
        entry.task(module, stage, learning, bank, 4)
    hip, head = JOINTS.index("root"), JOINTS.index("head")
    errors, seen = {}, stream("6T", 6)
    want = MOTION.forward_kinematics()[0][:6]
    for iterations in (1, 30):
        system = entry.system(module, "drag", ["vae", "predictor"], {"iterations": iterations})
        got = system.predict(seen, BODY).forward_kinematics()[0]
        assert np.allclose(got[1:, hip], want[1:, hip], atol=1e-9)
        errors[iterations] = np.linalg.norm(got[:, head] - want[:, head], axis=-1)[1:].mean()
    assert errors[30] < errors[1]
    four = entry.system(module, "drag", ["vae", "predictor"], {}).predict(stream("4T", 20), BODY)
    assert four.finite()
    with pytest.raises(InputError, match="no option 'solver'"):
        entry.system(module, "drag", ["vae"], {"solver": "newton"})
    # The published solver also runs on the weights of the improved system.
    improved = entry.build(entry.presets["smoke"].spec)
    both = [entry.system(improved, "drag", [], o) for o in ({}, {"published": True})]
    assert [type(system) for system in both] == [ManyDragPoser, PublishedDragPoser]
    with pytest.raises(InputError, match="no option 'solver'"):
        entry.system(improved, "drag", [], {"published": True, "solver": "newton"})


def test_dragposer_as_published_predicts_once_in_the_frames_of_its_window():
    entry = AGENTS["dragposer"]
    module: Any = entry.build(replace(entry.presets["smoke"].spec, published=True))
    module.token_std.fill_(1.0)
    tokens = {}
    for frames in (None, 60):
        given = {"predictor": True, "predicted_frames": frames, "iterations": 1}
        system: Any = entry.system(module, "drag", [], given)
        counts = []
        ahead = system.module.predictor.forward
        system.module.predictor.forward = lambda past, count, c=counts, f=ahead: (
            c.append(count) or f(past, count)
        )
        system.predict(stream("4T", 20), BODY)
        tokens[frames] = counts
    # The first of 20 frames has no past; a token is four frames.
    assert tokens == {None: [4, 4], 60: [15]}
    for frames in (0, 65):
        with pytest.raises(InputError, match=f"predicted_frames is {frames}, not from 1 to 64"):
            entry.system(module, "drag", [], {"predicted_frames": frames})
    with pytest.raises(InputError, match="no option 'predicted_frames'"):
        improved = entry.build(entry.presets["smoke"].spec)
        entry.system(improved, "drag", [], {"predicted_frames": 60})


def test_styles_held_out_are_only_in_the_windows_that_compare_checkpoints():
    learnt, other = replace(MOTION, style="normal"), replace(MOTION.mirrored(), style="old")
    kept, held = without_styles([learnt, other], "old")
    assert (kept, held) == ([learnt], [other])
    bank = MotionBank(kept, 20, held)
    assert np.allclose(bank.rotations, learnt.resampled(60.0).rotations, atol=1e-6)
    assert np.allclose(bank.validation.rotations, other.resampled(60.0).rotations, atol=1e-6)
    told = {}
    for name, validation in (("held", held), ("none", [])):
        module: Any = AGENTS["dragposer"].build(AGENTS["dragposer"].presets["smoke"].spec)
        learning = AGENTS["dragposer"].presets["smoke"].stages["vae"]
        torch.manual_seed(0)
        task = AGENTS["dragposer"].task(module, "vae", learning, MotionBank(kept, 3, validation), 4)
        told[name] = (module.mean.clone(), task.validate()["error_cm"])
    assert torch.equal(told["held"][0], told["none"][0])
    assert told["held"][1] != told["none"][1]
    with pytest.raises(InputError, match="no clip has style 'angry'"):
        without_styles([learnt], "angry")


def test_dragposer_goes_on_when_trackers_vanish_one_by_one_and_come_back():
    system, seen = system_of("dragposer", iterations=2), stream("6T", 16)
    present = seen.present.copy()
    present[2:10, 2:] = False
    present[4:7] = False
    hidden = replace(
        seen, present=present, position=np.where(present[..., None], seen.position, np.nan)
    )
    poses = system.predict(hidden, BODY)
    assert poses.finite()
    whole = tracker_error(system.predict(seen, BODY))
    assert tracker_error(poses)[-1] < whole[-1] + 0.05


def test_dragposer_is_back_within_two_seconds_after_the_user_is_somewhere_else():
    system, seen = (
        DragPoser(module_of("dragposer"), iterations=1, predictor=False),
        stream("6T", 40),
    )
    elsewhere = seen.position.copy()
    turn = rot.yaw_quat(np.array(3.0))
    elsewhere[10:] = rot.quat_rotate(turn, seen.position[10:]) + np.array([5.0, 0.0, 0.0])
    quat = seen.quat.copy()
    quat[10:] = rot.quat_multiply(turn, seen.quat[10:])
    poses = system.predict(replace(seen, position=elsewhere, quat=quat), BODY)
    want = rot.quat_rotate(turn, MOTION.root_position[39]) + np.array([5.0, 0.0, 0.0])
    assert np.linalg.norm(poses.root_position[39] - want) < 0.1
    assert LOST_FRAMES / 60.0 < 2.0


def test_a_constraint_of_the_user_is_met_where_trackers_leave_room():
    module, seen = module_of("dragposer"), stream("3T", 4)
    a, b = JOINTS.index("left_knee"), JOINTS.index("right_knee")

    def apart(constraints):
        system = DragPoser(module, iterations=10, predictor=False, constraints=constraints)
        position = system.predict(seen, BODY).forward_kinematics()[0]
        return float(np.linalg.norm(position[-1, a] - position[-1, b]))

    free = apart(())
    asked = apart((weighted(100.0, joint_distance("left_knee", "right_knee", free + 0.05)),))
    assert asked == pytest.approx(free + 0.05, abs=0.02)


def test_the_memory_of_dragposer_does_not_grow_with_the_stream():
    module = module_of("dragposer")
    module.token_std.fill_(1.0)
    system, seen = DragPoser(module, iterations=1), stream("6T", 2)
    system.reset(BODY, "6T")
    for t in range(4 * PAST + 8):
        system.step(replace(seen[0], time_s=t / 60.0))
    assert len(system._tokens) == PAST
    assert system._coming is not None


def test_decoded_joints_are_those_of_forward_kinematics():
    module = module_of("dragposer")
    assert isinstance(module, DragPoserModule)
    quat = torch.as_tensor(MOTION.forward_kinematics()[1][:3], dtype=torch.float32)
    root = quat[:, :1] * torch.tensor([1.0, -1, -1, -1])
    from questsim import differentiable as diff

    seen_from_root = diff.quat_multiply(*torch.broadcast_tensors(root, quat))
    offsets = torch.as_tensor(MOTION.offsets, dtype=torch.float32)
    position = torch.as_tensor(MOTION.forward_kinematics()[0][:3], dtype=torch.float32)
    want = diff.quat_rotate(root, position - position[:, :1])
    assert torch.allclose(joints_from_root(seen_from_root, offsets), want, atol=1e-5)


def some_unknowns():
    """A model with a decoder of some size, unknowns, the root's turn and place before."""
    module, generator = module_of("dragposer"), np.random.default_rng(0)
    turn = rot.yaw_quat(np.array(0.7))
    return DragModel(module), module, generator.normal(size=30), turn, generator.normal(size=3)


def test_the_solvers_pose_is_that_of_the_decoder_and_forward_kinematics():
    model, module, unknowns, turn, root = some_unknowns()
    skeleton = model.posed_skeleton(unknowns, turn, root, BODY.offsets)
    with torch.no_grad():
        decoded = module.double().decode(torch.as_tensor(unknowns[None, :24]))
    local, moved = decoded.rotation[0].numpy(), decoded.displacement[0].numpy()
    half = np.array([1.0, *0.5 * unknowns[27:]])
    own = rot.quat_multiply(rot.quat_multiply(turn, local[0]), half / np.linalg.norm(half))
    place = root + rot.quat_rotate(turn, moved) + unknowns[24:27]
    joints = joints_from_root(decoded.rotation[0], torch.as_tensor(BODY.offsets)).numpy()
    np.testing.assert_allclose(skeleton.position, place + rot.quat_rotate(own, joints), atol=1e-9)
    np.testing.assert_allclose(skeleton.quat[0], own, atol=1e-9)
    np.testing.assert_allclose(skeleton.quat[1:], rot.quat_multiply(own, local[1:]), atol=1e-9)


def test_the_solvers_derivatives_are_those_of_differences():
    model, _, unknowns, turn, root = some_unknowns()
    skeleton = model.posed_skeleton(unknowns, turn, root, BODY.offsets, slopes=True)
    for k in range(30):
        nudge = 1e-5 * np.eye(30)[k]
        a, b = (
            model.posed_skeleton(unknowns + s * nudge, turn, root, BODY.offsets) for s in (1, -1)
        )
        np.testing.assert_allclose(
            skeleton.d_position[..., k], (a.position - b.position) / 2e-5, atol=1e-7
        )
        np.testing.assert_allclose(skeleton.d_quat[..., k], (a.quat - b.quat) / 2e-5, atol=1e-7)


@pytest.mark.parametrize("sensors", ["6T", "3T"])
def test_the_solvers_residuals_change_as_their_derivatives_say(sensors):
    system, seen = DragPoser(module_of("dragposer"), predictor=False), stream(sensors, 2)
    system.constraints = (joint_distance("left_knee", "right_knee", 1.0),)
    goals, original = [], system._goal
    system._goal = lambda signals: (goals.append(original(signals)), goals[-1])[1]
    system.predict(seen, BODY)
    unknowns = np.random.default_rng(0).normal(size=30)
    _, jacobian = system._residuals(unknowns, goals[-1], slopes=True)
    # Head and hands: ankles near the floor, the hip below the head.
    assert len(jacobian) == 30 + 1 + (6 * 6 if sensors == "6T" else 3 * 6 + 1 + 2)
    for k in range(30):
        nudge = 1e-5 * np.eye(30)[k]
        a, b = (system._residuals(unknowns + s * nudge, goals[-1])[0] for s in (1, -1))
        np.testing.assert_allclose(jacobian[:, k], (a - b) / 2e-5, atol=1e-6)


def test_a_constraint_without_a_slope_does_not_stop_the_solver():
    module, seen = module_of("dragposer"), stream("6T", 3)

    def steep(position, quat):
        return (position[:, 0, 0] * 0.0).sqrt()  # zero, of infinite slope

    free = DragPoser(module, predictor=False).predict(seen, BODY)
    asked = DragPoser(module, predictor=False, constraints=(steep,)).predict(seen, BODY)
    np.testing.assert_allclose(asked.rotations, free.rotations, atol=1e-6)


# -- inverse kinematics --------------------------------------------------------------------------


def test_classical_ik_finds_the_avatars_own_pose_to_a_centimetre():
    seen = stream("6T", 6)
    position = InverseKinematics().predict(seen, BODY).forward_kinematics()[0]
    want = MOTION.forward_kinematics()[0][:6]
    assert np.linalg.norm(position - want, axis=-1).mean() < 0.01


def test_modules_are_what_the_registry_says():
    assert isinstance(module_of("hmdposer"), RecurrentModule)
    assert isinstance(system_of("lgsik"), RecurrentPoser)
    assert isinstance(module_of("sparseposer"), SparsePoserModule)
