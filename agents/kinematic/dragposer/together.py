"""DragPoser on many sequences at once: every frame of all of them is solved together.

The result is that of one stream after the other, to rounding. Call overhead dominates in networks
and systems of equations this small, so many streams take little longer than one. Only sequences
without gaps in which a tracker always reports can be solved together.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from agents.kinematic.dragposer.model import UNKNOWNS, DragModel, left_matrix
from agents.kinematic.dragposer.networks import HEIGHT_JOINTS, LATENT, PAST, TOKEN_EVERY
from agents.kinematic.dragposer.residuals import ROOT_WEIGHTS
from agents.kinematic.dragposer.solver import (
    ANKLES,
    BETTER,
    FIRST_ITERATIONS,
    FLOOR_WEIGHT,
    HEAD,
    HIP,
    HIP_WEIGHTS,
    LOST_FRAMES,
    LOST_M,
    NEWTON_SHARE,
    OTHER_WEIGHTS,
    PASSED_ON,
    PATIENCE,
    PREDICTION_WEIGHTS,
    UNDER_HEAD_WEIGHT,
    DragPoser,
)
from agents.kinematic.interface import DeviceSignals, Poses, UserBody
from questsim import rotations as rot
from questsim.joint_sensors import SensorSequence
from questsim.skeleton import JOINT_PARENTS

_EYE = np.eye(UNKNOWNS)
_PARENTS = list(JOINT_PARENTS)


@dataclass
class Goals:
    """The targets of one frame of ``B`` streams; see ``residuals.Goal``.

    Attributes:
        joints: ``(D,)`` joints that carry trackers.
        position, quat: ``(B, D, 3)``, ``(B, D, 4)``.
        scales: ``(B, D, 2)`` square roots of the weights; 0 for a tracker that does not report.
        shown: ``(B, D)`` whether a tracker reports.
        predicted: ``(B, 24)``.
        hold: ``(B, 30)`` square roots of the weights of the prior.
        root, turn: ``(B, 3)``, ``(B, 4)`` of the previous frame.
        offsets: ``(B, 22, 3)``.
        ankle_rise: ``(B,)``.
    """

    joints: list[int]
    position: np.ndarray
    quat: np.ndarray
    scales: np.ndarray
    shown: np.ndarray
    predicted: np.ndarray
    hold: np.ndarray
    root: np.ndarray
    turn: np.ndarray
    offsets: np.ndarray
    ankle_rise: np.ndarray

    def of(self, rows: np.ndarray) -> Goals:
        """The targets of some of the streams."""
        return Goals(
            self.joints,
            *(value[rows] for name, value in vars(self).items() if name != "joints"),
        )

    def reports(self, joint: int) -> np.ndarray:
        """``(B,)`` whether the tracker of a joint reports."""
        if joint not in self.joints:
            return np.zeros(len(self.position), bool)
        return self.shown[:, self.joints.index(joint)]

    def distance(self, position: np.ndarray) -> np.ndarray:
        """Mean distances ``(B,)`` in metres between joints and their trackers."""
        off = np.linalg.norm(position[:, self.joints] - self.position, axis=-1)
        return (off * self.shown).sum(axis=1) / self.shown.sum(axis=1)


def residuals(
    model: DragModel, unknowns: np.ndarray, goals: Goals, slopes: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals ``(B, R)`` and their derivatives ``(B, R, 30)``; see ``DragPoser._residuals``."""
    skeleton = model.posed_skeletons(unknowns, goals.turn, goals.root, goals.offsets, slopes)
    count, columns = len(unknowns), skeleton.columns
    prior = np.zeros((count, UNKNOWNS))
    prior[:, :LATENT] = goals.predicted
    at = goals.joints
    back = left_matrix(rot.quat_conjugate(goals.quat))
    turned = (back @ skeleton.quat[:, at][..., None])[..., 0]
    twice = np.where(turned[..., :1] < 0, -2.0, 2.0)
    place, spin = goals.scales[..., :1], twice * goals.scales[..., 1:]
    parts = [
        ((unknowns - prior) * goals.hold, goals.hold[..., None] * _EYE[:, :columns]),
        (
            (skeleton.position[:, at] - goals.position) * place,
            skeleton.d_position[:, at] * place[..., None],
        ),
        (turned[..., 1:] * spin, (back @ skeleton.d_quat[:, at])[:, :, 1:] * spin[..., None]),
    ]
    free = ~goals.reports(HIP)
    if free.any():
        rows = np.arange(count)
        foot = np.array(ANKLES)[skeleton.position[:, ANKLES, 2].argmin(axis=1)]
        low = free * np.sqrt(FLOOR_WEIGHT)
        parts.append(
            (
                ((skeleton.position[rows, foot, 2] - goals.ankle_rise) * low)[:, None],
                (skeleton.d_position[rows, foot, 2] * low[:, None])[:, None],
            )
        )
        under = (free & goals.reports(HEAD)) * np.sqrt(UNDER_HEAD_WEIGHT)
        if under.any():
            head = goals.position[:, at.index(HEAD), :2]
            parts.append(
                (
                    (skeleton.position[:, HIP, :2] - head) * under[:, None],
                    skeleton.d_position[:, HIP, :2] * under[:, None, None],
                )
            )
    values = [value.reshape(count, -1) for value, _ in parts]
    if not slopes:
        return np.concatenate(values, axis=1), np.zeros((count, 0, 0))
    found = [slope.reshape(count, -1, columns) for _, slope in parts]
    return np.concatenate(values, axis=1), np.concatenate(found, axis=1)


