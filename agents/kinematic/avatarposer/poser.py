"""AvatarPoser: a transformer over the last 40 frames of headset and controllers, then IK.

Source: Jiang et al., "AvatarPoser: Articulated Full-Body Pose Tracking from Sparse Motion Sensing",
ECCV 2022, and its released code for sizes, losses and optimiser: a linear embedding of 54 features,
3 encoder layers of 256 channels and 8 heads with 2,048 hidden units, and from the last token one
head for the orientation of the root and one for the rotations of the other 21 joints. The avatar's
head is then moved to the headset, and the shoulders and elbows are refined until the hands are at
the controllers. Changes here: features are relative to the head's heading, as for HMD-Poser; the
user's bones are known, while the paper uses one mean body; and the number of refinement steps and
their size are this project's, because the released code has no refinement.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor, nn

from agents.kinematic.data import MotionBank, Windows
from agents.kinematic.interface import DeviceSignals, KinematicSystem, Poses, UserBody
from agents.kinematic.learning import Learning, Task, begin_at_rest
from agents.kinematic.recurrent.assembly import assembled
from agents.kinematic.recurrent.features import DEVICES as ALL_DEVICES
from agents.kinematic.recurrent.features import features
from agents.kinematic.recurrent.training import training_inputs
from agents.kinematic.switches import SWITCH
from agents.kinematic.training_faults import Faults, drawn
from agents.precision import products
from questsim import differentiable as diff
from questsim.joint_sensors import SensorSequence
from questsim.skeleton import JOINT_PARENTS, JOINTS, NUM_JOINTS

DEVICES = ALL_DEVICES[:3]
WINDOW = 40
"""Frames of a window (the paper)."""
COLUMNS: list[int] = [*range(18), *range(36, 54), *range(72, 90)]
"""Of the 135 features: rotations and angular velocities, positions and velocities of 3 devices."""
ROOT_WEIGHT = 0.02
"""Weight of the root's orientation in the loss; rotations and positions of joints have 1 (code)."""
WINDOWS_AT_ONCE = 64
"""Windows per batch when a whole sequence is estimated."""
REFINEMENTS, REFINEMENT_RATE = 10, 0.02
"""Steps of Adam on shoulders and elbows, and their rate in radians."""

_ARMS = [[JOINTS.index(f"{side}_{part}") for part in ("shoulder", "elbow", "wrist")]
         for side in ("left", "right")]  # fmt: skip
_Batch = tuple[Windows, Faults | None]


@dataclass(frozen=True)
class AvatarPoserSpec:
    """Sizes of the network, and switches of its parts.

    Attributes:
        size: channels of a token.
        layers, heads, feed_forward, dropout: of the transformer encoder.
        refined: whether arms are refined so that the hands are at the controllers.
    """

    size: int = 256
    layers: int = 3
    heads: int = 8
    feed_forward: int = 2048
    dropout: float = 0.1
    refined: bool = field(default=True, metadata=SWITCH)


class AvatarPoserModule(nn.Module):
    """The network.

    Args:
        spec: network sizes.
    """

    def __init__(self, spec: AvatarPoserSpec) -> None:
        super().__init__()
        self.spec = spec
        self.embedding = nn.Linear(len(COLUMNS), spec.size)
        layer = nn.TransformerEncoderLayer(
            spec.size, spec.heads, spec.feed_forward, spec.dropout, batch_first=True
        )
        self.encoder = nn.TransformerEncoder(layer, spec.layers, enable_nested_tensor=False)
        self.root, self.pose = (
            nn.Sequential(nn.Linear(spec.size, 256), nn.ReLU(), nn.Linear(256, 6 * joints))
            for joints in (1, NUM_JOINTS - 1)
        )
        # From random rotations, spine1 and spine3 may settle half a turn off: joints beyond them
        # are then in place, and between half a turn and none every pose is worse.
        for head in (self.root, self.pose):
            begin_at_rest(head[-1])

    def forward(self, inputs: Tensor) -> Tensor:
        """6D rotations ``(B, 22, 6)`` of the last frame of features ``(B, T, 135)``."""
        last = self.encoder(self.embedding(inputs[..., COLUMNS]))[:, -1]
        return torch.cat([self.root(last), self.pose(last)], dim=-1).unflatten(-1, (NUM_JOINTS, 6))


