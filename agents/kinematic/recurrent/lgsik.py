"""LGSIK-Poser: groups of sensors, masked graph convolutions and an IK head for each body part.

Source: LGSIK-Poser, 2025. Sizes are those of the released code, with one correction. By an index
slip, the released leg heads are 18 wide and read a hand; here they read the 15 values of their own
leg's IMU, which makes 2 x 3 x 512 parameters fewer than the released 7,283,988. Other changes: see
``hmdposer``; the gender in the shape group is left open (zeros).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor, nn

from agents.kinematic.recurrent.features import ATOMS
from agents.kinematic.recurrent.lstm import LstmBank, LstmState
from agents.kinematic.skeletal import MaskedLinear
from agents.kinematic.small_batch import Linear
from agents.kinematic.switches import SWITCH
from questsim.errors import InputError
from questsim.proportions import NUM_BONES
from questsim.skeleton import JOINTS, NUM_JOINTS

SHAPE_INPUTS = 11
GROUPS: dict[str, tuple[str, ...]] = {
    "torso": ("pelvis", "head", "left_in_head", "right_in_head", "left_leg", "right_leg"),
    "head": ("head", "left_in_head", "right_in_head"),
    "left_arm": ("head", "left", "left_in_head"),
    "right_arm": ("head", "right", "right_in_head"),
    "left_leg": ("pelvis", "head", "left_leg"),
    "right_leg": ("pelvis", "head", "right_leg"),
    "upper": ("pelvis", "head", "left_in_head", "right_in_head"),
    "lower": ("pelvis", "head", "left_leg", "right_leg"),
}
"""Input columns of each group; the ninth group is the shape's."""

_EDGES = {
    "torso": "torso head left_arm right_arm left_leg right_leg upper lower",
    "head": "head torso upper",
    "left_arm": "left_arm torso upper",
    "right_arm": "right_arm torso upper",
    "left_leg": "left_leg torso lower",
    "right_leg": "right_leg torso lower",
    "upper": "upper torso head left_arm right_arm",
    "lower": "lower torso left_leg right_leg",
}
PARTS: dict[str, tuple[str, ...]] = {
    "torso": ("root", "spine1", "spine2", "spine3"),
    "head": ("neck", "head"),
    "left_arm": ("left_clavicle", "left_shoulder", "left_elbow", "left_wrist"),
    "right_arm": ("right_clavicle", "right_shoulder", "right_elbow", "right_wrist"),
    "left_leg": ("left_hip", "left_knee", "left_ankle", "left_toe"),
    "right_leg": ("right_hip", "right_knee", "right_ankle", "right_toe"),
}
"""The six parts with an IK head each, and their joints."""

LOSSES = ("lgsik", "lgsik-lengths", "hmdposer")
"""Available training losses; see ``recurrent.losses``."""

_END = {"head": "head", "left_arm": "left", "right_arm": "right",
        "left_leg": "left_leg", "right_leg": "right_leg"}  # fmt: skip


@dataclass(frozen=True)
class LgsikSpec:
    """Sizes of the network, and switches of its parts.

    Attributes:
        size: features per group.
        hidden: units of the two hidden layers of each IK head.
        shape_hidden: units of both hidden layers of the shape head.
        graph: whether masked graph convolutions connect the groups. Otherwise the six parts are
            processed separately, without the groups that only feed others (upper, lower, shape).
        ik_heads: whether each part has a head that reads its end's sensor and the root; otherwise
            one plain head outputs all rotations from the features of all parts.
        shape_group: whether the shape group and the shape head read measurements; otherwise bones
            are estimated from the motion alone.
        loss: ``lgsik`` (published: nothing but consistency in the window supervises the shape),
            ``lgsik-lengths`` (the true bone lengths supervise it too), or ``hmdposer`` for
            HMD-Poser's.
    """

    size: int = 128
    hidden: tuple[int, int] = (512, 256)
    shape_hidden: int = 256
    graph: bool = field(default=True, metadata=SWITCH)
    ik_heads: bool = field(default=True, metadata=SWITCH)
    shape_group: bool = field(default=True, metadata=SWITCH)
    loss: str = field(default="lgsik", metadata=SWITCH)


def group_mask(rows: int) -> Tensor:
    """Mask ``(rows, 9)`` of the groups that each group reads: torso reads all, all read shape.

    Shape reads only itself.
    """
    names = [*GROUPS, "shape"]
    mask = torch.zeros(len(names), len(names))
    for group, sources in _EDGES.items():
        for source in [*sources.split(), "shape"]:
            mask[names.index(group), names.index(source)] = 1.0
    mask[-1, -1] = 1.0
    return mask[:rows]