def newton(model: DragModel, unknowns: np.ndarray, goals: Goals, iterations: int) -> np.ndarray:
    """``DragPoser._newton`` for ``(B, 30)`` unknowns; a stream that is done is left out."""
    unknowns = unknowns.copy()
    damping = np.full(len(unknowns), 1e-4)
    left = np.arange(len(unknowns))
    for _ in range(iterations):
        if not len(left):
            break
        residual, jacobian = residuals(model, unknowns[left], goals.of(left), True)
        loss = (residual * residual).sum(axis=1)
        back = jacobian.swapaxes(1, 2)
        square, slope = back @ jacobian, back @ residual[..., None]
        tried, gain = unknowns[left], np.full(len(left), -1.0)
        trying = np.arange(len(left))
        for _ in range(4):
            damped = square[trying] + damping[left[trying], None, None] * _EYE
            step = np.linalg.solve(damped, slope[trying])[..., 0]
            tried[trying] = unknowns[left[trying]] - step
            new, _ = residuals(model, tried[trying], goals.of(left[trying]), False)
            gain[trying] = loss[trying] - (new * new).sum(axis=1)
            trying = trying[gain[trying] <= 0.0]
            if not len(trying):
                break
            damping[left[trying]] *= 10.0
        better = gain > 0.0
        unknowns[left[better]] = tried[better]
        damping[left] = np.maximum(damping[left] / 5.0, 1e-8)
        left = left[better & (gain >= 1e-4 * (loss - gain))]
    return unknowns


def can(system: DragPoser, sequences: Sequence[SensorSequence]) -> bool:
    """Whether the sequences can be solved together by this system."""
    plain = system.solver == "newton" and not system.constraints
    names = {sequence.names for sequence in sequences}
    return plain and len(names) == 1 and all(s.present.any(axis=1).all() for s in sequences)


