"""DragPoser's networks: an autoencoder of single poses and a predictor of its latent in time.

Source: Ponton et al., "DragPoser: Motion Reconstruction from Variable Sparse Tracking Signals via
Latent Space Optimization", 2024. The `paper` preset has the 65,872 parameters of the released
autoencoder (the paper says about 168 thousand) and a predictor of about 1.28 million.
``drag_solver`` uses them on a stream.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor, nn

from agents.kinematic.skeletal import (
    PARENTS,
    POOLINGS,
    SIZES,
    MaskedLinear,
    across_joints,
    neighbour_mask,
    pool_matrix,
    unpool_matrix,
)
from agents.kinematic.switches import SWITCH
from questsim import differentiable as diff
from questsim.skeleton import JOINTS, NUM_JOINTS

LATENT = 24
ENCODED, DECODED = 8, 4
"""Channels per joint in encoder and decoder."""
TOKEN_EVERY = 4
PAST, FUTURE = 16, 16
"""Number of tokens that the predictor reads and predicts, one every ``TOKEN_EVERY`` frames."""
HEIGHT_JOINTS: tuple[int, ...] = tuple(
    JOINTS.index(name)
    for name in ("root", "head", "left_wrist", "right_wrist", "left_ankle", "right_ankle")
)
TOKEN = LATENT + 3 + len(HEIGHT_JOINTS)


@dataclass(frozen=True)
class DragPoserSpec:
    """Network sizes and settings of the solver.

    Attributes:
        size, heads, encoder_layers, decoder_layers, feed_forward, dropout: of the predictor.
        solver: ``adam`` (as published) or ``newton`` (damped Gauss-Newton; one iteration per frame
            is enough).
        iterations: largest number of solver iterations per frame.
        predictor: whether the temporal predictor is used. Without it, its stage is not trained and
            the last latent is the prediction of the next one.
        published: whether predictor, training and solver are those of the paper (see
            ``published``), without this project's changes.
    """

    size: int = 48
    heads: int = 4
    encoder_layers: int = 3
    decoder_layers: int = 3
    feed_forward: int = 2048
    dropout: float = 0.1
    solver: str = "newton"
    iterations: int = 10
    predictor: bool = field(default=True, metadata=SWITCH)
    published: bool = field(default=False, metadata=SWITCH)


@dataclass(frozen=True)
class Decoded:
    """A pose decoded by the autoencoder.

    Attributes:
        rotation: ``(..., 22, 4)`` unit quaternions relative to the root; the root's own is its
            rotation since the previous frame.
        displacement: ``(..., 3)`` metres the root moved, in its own previous frame.
    """

    rotation: Tensor
    displacement: Tensor


class PoseAutoencoder(nn.Module):
    """The variational autoencoder of single poses.

    All layers are skeletal with a kernel of one frame. The encoder reduces 22 joints of 8 channels
    to 6 joints and 24 latent values; the decoder has 4 channels per joint and a slot for the
    root's displacement.
    """

    def __init__(self) -> None:
        super().__init__()
        self.encoder = nn.ModuleList(
            [MaskedLinear(neighbour_mask(PARENTS[level]), ENCODED, ENCODED) for level in range(3)]
        )
        self.to_mean = nn.Linear(SIZES[3] * ENCODED, LATENT)
        self.to_log_variance = nn.Linear(SIZES[3] * ENCODED, LATENT)
        self.from_latent = nn.Linear(LATENT, SIZES[3] * DECODED)
        self.decoder = nn.ModuleList(
            [
                MaskedLinear(neighbour_mask(PARENTS[level], displacement=True), DECODED, DECODED)
                for level in (2, 1, 0)
            ]
        )
        for level in range(3):
            unpool = unpool_matrix(POOLINGS[level], "out" if level == 2 else "both")
            self.register_buffer(f"unpool_{level}", unpool, persistent=False)
            self.register_buffer(f"pool_{level}", pool_matrix(POOLINGS[level]), persistent=False)

    def encode(self, pose: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log-variance ``(B, 24)`` of the latent of poses ``(B, 176)``."""
        x = pose
        for level, layer in enumerate(self.encoder):
            x = nn.functional.leaky_relu(layer(x), 0.2)
            x = across_joints(getattr(self, f"pool_{level}"), x, ENCODED)
        return self.to_mean(x), self.to_log_variance(x).clamp(-20.0, 4.0)

    def decode(self, latent: Tensor) -> Tensor:
        """Decode latents ``(B, 24)`` to ``(B, 23, 4)``: 22 joints, then the displacement."""
        x = nn.functional.leaky_relu(self.from_latent(latent), 0.2)
        for level, layer in zip((2, 1, 0), self.decoder, strict=True):
            x = layer(across_joints(getattr(self, f"unpool_{level}"), x, DECODED))
            if level:
                x = nn.functional.leaky_relu(x, 0.2)
        return x.unflatten(-1, (NUM_JOINTS + 1, DECODED))


