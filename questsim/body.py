"""The avatar's body: the MJCF humanoid scaled to a person's height."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np

from questsim.assets import mjcf_path
from questsim.body_proportions import Proportions, deform
from questsim.errors import InputError
from questsim.skeleton import DOFS, LINKS

DEFAULT_HEIGHT_M = 1.75
MIN_HEIGHT_M, MAX_HEIGHT_M = 1.2, 2.2
POLICY_TIMESTEP_S = 1.0 / 36.0


@dataclass(frozen=True)
class BodyPreset:
    """Scaling of a body's dynamics from the default body by the ratio ``s`` of heights.

    Attributes:
        mass_power, inertia_power, torque_power: exponents of ``s`` for link masses, for link
            inertias and armature, and for torque limits and damping.
        torque_limit: one limit in N m for every joint of the default body, or None for the
            limits by joint in the MJCF.
        joint_friction: dry friction of every hinge in N m.
        damped: whether hinges keep the MJCF's viscous damping.
        substeps: physics steps in each 1/36 s step of the policy.
    """

    mass_power: float = 3.0
    inertia_power: float = 5.0
    torque_power: float = 3.0
    torque_limit: float | None = None
    joint_friction: float = 0.0
    damped: bool = True
    substeps: int = 4


PRESETS: dict[str, BodyPreset] = {
    "default": BodyPreset(),
    # QuestSim section 4: everything scales linearly, +-200 N m, friction 0.1, 2 substeps.
    "paper": BodyPreset(
        mass_power=1.0,
        inertia_power=1.0,
        torque_power=1.0,
        torque_limit=200.0,
        joint_friction=0.1,
        damped=False,
        substeps=2,
    ),
}


@dataclass(frozen=True)
class Body:
    """A compiled body and its parameters for controllers.

    Attributes:
        model: the MuJoCo model; bodies 1 to 16 are ``skeleton.LINKS``, ``qpos[7:]`` and
            ``ctrl`` are ``skeleton.DOFS``.
        height_m: stature in metres.
        preset: name of the ``BodyPreset``.
        torque_limits: ``(33,)`` N m.
        damping: ``(33,)`` N m s/rad.
        substeps: physics steps in each 1/36 s step of the policy.
        proportions: None for those of the default body.
    """

    model: mujoco.MjModel
    height_m: float
    preset: str
    torque_limits: np.ndarray
    damping: np.ndarray
    substeps: int
    proportions: Proportions | None = None


def build_body(
    height_m: float = DEFAULT_HEIGHT_M,
    preset: str = "default",
    self_collision: bool = False,
    proportions: Proportions | None = None,
) -> Body:
    """The avatar of a person ``height_m`` tall; bodies are cached, do not write to the model.

    Args:
        height_m: stature, 1.2 to 2.2 m.
        preset: ``"default"`` or ``"paper"``.
        self_collision: whether links collide with each other, not only with the floor.
        proportions: lengths of arms, legs and trunk and widths of shoulders and hips, on top of
            the stature; None for those of the default body.

    Raises:
        InputError: height out of range or unknown preset.
    """
    if not MIN_HEIGHT_M <= height_m <= MAX_HEIGHT_M:
        raise InputError(
            f"height {height_m:g} m is outside {MIN_HEIGHT_M}-{MAX_HEIGHT_M} m",
            fix="give the stature in metres",
        )
    if preset not in PRESETS:
        raise InputError(f"unknown body preset {preset!r}", fix=f"choose from {sorted(PRESETS)}")
    return _build(round(float(height_m), 4), preset, bool(self_collision), proportions)


@lru_cache(maxsize=256)
def _build(
    height_m: float, preset: str, self_collision: bool, proportions: Proportions | None
) -> Body:
    options = PRESETS[preset]
    spec = scaled_spec(height_m, preset, proportions)
    if self_collision:
        let_links_collide(spec)
    model = spec.compile()
    _check_names(model)
    return Body(
        model=model,
        height_m=height_m,
        preset=preset,
        proportions=proportions,
        torque_limits=model.actuator_ctrlrange[:, 1].copy(),
        damping=np.ravel(model.dof_damping)[6:].copy(),
        substeps=options.substeps,
    )


def let_links_collide(spec: mujoco.MjSpec) -> None:
    """Let the links of a spec collide with each other, not only with the floor."""
    for body in spec.bodies:
        for geom in body.geoms:
            if geom.contype:
                geom.conaffinity = 1


def scaled_spec(
    height_m: float = DEFAULT_HEIGHT_M,
    preset: str = "default",
    proportions: Proportions | None = None,
) -> mujoco.MjSpec:
    """The editable MjSpec behind ``build_body``, for scenes and viewers."""
    options = PRESETS[preset]
    ratio = height_m / DEFAULT_HEIGHT_M
    spec = mujoco.MjSpec.from_file(str(mjcf_path("humanoid.xml")))
    original = _default_model()
    spec.option.timestep = POLICY_TIMESTEP_S / options.substeps
    links = [body for body in spec.bodies if body.name != "world"]
    for body in links:
        _scale_inertia(body, original, ratio, options)
    if proportions is not None:
        deform(spec, proportions)
    for body in links:
        body.pos = body.pos * ratio
        for geom in body.geoms:
            geom.pos, geom.size = geom.pos * ratio, geom.size * ratio
            if not np.isnan(geom.fromto[0]):
                geom.fromto = geom.fromto * ratio
        for site in body.sites:
            site.pos, site.size = site.pos * ratio, site.size * ratio
        for joint in body.joints:
            if joint.type == mujoco.mjtJoint.mjJNT_HINGE:
                _scale_hinge(joint, ratio, options)
    for actuator in spec.actuators:
        limit = options.torque_limit or actuator.ctrlrange[1]
        actuator.ctrlrange = np.array([-1.0, 1.0]) * limit * ratio**options.torque_power
    return spec


def _scale_inertia(
    body: mujoco.MjsBody, original: mujoco.MjModel, ratio: float, options: BodyPreset
) -> None:
    """Set mass and inertia explicitly: the exponents may differ from those of a scaled solid."""
    link = original.body(body.name).id
    body.explicitinertial = True
    body.mass = original.body_mass[link] * ratio**options.mass_power
    body.ipos = original.body_ipos[link] * ratio
    body.iquat = original.body_iquat[link]
    body.inertia = original.body_inertia[link] * ratio**options.inertia_power


def _scale_hinge(joint: mujoco.MjsJoint, ratio: float, options: BodyPreset) -> None:
    torque = ratio**options.torque_power
    joint.damping = joint.damping * (torque if options.damped else 0.0)
    joint.frictionloss = options.joint_friction * torque
    joint.armature = joint.armature * ratio**options.inertia_power


@lru_cache(maxsize=1)
def _default_model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(mjcf_path("humanoid.xml")))


def _check_names(model: mujoco.MjModel) -> None:
    """Reject an MJCF whose order differs from the skeleton's: every array depends on it."""
    links = tuple(model.body(i).name for i in range(1, model.nbody))
    hinges = tuple(model.joint(i).name for i in range(1, model.njnt))
    motors = tuple(model.actuator(i).name for i in range(model.nu))
    for found, expected, what in (
        (links, LINKS, "bodies"),
        (hinges, DOFS, "hinges"),
        (motors, DOFS, "motors"),
    ):
        if found != expected:
            raise InputError(f"{what} are {found}, not {expected}", "humanoid.xml")