class LgsikNet(nn.Module):
    """From 135 features per frame and 11 measurements to rotations in 6D and 16 shape values.

    Args:
        spec: network sizes.

    Raises:
        InputError: unknown loss.
    """

    def __init__(self, spec: LgsikSpec) -> None:
        super().__init__()
        if spec.loss not in LOSSES:
            raise InputError(f"there is no loss {spec.loss!r}", "lgsik", " or ".join(LOSSES))
        self.spec, size = spec, spec.size
        groups = GROUPS if spec.graph else PARTS
        self._columns = [[c for atom in GROUPS[group] for c in ATOMS[atom]] for group in groups]
        self._reads_body = spec.graph and spec.shape_group
        widths = [*map(len, self._columns), *([SHAPE_INPUTS] if self._reads_body else [])]
        self.embeddings = nn.ModuleList([nn.Linear(width, size) for width in widths])
        self.norms = nn.ModuleList([nn.LayerNorm(size, eps=1e-6) for _ in widths])
        self.first = LstmBank(len(widths), size)
        rows = (len(widths), len(widths), len(PARTS)) if spec.graph else ()
        masks = [group_mask(n)[:, : len(widths)] for n in rows]
        self.graph = nn.ModuleList([MaskedLinear(mask, size, size) for mask in masks])
        self.second = LstmBank(len(PARTS), size)
        self.heads = nn.ModuleList(self._heads())
        measured = SHAPE_INPUTS if spec.shape_group else 0
        self.shape = nn.Sequential(
            Linear(len(PARTS) * size + measured, spec.shape_hidden),
            nn.LeakyReLU(),
            Linear(spec.shape_hidden, spec.shape_hidden),
            nn.LeakyReLU(),
            Linear(spec.shape_hidden, NUM_BONES),
        )
        listed = [JOINTS.index(joint) for joints in PARTS.values() for joint in joints]
        self._order = [listed.index(joint) for joint in range(NUM_JOINTS)]

    def _heads(self) -> list[nn.Sequential]:
        """Heads of the root and the parts, in the order of ``_END``, or one for all joints."""
        size = self.spec.size
        if not self.spec.ik_heads:
            return [self._head(len(PARTS) * size, 6 * NUM_JOINTS)]
        root_out = 6 * len(PARTS["torso"])
        heads = [self._head(2 * size + len(ATOMS["pelvis"]) + len(ATOMS["head"]), root_out)]
        for part, atom in _END.items():
            width = size + root_out + len(ATOMS[atom])
            heads.append(self._head(width, 6 * len(PARTS[part])))
        return heads

    def _head(self, width: int, out: int) -> nn.Sequential:
        a, b = self.spec.hidden
        return nn.Sequential(
            Linear(width, a), nn.LeakyReLU(), Linear(a, b), nn.LeakyReLU(), Linear(b, out)
        )

    def last_layers(self) -> list[nn.Linear]:
        """The layers that output rotations."""
        last = [head[-1] for head in self.heads if isinstance(head, nn.Sequential)]
        return [layer for layer in last if isinstance(layer, nn.Linear)]

    def forward(
        self, features: Tensor, body: Tensor, states: list[LstmState] | None = None
    ) -> tuple[Tensor, Tensor, list[LstmState]]:
        """Poses of a sequence; arguments and result as in ``HmdPoserNet.forward``.

        Args:
            features: ``(B, T, 135)``.
            body: ``(B, 11)`` measurements, centred and scaled; not used without the shape group.
            states: states of both banks of LSTMs before the first frame.
        """
        batch, frames = features.shape[:2]
        measured = body[:, None].expand(-1, frames, -1)
        inputs = [features[..., columns] for columns in self._columns]
        if self._reads_body:
            inputs.append(measured)
        embedded = [
            norm(nn.functional.leaky_relu(layer(x)))
            for x, layer, norm in zip(inputs, self.embeddings, self.norms, strict=True)
        ]
        x, first = self.first(torch.stack(embedded, dim=-2), states[0] if states else None)
        x = x.flatten(2)
        for layer in self.graph:
            x = nn.functional.leaky_relu(layer(x), 0.2)
        x = x.view(batch, frames, len(PARTS), -1)
        x, second = self.second(x, states[1] if states else None)
        flat = x.flatten(2)
        six = self._rotations(features, x) if self.spec.ik_heads else self.heads[0](flat)
        if self.spec.shape_group:
            flat = torch.cat([flat, measured], dim=-1)
        return six.view(batch, frames, NUM_JOINTS, 6), self.shape(flat), [first, second]

    def _rotations(self, features: Tensor, x: Tensor) -> Tensor:
        """Output of the IK heads ``(B, T, 22, 6)`` from the parts' features ``(B, T, 6, size)``."""
        raw = [features[..., ATOMS[atom]] for atom in ("pelvis", "head")]
        root = self.heads[0](torch.cat([*raw, x[:, :, 0], x[:, :, 1]], dim=-1))
        parts = [root]
        for i, atom in enumerate(_END.values(), start=1):
            seen = [features[..., ATOMS[atom]], x[:, :, i], root]
            parts.append(self.heads[i](torch.cat(seen, dim=-1)))
        return torch.cat(parts, dim=-1).unflatten(-1, (NUM_JOINTS, 6))[:, :, self._order]
