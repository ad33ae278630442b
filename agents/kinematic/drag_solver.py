"""DragPoser on a stream: each frame the latent is dragged until the pose meets the trackers.

The trackers may change from frame to frame. Different from the published system: the root's place
and orientation are unknowns of their own beside the latent, which the decoder only predicts, so
that errors do not add up; the default solver is a damped Gauss-Newton method, which needs fewer
iterations than Adam; and a pose that has lost its trackers is begun anew.
"""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from agents.kinematic.constraints import Constraint
from agents.kinematic.dragposer import (
    HEIGHT_JOINTS,
    LATENT,
    PAST,
    TOKEN_EVERY,
    DragPoserModule,
    joints_from_root,
)
from agents.kinematic.interface import Body, KinematicSystem, Poses, Signals
from questsim import differentiable as diff
from questsim import rotations as rot
from questsim.errors import InputError
from questsim.sensors import DEVICES as WORN
from questsim.skeleton import JOINT_PARENTS, JOINTS

DEVICES: tuple[str, ...] = (
    "pelvis_tracker", "headset", "left_controller", "right_controller",
    "left_toe_tracker", "right_toe_tracker", "left_foot_tracker", "right_foot_tracker",
)  # fmt: skip
HIP, HEAD = JOINTS.index("root"), JOINTS.index("head")
ANKLES = [JOINTS.index("left_ankle"), JOINTS.index("right_ankle")]

HIP_WEIGHTS, OTHER_WEIGHTS = (10.0, 10.0), (5.0, 0.01)
"""Of position and rotation of trackers (the paper)."""
PREDICTION_WEIGHTS = {6: 0.02, 5: 0.02, 4: 0.125, 3: 0.15}
"""lambda_T by number of trackers (the paper; 5 as 6)."""
GOOD_POSITION, GOOD_ROTATION = 1e-4, 0.01
"""Losses at which Adam stops (the paper)."""
ADAM_RATE = 0.01
ROOT_WEIGHTS = (0.5, 0.05)
"""How much the root's own move (m) and turn (rad) shall be what the decoder says."""
FLOOR_WEIGHT, UNDER_HEAD_WEIGHT = 0.5, 0.05
"""Without a hip tracker: the lower ankle near the floor, the hip below the head."""
ANKLE_RISE_M = 0.03
"""An ankle stands this much higher than its toe's drop below it."""
LOST_M, LOST_FRAMES = 0.10, 6
"""Trackers this far off, on the mean, for so many frames: begin anew ..."""
BETTER, PATIENCE = 0.7, 60
"""... where that brings them this much nearer, and at most once in so many frames."""
FIRST_ITERATIONS = 40
UNKNOWNS = LATENT + 6
_NUDGE = 1e-6


@dataclass
class Goal:
    """What one frame asks for, in float64.

    Attributes:
        joints: indices of the joints whose trackers report.
        position, quat: ``(D, 3)`` and ``(D, 4)`` of these in the world.
        weights: ``(D, 2)`` of position and rotation.
        predicted: ``(24,)`` the latent that was expected.
        prediction_weight: lambda_T.
        root, turn: ``(3,)``, ``(4,)`` the root's place and orientation in the frame before.
    """

    joints: list[int]
    position: Tensor
    quat: Tensor
    weights: Tensor
    predicted: Tensor
    prediction_weight: float
    root: Tensor
    turn: Tensor


@dataclass(frozen=True)
class Figure:
    """Poses ``B`` of unknowns: world positions, world orientations, root and its orientation."""

    position: Tensor
    quat: Tensor


