"""The MJCF of a body in the form that the environments need: one floor, a motor on each hinge."""

from __future__ import annotations

import mujoco
import numpy as np

from questsim.bodies.description import Description
from questsim.body import POLICY_TIMESTEP_S
from questsim.errors import InputError

_FLOOR_SIZE_M = 50.0


def own_spec(description: Description) -> mujoco.MjSpec:
    """The body alone on a plane, with motors in the order of its hinges and sensors of its feet.

    Furniture of the world, actuators, tendons, sensors and keyframes of the MJCF are left out.

    Raises:
        InputError: MuJoCo cannot read the MJCF, or it is no body of hinges on a free joint.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(description.mjcf))
        model = spec.compile()
    except (ValueError, OSError) as error:
        raise InputError(f"MuJoCo cannot read it ({error})", description.mjcf) from None
    root = _check_joints(description, model)
    limits = _torque_limits(description, model)
    hinges = [model.joint(i).name for i in range(model.njnt) if i != model.body_jntadr[root]]
    _strip(spec, model.body(root).name)
    _set_masses(description, spec, model)
    spec.option.timestep = POLICY_TIMESTEP_S / description.substeps
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    spec.option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    spec.option.iterations = 100
    spec.memory = 1 << 20
    for name in hinges:
        motor = spec.add_actuator(
            name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, ctrllimited=1,
            ctrlrange=[-limits[name], limits[name]], forcelimited=0,
        )  # fmt: skip
        motor.set_to_motor()
        motor.gear[:] = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    for side in ("left", "right"):
        _add_foot_sensor(spec, side, description.links[f"{side}_foot"].body, description)
    return spec


def hinge_limits(model: mujoco.MjModel) -> np.ndarray:
    """Torque limits ``(D,)`` in N m of the motors of ``own_spec``."""
    return model.actuator_ctrlrange[:, 1].copy()


def _check_joints(description: Description, model: mujoco.MjModel) -> int:
    """The body of the only free joint; every other joint is a named hinge of its tree."""
    free = np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))
    where = description.mjcf
    if len(free) != 1:
        fix = "give the root body one freejoint"
        raise InputError(f"has {len(free)} free joints, not 1", where, fix)
    root = int(model.jnt_bodyid[free[0]])
    for joint in range(model.njnt):
        name = model.joint(joint).name
        if joint == free[0]:
            continue
        if model.jnt_type[joint] != int(mujoco.mjtJoint.mjJNT_HINGE):
            raise InputError(
                f"joint {name!r} is not a hinge", where, "use hinges, one for each axis"
            )
        if not name:
            owner = model.body(int(model.jnt_bodyid[joint])).name
            raise InputError(f"a joint of {owner!r} has no name", where, "name every joint")
        if int(model.body_rootid[model.jnt_bodyid[joint]]) != root:
            raise InputError(f"joint {name!r} is not on the body of the free joint", where)
    if model.body_parentid[root] != 0:
        raise InputError("the body of the free joint is not at the top of the tree", where)
    if model.neq:
        raise InputError("has equality constraints, which no map describes", where, "remove them")
    return root


def _torque_limits(description: Description, model: mujoco.MjModel) -> dict[str, float]:
    """N m of every hinge: of the description, of its actuator, or of the joint."""
    hinge = int(mujoco.mjtJoint.mjJNT_HINGE)
    hinges = {model.joint(i).name: i for i in range(model.njnt) if model.jnt_type[i] == hinge}
    for field in ("torque_limits", "rest"):
        for name in getattr(description, field):
            if name not in hinges:
                where = f"{description.path}, {field}"
                raise InputError(
                    f"the MJCF has no hinge {name!r}", where, f"it has {', '.join(hinges)}"
                )
    limits: dict[str, float] = {}
    for actuator in range(model.nu):
        limit = _actuator_limit(model, actuator)
        if limit is not None:
            limits[model.joint(int(model.actuator_trnid[actuator, 0])).name] = limit
    for name, joint in hinges.items():
        if name not in limits and model.jnt_actfrclimited[joint]:
            limits[name] = float(np.abs(model.jnt_actfrcrange[joint]).max())
    limits |= description.torque_limits
    for name in hinges:
        if not limits.get(name, 0.0) > 0.0:
            raise InputError(
                f"hinge {name!r} has no motor with a limit",
                description.mjcf,
                f"add {name} = N m to [torque_limits] of {description.path.name}",
            )
    return limits


def _actuator_limit(model: mujoco.MjModel, actuator: int) -> float | None:
    if model.actuator_trntype[actuator] != int(mujoco.mjtTrn.mjTRN_JOINT):
        return None
    gear = abs(float(model.actuator_gear[actuator, 0]))
    if model.actuator_forcelimited[actuator]:
        return gear * float(np.abs(model.actuator_forcerange[actuator]).max())
    joint = int(model.actuator_trnid[actuator, 0])
    if model.jnt_actfrclimited[joint]:
        return float(np.abs(model.jnt_actfrcrange[joint]).max())
    motor = model.actuator_biastype[actuator] == int(mujoco.mjtBias.mjBIAS_NONE)
    if motor and model.actuator_ctrllimited[actuator]:
        gain = abs(float(model.actuator_gainprm[actuator, 0]))
        return gear * gain * float(np.abs(model.actuator_ctrlrange[actuator]).max())
    return None


def _strip(spec: mujoco.MjSpec, root: str) -> None:
    """Leave the body alone on a plane."""
    world = spec.worldbody
    for part in (
        *spec.actuators, *spec.sensors, *spec.tendons, *spec.keys, *spec.pairs,
        *world.geoms, *world.sites, *world.cameras, *world.lights,
    ):  # fmt: skip
        spec.delete(part)
    for body in list(world.bodies):
        if body.name != root:
            spec.delete(body)
    # Room for user data and keyframes would differ from the scenes that show the body.
    spec.nkey, spec.nuser_geom = 0, -1
    for body in spec.bodies[1:]:
        for geom in body.geoms:
            geom.userdata = []
            touches = bool(geom.contype or geom.conaffinity)
            geom.contype, geom.conaffinity = int(touches), 0
    spec.worldbody.add_light(
        name="sun", type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, pos=[0, 0, 4], dir=[-0.3, 0.3, -1]
    )
    spec.worldbody.add_geom(
        name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[_FLOOR_SIZE_M, _FLOOR_SIZE_M, 1.0],
        contype=0, conaffinity=1, condim=3, friction=[1.0, 0.005, 0.0001],
    )  # fmt: skip


def _set_masses(description: Description, spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Set the described masses; inertias change in proportion."""
    known = [model.body(i).name for i in range(1, model.nbody)]
    for name, mass in description.masses.items():
        if name not in known:
            where = f"{description.path}, masses"
            what = f"the MJCF has no body {name!r}"
            raise InputError(what, where, f"it has {', '.join(known)}")
        body, index = spec.body(name), model.body(name).id
        if not model.body_mass[index] > 0.0:
            raise InputError(f"{name!r} has no mass to change", f"{description.path}, masses")
        body.explicitinertial = True
        body.mass = mass
        body.ipos, body.iquat = model.body_ipos[index], model.body_iquat[index]
        body.inertia = model.body_inertia[index] * mass / model.body_mass[index]


def _add_foot_sensor(spec: mujoco.MjSpec, side: str, foot: str, description: Description) -> None:
    """The force of a foot and everything below it on the floor."""
    if spec.body(foot) is None:
        where = f"{description.path}, links.{side}_foot"
        raise InputError(f"the MJCF has no body {foot!r}", where)
    spec.add_sensor(
        name=f"{side}_foot_force", type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_XBODY, objname=foot,
        reftype=mujoco.mjtObj.mjOBJ_BODY, refname="world",
        intprm=[1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 3, 1],
    )  # fmt: skip
