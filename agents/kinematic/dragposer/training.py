"""Training of DragPoser: first the pose autoencoder, then the predictor on its latents."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor, nn

from agents.kinematic.data import MotionBank, Windows
from agents.kinematic.dragposer.networks import (
    ENCODED,
    FUTURE,
    HEIGHT_JOINTS,
    LATENT,
    PAST,
    TOKEN_EVERY,
    AutoregressivePredictor,
    DragPoserModule,
    LatentPredictor,
    joints_from_root,
    pose_of,
)
from agents.kinematic.learning import Learning, Task
from questsim import differentiable as diff
from questsim.skeleton import JOINTS, NUM_JOINTS

FK_WEIGHT, KLD_WEIGHT = 100.0, 0.001
"""Weight of the forward kinematics loss; quaternions have weight 1 (the paper)."""
CONTINUITY = "continuity"
WEIGHTS = {CONTINUITY: 1.0}
"""Weight of the continuity loss (the paper); 0 disables it."""
LATENT_STEP, PUBLISHED_STEP = 0.1, 1.0
"""Step size of the single gradient step in the continuity loss; as published, the gradient is
subtracted as it is."""
NOISE_CHANCE, NOISE_STD = 0.1, 0.3
"""Disturbance of the predictor's inputs: share of windows, and noise in standard deviations."""
LIMBS: tuple[tuple[int, ...], ...] = tuple(
    tuple(i for i, name in enumerate(JOINTS) if name in names.split())
    for names in (
        f"{side}_{a} {side}_{b} {side}_{c} {side}_{d}"
        for side in ("left", "right")
        for a, b, c, d in (
            ("hip", "knee", "ankle", "toe"),
            ("clavicle", "shoulder", "elbow", "wrist"),
        )
    )
)
"""Joints of the four limbs. In the published training each limb is replaced by noise in the past
tokens of a window with probability ``NOISE_CHANCE``, in all but the last token."""
NORMALISED_BY = 512

_Batch = tuple[Windows, Tensor]


def poses(windows: Windows, frame: int) -> Tensor:
    """``pose_of`` for one frame of windows and the frame before it: ``(B, 22, 8)``."""
    turned = diff.matrix_to_quat(windows.world[:, frame - 1 : frame + 1])
    return pose_of(
        turned[:, 1], windows.position[:, frame], turned[:, 0, 0], windows.position[:, frame - 1, 0]
    )


def make_task(
    module: nn.Module, stage: str, learning: Learning, bank: MotionBank, validation: int
) -> Task:
    """Create the task of stage ``vae`` or ``predictor``."""
    assert isinstance(module, DragPoserModule)
    if not module.std.any():
        known = poses(bank.fixed(NORMALISED_BY), 1)
        module.mean.copy_(known.mean(dim=0))
        module.std.copy_(known.std(dim=0).clamp_min(1e-3))
        module.step_std.copy_(known[:, 0, 4:7].std().clamp_min(1e-4))
    if stage == "predictor" and not module.token_std.any():
        with torch.no_grad():
            tokens = tokens_of(module, bank.fixed(64)).flatten(0, 1)
        module.token_mean.copy_(tokens.mean(dim=0))
        module.token_std.copy_(tokens.std(dim=0).clamp_min(1e-3))
    if stage == "vae":
        trained, loss = module.vae, _vae_loss(module, (WEIGHTS | learning.weights)[CONTINUITY])
    else:
        assert module.predictor is not None
        trained, loss = module.predictor, _predictor_loss(module, module.predictor)
    normal = _limb_noise if stage == "predictor" and module.spec.published else _normal
    fixed = (bank.validation.fixed(validation), normal(np.random.default_rng(7), stage, validation))

    def draw(rng: np.random.Generator) -> _Batch:
        return bank.draw(learning.batch, rng), normal(rng, stage, learning.batch)

    def validate() -> dict[str, float]:
        return loss(fixed)[1]

    return Task(list(trained.parameters()), draw, loss, validate)


def _normal(rng: np.random.Generator, stage: str, count: int) -> Tensor:
    """Noise of one batch: the autoencoder's samples, or the disturbance of tokens."""
    if stage == "vae":
        return torch.as_tensor(rng.standard_normal((count, LATENT)), dtype=torch.float32)
    noise = NOISE_STD * rng.standard_normal((count, PAST, LATENT))
    noise *= (rng.random(count) < NOISE_CHANCE)[:, None, None]
    return torch.as_tensor(noise, dtype=torch.float32)


def _limb_noise(rng: np.random.Generator, stage: str, count: int) -> Tensor:
    """Noise ``(B, PAST, 22, 8)`` of joints in past tokens; NaN where the pose is left as it is."""
    noise = np.full((count, PAST, NUM_JOINTS, ENCODED), np.nan, np.float32)
    for limb in LIMBS:
        hit = rng.random(count) < NOISE_CHANCE
        drawn = rng.standard_normal((int(hit.sum()), PAST - 1, len(limb), ENCODED))
        for joint, values in zip(limb, drawn.swapaxes(0, 2), strict=True):
            noise[hit, : PAST - 1, joint] = values.swapaxes(0, 1)
    return torch.from_numpy(noise)


