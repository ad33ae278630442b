"""HMD-Poser: sensor tokens pass through LSTMs over time and transformers across the body.

Source: Dai et al., "HMD-Poser: On-Device Real-time Human Motion Tracking from Scalable Sparse
Observations", CVPR 2024. The `paper` preset has as many parameters as the released code. Changes
here: accelerations are causal, LSTM states are kept between frames, features are relative to the
head's heading, and the 16 shape values are bone lengths (``questsim.proportions``), not SMPL's.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor, nn

from agents.kinematic.derived_weights import DerivedWeights
from agents.kinematic.recurrent.features import ATOMS
from agents.kinematic.recurrent.lstm import LstmBank, LstmState
from agents.kinematic.small_batch import (
    EncoderLayer,
    Linear,
    group_linear,
    is_small_batch,
    side_by_side,
)
from agents.kinematic.switches import SWITCH
from questsim.proportions import NUM_BONES
from questsim.skeleton import NUM_JOINTS

TOKENS: tuple[str, ...] = (
    "head", "left", "right", "left_leg", "right_leg", "pelvis", "left_in_head", "right_in_head",
)  # fmt: skip


@dataclass(frozen=True)
class HmdPoserSpec:
    """Sizes of the network, and switches of its parts.

    Attributes:
        size: features per token.
        blocks: number of pairs of LSTMs and transformer.
        layers, heads, feed_forward: of each transformer encoder.
        head_hidden: hidden units of the pose and shape heads.
        acceleration_size: features of an IMU's token that encode its acceleration.
        dropout: of the transformers.
        hands_in_head: whether there are two tokens for the hands relative to the head.
        shape_head: whether bones are estimated; otherwise the mean body is used.
    """

    size: int = 256
    blocks: int = 2
    layers: int = 3
    heads: int = 8
    feed_forward: int = 2048
    head_hidden: int = 256
    acceleration_size: int = 16
    dropout: float = 0.1
    hands_in_head: bool = field(default=True, metadata=SWITCH)
    shape_head: bool = field(default=True, metadata=SWITCH)


class HmdPoserNet(DerivedWeights):
    """From 135 features per frame to 22 rotations in 6D and 16 shape values.

    Args:
        spec: network sizes.
    """

    def __init__(self, spec: HmdPoserSpec) -> None:
        super().__init__()
        self.spec = spec
        quarter, rest = spec.size // 4, (spec.size - spec.acceleration_size) // 2
        self._tokens = [t for t in TOKENS if spec.hands_in_head or not t.endswith("_in_head")]
        self.embeddings = nn.ModuleList()
        for token in self._tokens:
            widths = [(6, quarter), (6, quarter), (3, quarter), (3, quarter)]
            if len(ATOMS[token]) == 15:
                widths = [(6, rest), (6, rest), (3, spec.acceleration_size)]
            self.embeddings.append(nn.ModuleList([nn.Linear(a, b) for a, b in widths]))
        self.norm = nn.LayerNorm(spec.size, eps=1e-6)
        self.time = nn.ModuleList(
            [LstmBank(len(self._tokens), spec.size) for _ in range(spec.blocks)]
        )
        self.space = nn.ModuleList()
        for _ in range(spec.blocks):
            layer = EncoderLayer(
                spec.size, spec.heads, spec.feed_forward, spec.dropout, batch_first=True
            )
            encoder = nn.TransformerEncoder(layer, spec.layers, enable_nested_tensor=False)
            self.space.append(encoder)
        wide = spec.size * len(self._tokens)
        self.pose = _head(wide, spec.head_hidden, NUM_JOINTS * 6)
        self.shape = _head(wide, spec.head_hidden, NUM_BONES) if spec.shape_head else None

    def last_layers(self) -> list[nn.Linear]:
        """The layers that output rotations."""
        layer = self.pose[-1]
        assert isinstance(layer, nn.Linear)
        return [layer]

    def _embed(self, features: Tensor) -> Tensor:
        """Tokens ``(B, T, tokens, size)``."""
        rows = features.shape[:2].numel()
        if is_small_batch(features, rows):
            columns, weights, bias, order = self.derived(self._embeddings_at_once)
            seen = features.reshape(rows, -1).t()[columns].transpose(1, 2)
            parts = group_linear(seen, weights, bias).transpose(0, 1).flatten(1)[:, order]
            x = nn.functional.leaky_relu(parts).view(*features.shape[:2], len(self._tokens), -1)
            return self.norm(x)
        tokens = []
        for token, layers in zip(self._tokens, self.embeddings, strict=True):
            assert isinstance(layers, nn.ModuleList)
            atom, at, parts = features[..., ATOMS[token]], 0, []
            for layer in layers:
                assert isinstance(layer, nn.Linear)
                part = layer(atom[..., at : at + layer.in_features])
                parts.append(nn.functional.leaky_relu(part))
                at += layer.in_features
            tokens.append(self.norm(torch.cat(parts, dim=-1)))
        return torch.stack(tokens, dim=-2)

    def _embeddings_at_once(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """All layers for ``side_by_side``, and the positions of each token's features."""
        layers, columns = [], []
        for token, own in zip(self._tokens, self.embeddings, strict=True):
            assert isinstance(own, nn.ModuleList)
            at = 0
            for layer in own:
                assert isinstance(layer, nn.Linear)
                layers.append(layer)
                columns.append(ATOMS[token][at : at + layer.in_features])
                at += layer.in_features
        index, weights, bias = side_by_side(layers, columns)
        order = [
            g * weights.shape[1] + n
            for g, layer in enumerate(layers)
            for n in range(layer.out_features)
        ]
        return index, weights, bias, torch.tensor(order)

    def forward(
        self, features: Tensor, body: Tensor, states: list[LstmState] | None = None
    ) -> tuple[Tensor, Tensor, list[LstmState]]:
        """Poses of a sequence.

        Args:
            features: ``(B, T, 135)``.
            body: ``(B, 11)``; not used.
            states: states of the LSTMs before the first frame.

        Returns:
            6D rotations ``(B, T, 22, 6)``, shape ``(B, T, 16)``, states after the last frame.
        """
        batch, frames = features.shape[:2]
        x, after = self._embed(features), []
        for block, (time, space) in enumerate(zip(self.time, self.space, strict=True)):
            x, state = time(x, None if states is None else states[block])
            after.append(state)
            x = space(x.flatten(0, 1)).view(batch, frames, len(self._tokens), -1)
        x = x.flatten(2)
        shape = x.new_zeros(batch, frames, NUM_BONES) if self.shape is None else self.shape(x)
        return self.pose(x).view(batch, frames, NUM_JOINTS, 6), shape, after


def _head(wide: int, hidden: int, out: int) -> nn.Sequential:
    return nn.Sequential(Linear(wide, hidden), nn.LeakyReLU(), Linear(hidden, out))