class AvatarPoser(KinematicSystem):
    """AvatarPoser on a stream.

    Args:
        module: a trained module.
        name: for messages.
        refined: whether arms are refined; by default as trained.
    """

    devices = required = DEVICES

    def __init__(self, module: AvatarPoserModule, name: str, refined: bool | None = None) -> None:
        self.module, self.name = module, name
        self.refined = module.spec.refined if refined is None else refined
        module.eval()

    def _begin(self, body: UserBody) -> None:
        assert self._names is not None
        self._columns = [self._names.index(device) for device in DEVICES]
        self._past: list[Tensor] = []
        self._before: tuple[Tensor, Tensor] | None = None

    @torch.no_grad()
    def _next(self, signals: DeviceSignals) -> Poses:
        inputs, heading, position = self._inputs(signals)
        self._past = [*self._past[1 - WINDOW :], inputs]
        six = self.module(torch.cat(self._past)[None])
        return self._poses(six, heading, position)

    @torch.no_grad()
    def predict(self, sequence: SensorSequence, body: UserBody) -> Poses:
        """Like ``KinematicSystem.predict``; many windows at once if the stream has no gap."""
        signals = self._all_signals(sequence, body)
        if signals is None:
            return super().predict(sequence, body)
        inputs, heading, position = self._inputs(signals)
        parts = [self.module(inputs[None, : t + 1]) for t in range(min(WINDOW - 1, len(inputs)))]
        for begin in range(0, len(inputs) - WINDOW + 1, WINDOWS_AT_ONCE):
            end = min(begin + WINDOWS_AT_ONCE, len(inputs) - WINDOW + 1)
            parts.append(
                self.module(inputs[torch.arange(begin, end)[:, None] + torch.arange(WINDOW)])
            )
        poses = self._poses(torch.cat(parts), heading, position)
        return poses if poses.finite() else super().predict(sequence, body)

    def _inputs(self, signals: DeviceSignals) -> tuple[Tensor, Tensor, np.ndarray]:
        """Features ``(T, 135)``, headings ``(T, 3, 3)`` and places ``(T, 3, 3)`` of new frames."""
        place = torch.as_tensor(signals.position[:, self._columns], dtype=torch.float32)
        quat = torch.as_tensor(signals.quat[:, self._columns], dtype=torch.float32)
        turn = torch.eye(3).expand(len(place), len(ALL_DEVICES), 3, 3).clone()
        turn[:, :3] = diff.quat_to_matrix(quat)
        before = self._before if self._before is not None else (place[:1], turn[:1])
        self._before = (place[-1:], turn[-1:])
        place, turn = (torch.cat(pair) for pair in zip(before, (place, turn), strict=True))
        empty, seen = torch.zeros_like(place), torch.zeros(1, 3, dtype=torch.bool)
        inputs, heading = features(place[None], turn[None], empty[None], seen)
        return inputs[0, 1:], heading[0, 1:], signals.position[:, self._columns]

    def _poses(self, six: Tensor, heading: Tensor, position: np.ndarray) -> Poses:
        """The poses with the head at the headset and, if refined, the hands at the controllers."""
        offsets = np.broadcast_to(self._body.offsets, (len(six), NUM_JOINTS, 3))
        root, quat = assembled(six.numpy(), heading.numpy(), position[:, 0], offsets)
        if self.refined and np.isfinite(quat).all():
            refine(root, quat, offsets, position[:, 1:])
        return Poses(root, quat, offsets)


