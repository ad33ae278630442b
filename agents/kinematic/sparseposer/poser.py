"""SparsePoser on a stream of six trackers: windows of poses, networks, measured orientations."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from agents.kinematic.interface import DeviceSignals, KinematicSystem, Poses, UserBody
from agents.kinematic.skeletal import PARENTS
from agents.kinematic.sparseposer.networks import ENDS, TURNED, SparsePoserModule
from questsim import rotations as rot
from questsim.errors import InputError
from questsim.joint_sensors import SensorSequence
from questsim.skeleton import NUM_JOINTS

WINDOW = 64
MAX_FUTURE = 7
WINDOWS_AT_ONCE = 32
"""Windows per batch when a whole sequence is estimated."""
DEVICES: tuple[str, ...] = (
    "pelvis_tracker", "left_toe_tracker", "right_toe_tracker",
    "headset", "left_controller", "right_controller",
)  # fmt: skip
PASSED_ON = (3, 4, 5)
"""Head and hands take the measured orientation, like the root."""


class SparsePoser(KinematicSystem):
    """SparsePoser on a stream of six trackers.

    Args:
        module: a trained module.
        name: for messages.
        future_frames: number of later frames that a pose needs, 0 to 7.
        learned_ik: whether learned IK corrects the limbs.
    """

    devices = DEVICES
    required = DEVICES

    def __init__(
        self,
        module: SparsePoserModule,
        name: str = "SparsePoser",
        future_frames: int = 0,
        learned_ik: bool = True,
    ) -> None:
        if not 0 <= future_frames <= MAX_FUTURE:
            raise InputError(f"future_frames is {future_frames}, not 0 to {MAX_FUTURE}", name)
        if learned_ik and not module.spec.learned_ik:
            raise InputError("was trained without learned IK", name, "leave learned_ik out")
        self.module, self.name = module, name
        self.future_frames, self.learned_ik = future_frames, learned_ik
        module.eval()

    def _begin(self, body: UserBody) -> None:
        assert self._names is not None
        self._columns = [self._names.index(device) for device in DEVICES]
        self._offsets = torch.as_tensor(body.offsets, dtype=torch.float32)[None]
        self._normal_offsets = self.module.normal_offsets(self._offsets)
        self._position: Tensor | None = None
        self._quat: Tensor | None = None

    def _trackers(self, signals: DeviceSignals) -> tuple[Tensor, Tensor]:
        """Positions ``(T, 6, 3)`` and orientations ``(T, 6, 4)`` of the joints' trackers."""
        position, quat = signals.position[:, self._columns], signals.quat[:, self._columns]
        feet = [1, 2]
        toes = self._body.offsets[[ENDS[i] for i in feet]]
        position[:, feet] += rot.quat_rotate(quat[:, feet], toes)
        return torch.as_tensor(position, dtype=torch.float32), torch.as_tensor(
            quat, dtype=torch.float32
        )

    def _remember(self, signals: DeviceSignals) -> tuple[Tensor, Tensor]:
        """The last 64 frames of the trackers; a shorter history is padded with its first frame."""
        now, turn = self._trackers(signals)
        if self._position is None or self._quat is None:
            self._position = now.expand(WINDOW, -1, -1)
            self._quat = turn.expand(WINDOW, -1, -1)
        self._position = torch.cat([self._position[1:], now])
        self._quat = torch.cat([self._quat[1:], turn])
        return self._position[None], self._quat[None]

    @torch.no_grad()
    def _next(self, signals: DeviceSignals) -> Poses:
        return self._estimated(*self._remember(signals))

    def _estimated(self, position: Tensor, quat: Tensor) -> Poses:
        """The poses of windows ``(B, 64, 6, ...)`` of trackers, one each."""
        at = WINDOW - 1 - self.future_frames
        sparse, ends = self.module.sparse(position, quat)
        offsets = self._normal_offsets.expand(len(position), -1, -1)
        dual = self.module.generate(sparse, offsets)[:, at : at + 1]
        if self.learned_ik:
            dual = self.module.solve(dual, ends[:, at : at + 1], offsets)
        turned = dual[:, 0, :, :4].double().numpy()
        measured = quat[:, at].double().numpy()
        turned[:, 0] = [1.0, 0.0, 0.0, 0.0]
        back = rot.quat_conjugate(measured[:, 0])
        for i in PASSED_ON:
            turned[:, TURNED[i]] = rot.quat_multiply(back, measured[:, i])
        local = rot.quat_multiply(rot.quat_conjugate(turned[:, list(PARENTS[0])]), turned)
        local[:, 0] = measured[:, 0]
        local = local / np.linalg.norm(local, axis=-1, keepdims=True)
        root = position[:, at, 0].double().numpy()
        offsets = np.broadcast_to(self._body.offsets, (len(root), NUM_JOINTS, 3))
        return Poses(root, local, offsets)

    @torch.no_grad()
    def predict(self, sequence: SensorSequence, body: UserBody) -> Poses:
        """Like ``KinematicSystem.predict``; many windows at once if the stream has no gap."""
        signals = self._all_signals(sequence, body)
        if signals is None:
            return super().predict(sequence, body)
        position, quat = self._trackers(signals)
        before, after = WINDOW - 1 - self.future_frames, self.future_frames
        position, quat = (
            torch.cat([x[:1].expand(before, -1, -1), x, x[-1:].expand(after, -1, -1)])
            for x in (position, quat)
        )
        parts = []
        for begin in range(0, len(sequence), WINDOWS_AT_ONCE):
            end = min(begin + WINDOWS_AT_ONCE, len(sequence))
            rows = torch.arange(begin, end)[:, None] + torch.arange(WINDOW)
            parts.append(self._estimated(position[rows], quat[rows]))
        poses = Poses.joined(parts)
        return poses if poses.finite() else super().predict(sequence, body)