class LatentPredictor(nn.Module):
    """A transformer that predicts future latents from past tokens.

    The last token is the query of every prediction; positions are encoded by sinusoids
    (Vaswani et al. 2017).

    Args:
        spec: network sizes.
    """

    def __init__(self, spec: DragPoserSpec) -> None:
        super().__init__()
        self.into = nn.Linear(TOKEN, spec.size)
        self.transformer = nn.Transformer(
            spec.size, spec.heads, spec.encoder_layers, spec.decoder_layers, spec.feed_forward,
            spec.dropout, batch_first=True,
        )  # fmt: skip
        self.out = nn.Linear(spec.size, LATENT)
        # The untrained predictor predicts no change.
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)
        self.register_buffer("places", _sinusoids(PAST + FUTURE, spec.size), persistent=False)

    def forward(self, past: Tensor, future: int) -> Tensor:
        """Predict z-scored latents ``(B, future, 24)`` from z-scored tokens ``(B, P, 33)``.

        The network's output is the change from the last token's latent.
        """
        assert isinstance(self.places, Tensor)
        count = past.shape[1]
        shown = self.into(past) + self.places[PAST - count : PAST]
        asked = self.into(past[:, -1:]) + self.places[PAST : PAST + future]
        return past[:, -1:, :LATENT] + self.out(self.transformer(shown, asked))


class AutoregressivePredictor(nn.Module):
    """The published predictor: a transformer that decodes future latents one after the other.

    The encoder reads all past tokens but the last. The decoder starts from the latent of the last
    one and reads its own predictions, with a causal mask; in training it reads the true latents.

    Args:
        spec: network sizes.
    """

    def __init__(self, spec: DragPoserSpec) -> None:
        super().__init__()
        self.into, self.again = nn.Linear(TOKEN, spec.size), nn.Linear(LATENT, spec.size)
        self.transformer = nn.Transformer(
            spec.size, spec.heads, spec.encoder_layers, spec.decoder_layers, spec.feed_forward,
            spec.dropout, batch_first=True,
        )  # fmt: skip
        self.out = nn.Linear(spec.size, LATENT)
        self.register_buffer("places", _sinusoids(PAST + FUTURE, spec.size), persistent=False)

    def taught(self, past: Tensor, coming: Tensor) -> Tensor:
        """Predict latents ``(B, F, 24)`` from tokens ``(B, P, 33)`` and the true latents before."""
        shown = torch.cat([past[:, -1:, :LATENT], coming[:, :-1]], dim=1)
        return self._decoded(self._remembered(past), shown)

    def forward(self, past: Tensor, future: int) -> Tensor:
        """Predict z-scored latents ``(B, future, 24)`` from z-scored tokens ``(B, P, 33)``."""
        memory, shown = self._remembered(past), past[:, -1:, :LATENT]
        for _ in range(future):
            shown = torch.cat([shown, self._decoded(memory, shown)[:, -1:]], dim=1)
        return shown[:, 1:]

    def _remembered(self, past: Tensor) -> Tensor:
        assert isinstance(self.places, Tensor)
        count = past.shape[1]
        tokens = self.into(past[:, :-1]) + self.places[PAST - count : PAST - 1]
        return self.transformer.encoder(tokens)

    def _decoded(self, memory: Tensor, latents: Tensor) -> Tensor:
        assert isinstance(self.places, Tensor)
        count = latents.shape[1]
        mask = torch.triu(latents.new_full((count, count), float("-inf")), diagonal=1)
        asked = self.again(latents) + self.places[PAST - 1 : PAST - 1 + count]
        return self.out(self.transformer.decoder(asked, memory, tgt_mask=mask))


