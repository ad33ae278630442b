"""A body of the user's own, compiled and measured: what sensors, environments and clips need."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np

from questsim import rotations as rot
from questsim.bodies.description import TOES, Description, read_description
from questsim.bodies.own_body import OwnBody
from questsim.bodies.own_mjcf import hinge_limits, own_spec
from questsim.bodies.rest import rest_pose
from questsim.bodies.scaling import scaled_spec
from questsim.bodies.support import Support, support_of
from questsim.body import Body
from questsim.errors import InputError
from questsim.skeleton import LINK_PARENTS, LINKS

_STRONG = ("pelvis", "spine", "chest", "left_foot", "right_foot", *TOES)
"""The hinges up to these roles carry the body's weight."""


@dataclass(frozen=True)
class BodyMap:
    """A compiled body and the places of our avatar's links on it.

    ``L`` links are all bodies of the MJCF, ``D`` hinges all its hinges; the root is the first link.

    Attributes:
        body: model, stature, torque limits.
        colliding: the same with links that collide with each other.
        links, dofs: ``(L,)``, ``(D,)`` names, in the order of the MJCF.
        role_link: ``(16,)`` the link that carries each of ``skeleton.LINKS``; a missing spine or
            chest is the pelvis.
        role_at: ``(16, 3)`` the role's origin in its link, metres.
        role_turn: ``(16, 4)`` the role's frame in its link: a role stands along the world's axes
            when the body stands upright with its arms hanging.
        toes: link of the left and of the right toes, -1 without.
        mapped: ``(16,)`` bool, whether the description has the role.
        rest: ``(7 + D,)`` the pose upright, arms hanging, soles on the floor, facing x.
        joint_range: ``(D, 2)`` rad.
        support: lowest points of the feet.
        strong: ``(D,)`` bool, hinges of legs and trunk.
        spec: behind ``body.model``; copy it before a change.
    """

    body: Body
    colliding: Body
    links: tuple[str, ...]
    dofs: tuple[str, ...]
    role_link: np.ndarray
    role_at: np.ndarray
    role_turn: np.ndarray
    toes: tuple[int, int]
    mapped: np.ndarray
    rest: np.ndarray
    joint_range: np.ndarray
    support: Support
    strong: np.ndarray
    spec: mujoco.MjSpec

    def looks(self, height_m: float) -> mujoco.MjSpec:
        """The body alone at a stature, for pictures: no floor, light, motor or sensor."""
        spec = scaled_spec(self.spec, height_m / self.body.height_m)
        world = spec.worldbody
        for part in (*spec.actuators, *spec.sensors, *world.geoms, *world.lights):
            spec.delete(part)
        return spec

    def roles(
        self, position: np.ndarray, quat: np.ndarray, height_m: np.ndarray | float | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Poses of our avatar's 16 links on this body.

        Args:
            position: ``(..., L, 3)`` of its links in metres.
            quat: ``(..., L, 4)``.
            height_m: stature, or one for each row; None for that of the MJCF.

        Returns:
            positions ``(..., 16, 3)`` and orientations ``(..., 16, 4)``, as ``skeleton.LINKS``.
        """
        turn = np.asarray(quat, float)[..., self.role_link, :]
        place = np.asarray(position, float)[..., self.role_link, :]
        at = self.role_at
        if height_m is not None:
            at = at * (np.asarray(height_m)[..., None, None] / self.body.height_m)
        return (
            place + rot.quat_rotate(turn, at),
            rot.quat_multiply(turn, self.role_turn),
        )


def read_body(file: str | Path | OwnBody) -> OwnBody:
    """The body of a description: a TOML file, or the name of a shipped one.

    Raises:
        InputError: the description or its MJCF cannot be used.
    """
    if isinstance(file, OwnBody):
        return file
    description = read_description(file)
    return OwnBody(description.name, str(description.path), _compiled(description).digest)


@lru_cache(maxsize=16)
def map_of(body: OwnBody) -> BodyMap:
    """The compiled body; cached, do not write to its model.

    Raises:
        InputError: its description is gone, or has changed since it was read.
    """
    compiled = _compiled(read_description(body.path))
    if compiled.digest != body.digest:
        raise InputError(
            f"the body {body.name!r} has changed since it was used", body.path, "restore the file"
        )
    return compiled.map


@dataclass(frozen=True)
class _Compiled:
    digest: str
    map: BodyMap


def _compiled(description: Description) -> _Compiled:
    spec = own_spec(description)
    text = spec.to_xml()
    key = (text, repr(sorted(description.links.items())), repr(sorted(description.rest.items())))
    digest = hashlib.sha256("\n".join((*key, repr(description.height_m))).encode()).hexdigest()
    return _Compiled(digest, _measured(digest, description, text, spec))


_MAPS: dict[str, BodyMap] = {}


def _measured(digest: str, description: Description, text: str, spec: mujoco.MjSpec) -> BodyMap:
    if digest not in _MAPS:
        _MAPS[digest] = _measure(description, spec)
    return _MAPS[digest]


def _measure(description: Description, spec: mujoco.MjSpec) -> BodyMap:
    model = spec.compile()
    links = tuple(model.body(i).name for i in range(1, model.nbody))
    dofs = tuple(model.joint(i).name for i in range(1, model.njnt))
    link, at, mapped = _roles(description, links)
    toes = tuple(
        links.index(description.links[toe].body) if toe in description.links else -1 for toe in TOES
    )
    feet = tuple(int(link[LINKS.index(f"{side}_foot")]) for side in ("left", "right"))
    support = support_of(model, feet)
    joint_range = np.where(model.jnt_limited[1:, None] > 0, model.jnt_range[1:], [-np.pi, np.pi])
    rest, turn = rest_pose(description, model, link, at, mapped, joint_range)
    position, quat = _link_poses(model, rest)
    rest = rest.copy()
    rest[2] -= support.lowest(position[None], quat[None]).min()
    height = description.height_m or _top(model, rest)
    substeps = description.substeps
    limits = hinge_limits(model)
    damping = np.ravel(model.dof_damping)[6:].copy()
    body = Body(model, height, "default", limits, damping, substeps)
    return BodyMap(
        body=body,
        colliding=Body(_colliding(spec), height, "default", limits, damping, substeps),
        links=links,
        dofs=dofs,
        role_link=link,
        role_at=at,
        role_turn=turn,
        toes=(toes[0], toes[1]),
        mapped=mapped,
        rest=rest,
        joint_range=joint_range,
        support=support,
        strong=_strong(model, [int(link[LINKS.index(r)]) for r in _STRONG if r in LINKS], toes),
        spec=spec,
    )


def _roles(
    description: Description, links: tuple[str, ...]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Link and place of the 16 roles, and which of them the description has."""
    link, at = np.zeros(len(LINKS), int), np.zeros((len(LINKS), 3))
    mapped = np.array([role in description.links for role in LINKS])
    for role, place in description.links.items():
        if place.body not in links:
            known = ", ".join(links)
            raise InputError(
                f"the MJCF has no body {place.body!r}",
                f"{description.path}, links.{role}",
                f"it has {known}",
            )
        if role in LINKS:
            link[LINKS.index(role)], at[LINKS.index(role)] = links.index(place.body), place.at
    for role in np.flatnonzero(~mapped):  # parents come first
        parent = LINK_PARENTS[role]
        link[role], at[role] = link[parent], at[parent]
    return link, at, mapped


def _link_poses(model: mujoco.MjModel, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    return data.xpos[1:].copy(), data.xquat[1:].copy()


def _top(model: mujoco.MjModel, qpos: np.ndarray) -> float:
    """Height in metres of the highest geom's bounding sphere or half-size above the floor."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    top = 0.0
    for geom in range(model.ngeom):
        if model.geom_bodyid[geom] == 0:
            continue
        middle, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        turn = data.geom_xmat[geom].reshape(3, 3)
        reach = np.abs(turn[2]) @ half
        top = max(top, float(data.geom_xpos[geom, 2] + turn[2] @ middle + reach))
    return round(top, 3)


def _colliding(spec: mujoco.MjSpec) -> mujoco.MjModel:
    spec = spec.copy()
    for body in spec.bodies[1:]:
        for geom in body.geoms:
            if geom.contype:
                geom.conaffinity = 1
    return spec.compile()


def _strong(model: mujoco.MjModel, links: list[int], toes: tuple[int, ...]) -> np.ndarray:
    carrying: set[int] = set()
    for link in (*links, *(toe for toe in toes if toe >= 0)):
        body = link + 1
        while body > 0:
            carrying.add(body)
            body = int(model.body_parentid[body])
    return np.isin(model.jnt_bodyid[1:], sorted(carrying))
