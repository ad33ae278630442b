"""The compiled parts of a streamed frame against PyTorch and SciPy."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from agents.kinematic.data import MotionBank
from agents.kinematic.interface import Poses, UserBody
from agents.kinematic.recurrent.assembly import assembled
from agents.kinematic.recurrent.features import features
from agents.kinematic.recurrent.poser import RecurrentModule
from agents.kinematic.registry import AGENTS
from agents.kinematic.small_batch import (
    MOST_ROWS,
    EncoderLayer,
    group_linear,
    linear,
    pytorch_alone,
    side_by_side,
)
from questsim import differentiable as diff
from questsim import rotations as rot
from questsim.joint_sensors import readings
from questsim.motion.retarget_back import to_motion
from questsim.sensors import SENSOR_SETS
from questsim.skeleton import JOINTS
from tests.helpers import swaying_clip


@pytest.mark.parametrize("rows", [1, 2, 5, MOST_ROWS])
@pytest.mark.parametrize(("width", "count"), [(6, 5), (256, 31), (1000, 64)])
@torch.no_grad()
def test_a_linear_layer_of_few_rows_is_pytorchs(rows, width, count):
    generator = torch.Generator().manual_seed(rows)
    x = torch.randn(width, rows, generator=generator).t()
    weight, bias = torch.randn(count, width, generator=generator), torch.randn(count)
    with FlopCounterMode(display=False) as counter:
        got = linear(x, weight, bias)
    assert counter.get_total_flops() == 0
    torch.testing.assert_close(got, torch.nn.functional.linear(x, weight, bias), atol=1e-4, rtol=0)


@torch.no_grad()
def test_layers_side_by_side_are_each_layer_on_its_own_columns():
    torch.manual_seed(0)
    layers = [torch.nn.Linear(3, 7), torch.nn.Linear(5, 4)]
    columns = [[4, 0, 2], [1, 3, 5, 0, 2]]
    x = torch.randn(2, 6)
    index, weight, bias = side_by_side(layers, columns)
    got = group_linear(x.t()[index].transpose(1, 2), weight, bias)
    for g, (layer, read) in enumerate(zip(layers, columns, strict=True)):
        torch.testing.assert_close(got[g, :, : layer.out_features], layer(x[:, read]))


@torch.no_grad()
def test_an_encoder_layer_of_few_tokens_is_pytorchs():
    torch.manual_seed(0)
    layer = EncoderLayer(32, 4, 80, dropout=0.1, batch_first=True).eval()
    for parameter in layer.parameters():
        parameter.normal_(0.0, 0.3)
    x = torch.randn(1, 8, 32)
    got = layer(x)
    with pytorch_alone():
        torch.testing.assert_close(got, layer(x), atol=1e-5, rtol=1e-5)
    assert not torch.equal(got, layer.train()(x))


def test_gradients_go_through_pytorchs_products():
    weight = torch.randn(4, 6, requires_grad=True)
    linear(torch.ones(1, 6), weight, torch.zeros(4)).sum().backward()
    assert weight.grad is not None and torch.equal(weight.grad, torch.ones(4, 6))


@torch.no_grad()
def test_values_that_are_not_finite_stay_so():
    x = torch.ones(2, 40)
    x[1, 3] = torch.nan
    got = linear(x, torch.ones(3, 40), torch.zeros(3))
    assert got[0].tolist() == [40.0] * 3 and got[1].isnan().all()


@torch.no_grad()
def test_the_counter_of_operations_sees_a_linear_layer_where_pytorch_is_alone():
    with pytorch_alone(), FlopCounterMode(display=False) as counter:
        linear(torch.ones(1, 6), torch.ones(4, 6), torch.ones(4))
    assert counter.get_total_flops() == 2 * 4 * 6


def test_poses_are_those_of_forward_kinematics_with_the_head_in_its_place():
    rng = np.random.default_rng(0)
    six, head = rng.normal(size=(40, 22, 6)), rng.normal(size=(40, 3))
    offsets = rng.normal(size=(40, 22, 3))
    heading = rot.quat_to_matrix(rot.yaw_quat(rng.uniform(-3, 3, 40)))
    root, quat = assembled(six, heading, head, offsets)
    local = diff.six_d_to_matrix(torch.as_tensor(six)).numpy()
    local[:, 0] = heading @ local[:, 0]
    np.testing.assert_allclose(quat, rot.matrix_to_quat(local), atol=1e-9)
    position = Poses(root, quat, offsets).forward_kinematics()[0]
    np.testing.assert_allclose(position[:, JOINTS.index("head")], head, atol=1e-9)


def test_columns_that_make_no_rotation_give_no_number():
    six = np.tile([1.0, 0, 0, 0, 1, 0], (1, 22, 1))
    six[0, 3, 3:] = [2.0, 0, 0]
    six[0, 5, 0] = np.nan
    quat = assembled(six, np.eye(3)[None], np.zeros((1, 3)), np.zeros((1, 22, 3)))[1]
    bad = np.isnan(quat[0]).all(axis=-1)
    assert np.flatnonzero(bad).tolist() == [3, 5]


@pytest.mark.parametrize(
    ("agent", "sensors", "without"),
    [
        ("hmdposer", "H+2C+3IMU", {}),
        ("hmdposer", "H+2C", {"hands_in_head": False, "shape_head": False}),
        ("lgsik", "H+2C+3IMU", {}),
        ("lgsik", "H+2C+2IMU", {"graph": False}),
    ],
)
def test_a_stream_at_the_papers_size_gives_the_poses_of_the_sequence(agent, sensors, without):
    motion = to_motion(swaying_clip(frames=40)).resampled(60.0)
    torch.manual_seed(0)
    entry = AGENTS[agent]
    config = entry.presets["paper"]
    module = entry.build(replace(config.spec, **without))
    assert isinstance(module, RecurrentModule)
    for layer in module.net.last_layers():
        layer.weight.data.mul_(10.0)
    entry.task(module, "network", config.stages["network"], MotionBank([motion], 42), 2)
    system = entry.system(module, agent, ["network"], {})
    seen = readings(motion, SENSOR_SETS[sensors])
    whole = system.predict(seen, UserBody.of(motion))
    system.reset(UserBody.of(motion), seen.names)
    one_by_one = Poses.joined([system.step(seen[t]) for t in range(len(seen))])
    for name, told in vars(whole).items():
        np.testing.assert_allclose(getattr(one_by_one, name), told, atol=1e-4)


def readable_features(position, rotation, acceleration, seen):
    """What ``features`` computes, in PyTorch: the same numbers in the words of its text."""
    heading = diff.heading_matrix(rotation[:, :, 0])
    back = heading.transpose(-1, -2)

    def before(x):
        return torch.cat([x[:, :1], x[:, :-1]], dim=1)

    def spin(r):
        return diff.matrix_to_six_d(before(r).transpose(-1, -2) @ r)

    def seen_from(turn, vectors):
        return (turn[:, :, None] @ vectors[..., None]).squeeze(-1)

    floor = position[:, :, :1] * position.new_tensor([1.0, 1.0, 0.0])
    velocity = (position - before(position)) * 60.0
    head, hands = rotation[:, :, :1].transpose(-1, -2), rotation[:, :, 1:3]
    in_head = head @ hands
    place = (head @ (position[:, :, 1:] - position[:, :, :1])[..., None]).squeeze(-1)
    mask = torch.cat([seen.new_ones(len(seen), 3), seen], dim=1).to(position)[:, None, :, None]
    imu = seen.to(position)[:, None, :, None]
    parts = [
        diff.matrix_to_six_d(back[:, :, None] @ rotation) * mask,
        spin(rotation) * mask,
        seen_from(back, position - floor),
        seen_from(back, velocity),
        diff.matrix_to_six_d(in_head),
        spin(in_head),
        place,
        (place - before(place)) * 60.0,
        seen_from(back, acceleration) * imu / 10.0,
    ]
    return torch.cat([part.flatten(2) for part in parts], dim=-1), heading


def test_features_are_those_of_the_readable_formulas():
    torch.manual_seed(0)
    quat = np.random.default_rng(0).normal(size=(2, 5, 6, 4))
    quat[0, 2, 0] = [1.0, 0.0, -1.0, 0.0]  # the head looks straight up
    quat /= np.linalg.norm(quat, axis=-1, keepdims=True)
    position, acceleration = torch.randn(2, 2, 5, 3, 3)
    rotation = torch.as_tensor(rot.quat_to_matrix(quat), dtype=torch.float32)
    seen = torch.tensor([[True, True, False], [False, False, False]])
    got = features(position, rotation, acceleration, seen)
    want = readable_features(position, rotation, acceleration, seen)
    for mine, readable in zip(got, want, strict=True):
        torch.testing.assert_close(mine, readable, atol=1e-4, rtol=1e-5)