def _apart(module: DragPoserModule, latent: Tensor, target: Tensor, offsets: Tensor) -> Tensor:
    """Reconstruction loss ``(B,)``: 1 quaternion MSE + 100 FK MSE, which includes displacement."""
    got = module.decode(latent)
    want = target[..., :4]
    sign = torch.sign((got.rotation * want).sum(-1, keepdim=True).detach())
    quaternion = (got.rotation * sign - want).square().mean((1, 2))
    joints = joints_from_root(got.rotation, offsets) - joints_from_root(want, offsets)
    moved = (got.displacement - target[:, 0, 4:7]) / module.step_std
    return quaternion + FK_WEIGHT * joints.square().mean((1, 2)) + 0.01 * moved.square().mean(-1)


_Loss = Callable[[_Batch], tuple[Tensor, dict[str, float]]]


def _vae_loss(module: DragPoserModule, continuity_weight: float) -> _Loss:
    def loss(batch: _Batch) -> tuple[Tensor, dict[str, float]]:
        windows, noise = batch
        target, offsets = poses(windows, 1), windows.offsets
        mean, log_variance = module.encode(target)
        latent = mean + noise * torch.exp(0.5 * log_variance)
        rebuilt = _apart(module, latent, target, offsets).mean()
        kld = -0.5 * (1 + log_variance - mean.square() - log_variance.exp()).mean()
        total = rebuilt + KLD_WEIGHT * kld
        figures = {"rebuilt": float(rebuilt.detach()), "kld": float(kld.detach())}
        if windows.frames > 2 and continuity_weight:
            # One gradient step from this pose's latent must decode to the next pose.
            following = poses(windows, 2)
            with torch.enable_grad():
                start = mean if mean.requires_grad else mean.detach().requires_grad_()
                there = _apart(module, start, following, offsets).sum()
                slope = torch.autograd.grad(there, start, create_graph=True)[0]
            step = PUBLISHED_STEP if module.spec.published else LATENT_STEP
            moved = start - step * slope
            continuity = _apart(module, moved, following, offsets).mean()
            total = total + continuity_weight * continuity
            figures[CONTINUITY] = float(continuity.detach())
        with torch.no_grad():
            got = joints_from_root(module.decode(mean).rotation, offsets)
            want = joints_from_root(target[..., :4], offsets)
            figures["error_cm"] = float(100.0 * (got - want).norm(dim=-1).mean())
        return total, figures

    return loss


def tokens_of(module: DragPoserModule, windows: Windows, noise: Tensor | None = None) -> Tensor:
    """Tokens ``(B, P, 33)`` of every fourth frame: latent, displacement since the last, heights.

    Args:
        module: encodes the poses.
        windows: the motion.
        noise: see ``_limb_noise``, in standard deviations of each channel.
    """
    frames = range(TOKEN_EVERY, windows.frames, TOKEN_EVERY)
    turned = diff.matrix_to_quat(windows.world[:, :, 0])
    states = []
    for i, frame in enumerate(frames):
        pose = poses(windows, frame)
        if noise is not None and i < noise.shape[1]:
            drawn = module.mean + module.std * noise[:, i]
            pose = torch.where(torch.isnan(drawn), pose, drawn)
        latent, _ = module.encode(pose)
        root = windows.position[:, :, 0]
        moved = root[:, frame] - root[:, frame - TOKEN_EVERY]
        moved = diff.quat_rotate(diff.quat_conjugate(turned[:, frame - TOKEN_EVERY]), moved)
        heights = windows.position[:, frame, list(HEIGHT_JOINTS), 2]
        states.append(torch.cat([latent, moved, heights], dim=-1))
    return torch.stack(states, dim=1)


def _predictor_loss(
    module: DragPoserModule, predictor: LatentPredictor | AutoregressivePredictor
) -> _Loss:
    def loss(batch: _Batch) -> tuple[Tensor, dict[str, float]]:
        windows, noise = batch
        with torch.no_grad():
            tokens = tokens_of(module, windows, noise if module.spec.published else None)
            tokens = (tokens - module.token_mean) / module.token_std
        past, coming = tokens[:, :PAST].clone(), tokens[:, PAST : PAST + FUTURE, :LATENT]
        if isinstance(predictor, AutoregressivePredictor):
            got = predictor.taught(past, coming)
        else:
            past[..., :LATENT] += noise[:, : past.shape[1]]
            got = predictor(past, coming.shape[1])
        squared = (got - coming).square()
        total = squared.mean()
        first = squared[:, 0].mean()
        with torch.no_grad():
            scale, mean = module.token_std[:LATENT], module.token_mean[:LATENT]
            offsets = windows.offsets
            a = joints_from_root(module.decode(got[:, 0] * scale + mean).rotation, offsets)
            b = joints_from_root(module.decode(coming[:, 0] * scale + mean).rotation, offsets)
        return total, {
            "latent": float(total.detach()),
            "next_latent": float(first.detach()),
            "error_cm": float(100.0 * (a - b).norm(dim=-1).mean()),
        }

    return loss
