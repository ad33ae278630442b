"""The avatar's initial pose, estimated from the device poses alone."""

from __future__ import annotations

from collections.abc import Sequence

import mink
import mujoco
import numpy as np

from questsim import rotations as rot
from questsim.body import build_body
from questsim.motion.kinematics import sole_positions, standing_clip, standing_devices
from questsim.sensors import DEVICES, device_poses
from questsim.skeleton import FEET, LINKS

ITERATIONS, STEP_S = 40, 0.15
POSTURE_COST = 0.02
"""Cost of each joint's deviation from standing upright; the feet's cost is 5 per metre."""
_COSTS = {"head": (5.0, 2.0), "pelvis": (5.0, 1.0)}
_HAND_COSTS, _FOOT_COSTS = (3.0, 0.5), (5.0, 2.0)
LOWEST_SHARE = 0.35
"""Lowest assumed headset height, as a share of its standing height."""


def estimated_pose(
    names: Sequence[str], position: np.ndarray, quat: np.ndarray, height_m: float
) -> np.ndarray:
    """A pose on both feet that matches the user's device poses, by inverse kinematics.

    The real foot poses are unknown: the feet stand flat and parallel below the head, in its
    heading.

    Args:
        names: ``D`` devices, the headset among them.
        position: ``(D, 3)`` metres over a level floor at z = 0.
        quat: ``(D, 4)``.
        height_m: stature.

    Returns:
        ``qpos`` ``(40,)``.
    """
    model = build_body(height_m).model
    standing = standing_clip(height_m)
    headset = list(names).index("headset")
    upright = standing_devices(["headset"], height_m)
    yaw = float(rot.heading(quat[headset]))
    turn = rot.yaw_quat(np.array(yaw))
    low = LOWEST_SHARE * upright[0, 2]
    position = np.array(position, float)
    position[headset, 2] = np.clip(position[headset, 2], low, 1.05 * upright[0, 2])
    spot = position[headset] - rot.quat_rotate(turn, upright[0])
    spot[2] = 0.0

    qpos = standing.qpos[0].copy()
    qpos[:3] = spot + rot.quat_rotate(turn, qpos[:3])
    qpos[2] -= upright[0, 2] - min(position[headset, 2], upright[0, 2])
    qpos[3:7] = turn
    tasks = _device_tasks(names, position, quat, height_m)
    if not any(DEVICES[name].link in FEET for name in names):
        for foot in FEET:
            place = spot + rot.quat_rotate(turn, standing.link_position[0, LINKS.index(foot)])
            tasks.append(_task(foot, place, turn, _FOOT_COSTS))
    posture = mink.PostureTask(model, cost=POSTURE_COST)
    posture.set_target(qpos)
    configuration = mink.Configuration(model)
    configuration.update(_bent(model, qpos))
    limits = [mink.ConfigurationLimit(model)]
    for _ in range(ITERATIONS):
        speed = mink.solve_ik(
            configuration, [*tasks, posture], STEP_S, "daqp", damping=1e-2, limits=limits
        )
        configuration.integrate_inplace(speed, STEP_S)
    return _on_the_floor(model, configuration.q.copy(), height_m)


def _bent(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """The pose with bent knees and elbows: straight limbs are singular."""
    start = qpos.copy()
    bends = {"hip_y": -0.2, "knee_y": 0.4, "ankle_y": -0.2, "elbow_y": -0.2}
    for side in ("left", "right"):
        for hinge, angle in bends.items():
            start[model.joint(f"{side}_{hinge}").qposadr[0]] = angle
    return start


def _device_tasks(
    names: Sequence[str], position: np.ndarray, quat: np.ndarray, height_m: float
) -> list[mink.FrameTask]:
    """Tasks of the links that carry the devices."""
    tasks = []
    for name, place, turned in zip(names, position, quat, strict=True):
        link = DEVICES[name].link
        at, _ = device_poses(np.zeros((len(LINKS), 3)), _upright(), [name], height_m)
        costs = _HAND_COSTS if link.endswith("hand") else _COSTS.get(link, _FOOT_COSTS)
        goal = place - rot.quat_rotate(turned, at[0])
        tasks.append(_task(link, goal, turned, costs))
    return tasks


def _upright() -> np.ndarray:
    quat = np.zeros((len(LINKS), 4))
    quat[:, 0] = 1.0
    return quat


def _task(
    link: str, position: np.ndarray, quat: np.ndarray, costs: tuple[float, float]
) -> mink.FrameTask:
    task = mink.FrameTask(link, "body", *costs, lm_damping=1e-3)
    task.set_target(mink.SE3(np.concatenate([quat, position])))
    return task


def _on_the_floor(model: mujoco.MjModel, qpos: np.ndarray, height_m: float) -> np.ndarray:
    """The pose, raised or lowered so that its lower sole is at z = 0."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    feet = [model.body(foot).id for foot in FEET]
    soles = sole_positions(data.xpos[feet], data.xquat[feet], height_m)
    qpos[2] -= float(soles[..., 2].min())
    return qpos
