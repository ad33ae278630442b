"""Clips of a body from those of our avatar, by inverse kinematics frame by frame.

The root's path and the feet are scaled by the ratio of leg lengths, so that feet that rest still
rest. Trunk, head and feet take the avatar's orientations, limbs its directions, as far as the
hinges of the body go; hands keep their place relative to the shoulders, scaled by the arms.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from questsim import rotations as rot
from questsim.bodies.body_map import BodyMap, map_of
from questsim.bodies.own_body import OwnBody
from questsim.bodies.solver import Solver, turn_error
from questsim.body import DEFAULT_HEIGHT_M
from questsim.errors import InputError
from questsim.files import whole_file
from questsim.motion.cache import cache_dir
from questsim.motion.clip import Clip
from questsim.motion.kinematics import clip_of_links, sole_points, standing_clip
from questsim.skeleton import LINK_PARENTS, LINKS, NUM_DOFS

_FIRST_STEPS, _NEXT_STEPS = 60, 8
_FOOT, _PELVIS, _HAND = 40.0, 8.0, 10.0
"""Weights of places, per metre."""
_TURN, _TWIST, _LIMB = 1.0, 0.2, 1.0
"""Weights of orientations, per radian: trunk, head and feet; limbs about their axes and across."""
_REST, _SMOOTH = 0.02, 0.1
_LIMBS = tuple(
    f"{side}_{part}"
    for side in ("left", "right")
    for part in ("thigh", "shin", "upper_arm", "forearm")
)
_TOE_BEND_M = 0.05
"""The toes are flat on the floor while the ball of the foot is lower; they follow the foot above
twice this height."""
_KEPT = 4096


@dataclass(frozen=True)
class _Sizes:
    """Sizes of the body over those of the 1.75 m avatar."""

    legs: float
    arms: np.ndarray
    ankle_m: float
    turned: np.ndarray


def clips_for(body: OwnBody, clips: Sequence[Clip]) -> list[Clip]:
    """``clip_for`` of each clip."""
    return [clip_for(body, clip) for clip in clips]


def clip_for(body: OwnBody, clip: Clip) -> Clip:
    """The motion of a clip on another body, whose links and hinges it has.

    Takes about 1 ms a frame; results are kept in this process and in the cache folder.

    Args:
        body: the other body.
        clip: of our avatar, of any stature.

    Raises:
        InputError: the clip is not of our avatar.
    """
    if clip.link_position.shape[1:] != (len(LINKS), 3) or clip.qpos.shape[1] != 7 + NUM_DOFS:
        raise InputError("is not a clip of our avatar", clip.name, "give the user's own motion")
    if clip.proportions is not None:
        what = "proportions do not go with a body of your own"
        raise InputError(what, clip.name, "leave the proportions out")
    digest = hashlib.sha256(_code_digest() + body.digest.encode() + f"{clip.height_m}".encode())
    digest.update(np.ascontiguousarray(clip.qpos, "<f8").tobytes())
    key = digest.hexdigest()[:32]
    if key not in _CLIPS:
        if len(_CLIPS) >= _KEPT:
            _CLIPS.clear()
        _CLIPS[key] = _kept(key, map_of(body), clip)
    return clip_of_poses(map_of(body), _CLIPS[key], clip)


_CLIPS: dict[str, np.ndarray] = {}


@lru_cache(maxsize=1)
def _code_digest() -> bytes:
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    return digest.digest()


def _kept(key: str, body: BodyMap, clip: Clip) -> np.ndarray:
    path, shape = cache_dir() / "bodies" / f"{key}.npy", (len(clip), 7 + len(body.dofs))
    try:
        poses = np.load(path, allow_pickle=False)
        if poses.shape == shape and np.isfinite(poses).all():
            return poses
    except (OSError, ValueError, EOFError):
        pass
    poses = retargeted(body, clip)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as fresh, fresh.open("wb") as file:
            np.save(file, poses)
    except (OSError, InputError):
        pass
    return poses


def retargeted(body: BodyMap, clip: Clip) -> np.ndarray:
    """Poses ``(T, 7 + D)`` of the body that follow a clip of our avatar."""
    sizes = _sizes(body)
    position = clip.link_position * (DEFAULT_HEIGHT_M / clip.height_m)
    sole_m = -float(sole_points()[..., 2].mean())
    want = position * sizes.legs
    want[..., 2] = (position[..., 2] - sole_m) * sizes.legs + sizes.ankle_m
    wanted = rot.quat_multiply(clip.link_quat, rot.quat_conjugate(body.role_turn))
    axis = rot.quat_rotate(clip.link_quat, np.array([0.0, 0.0, 1.0]))
    across = np.eye(3) - (1.0 - _TWIST) * axis[..., :, None] * axis[..., None, :]
    toes = _toes(body, position, clip.link_quat)
    solver = Solver(body.body.model, body.joint_range)
    start = body.rest.copy()
    start[:2] = want[0, 0, :2]
    start[3:7] = rot.quat_multiply(rot.yaw_quat(rot.heading(clip.link_quat[0, 0])), start[3:7])
    solver.set_pose(start)
    poses = np.empty((len(clip), len(start)))
    for frame in range(len(clip)):
        target = _Target(want[frame], position[frame], wanted[frame], across[frame], toes[frame])
        # The first frame has none before it: its own solution is taken in its place.
        for steps in (_NEXT_STEPS,) if frame else (_FIRST_STEPS, _NEXT_STEPS, _NEXT_STEPS):
            before = solver.data.qpos[7:].copy()

            def ask(target: _Target = target, before: np.ndarray = before) -> None:
                _residuals(solver, body, sizes, target, before)

            solver.until_still(ask, steps)
        poses[frame] = solver.data.qpos
    return _above_floor(body, poses)


@dataclass(frozen=True)
class _Target:
    """One frame.

    Places on the body's scale and those of the 1.75 m avatar ``(16, 3)``, orientations of the
    body's links ``(16, 4)``, weights ``(16, 3, 3)`` of the limbs' rotations, orientations of the
    toes ``(2, 4)``.
    """

    place: np.ndarray
    avatar: np.ndarray
    quat: np.ndarray
    across: np.ndarray
    toes: np.ndarray


def _sizes(body: BodyMap) -> _Sizes:
    ours = standing_clip(DEFAULT_HEIGHT_M).link_position
    position, quat = poses_of(body, body.rest[None])
    theirs, _ = body.roles(position[0], quat[0])

    def length(points: np.ndarray, *names: str) -> float:
        chain = points[[LINKS.index(name) for name in names]]
        return float(np.linalg.norm(np.diff(chain, axis=0), axis=-1).sum())

    arms, ankles = [], []
    for side in ("left", "right"):
        arm = [f"{side}_{part}" for part in ("upper_arm", "forearm", "hand")]
        arms.append(length(theirs, *arm) / length(ours[0], *arm))
        ankles.append(LINKS.index(f"{side}_foot"))
    model = body.body.model
    turned = np.array([_has_hinges(body, model, role) for role in range(len(LINKS))])
    # From pelvis to ankles: hips may have links of their own between pelvis and thigh.
    drop, ankle_m = (theirs[0, 2] - theirs[ankles, 2].mean(), float(theirs[ankles, 2].mean()))
    legs = float(drop / (ours[0, 0, 2] - ours[0, ankles, 2].mean()))
    return _Sizes(legs, np.array(arms), ankle_m, turned)


def _has_hinges(body: BodyMap, model: mujoco.MjModel, role: int) -> bool:
    """Whether hinges between a role's link and its parent role's let it turn."""
    if role == 0:
        return True
    link, parent = int(body.role_link[role]) + 1, int(body.role_link[LINK_PARENTS[role]]) + 1
    above = set()
    body_id = parent
    while body_id > 0:
        above.add(body_id)
        body_id = int(model.body_parentid[body_id])
    body_id = link
    while body_id > 0 and body_id not in above:
        if model.body_jntnum[body_id] > 0:
            return True
        body_id = int(model.body_parentid[body_id])
    # The parent role may hang below this one, as a pelvis below a torso that is the root.
    return body_id != parent


def _residuals(
    solver: Solver, body: BodyMap, sizes: _Sizes, target: _Target, before: np.ndarray
) -> None:
    """Everything that the body is asked for in one frame."""
    for role, name in enumerate(LINKS):
        link = int(body.role_link[role])
        if not body.mapped[role] or not sizes.turned[role]:
            continue
        error = turn_error(solver.quat(link), target.quat[role])
        jacobian = solver.turn_jacobian(link)
        if name in _LIMBS:
            across = target.across[role]
            solver.add(across @ error, across @ jacobian, _LIMB)
        else:
            solver.add(error, jacobian, _TURN)
    _ask_place(solver, body, 0, target.place[0], _PELVIS)
    for index, side in enumerate(("left", "right")):
        foot = LINKS.index(f"{side}_foot")
        _ask_place(solver, body, foot, target.place[foot], _FOOT)
        _ask_hand(solver, body, side, sizes.arms[index], target)
        if body.toes[index] >= 0:
            link = body.toes[index]
            error = turn_error(solver.quat(link), target.toes[index])
            solver.add(error, solver.turn_jacobian(link), _TURN)
    solver.add_angles(body.rest[7:], _REST)
    solver.add_angles(before, _SMOOTH)


def _ask_place(solver: Solver, body: BodyMap, role: int, wanted: np.ndarray, weight: float) -> None:
    link, at = int(body.role_link[role]), body.role_at[role]
    solver.add(wanted - solver.place(link, at), solver.move_jacobian(link, at), weight)


def _ask_hand(solver: Solver, body: BodyMap, side: str, size: float, target: _Target) -> None:
    """The hand, seen from the shoulder, as the avatar's times the ratio of arm lengths."""
    hand, arm = LINKS.index(f"{side}_hand"), LINKS.index(f"{side}_upper_arm")
    ends = [(int(body.role_link[role]), body.role_at[role]) for role in (hand, arm)]
    reach = solver.place(*ends[0]) - solver.place(*ends[1])
    wanted = size * (target.avatar[hand] - target.avatar[arm])
    jacobian = solver.move_jacobian(*ends[0]) - solver.move_jacobian(*ends[1])
    solver.add(wanted - reach, jacobian, _HAND)


