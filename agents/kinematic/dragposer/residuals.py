"""What a pose should meet in one frame, and how far it is from that: DragPoser's residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from agents.kinematic.dragposer.constraints import Constraint
from agents.kinematic.dragposer.model import UNKNOWNS, PosedSkeleton, left_matrix
from agents.kinematic.dragposer.networks import LATENT
from questsim import rotations as rot

GOOD_POSITION, GOOD_ROTATION = 1e-4, 0.01
"""Losses at which Adam stops (the paper)."""
ROOT_WEIGHTS = (0.5, 0.05)
"""Weights that keep the root's translation (m) and rotation (rad) near the decoded ones."""


@dataclass
class Goal:
    """The targets of one frame.

    Attributes:
        joints: indices of the joints whose trackers report.
        position, quat: ``(D, 3)`` and ``(D, 4)`` of these joints in the world.
        weights: ``(D, 2)`` of position and rotation.
        predicted: ``(24,)`` the predicted latent.
        prediction_weight: lambda_T.
        root, turn: ``(3,)``, ``(4,)`` the root's position and orientation in the previous frame.
    """

    joints: list[int]
    position: np.ndarray
    quat: np.ndarray
    weights: np.ndarray
    predicted: np.ndarray
    prediction_weight: float
    root: np.ndarray
    turn: np.ndarray


Part = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Residuals, their derivatives (one more axis), and the square roots of their weights."""


def prior_mean(goal: Goal) -> np.ndarray:
    """Prior means ``(30,)`` of the unknowns: the predicted latent, the root as decoded."""
    return np.concatenate([goal.predicted, np.zeros(UNKNOWNS - LATENT)])


def prior_scale(goal: Goal) -> np.ndarray:
    """Square roots ``(30,)`` of the weights of this prior."""
    weights = [goal.prediction_weight / LATENT, *(weight / 3.0 for weight in ROOT_WEIGHTS)]
    return np.repeat(np.sqrt(weights), [LATENT, 3, 3])


def off_trackers(skeleton: PosedSkeleton, goal: Goal) -> list[Part]:
    """Tracker errors: metres, and twice the vector parts of the rotation errors."""
    scales = np.sqrt(goal.weights / (3.0 * len(goal.joints)))
    back = left_matrix(rot.quat_conjugate(goal.quat))
    turned = (back @ skeleton.quat[goal.joints][..., None])[..., 0]
    twice = np.where(turned[:, :1] < 0, -2.0, 2.0)
    return [
        (
            skeleton.position[goal.joints] - goal.position,
            skeleton.d_position[goal.joints],
            scales[:, :1],
        ),
        (turned[:, 1:], (back @ skeleton.d_quat[goal.joints])[:, 1:], twice * scales[:, 1:]),
    ]


def constraint_residual(constraint: Constraint, skeleton: PosedSkeleton) -> Part:
    """The square root of a user's loss; its derivative is set to zero where it is undefined."""
    position = torch.from_numpy(skeleton.position)[None].requires_grad_()
    quat = torch.from_numpy(skeleton.quat)[None].requires_grad_()
    with torch.enable_grad():
        root = (constraint(position, quat)[0] + 1e-12).sqrt()
    slope = np.zeros((1, skeleton.columns))
    if skeleton.columns and root.requires_grad:
        found = torch.autograd.grad(root, [position, quat], allow_unused=True)
        for each, change in zip(found, (skeleton.d_position, skeleton.d_quat), strict=True):
            if each is not None:
                each = np.nan_to_num(each[0].numpy(), posinf=0.0, neginf=0.0)
                slope += np.tensordot(each, change, axes=2)
    return np.array([float(root.detach())]), slope, np.ones(1)


def is_near(skeleton: PosedSkeleton, goal: Goal) -> bool:
    """Whether the losses are those at which Adam stops."""
    apart = ((skeleton.position[goal.joints] - goal.position) ** 2).mean()
    dot = np.abs((skeleton.quat[goal.joints] * goal.quat).sum(-1))
    return bool(apart <= GOOD_POSITION) and bool((1.0 - dot).mean() <= GOOD_ROTATION)


def mean_distance(skeleton: PosedSkeleton, goal: Goal) -> float:
    """Mean distance in metres between joints and their trackers."""
    return float(np.linalg.norm(skeleton.position[goal.joints] - goal.position, axis=-1).mean())
