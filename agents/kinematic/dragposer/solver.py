"""DragPoser on a stream: optimise the latent in each frame until the pose meets the trackers.

The set of trackers may change from frame to frame. Differences from the published system: the
root's position and orientation are additional unknowns that the decoder only predicts, so that
errors do not accumulate; the default solver is a damped Gauss-Newton method, which needs fewer
iterations than Adam; and a pose that has lost its trackers is initialised again.
"""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from agents.kinematic.dragposer.constraints import Constraint
from agents.kinematic.dragposer.model import UNKNOWNS, DragModel, PosedSkeleton
from agents.kinematic.dragposer.networks import (
    HEIGHT_JOINTS,
    LATENT,
    PAST,
    TOKEN_EVERY,
    DragPoserModule,
)
from agents.kinematic.dragposer.residuals import (
    Goal,
    constraint_residual,
    is_near,
    mean_distance,
    off_trackers,
    prior_mean,
    prior_scale,
)
from agents.kinematic.interface import DeviceSignals, KinematicSystem, Poses, UserBody
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

PASSED_ON = (HEAD, JOINTS.index("left_wrist"), JOINTS.index("right_wrist"), *ANKLES)
"""Joints that take the measured orientation, as in SparsePoser."""
HIP_WEIGHTS, OTHER_WEIGHTS = (10.0, 10.0), (5.0, 0.01)
"""Weights of trackers' position and rotation (the paper)."""
PREDICTION_WEIGHTS = {6: 0.02, 5: 0.02, 4: 0.125, 3: 0.15}
"""lambda_T by number of trackers (the paper; for 5 as for 6)."""
NEWTON_SHARE = 0.05
"""Factor on lambda_T in the Gauss-Newton solver. This solver reaches the optimum, unlike the few
steps of Adam in the paper, and there the full weight keeps the pose away from its trackers."""
ADAM_RATE = 0.01
FLOOR_WEIGHT, UNDER_HEAD_WEIGHT = 0.5, 0.05
"""Weights without a hip tracker: the lower ankle near the floor, the hip below the head."""
ANKLE_RISE_M = 0.03
"""Height in m of an ankle above the floor, in addition to the toe's drop below the ankle."""
LOST_M, LOST_FRAMES = 0.10, 6
"""Restart when the mean tracker error exceeds this distance for this number of frames ..."""
BETTER, PATIENCE = 0.7, 60
"""... if it reduces the error to this share, at most once in this number of frames."""
FIRST_ITERATIONS = 40

_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


