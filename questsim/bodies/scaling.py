"""A body of the user's own in another size.

As with the avatar's default preset, lengths scale by the ratio of the statures, masses, torques and
damping by its third power, and inertias and armature by its fifth: the density stays.
"""

from __future__ import annotations

import mujoco
import numpy as np


def scaled_spec(spec: mujoco.MjSpec, ratio: float) -> mujoco.MjSpec:
    """A copy of the spec of ``own_mjcf.own_spec`` with a body of another size.

    Args:
        spec: the body on a plane.
        ratio: wanted stature over that of the body.
    """
    model, spec = spec.copy().compile(), spec.copy()
    for body in spec.bodies[1:]:
        _scale_inertia(body, model, ratio)
        body.pos = body.pos * ratio
        for geom in body.geoms:
            geom.pos, geom.size = geom.pos * ratio, geom.size * ratio
            if not np.isnan(geom.fromto[0]):
                geom.fromto = geom.fromto * ratio
        for part in (*body.sites, *body.cameras, *body.lights, *body.frames):
            part.pos = part.pos * ratio
        for site in body.sites:
            site.size = site.size * ratio
        for joint in body.joints:
            _scale_joint(joint, ratio)
    for mesh in spec.meshes:
        mesh.scale = mesh.scale * ratio
    for actuator in spec.actuators:
        actuator.ctrlrange = actuator.ctrlrange * ratio**3
    return spec


def _scale_inertia(body: mujoco.MjsBody, model: mujoco.MjModel, ratio: float) -> None:
    """Set mass and inertia explicitly: an MJCF may give them for the body or for its shapes."""
    index = model.body(body.name).id
    body.explicitinertial = True
    body.mass = model.body_mass[index] * ratio**3
    body.ipos, body.iquat = model.body_ipos[index] * ratio, model.body_iquat[index]
    body.fullinertia = np.full(6, np.nan)
    body.inertia = model.body_inertia[index] * ratio**5


def _scale_joint(joint: mujoco.MjsJoint, ratio: float) -> None:
    torque = ratio**3
    joint.pos = joint.pos * ratio
    joint.damping, joint.stiffness = joint.damping * torque, joint.stiffness * torque
    joint.frictionloss = joint.frictionloss * torque
    joint.actfrcrange = joint.actfrcrange * torque
    joint.armature = joint.armature * ratio**5
