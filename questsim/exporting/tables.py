"""Motions as arrays: AMASS-style npz, and CSV with named columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from questsim import rotations as rot
from questsim.exporting.axes import y_up_quat
from questsim.motion.amass import SMPL_NAMES
from questsim.motion.clip import FPS, Clip
from questsim.motion.convert import world_axes
from questsim.motion.families import SMPL
from questsim.motion.motion import Motion
from questsim.skeleton import DOFS, JOINTS, LINKS

_POSE_NUMBERS = 156  # SMPL-H: 22 joints of the body, 30 of the hands
_NUM_BETAS = 16


def write_amass(path: Path, motion: Motion) -> None:
    """Write ``poses`` ``(T, 156)``, ``trans``, ``betas``, ``gender``, ``mocap_framerate``.

    z up, metres, radians; hands are flat. ``trans`` is where the pelvis is: a SMPL model puts it
    beside that by the pelvis of its own mean shape. SMPL's bones are its own: orientations are
    kept, places of joints are those of the reader's body.
    """
    # SMPL's zero pose is ours seen with y up, facing +z.
    local = y_up_quat(motion.rotations)
    # Its root turns from those axes to a world with z up, in which people by custom face -y.
    from_smpl = rot.matrix_to_quat(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    facing = rot.matrix_to_quat(world_axes("z").T)
    local[:, 0] = rot.quat_multiply(facing, rot.quat_multiply(motion.rotations[:, 0], from_smpl))
    ours = {theirs: name for name, theirs in SMPL.joints.items()}
    order = [JOINTS.index(ours[name]) for name in SMPL_NAMES]
    poses = np.zeros((len(motion), _POSE_NUMBERS))
    turns = rot.as_rotation(local[:, order]).as_rotvec()
    poses[:, : 3 * len(order)] = turns.reshape(len(motion), -1)
    with path.open("wb") as file:
        np.savez_compressed(
            file,
            poses=poses,
            trans=motion.root_position @ world_axes("z"),
            betas=np.zeros(_NUM_BETAS),
            gender="neutral",
            mocap_framerate=motion.fps,
        )


def write_csv(path: Path, clip: Clip) -> None:
    """Write a row a frame: time, root, 33 angles in rad, links in the world, contacts.

    Columns: ``time_s``, ``root_x`` to ``root_qz`` (metres, quaternion wxyz), one a hinge named as
    in ``skeleton.DOFS``, ``link_NAME_x`` to ``link_NAME_qz`` for each link, ``left_foot_contact``
    and ``right_foot_contact`` as 0 or 1. z up, x forward.
    """
    parts = ("x", "y", "z", "qw", "qx", "qy", "qz")
    names = ["time_s", *(f"root_{p}" for p in parts), *DOFS]
    names += [f"link_{link}_{p}" for link in LINKS for p in parts]
    names += ["left_foot_contact", "right_foot_contact"]
    links = np.concatenate([clip.link_position, clip.link_quat], axis=-1)
    table = np.column_stack(
        [np.arange(len(clip)) / FPS, clip.qpos, links.reshape(len(clip), -1), clip.contacts]
    )
    np.savetxt(path, table, fmt="%.7g", delimiter=",", header=",".join(names), comments="")