class DragPoser(KinematicSystem):
    """DragPoser on a stream.

    Args:
        module: a trained module.
        name: for messages.
        iterations: solver iterations per frame; by default the preset's.
        solver: ``newton`` or ``adam``; by default the preset's.
        predictor: whether to use the trained predictor; otherwise the last latent is predicted.
        constraints: losses in addition to the trackers'; see ``constraints``.
        rotations: whether trackers' orientations are used.
    """

    devices = DEVICES
    interpolates_dropouts = False
    passes_on = True
    """Whether the joints of ``PASSED_ON`` take the measured orientation."""

    def __init__(
        self,
        module: DragPoserModule,
        name: str = "DragPoser",
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
            what = f"cannot solve by {self.iterations} iterations of {self.solver!r}"
            raise InputError(what, name, "use newton or adam, and 1 iteration or more")
        if predictor and module.predictor is None:
            raise InputError("was trained without a predictor", name, "leave predictor out")
        self.module = copy.deepcopy(module).double().eval()
        for parameter in self.module.parameters():
            parameter.requires_grad_(False)
        self.model = DragModel(self.module)
        self.use_predictor, self.rotations = predictor, rotations
        self.constraints = tuple(constraints)

    def usable(self, sensors: str | Sequence[str]) -> tuple[str, ...]:
        """Require three or more trackers, with headset or pelvis among them; see the base class."""
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

    def _begin(self, body: UserBody) -> None:
        drop = -body.offsets[[JOINTS.index("left_toe"), JOINTS.index("right_toe")], 2].mean()
        self._ankle_rise = max(float(drop), 0.0) + ANKLE_RISE_M
        self._latent: np.ndarray | None = None
        self._root, self._turn = np.zeros(3), _UPRIGHT
        self._lost_for = 0
        self._tokens: deque[Tensor] = deque(maxlen=PAST)
        self._coming: tuple[np.ndarray, np.ndarray] | None = None
        self._since = 0
        self._token_root, self._token_turn = self._root, self._turn

    # -- a frame ---------------------------------------------------------------------------

    @torch.no_grad()
    def _next(self, signals: DeviceSignals) -> Poses:
        goal = self._goal(signals)
        iterations = self.iterations
        if self._latent is None:
            if not goal.joints:
                return self._rest(signals)
            unknowns = self._start(goal)
            iterations = max(iterations, FIRST_ITERATIONS)
        else:
            unknowns = np.concatenate([self._latent, np.zeros(6)])
        unknowns = self._solve(unknowns, goal, iterations)
        unknowns = self._found_again(unknowns, goal)
        skeleton = self._skeleton(unknowns, goal)
        self._latent = unknowns[:LATENT]
        self._root, self._turn = skeleton.position[0].copy(), skeleton.quat[0].copy()
        self._note_token(skeleton)
        quat = skeleton.quat
        local = rot.quat_multiply(rot.quat_conjugate(quat[list(JOINT_PARENTS)]), quat)
        local[0] = quat[0]
        for joint, weight, measured in zip(goal.joints, goal.weights, goal.quat, strict=True):
            # The solver gives these rotations little weight, and no tracked joint depends on them.
            if self.passes_on and joint in PASSED_ON and weight[1] > 0:
                local[joint] = rot.quat_multiply(
                    rot.quat_conjugate(quat[JOINT_PARENTS[joint]]), measured
                )
        return Poses(skeleton.position[:1].copy(), local[None], self._body.offsets[None])

    def _goal(self, signals: DeviceSignals) -> Goal:
        shown = [i for i in range(len(self._mounts)) if signals.present[0, i]]
        joints = [self._mounts[i].joint for i in shown]
        weights = [HIP_WEIGHTS if joint == HIP else OTHER_WEIGHTS for joint in joints]
        wanted = np.reshape(np.array(weights), (-1, 2))
        if not self.rotations:
            wanted[:, 1] = 0.0
        latent = self._latent if self._latent is not None else np.zeros(LATENT)
        self._reporting = joints
        share = NEWTON_SHARE if self.solver == "newton" else 1.0
        return Goal(
            joints=joints,
            position=signals.position[0, shown],
            quat=signals.quat[0, shown],
            weights=wanted,
            predicted=self._expected(latent),
            prediction_weight=share * PREDICTION_WEIGHTS[min(max(len(joints), 3), 6)],
            root=self._root,
            turn=self._turn,
        )

    def _start(self, goal: Goal) -> np.ndarray:
        """A mean pose at the hip tracker, else under the head, else at any tracker."""
        unknowns = np.zeros(UNKNOWNS)
        anchor = HIP if HIP in goal.joints else HEAD if HEAD in goal.joints else goal.joints[0]
        at = goal.joints.index(anchor)
        goal.turn = goal.quat[at] if anchor == HIP else rot.yaw_quat(rot.heading(goal.quat[at]))
        goal.root = np.zeros(3)
        goal.root = goal.position[at] - self._skeleton(unknowns, goal).position[anchor]
        return unknowns

    def _skeleton(self, unknowns: np.ndarray, goal: Goal, slopes: bool = False) -> PosedSkeleton:
        return self.model.posed_skeleton(unknowns, goal.turn, goal.root, self._body.offsets, slopes)

    def _residuals(
        self, unknowns: np.ndarray, goal: Goal, slopes: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residuals ``(R,)`` whose squared sum is the loss, and their derivatives ``(R, 30)``.

        Without ``slopes`` the derivatives have no columns.
        """
        skeleton = self._skeleton(unknowns, goal, slopes)
        unit = np.eye(UNKNOWNS)[:, : skeleton.columns]
        parts = [(unknowns - prior_mean(goal), unit, prior_scale(goal))]
        if goal.joints:
            parts += off_trackers(skeleton, goal)
        if HIP not in goal.joints:
            foot = ANKLES[int(skeleton.position[ANKLES, 2].argmin())]
            low = skeleton.position[[foot], 2] - self._ankle_rise
            parts.append((low, skeleton.d_position[[foot], 2], np.sqrt([FLOOR_WEIGHT])))
            if HEAD in goal.joints:
                off = skeleton.position[HIP, :2] - goal.position[goal.joints.index(HEAD), :2]
                parts.append((off, skeleton.d_position[HIP, :2], np.sqrt([UNDER_HEAD_WEIGHT])))
        parts += [constraint_residual(constraint, skeleton) for constraint in self.constraints]
        values = [(value * weight).ravel() for value, _, weight in parts]
        rows = [
            (slope * weight[..., None]).reshape(value.size, skeleton.columns)
            for value, slope, weight in parts
        ]
        return np.concatenate(values), np.concatenate(rows)

    # -- solvers ---------------------------------------------------------------------------

    def _solve(self, unknowns: np.ndarray, goal: Goal, iterations: int) -> np.ndarray:
        if self.solver == "adam":
            return self._adam(unknowns, goal, iterations)
        return self._newton(unknowns, goal, iterations)

    def _newton(self, unknowns: np.ndarray, goal: Goal, iterations: int) -> np.ndarray:
        damping = 1e-4
        for _ in range(iterations):
            residual, jacobian = self._residuals(unknowns, goal, slopes=True)
            loss = residual @ residual
            square, slope = jacobian.T @ jacobian, jacobian.T @ residual
            tried, new, better = unknowns, residual, False
            for _ in range(4):
                tried = unknowns - np.linalg.solve(square + damping * np.eye(UNKNOWNS), slope)
                new, _ = self._residuals(tried, goal)
                better = new @ new < loss
                if better:
                    break
                damping *= 10.0
            if not better:
                break
            unknowns, gained = tried, loss - new @ new
            damping = max(damping / 5.0, 1e-8)
            if gained < 1e-4 * (loss - gained):
                break
        return unknowns

    def _adam(self, unknowns: np.ndarray, goal: Goal, iterations: int) -> np.ndarray:
        """The published solver: Adam until the trackers are near enough."""
        free = torch.from_numpy(unknowns.copy())
        optimiser = torch.optim.Adam([free], lr=ADAM_RATE)
        for _ in range(iterations):
            residual, jacobian = self._residuals(free.numpy(), goal, slopes=True)
            free.grad = torch.from_numpy(2.0 * jacobian.T @ residual)
            optimiser.step()
            if goal.joints and is_near(self._skeleton(free.numpy(), goal), goal):
                break
        return free.numpy()

    def _found_again(self, unknowns: np.ndarray, goal: Goal) -> np.ndarray:
        """The same unknowns, or newly initialised ones if the pose has lost its trackers."""
        if not goal.joints:
            return unknowns
        off = mean_distance(self._skeleton(unknowns, goal), goal)
        # The first frame and a returning device may be far off immediately.
        self._lost_for = self._lost_for + 1 if off > LOST_M else 0
        if self._lost_for < LOST_FRAMES:
            return unknowns
        # After a failed restart, wait before the next one: a restart is slow.
        self._lost_for = -PATIENCE
        if HIP not in goal.joints and HEAD not in goal.joints:
            return unknowns
        fresh = copy.copy(goal)
        fresh.predicted = np.zeros(LATENT)
        again = self._solve(self._start(fresh), fresh, FIRST_ITERATIONS)
        if mean_distance(self._skeleton(again, fresh), goal) < BETTER * off:
            self._tokens.clear()
            self._coming, self._since = None, 0
            goal.root, goal.turn = fresh.root, fresh.turn
            return again
        return unknowns

    # -- prediction ------------------------------------------------------------------------

    def _expected(self, latent: np.ndarray) -> np.ndarray:
        """This frame's predicted latent, interpolated between predictions, or the last one."""
        if self._coming is None:
            return latent
        share = min(self._since + 1, TOKEN_EVERY) / TOKEN_EVERY
        return self._coming[0] * (1 - share) + self._coming[1] * share

    def _note_token(self, skeleton: PosedSkeleton) -> None:
        """Every fourth frame: store a token, and predict the latent four frames ahead."""
        self._since += 1
        if not self.use_predictor or (self._tokens and self._since < TOKEN_EVERY):
            return
        assert self._latent is not None and self.module.predictor is not None
        moved = self._root - self._token_root
        moved = rot.quat_rotate(rot.quat_conjugate(self._token_turn), moved)
        if not self._tokens:
            moved = np.zeros_like(moved)
        heights = skeleton.position[list(HEIGHT_JOINTS), 2]
        token = torch.from_numpy(np.concatenate([self._latent, moved, heights]))
        mean, std = self.module.token_mean, self.module.token_std
        self._tokens.append((token - mean) / std)
        self._token_root, self._token_turn, self._since = self._root, self._turn, 0
        answer = self.module.predictor(torch.stack(list(self._tokens))[None], 1)[0, 0]
        self._coming = (self._latent, (answer * std[:LATENT] + mean[:LATENT]).numpy())