def _sinusoids(count: int, size: int) -> Tensor:
    place = torch.arange(count)[:, None]
    rate = torch.exp(torch.arange(0, size, 2) * (-9.21034 / size))
    return torch.stack([torch.sin(place * rate), torch.cos(place * rate)], dim=-1).flatten(1)


class DragPoserModule(nn.Module):
    """Autoencoder, predictor and the normalisers.

    Args:
        spec: network sizes.
    """

    mean: Tensor
    std: Tensor
    step_std: Tensor
    token_mean: Tensor
    token_std: Tensor

    def __init__(self, spec: DragPoserSpec) -> None:
        super().__init__()
        self.spec = spec
        self.vae = PoseAutoencoder()
        kind = AutoregressivePredictor if spec.published else LatentPredictor
        self.predictor = kind(spec) if spec.predictor else None
        for buffer, value in (
            ("mean", torch.zeros(NUM_JOINTS, ENCODED)),
            ("std", torch.zeros(NUM_JOINTS, ENCODED)),
            ("step_std", torch.ones(())),
            ("token_mean", torch.zeros(TOKEN)),
            ("token_std", torch.zeros(TOKEN)),
        ):
            self.register_buffer(buffer, value)

    def encode(self, pose: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log-variance ``(B, 24)`` of poses ``(B, 22, 8)`` as ``pose_of`` gives them."""
        return self.vae.encode(((pose - self.mean) / self.std).flatten(1))

    def decode(self, latent: Tensor) -> Decoded:
        """Poses of latents ``(B, 24)``."""
        out = self.vae.decode(latent)
        # Relative to the mean pose, so that an untrained decoder already gives a standing pose.
        rotation = diff.unit_quat(out[..., :NUM_JOINTS, :] + self.mean[:, :4])
        return Decoded(rotation, out[..., NUM_JOINTS, :3] * self.step_std)


def pose_of(world: Tensor, position: Tensor, before: Tensor, root_before: Tensor) -> Tensor:
    """Input of the autoencoder: dual quaternions ``(B, 22, 8)`` relative to the root.

    The root's slot holds its rotation since the previous frame, its displacement in its previous
    frame, and a zero. Quaternions have ``w >= 0``.

    Args:
        world: ``(B, 22, 4)`` orientations.
        position: ``(B, 22, 3)``.
        before: ``(B, 4)`` the root's orientation in the previous frame.
        root_before: ``(B, 3)`` the root's position in the previous frame.
    """
    inverse = diff.quat_conjugate(world[:, :1])
    rotation = diff.quat_multiply(*torch.broadcast_tensors(inverse, world))
    place = diff.quat_rotate(inverse, position - position[:, :1])
    back = diff.quat_conjugate(before)
    turn = diff.quat_multiply(back, world[:, 0])
    moved = diff.quat_rotate(back, position[:, 0] - root_before)
    sign = torch.where(rotation[..., :1] < 0, -1.0, 1.0)
    dual = diff.dual_quat(rotation * sign, place)
    turn = turn * torch.where(turn[:, :1] < 0, -1.0, 1.0)
    root = torch.cat([turn, moved, torch.zeros_like(turn[:, :1])], dim=-1)
    return torch.cat([root[:, None], dual[:, 1:]], dim=1)


def joints_from_root(rotation: Tensor, offsets: Tensor) -> Tensor:
    """Joints ``(..., 22, 3)`` in root space, from rotations ``(..., 22, 4)`` in root space."""
    matrix = diff.quat_to_matrix(rotation)
    unturned = torch.eye(3).to(matrix).expand(*matrix.shape[:-3], 1, 3, 3)
    return diff.positions_from_root(torch.cat([unturned, matrix[..., 1:, :, :]], -3), offsets)