class DragPoser(KinematicSystem):
    """DragPoser on a stream.

    Args:
        module: trained.
        name: for messages.
        iterations: of the solver a frame; by default the preset's.
        solver: ``newton`` or ``adam``; by default the preset's.
        predictor: whether a trained predictor tells what to expect; else the last latent does.
        constraints: losses to be met beside the trackers'; see ``constraints``.
        rotations: whether trackers' orientations count.
    """

    devices = DEVICES
    interpolates_dropouts = False

    def __init__(
        self,
        module: DragPoserModule,
        name: str = "dragposer",
        iterations: int | None = None,
        solver: str | None = None,
        predictor: bool = True,
        constraints: Sequence[Constraint] = (),
        rotations: bool = True,
    ) -> None:
        self.name = name
        self.iterations = module.spec.iterations if iterations is None else iterations
        self.solver = solver or module.spec.solver
        if self.iterations < 1 or self.solver not in ("newton", "adam"):
            raise InputError(
                f"{self.iterations} iterations of {self.solver!r}",
                name,
                "newton or adam, 1 or more",
            )
        if predictor and module.predictor is None:
            raise InputError("was trained without a predictor", name, "leave predictor out")
        # Differences of a millionth need float64; the networks are small.
        self.module = copy.deepcopy(module).double().eval()
        for parameter in self.module.parameters():
            parameter.requires_grad_(False)
        self.use_predictor, self.rotations = predictor, rotations
        self.constraints = tuple(constraints)

    def usable(self, sensors: str | Sequence[str]) -> tuple[str, ...]:
        """Three or more trackers, the headset or the pelvis's among them; see the base class."""
        names = super().usable(sensors)
        if len({WORN[name].link for name in names}) < len(names):
            raise InputError("two trackers are on one foot", "sensors")
        if len(names) < 3 or not {"headset", "pelvis_tracker"} & set(names):
            raise InputError(
                f"{self.name} needs three trackers, headset or pelvis_tracker among them", "sensors"
            )
        return names

    def describe(self) -> str:
        """See the base class."""
        return "three or more of " + ", ".join(DEVICES)

    def _begin(self, body: Body) -> None:
        self._offsets = torch.as_tensor(body.offsets, dtype=torch.float64)
        drop = -self._offsets[[JOINTS.index("left_toe"), JOINTS.index("right_toe")], 2].mean()
        self._ankle_rise = float(drop.clamp_min(0.0)) + ANKLE_RISE_M
        self._latent: Tensor | None = None
        self._root, self._turn = torch.zeros(3).double(), torch.tensor([1.0, 0, 0, 0]).double()
        self._lost_for = 0
        self._tokens: deque[Tensor] = deque(maxlen=PAST)
        self._coming: tuple[Tensor, Tensor] | None = None
        self._since = 0
        self._token_root, self._token_turn = self._root, self._turn

    # -- a frame ---------------------------------------------------------------------------

    @torch.no_grad()
    def _next(self, signals: Signals) -> Poses:
        goal = self._goal(signals)
        iterations = self.iterations
        if self._latent is None:
            if not goal.joints:
                return self._rest(signals)
            unknowns = self._start(goal)
            iterations = max(iterations, FIRST_ITERATIONS)
        else:
            unknowns = torch.cat([self._latent, torch.zeros(6).double()])
        unknowns = self._solve(unknowns, goal, iterations)
        unknowns = self._found_again(unknowns, goal)
        figure = self._figure(unknowns[None], goal)
        self._latent = unknowns[:LATENT]
        self._root, self._turn = figure.position[0, 0], figure.quat[0, 0]
        self._note_token(figure)
        quat = figure.quat[0].numpy()
        local = rot.quat_multiply(rot.quat_conjugate(quat[list(JOINT_PARENTS)]), quat)
        local[0] = quat[0]
        return Poses(figure.position[0, :1].numpy().copy(), local[None], self._body.offsets[None])

    def _goal(self, signals: Signals) -> Goal:
        shown = [i for i in range(len(self._mounts)) if signals.present[0, i]]
        joints = [self._mounts[i].joint for i in shown]
        weights = [HIP_WEIGHTS if joint == HIP else OTHER_WEIGHTS for joint in joints]
        wanted = torch.tensor(weights, dtype=torch.float64).reshape(-1, 2)
        if not self.rotations:
            wanted[:, 1] = 0.0
        latent = self._latent if self._latent is not None else torch.zeros(LATENT).double()
        return Goal(
            joints=joints,
            position=torch.as_tensor(signals.position[0, shown], dtype=torch.float64),
            quat=torch.as_tensor(signals.quat[0, shown], dtype=torch.float64),
            weights=wanted,
            predicted=self._expected(latent),
            prediction_weight=PREDICTION_WEIGHTS[min(max(len(joints), 3), 6)],
            root=self._root,
            turn=self._turn,
        )

    def _start(self, goal: Goal) -> Tensor:
        """A mean pose where the hip's tracker is, or under the head, or where any tracker is."""
        unknowns = torch.zeros(UNKNOWNS).double()
        anchor = HIP if HIP in goal.joints else HEAD if HEAD in goal.joints else goal.joints[0]
        at = goal.joints.index(anchor)
        yaw = diff.heading_matrix(diff.quat_to_matrix(goal.quat[at : at + 1]))
        goal.turn = diff.matrix_to_quat(yaw)[0] if anchor != HIP else goal.quat[at]
        goal.root = torch.zeros(3).double()
        figure = self._figure(unknowns[None], goal)
        goal.root = goal.position[at] - figure.position[0, anchor]
        return unknowns

    def _figure(self, unknowns: Tensor, goal: Goal) -> Figure:
        """Poses of unknowns ``(B, 30)``: latent, the root's own move and its own turn."""
        decoded = self.module.decode(unknowns[:, :LATENT])
        move, turn = unknowns[:, LATENT : LATENT + 3], unknowns[:, LATENT + 3 :]
        half = torch.cat([torch.ones_like(turn[:, :1]), 0.5 * turn], dim=-1)
        before = goal.turn.expand(len(unknowns), 4)
        own = diff.quat_multiply(before, decoded.rotation[:, 0])
        own = diff.quat_multiply(own, diff.unit_quat(half))
        root = goal.root + diff.quat_rotate(before, decoded.displacement) + move
        joints = joints_from_root(decoded.rotation, self._offsets)
        matrix = diff.quat_to_matrix(own)
        position = root[:, None] + joints @ matrix.transpose(-1, -2)
        whole = diff.quat_multiply(*torch.broadcast_tensors(own[:, None], decoded.rotation))
        return Figure(position, torch.cat([own[:, None], whole[:, 1:]], dim=1))

    def _residuals(self, unknowns: Tensor, goal: Goal) -> Tensor:
        """``(B, R)``: their squared sum is the loss of unknowns ``(B, 30)``."""
        figure = self._figure(unknowns, goal)
        count = max(len(goal.joints), 1)
        parts = []
        if goal.joints:
            apart = figure.position[:, goal.joints] - goal.position
            turned = diff.quat_multiply(
                diff.quat_conjugate(goal.quat).expand(len(unknowns), -1, -1),
                figure.quat[:, goal.joints],
            )
            turned = turned[..., 1:] * torch.where(turned[..., :1] < 0, -2.0, 2.0)
            for difference, weight in zip((apart, turned), goal.weights.T, strict=True):
                scale = (weight / (3.0 * count)).sqrt()
                parts.append((difference * scale[:, None]).flatten(1))
        away = unknowns[:, :LATENT] - goal.predicted
        parts.append(away * (goal.prediction_weight / LATENT) ** 0.5)
        for weight, own in zip(ROOT_WEIGHTS, unknowns[:, LATENT:].chunk(2, -1), strict=True):
            parts.append(own * (weight / 3.0) ** 0.5)
        if HIP not in goal.joints:
            low = figure.position[:, ANKLES, 2].min(dim=1, keepdim=True).values - self._ankle_rise
            parts.append(low * FLOOR_WEIGHT**0.5)
            if HEAD in goal.joints:
                head = goal.position[goal.joints.index(HEAD), :2]
                parts.append((figure.position[:, HIP, :2] - head) * UNDER_HEAD_WEIGHT**0.5)
        for constraint in self.constraints:
            parts.append((constraint(figure.position, figure.quat)[:, None] + 1e-12).sqrt())
        return torch.cat(parts, dim=-1)

    # -- solvers ---------------------------------------------------------------------------

    def _solve(self, unknowns: Tensor, goal: Goal, iterations: int) -> Tensor:
        if self.solver == "adam":
            return self._adam(unknowns, goal, iterations)
        damping = 1e-4
        residual = self._residuals(unknowns[None], goal)[0]
        loss = residual.square().sum()
        steps = torch.eye(UNKNOWNS).double() * _NUDGE
        for _ in range(iterations):
            nudged = self._residuals(unknowns + steps, goal)
            jacobian = ((nudged - residual) / _NUDGE).T
            square, slope = jacobian.T @ jacobian, jacobian.T @ residual
            for _ in range(4):
                held = square + damping * torch.eye(UNKNOWNS).double()
                step = torch.linalg.solve(held, slope)
                tried = unknowns - step
                new = self._residuals(tried[None], goal)[0]
                better = new.square().sum() < loss
                if better:
                    break
                damping *= 10.0
            if not better:
                break
            gained = loss - new.square().sum()
            unknowns, residual, loss = tried, new, loss - gained
            damping = max(damping / 5.0, 1e-8)
            if gained < 1e-4 * loss:
                break
        return unknowns

    def _adam(self, unknowns: Tensor, goal: Goal, iterations: int) -> Tensor:
        """The published way: Adam, until trackers are near enough."""
        with torch.enable_grad():
            free = unknowns.clone().requires_grad_()
            optimiser = torch.optim.Adam([free], lr=ADAM_RATE)
            for _ in range(iterations):
                optimiser.zero_grad()
                loss = self._residuals(free[None], goal).square().sum()
                loss.backward()
                optimiser.step()
                with torch.no_grad():
                    figure = self._figure(free[None], goal)
                    if goal.joints and self._near(figure, goal):
                        break
        return free.detach()

    @staticmethod
    def _near(figure: Figure, goal: Goal) -> bool:
        apart = (figure.position[0, goal.joints] - goal.position).square().mean()
        dot = (figure.quat[0, goal.joints] * goal.quat).sum(-1).abs()
        return bool(apart <= GOOD_POSITION) and bool((1.0 - dot).mean() <= GOOD_ROTATION)

    def _found_again(self, unknowns: Tensor, goal: Goal) -> Tensor:
        """The same unknowns, or those of a new beginning where the trackers have been lost."""
        if not goal.joints:
            return unknowns
        figure = self._figure(unknowns[None], goal)
        off = (figure.position[0, goal.joints] - goal.position).norm(dim=-1).mean()
        # The first frame, and a device that comes back, may be far off at once.
        self._lost_for = self._lost_for + 1 if off > LOST_M else 0
        if self._lost_for < LOST_FRAMES:
            return unknowns
        # What was not to be had is not asked for again at once: a new beginning takes time.
        self._lost_for = -PATIENCE
        if HIP not in goal.joints and HEAD not in goal.joints:
            return unknowns
        fresh = copy.copy(goal)
        fresh.predicted = torch.zeros(LATENT).double()
        again = self._solve(self._start(fresh), fresh, FIRST_ITERATIONS)
        moved = self._figure(again[None], fresh)
        if (moved.position[0, goal.joints] - goal.position).norm(dim=-1).mean() < BETTER * off:
            self._tokens.clear()
            self._coming, self._since = None, 0
            goal.root, goal.turn = fresh.root, fresh.turn
            return again
        return unknowns

    # -- what to expect --------------------------------------------------------------------

    def _expected(self, latent: Tensor) -> Tensor:
        """The latent expected now: on the way to the predicted one, or the last."""
        if self._coming is None:
            return latent
        share = min(self._since + 1, TOKEN_EVERY) / TOKEN_EVERY
        return self._coming[0] * (1 - share) + self._coming[1] * share

    def _note_token(self, figure: Figure) -> None:
        """Every fourth frame: remember a token, and predict the latent four frames on."""
        self._since += 1
        if not self.use_predictor or (self._tokens and self._since < TOKEN_EVERY):
            return
        assert self._latent is not None and self.module.predictor is not None
        moved = self._root - self._token_root
        moved = diff.quat_rotate(diff.quat_conjugate(self._token_turn), moved)
        if not self._tokens:
            moved = torch.zeros_like(moved)
        heights = figure.position[0, list(HEIGHT_JOINTS), 2]
        token = torch.cat([self._latent, moved, heights])
        mean, std = self.module.token_mean, self.module.token_std
        self._tokens.append((token - mean) / std)
        self._token_root, self._token_turn, self._since = self._root, self._turn, 0
        answer = self.module.predictor(torch.stack(list(self._tokens))[None], 1)[0, 0]
        self._coming = (self._latent, answer * std[:LATENT] + mean[:LATENT])
