"""Motions for other programs: BVH, GLB, AMASS-style npz and CSV."""

from __future__ import annotations

from pathlib import Path

from questsim.errors import InputError
from questsim.exporting.bvh_file import write_avatar_bvh, write_joint_bvh
from questsim.exporting.formats import FORMATS, SKELETONS, check_format, needs, safe_names
from questsim.exporting.tables import write_amass, write_csv
from questsim.files import whole_file
from questsim.motion.clip import Clip
from questsim.motion.motion import Motion

__all__ = ["FORMATS", "SKELETONS", "check_format", "safe_names", "write_clip", "write_motion"]


def write_clip(path: Path, clip: Clip, skeleton: str = "joints") -> None:
    """Write a clip of the avatar; the suffix of the file selects the format.

    Args:
        path: ``.bvh``, ``.glb``, ``.npz`` or ``.csv``.
        clip: the clip to write.
        skeleton: of a BVH file: ``joints`` for the 22 joints of a ``Motion``, whose zero pose is
            a T-pose, ``avatar`` for the 16 links as they are. GLB and CSV always have the
            avatar, npz the 22 joints.

    Raises:
        InputError: another ending, or the file cannot be written.
    """
    from questsim.motion.retarget_back import to_motion

    kind = check_format(path.suffix, str(path))
    if kind == "glb":
        needs("pygltflib", path)
    with whole_file(path) as fresh:
        if kind == "glb":
            from questsim.exporting.glb import write_glb

            write_glb(fresh, clip)
        elif kind == "csv":
            write_csv(fresh, clip)
        elif kind == "npz":
            write_amass(fresh, to_motion(clip))
        elif skeleton == "avatar":
            write_avatar_bvh(fresh, clip)
        else:
            write_joint_bvh(fresh, to_motion(clip))


def write_motion(path: Path, motion: Motion) -> None:
    """Write a motion on the 22 joints, at its own frame rate, as ``.bvh`` or ``.npz``.

    Raises:
        InputError: another ending, or the file cannot be written.
    """
    kind = check_format(path.suffix, str(path))
    if kind not in ("bvh", "npz"):
        what = f"a motion on the 22 joints cannot be written as .{kind}"
        raise InputError(what, path, "name a .bvh or .npz file")
    with whole_file(path) as fresh:
        (write_joint_bvh if kind == "bvh" else write_amass)(fresh, motion)