def _toes(body: BodyMap, position: np.ndarray, quat: np.ndarray) -> np.ndarray:
    """Orientations ``(T, 2, 4)`` of the toes: flat while the ball of the foot is on the floor.

    They follow the foot in the air. Their frame stands as the foot's in the rest pose.
    """
    wanted = np.zeros((len(position), 2, 4))
    _, rest = poses_of(body, body.rest[None])
    for index, side in enumerate(("left", "right")):
        if body.toes[index] < 0:
            continue
        foot = LINKS.index(f"{side}_foot")
        points = sole_points()[index]
        ball = points[points[:, 0].argmax()] * [1.0, 0.0, 1.0]
        height = (position[:, foot] + rot.quat_rotate(quat[:, foot], ball))[:, 2]
        air = np.clip(height / _TOE_BEND_M - 1.0, 0.0, 1.0)[:, None]
        flat = rot.yaw_quat(rot.heading(quat[:, foot]))
        bend = rot.quat_multiply(quat[:, foot], rot.quat_conjugate(flat))
        turn = Rotation.from_rotvec(air * rot.as_rotation(bend).as_rotvec())
        stands = rot.quat_multiply(rot.as_quat(turn), flat)
        wanted[:, index] = rot.quat_multiply(stands, rest[0, body.toes[index]])
    return wanted