class Together:
    """The streams of several sequences of one ``DragPoser`` in the same frame.

    Args:
        system: the system, with the default solver and without constraints.
        signals: all frames of each sequence; all have the same devices.
        bodies: the users.
        joints: that carry the devices.
        ankle_rise: height of each user's ankle over the floor.
    """

    def __init__(
        self,
        system: DragPoser,
        signals: Sequence[DeviceSignals],
        bodies: Sequence[UserBody],
        joints: list[int],
        ankle_rise: Sequence[float],
    ) -> None:
        self.system, self.model, self.joints = system, system.model, joints
        self.signals = signals
        self.offsets = np.stack([body.offsets for body in bodies])
        self.ankle_rise = np.array(ankle_rise)
        count = len(signals)
        self.latent = np.zeros((count, LATENT))
        self.root, self.turn = np.zeros((count, 3)), np.zeros((count, 4))
        self.turn[:, 0] = 1.0
        self.lost_for, self.since = np.zeros(count, int), np.zeros(count, int)
        self.tokens: list[deque[Tensor]] = [deque(maxlen=PAST) for _ in signals]
        self.coming: list[tuple[np.ndarray, np.ndarray] | None] = [None] * count
        self.token_root, self.token_turn = self.root.copy(), self.turn.copy()

    def run(self) -> list[Poses]:
        """The poses of all sequences."""
        lengths = np.array([len(signals.position) for signals in self.signals])
        found: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in self.signals]
        for frame in range(int(lengths.max())):
            rows = np.flatnonzero(lengths > frame)
            root, local = self._frame(rows, frame)
            for row, place, turns in zip(rows, root, local, strict=True):
                found[row].append((place, turns))
        return [
            Poses(
                np.stack([place for place, _ in each]),
                np.stack([turns for _, turns in each]),
                np.broadcast_to(offsets, (len(each), *offsets.shape)),
            )
            for each, offsets in zip(found, self.offsets, strict=True)
        ]

    def _frame(self, rows: np.ndarray, frame: int) -> tuple[np.ndarray, np.ndarray]:
        goals, iterations = self._goals(rows, frame), self.system.iterations
        unknowns = np.zeros((len(rows), UNKNOWNS))
        if frame == 0:
            self._start(goals)
            iterations = max(iterations, FIRST_ITERATIONS)
        else:
            unknowns[:, :LATENT] = self.latent[rows]
        unknowns = newton(self.model, unknowns, goals, iterations)
        unknowns = self._found_again(unknowns, goals, rows)
        skeleton = self.model.posed_skeletons(unknowns, goals.turn, goals.root, goals.offsets)
        self.latent[rows] = unknowns[:, :LATENT]
        self.root[rows], self.turn[rows] = skeleton.position[:, 0], skeleton.quat[:, 0]
        self._note_tokens(rows, skeleton.position)
        quat = skeleton.quat
        above = rot.quat_conjugate(quat[:, _PARENTS])
        local = rot.quat_multiply(above, quat)
        local[:, 0] = quat[:, 0]
        for at, joint in enumerate(self.joints):
            if joint in PASSED_ON:
                taken = goals.scales[:, at, 1] > 0
                measured = rot.quat_multiply(above[taken, joint], goals.quat[taken, at])
                local[taken, joint] = measured
        return skeleton.position[:, 0], local

    def _goals(self, rows: np.ndarray, frame: int) -> Goals:
        streams = [self.signals[row] for row in rows]
        shown = np.stack([each.present[frame] for each in streams])
        weights = np.array([HIP_WEIGHTS if j == HIP else OTHER_WEIGHTS for j in self.joints])
        if not self.system.rotations:
            weights[:, 1] = 0.0
        count = shown.sum(axis=1)
        scales = np.sqrt(weights * shown[..., None] / (3.0 * count[:, None, None]))
        lambdas = [NEWTON_SHARE * PREDICTION_WEIGHTS[min(max(int(n), 3), 6)] for n in count]
        held = [
            np.repeat(np.sqrt([w / LATENT, *(r / 3.0 for r in ROOT_WEIGHTS)]), [LATENT, 3, 3])
            for w in lambdas
        ]
        return Goals(
            self.joints,
            np.stack([each.position[frame] for each in streams]),
            np.stack([each.quat[frame] for each in streams]),
            scales,
            shown,
            np.stack([self._expected(row) for row in rows]),
            np.stack(held),
            self.root[rows],
            self.turn[rows],
            self.offsets[rows],
            self.ankle_rise[rows],
        )

    def _start(self, goals: Goals) -> None:
        """See ``DragPoser._start``; changes ``root`` and ``turn`` of the goals."""
        count = len(goals.position)
        rows, anchor = np.arange(count), goals.shown.argmax(axis=1)
        for joint in (HEAD, HIP):
            anchor[goals.reports(joint)] = goals.joints.index(joint) if joint in goals.joints else 0
        quat = goals.quat[rows, anchor]
        joint = np.array(goals.joints)[anchor]
        upright = rot.yaw_quat(rot.heading(quat))
        goals.turn = np.where((joint == HIP)[:, None], quat, upright)
        goals.root = np.zeros((count, 3))
        none = np.zeros((count, UNKNOWNS))
        there = self.model.posed_skeletons(none, goals.turn, goals.root, goals.offsets).position
        goals.root = goals.position[rows, anchor] - there[rows, joint]

    def _found_again(self, unknowns: np.ndarray, goals: Goals, rows: np.ndarray) -> np.ndarray:
        skeleton = self.model.posed_skeletons(unknowns, goals.turn, goals.root, goals.offsets)
        off = goals.distance(skeleton.position)
        self.lost_for[rows] = np.where(off > LOST_M, self.lost_for[rows] + 1, 0)
        lost = self.lost_for[rows] >= LOST_FRAMES
        self.lost_for[rows[lost]] = -PATIENCE
        lost &= goals.reports(HIP) | goals.reports(HEAD)
        which = np.flatnonzero(lost)
        if not len(which):
            return unknowns
        fresh = goals.of(which)
        fresh.predicted = np.zeros_like(fresh.predicted)
        self._start(fresh)
        again = newton(self.model, np.zeros((len(which), UNKNOWNS)), fresh, FIRST_ITERATIONS)
        there = self.model.posed_skeletons(again, fresh.turn, fresh.root, fresh.offsets).position
        for i, at in enumerate(which):
            if fresh.distance(there)[i] < BETTER * off[at]:
                row = rows[at]
                self.tokens[row].clear()
                self.coming[row], self.since[row] = None, 0
                goals.root[at], goals.turn[at] = fresh.root[i], fresh.turn[i]
                unknowns[at] = again[i]
        return unknowns

    # -- prediction ------------------------------------------------------------------------

    def _expected(self, row: int) -> np.ndarray:
        coming = self.coming[row]
        if coming is None:
            return self.latent[row]
        share = min(self.since[row] + 1, TOKEN_EVERY) / TOKEN_EVERY
        return coming[0] * (1 - share) + coming[1] * share

    def _note_tokens(self, rows: np.ndarray, position: np.ndarray) -> None:
        """See ``DragPoser._note_token``."""
        self.since[rows] += 1
        if not self.system.use_predictor:
            return
        module = self.system.module
        mean, std = module.token_mean, module.token_std
        due: dict[int, list[int]] = {}
        for row, joints in zip(rows, position, strict=True):
            tokens = self.tokens[row]
            if tokens and self.since[row] < TOKEN_EVERY:
                continue
            moved = self.root[row] - self.token_root[row]
            moved = rot.quat_rotate(rot.quat_conjugate(self.token_turn[row]), moved)
            moved = moved if tokens else np.zeros_like(moved)
            heights = joints[list(HEIGHT_JOINTS), 2]
            token = torch.from_numpy(np.concatenate([self.latent[row], moved, heights]))
            tokens.append((token - mean) / std)
            self.token_root[row], self.token_turn[row] = self.root[row], self.turn[row]
            self.since[row] = 0
            due.setdefault(len(tokens), []).append(int(row))
        for asking in due.values():
            assert module.predictor is not None
            past = torch.stack([torch.stack(list(self.tokens[row])) for row in asking])
            answers = module.predictor(past, 1)[:, 0] * std[:LATENT] + mean[:LATENT]
            for row, answer in zip(asking, answers, strict=True):
                self.coming[row] = (self.latent[row].copy(), answer.numpy())


class ManyDragPoser(DragPoser):
    """``DragPoser`` whose ``predict_many`` solves all sequences together."""

    at_once = 48

    @torch.no_grad()
    def predict_many(
        self, sequences: Sequence[SensorSequence], bodies: Sequence[UserBody]
    ) -> list[Poses]:
        """Like ``KinematicSystem.predict_many``; all sequences at once if ``can`` is true."""
        if not can(self, sequences):
            return super().predict_many(sequences, bodies)
        signals, rises = [], []
        for sequence, body in zip(sequences, bodies, strict=True):
            stream = self._all_signals(sequence, body)
            if stream is None:
                return super().predict_many(sequences, bodies)
            signals.append(stream)
            rises.append(self._ankle_rise)
        joints = [each.joint for each in self._mounts]
        found = Together(self, signals, bodies, joints, rises).run()
        if all(poses.finite() for poses in found):
            return found
        return super().predict_many(sequences, bodies)