def refine(root: np.ndarray, quat: np.ndarray, offsets: np.ndarray, hands: np.ndarray) -> None:
    """Turn shoulders and elbows so that the wrists get nearer to the hands; in place.

    Args:
        root: ``(T, 3)``.
        quat: ``(T, 22, 4)`` rotations in the parent's frame; those of shoulders and elbows change.
        offsets: ``(T, 22, 3)``.
        hands: ``(T, 2, 3)`` measured positions of the wrists.
    """
    position, world = Poses(root, quat, offsets).forward_kinematics()
    joints = np.array(_ARMS)
    start, above = (
        torch.from_numpy(np.ascontiguousarray(array))
        for array in (position[:, joints[:, 0]], world[:, np.array(JOINT_PARENTS)[joints[:, 0]]])
    )
    local = torch.from_numpy(quat[:, joints[:, :2]])
    bones = torch.from_numpy(np.ascontiguousarray(offsets[:, joints[:, 1:]]))
    goal = torch.from_numpy(np.ascontiguousarray(hands, float))
    with torch.enable_grad():
        turned = torch.zeros(*local.shape[:-1], 3, dtype=torch.float64, requires_grad=True)
        optimiser = torch.optim.Adam([turned], lr=REFINEMENT_RATE)
        for _ in range(REFINEMENTS):
            optimiser.zero_grad()
            now = _turned(local, turned)
            forearm = diff.quat_rotate(now[..., 1, :], bones[..., 1, :])
            arm = diff.quat_rotate(now[..., 0, :], bones[..., 0, :] + forearm)
            wrist = start + diff.quat_rotate(above, arm)
            (wrist - goal).square().sum().backward()
            optimiser.step()
    quat[:, joints[:, :2]] = _turned(local, turned).detach().numpy()


def _turned(quat: Tensor, vector: Tensor) -> Tensor:
    """Quaternions turned by small rotation vectors in their own frame."""
    step = torch.cat([torch.ones_like(vector[..., :1]), 0.5 * vector], dim=-1)
    return diff.unit_quat(diff.quat_multiply(quat, step))


# -- training ----------------------------------------------------------------------------------


def make_task(
    module: nn.Module, stage: str, learning: Learning, bank: MotionBank, validation: int
) -> Task:
    """Create the task of ``network``, the only stage.

    The loss is the mean absolute error of the root's 6D rotation (0.02), of the other joints' and
    of joint positions from the root, in the last frame of each window (released code).
    """
    assert isinstance(module, AvatarPoserModule) and stage == "network"
    fixed = bank.validation.fixed(validation)

    def with_faults(windows: Windows, rng: np.random.Generator) -> _Batch:
        shape = (len(windows), windows.frames, len(ALL_DEVICES))
        return windows, drawn(learning.noise, shape, rng)

    def draw(rng: np.random.Generator) -> _Batch:
        return with_faults(bank.draw(learning.batch, rng), rng)

    def loss(batch: _Batch) -> tuple[Tensor, dict[str, float]]:
        windows, faults = batch
        seen = torch.zeros(len(windows), 3, dtype=torch.bool)
        inputs, heading, target = training_inputs(windows, seen, faults)
        with products(learning.bfloat16 and module.training):
            six = module(inputs)
        return _compared(six.float(), heading[:, -1], target)

    compared = with_faults(fixed, np.random.default_rng(20_260))

    def validate() -> dict[str, float]:
        return loss(compared)[1]

    return Task(list(module.parameters()), draw, loss, validate)


def _compared(six: Tensor, heading: Tensor, target: Windows) -> tuple[Tensor, dict[str, float]]:
    """The loss of estimated rotations ``(B, 22, 6)``, and its terms and ``error_cm`` by name."""
    want = target.local[:, -1].clone()
    want[:, 0] = heading.transpose(-1, -2) @ want[:, 0]
    want_six = diff.matrix_to_six_d(want)
    got, there = (
        diff.positions_from_root(diff.world_matrices(each), target.offsets)
        for each in (diff.six_d_to_matrix(six), want)
    )
    terms = {
        "root": ROOT_WEIGHT * (six[:, 0] - want_six[:, 0]).abs().mean(),
        "rotations": (six[:, 1:] - want_six[:, 1:]).abs().mean(),
        "positions": (got - there).abs().mean(),
    }
    figures = {name: float(term.detach()) for name, term in terms.items()}
    head = JOINTS.index("head")
    apart = (got - got[:, head : head + 1]) - (there - there[:, head : head + 1])
    figures["error_cm"] = float(100.0 * apart.detach().norm(dim=-1).mean())
    return torch.stack(list(terms.values())).sum(), figures