def _above_floor(body: BodyMap, poses: np.ndarray) -> np.ndarray:
    """Raise poses whose soles are below the floor."""
    position, quat = poses_of(body, poses)
    below = np.minimum(body.support.lowest(position, quat).min(axis=-1), 0.0)
    poses[:, 2] -= below
    return poses


def poses_of(body: BodyMap, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places ``(T, L, 3)`` and orientations ``(T, L, 4)`` of the links in poses ``(T, 7 + D)``."""
    model = body.body.model
    data = mujoco.MjData(model)
    position = np.empty((len(poses), model.nbody - 1, 3))
    quat = np.empty((len(poses), model.nbody - 1, 4))
    for frame, pose in enumerate(poses):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        position[frame], quat[frame] = data.xpos[1:], data.xquat[1:]
    return position, quat


def clip_of_poses(body: BodyMap, poses: np.ndarray, about: Clip) -> Clip:
    """A clip of the body in poses ``(T, 7 + D)`` at 36 Hz; name and origin are of ``about``."""
    position, quat = poses_of(body, poses)
    return replace(
        clip_of_links(about.name, poses, body.body.height_m, position, quat),
        contacts=about.contacts,
        source=about.source,
        source_sha256=about.source_sha256,
        licence=about.licence,
        kind=about.kind,
        style=about.style,
        weight=about.weight,
    )
