"""Classical inverse kinematics for six trackers: the baseline of the comparison.

Differential inverse kinematics (mink, after Pink; one quadratic programme per step) moves the
avatar's MuJoCo body, with the user's bone lengths, within its joint ranges. The tracked joints are
frame tasks; a posture task keeps the remaining freedom near a standing pose.
"""

from __future__ import annotations

import mink
import mujoco
import numpy as np

from agents.kinematic.interface import DeviceSignals, KinematicSystem, Poses, UserBody
from agents.resolve import IK
from questsim import rotations as rot
from questsim.body import scaled_spec
from questsim.motion.checks import stature_of
from questsim.motion.limbs import ARM_REST, SIDES
from questsim.skeleton import JOINT_PARENTS, JOINTS, LINK_JOINTS, LINK_PARENTS, LINKS, NUM_JOINTS

DEVICES: tuple[str, ...] = (
    "pelvis_tracker", "headset", "left_controller", "right_controller",
    "left_toe_tracker", "right_toe_tracker",
)  # fmt: skip
# Device, site on the avatar, costs of position and orientation.
_TASKS = (
    ("pelvis_tracker", "pelvis", 10.0, 2.0),
    ("headset", "head", 5.0, 1.0),
    ("left_controller", "left_hand", 5.0, 1.0),
    ("right_controller", "right_hand", 5.0, 1.0),
    ("left_toe_tracker", "left_foot", 5.0, 1.0),
    ("right_toe_tracker", "right_foot", 5.0, 1.0),
)
POSTURE_COST = 0.02
"""Cost of each joint's deviation from standing; the trackers' costs are 5 or 10 per metre."""
DAMPING = 0.1
"""Damping of every step; with less, arms near their joint limits jump between solutions."""
ITERATIONS, FIRST_ITERATIONS = 4, 60
STEP_S = 0.1
"""Duration of one step in s; gains of 1 reach the target in one second."""


# Straight limbs are singular: start and rest pose are slightly bent.
_BENT = {"hip_y": -0.3, "knee_y": 0.6, "ankle_y": -0.3, "elbow_y": -0.6}


def _standing(model: mujoco.MjModel) -> np.ndarray:
    """Target pose ``(40,)`` of the posture task."""
    qpos = model.qpos0.copy()
    for side in SIDES:
        for hinge, angle in _BENT.items():
            qpos[model.joint(f"{side}_{hinge}").qposadr[0]] = angle
    return qpos


def user_model(offsets: np.ndarray) -> mujoco.MjModel:
    """The avatar with the bone lengths of ``(22, 3)`` offsets; its masses have no meaning.

    Link frames stay those of the avatar; the pelvis is midway between the user's hips.
    """
    places = _link_places(offsets)
    spec = scaled_spec(float(np.clip(stature_of(offsets), 1.2, 2.2)))
    for body in spec.bodies:
        if body.name in LINKS[1:]:
            body.pos = places[LINKS.index(body.name)]
    head = spec.body("head")
    head.add_site(name="head_joint", pos=offsets[JOINTS.index("head")])
    return spec.compile()


def _rest(link: str) -> np.ndarray:
    """Orientation of a link in its joint's frame; in the avatar's zero pose the arms hang."""
    side, _, part = link.partition("_")
    if part in ("upper_arm", "forearm", "hand"):
        return ARM_REST[side]
    return np.array([1.0, 0.0, 0.0, 0.0])


def _link_places(offsets: np.ndarray) -> np.ndarray:
    """Origin ``(16, 3)`` of each link in its parent link's frame."""
    hips = offsets[[JOINTS.index("left_hip"), JOINTS.index("right_hip")]].mean(axis=0)
    places = np.zeros((len(LINKS), 3))
    for link in range(1, len(LINKS)):
        parent = LINK_PARENTS[link]
        joint, place = JOINTS.index(LINK_JOINTS[link]), np.zeros(3)
        while joint != JOINTS.index(LINK_JOINTS[parent]):
            place = place + offsets[joint]
            joint = JOINT_PARENTS[joint]
        if parent == 0:
            place = place - hips
        places[link] = rot.quat_rotate(rot.quat_conjugate(_rest(LINKS[parent])), place)
    return places


class InverseKinematics(KinematicSystem):
    """The solver on a stream of six trackers; it needs no training.

    Args:
        iterations: solver steps per frame.
    """

    name, devices, required = IK, DEVICES, DEVICES

    def __init__(self, iterations: int = ITERATIONS) -> None:
        self.iterations = iterations

    def _begin(self, body: UserBody) -> None:
        model = user_model(body.offsets)
        self._configuration = mink.Configuration(model)
        standing = _standing(model)
        self._configuration.update(standing)
        self._limits: list[mink.Limit] = [mink.ConfigurationLimit(model)]
        self._posture = mink.PostureTask(model, cost=POSTURE_COST)
        self._posture.set_target(standing)
        self._frames = []
        for device, link, position, orientation in _TASKS:
            kind = "site" if link == "head" else "body"
            task = mink.FrameTask(
                "head_joint" if link == "head" else link, kind, position, orientation
            )
            self._frames.append((device, link, task))
        self._fresh = True
        hips = [JOINTS.index("left_hip"), JOINTS.index("right_hip")]
        self._hips = body.offsets[hips].mean(axis=0)

    def _next(self, signals: DeviceSignals) -> Poses:
        assert self._names is not None
        configuration = self._configuration
        qpos = configuration.q.copy()
        for device, link, task in self._frames:
            column = self._names.index(device)
            position, quat = signals.position[0, column], signals.quat[0, column]
            if link == "pelvis":
                position = position + rot.quat_rotate(quat, self._hips)
                # The root starts at the pelvis tracker; the solver steps refine it.
                qpos[:7] = np.concatenate([position, quat])
            turned = rot.quat_multiply(quat, _rest(link))
            task.set_target(mink.SE3(np.concatenate([turned, position])))
        configuration.update(qpos)
        tasks = [*(task for _, _, task in self._frames), self._posture]
        for _ in range(FIRST_ITERATIONS if self._fresh else self.iterations):
            velocity = mink.solve_ik(
                configuration, tasks, STEP_S, "daqp", damping=DAMPING, limits=self._limits
            )
            configuration.integrate_inplace(velocity, STEP_S)
        self._fresh = False
        return self._poses()

    def _poses(self) -> Poses:
        """The 22 joints from the avatar's links; joints without a link keep their rest rotation."""
        links = self._configuration.data.xquat[1 : len(LINKS) + 1].copy()
        world = np.zeros((NUM_JOINTS, 4))
        by_joint = dict(zip(LINK_JOINTS, range(len(LINKS)), strict=True))
        for joint, name in enumerate(JOINTS):
            if name in by_joint:
                link = by_joint[name]
                turned = rot.quat_conjugate(_rest(LINKS[link]))
                world[joint] = rot.quat_multiply(links[link], turned)
            else:
                world[joint] = world[JOINT_PARENTS[joint]]
        local = rot.quat_multiply(rot.quat_conjugate(world[list(JOINT_PARENTS)]), world)
        local[0] = world[0]
        pelvis = self._configuration.data.xpos[1]
        root = pelvis - rot.quat_rotate(world[0], self._hips)
        return Poses(root[None], local[None], self._body.offsets[None])
