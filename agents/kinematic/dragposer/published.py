"""DragPoser as published, beside the improved solver of ``solver``.

In each frame Adam changes the latent alone. The root follows from the decoded displacement and
rotation, and is moved onto the hip's tracker if there is one. lambda_T has its full weight. The
predictor runs once every W_f frames and decodes the next W_f / 4 latents one after the other. A
pose that has lost its trackers is not restarted. No measured orientation replaces an estimated one.

Sources: Ponton et al., "DragPoser", 2024, and its released code for the averaging of weights, the
stopping rule and the root. One difference: the paper starts from the true first pose, which no
stream contains, so the first frame is solved to convergence by ``solver``.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
import torch

from agents.kinematic.dragposer.model import UNKNOWNS, PosedSkeleton
from agents.kinematic.dragposer.networks import (
    FUTURE,
    HEIGHT_JOINTS,
    LATENT,
    PAST,
    TOKEN_EVERY,
    DragPoserModule,
)
from agents.kinematic.dragposer.residuals import GOOD_POSITION, GOOD_ROTATION, Goal, off_trackers
from agents.kinematic.dragposer.solver import ADAM_RATE, HIP, DragPoser
from agents.kinematic.interface import DeviceSignals, UserBody
from questsim import rotations as rot
from questsim.errors import InputError

MATRIX_SHARE = 2.0 / 3.0
"""The mean squared difference of two rotation matrices, 8/9 sin^2(a/2), over the solver's mean
squared rotation vector, 4/3 sin^2(a/2)."""
FUTURE_FRAMES = {6: 1, 5: 1, 4: 16, 3: 16}
"""W_f by number of trackers (the paper; for 5 as for 6)."""

_Frame = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Latent, root position, root orientation, heights of ``HEIGHT_JOINTS``."""


class PublishedDragPoser(DragPoser):
    """DragPoser as published; see the module's docstring and ``DragPoser``.

    Args:
        module, name, options: see ``DragPoser``.
        predicted_frames: W_f, frames from one run of the predictor to the next, at most 64; by
            default ``FUTURE_FRAMES`` (the paper also has 60).
    """

    passes_on = False

    def __init__(
        self,
        module: DragPoserModule,
        name: str = "DragPoser",
        predicted_frames: int | None = None,
        **options: Any,
    ) -> None:
        super().__init__(module, name, **options)
        most = FUTURE * TOKEN_EVERY
        if predicted_frames is not None and not 1 <= predicted_frames <= most:
            what = f"predicted_frames is {predicted_frames}, not from 1 to {most}"
            raise InputError(what, name)
        self._predicted_frames = predicted_frames

    def _begin(self, body: UserBody) -> None:
        super()._begin(body)
        self._past: deque[_Frame] = deque(maxlen=PAST * TOKEN_EVERY + 1)
        self._ahead: list[np.ndarray] = []

    def _goal(self, signals: DeviceSignals) -> Goal:
        goal = super()._goal(signals)
        goal.weights = goal.weights * np.array([1.0, MATRIX_SHARE])
        return goal

    def _solve(self, unknowns: np.ndarray, goal: Goal, iterations: int) -> np.ndarray:
        if self._latent is None:
            return self._newton(unknowns, goal, iterations)
        latent = torch.from_numpy(unknowns[:LATENT].copy())
        optimiser = torch.optim.Adam([latent], lr=ADAM_RATE)
        for _ in range(iterations):
            whole = np.concatenate([latent.numpy(), np.zeros(UNKNOWNS - LATENT)])
            if goal.joints and _near(self._skeleton(whole, goal), goal):
                break
            residual, jacobian = self._residuals(whole, goal, slopes=True)
            latent.grad = torch.from_numpy(2.0 * jacobian[:, :LATENT].T @ residual)
            optimiser.step()
        whole = np.concatenate([latent.numpy(), np.zeros(UNKNOWNS - LATENT)])
        if HIP in goal.joints:
            off = goal.position[goal.joints.index(HIP)] - self._skeleton(whole, goal).position[HIP]
            whole[LATENT : LATENT + 3] = off
        return whole

    def _found_again(self, unknowns: np.ndarray, goal: Goal) -> np.ndarray:
        return unknowns

    # -- prediction ------------------------------------------------------------------------

    def _expected(self, latent: np.ndarray) -> np.ndarray:
        if not self.use_predictor or not self._past:
            return latent
        if not self._ahead:
            usual = FUTURE_FRAMES[min(max(len(self._reporting), 3), 6)]
            frames = self._predicted_frames or usual
            tokens = self._predicted(-(-frames // TOKEN_EVERY))
            # Each frame's target is the next predicted token.
            self._ahead = [tokens[j // TOKEN_EVERY] for j in range(frames)]
        return self._ahead.pop(0)

    def _predicted(self, count: int) -> np.ndarray:
        """The next latents ``(count, 24)``, one every ``TOKEN_EVERY`` frames."""
        assert self.module.predictor is not None
        frames = list(self._past)
        frames = [frames[0]] * (PAST * TOKEN_EVERY + 1 - len(frames)) + frames
        tokens = []
        for at in range(TOKEN_EVERY, len(frames), TOKEN_EVERY):
            latent, root, _, heights = frames[at]
            _, root_before, turn_before, _ = frames[at - TOKEN_EVERY]
            moved = rot.quat_rotate(rot.quat_conjugate(turn_before), root - root_before)
            tokens.append(np.concatenate([latent, moved, heights]))
        mean, std = self.module.token_mean, self.module.token_std
        past = (torch.from_numpy(np.stack(tokens)) - mean) / std
        answer = self.module.predictor(past[None], count)[0]
        return (answer * std[:LATENT] + mean[:LATENT]).numpy()

    def _note_token(self, skeleton: PosedSkeleton) -> None:
        assert self._latent is not None
        heights = skeleton.position[list(HEIGHT_JOINTS), 2].copy()
        self._past.append((self._latent.copy(), self._root, self._turn, heights))


def _near(skeleton: PosedSkeleton, goal: Goal) -> bool:
    """Whether both weighted losses are below the published limits."""
    position, rotation = (
        float(((value * weight) ** 2).sum()) for value, _, weight in off_trackers(skeleton, goal)
    )
    return position <= GOOD_POSITION and rotation <= GOOD_ROTATION
