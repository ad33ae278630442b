"""BVH and AMASS files that tests write: a small person in each known skeleton."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

SHARED = Path(__file__).parents[2] / "shared" / "mocap"
BANDAI_ZIP = SHARED / "bandai-namco-2.zip"
BANDAI_ROOT = (
    "Bandai-Namco-Research-Motiondataset-74ead3ba1ae4696404e6086233779f60de8bf9ef/dataset/"
    "Bandai-Namco-Research-Motiondataset-2/"
)

# Name, parent, offset: bone lengths and rest directions as the CMU skeletons have them (y up,
# facing z, x left, inches times 0.45, legs splayed by 20 degrees).
CMU_JOINTS: list[tuple[str, int, tuple[float, float, float]]] = [
    ("Hips", -1, (0, 0, 0)),
    ("LHipJoint", 0, (0, 0, 0)), ("LeftUpLeg", 1, (1.4, -1.8, 0.8)),
    ("LeftLeg", 2, (2.45, -6.73, 0)), ("LeftFoot", 3, (2.56, -7.04, 0)),
    ("LeftToeBase", 4, (0.16, -0.43, 2.3)),
    ("RHipJoint", 0, (0, 0, 0)), ("RightUpLeg", 6, (-1.4, -1.8, 0.8)),
    ("RightLeg", 7, (-2.45, -6.73, 0)), ("RightFoot", 8, (-2.56, -7.04, 0)),
    ("RightToeBase", 9, (-0.16, -0.43, 2.3)),
    ("LowerBack", 0, (0, 0, 0)), ("Spine", 11, (0, 2.1, -0.1)), ("Spine1", 12, (0, 2.1, 0)),
    ("Neck", 13, (0, 0, 0)), ("Neck1", 14, (0, 1.7, 0.1)), ("Head", 15, (0, 1.7, -0.1)),
    ("LeftShoulder", 13, (0, 0, 0)), ("LeftArm", 17, (3.4, 1.2, 0)),
    ("LeftForeArm", 18, (5.0, 0, 0)), ("LeftHand", 19, (3.4, 0, 0)),
    ("RightShoulder", 13, (0, 0, 0)), ("RightArm", 21, (-3.4, 1.2, 0)),
    ("RightForeArm", 22, (-5.0, 0, 0)), ("RightHand", 23, (-3.4, 0, 0)),
]  # fmt: skip

# The same for LAFAN1: centimetres, every bone along its own x axis.
LAFAN1_JOINTS: list[tuple[str, int, tuple[float, float, float]]] = [
    ("Hips", -1, (0, 0, 0)),
    ("LeftUpLeg", 0, (0.1, 1.9, 10.5)), ("LeftLeg", 1, (43.5, 0, 0)),
    ("LeftFoot", 2, (42.4, 0, 0)), ("LeftToe", 3, (17.3, 0, 0)),
    ("RightUpLeg", 0, (0.1, 1.9, -10.5)), ("RightLeg", 5, (43.5, 0, 0)),
    ("RightFoot", 6, (42.4, 0, 0)), ("RightToe", 7, (17.3, 0, 0)),
    ("Spine", 0, (6.9, -2.6, 0)), ("Spine1", 9, (12.6, 0, 0)), ("Spine2", 10, (12.3, 0, 0)),
    ("Neck", 11, (25.8, 0, 0)), ("Head", 12, (11.8, 0, 0)),
    ("LeftShoulder", 11, (19.7, -1.5, 6)), ("LeftArm", 14, (11.3, 0, 0)),
    ("LeftForeArm", 15, (33, 0, 0)), ("LeftHand", 16, (25.2, 0, 0)),
    ("RightShoulder", 11, (19.7, -1.5, -6)), ("RightArm", 18, (11.3, 0, 0)),
    ("RightForeArm", 19, (33, 0, 0)), ("RightHand", 20, (25.2, 0, 0)),
]  # fmt: skip

# Euler angles z, y, x in degrees of someone who stands with the arms out, facing z.
LAFAN1_T_POSE: dict[str, tuple[float, float, float]] = {
    "Hips": (90, 0, 90), "LeftUpLeg": (0, 180, 0), "RightUpLeg": (0, 180, 0),
    "LeftFoot": (90 - 21.45, 0, 0), "RightFoot": (90 - 21.45, 0, 0),
    "LeftToe": (21.45, 0, 0), "RightToe": (21.45, 0, 0),
    "LeftShoulder": (0, -90, 180), "RightShoulder": (0, 90, 180),
}  # fmt: skip

SMPL_JOINTS: list[tuple[str, int, tuple[float, float, float]]] = [
    ("Pelvis", -1, (0, 0, 0)),
    ("L_Hip", 0, (0.06, -0.09, 0)), ("L_Knee", 1, (0.04, -0.38, 0)),
    ("L_Ankle", 2, (-0.01, -0.4, -0.04)), ("L_Foot", 3, (0.04, -0.06, 0.12)),
    ("R_Hip", 0, (-0.06, -0.09, 0)), ("R_Knee", 5, (-0.04, -0.38, 0)),
    ("R_Ankle", 6, (0.01, -0.4, -0.04)), ("R_Foot", 7, (-0.04, -0.06, 0.12)),
    ("Spine1", 0, (0, 0.11, -0.02)), ("Spine2", 9, (0, 0.13, 0)), ("Spine3", 10, (0, 0.05, 0)),
    ("Neck", 11, (0, 0.21, -0.03)), ("Head", 12, (0, 0.09, 0.05)),
    ("L_Collar", 11, (0.07, 0.12, -0.02)), ("L_Shoulder", 14, (0.12, 0.05, -0.01)),
    ("L_Elbow", 15, (0.26, -0.01, -0.02)), ("L_Wrist", 16, (0.25, 0.01, 0)),
    ("R_Collar", 11, (-0.07, 0.12, -0.02)), ("R_Shoulder", 18, (-0.12, 0.05, -0.01)),
    ("R_Elbow", 19, (-0.26, -0.01, -0.02)), ("R_Wrist", 20, (-0.25, 0.01, 0)),
]  # fmt: skip


def write_bvh(
    path: Path,
    joints: Sequence[tuple[str, int, Sequence[float]]],
    root: np.ndarray,
    angles: Mapping[str, ArrayLike] | None = None,
    *,
    order: str = "ZYX",
    frame_time: float = 1 / 30,
) -> Path:
    """Writes a BVH file.

    Args:
        path: the file.
        joints: name, index of the parent, offset.
        root: ``(T, 3)`` root positions.
        angles: Euler angles in degrees ``(T, 3)`` or ``(3,)`` by joint, in the channels' order.
        order: the channels' order.
        frame_time: seconds a frame.
    """
    lines: list[str] = ["HIERARCHY"]
    columns: list[np.ndarray] = [np.asarray(root, float)]

    def write(joint: int, depth: int) -> None:
        name, parent, offset = joints[joint]
        tab = "\t" * depth
        lines.append(f"{tab}{'ROOT' if parent < 0 else 'JOINT'} {name}")
        lines.append(f"{tab}{{")
        lines.append(f"{tab}\tOFFSET {offset[0]} {offset[1]} {offset[2]}")
        turns = " ".join(f"{axis}rotation" for axis in order)
        where = "6 Xposition Yposition Zposition" if parent < 0 else "3"
        lines.append(f"{tab}\tCHANNELS {where} {turns}")
        angle = np.asarray((angles or {}).get(name, (0, 0, 0)), float)
        columns.append(np.broadcast_to(angle, (len(root), 3)))
        children = [i for i, (_, p, _) in enumerate(joints) if p == joint]
        for child in children:
            write(child, depth + 1)
        if not children:
            lines.extend([f"{tab}\tEnd Site", f"{tab}\t{{", f"{tab}\t\tOFFSET 0 0 0", f"{tab}\t}}"])
        lines.append(f"{tab}}}")

    write(0, 0)
    rows = np.concatenate(columns, axis=1)
    lines += ["MOTION", f"Frames: {len(rows)}", f"Frame Time: {frame_time:.7f}"]
    lines += [" ".join(f"{value:.6f}" for value in row) for row in rows]
    path.write_text("\n".join(lines) + "\n")
    return path


def standing(frames: int, height: float) -> np.ndarray:
    """A root ``(T, 3)`` at rest at this height, y up."""
    return np.tile([0.0, height, 0.0], (frames, 1))


def write_amass(path: Path, frames: int = 40, *, fps: float = 60.0, **changes) -> Path:
    """Writes an AMASS file of someone who stands still, facing -y; ``changes`` replace arrays."""
    poses = np.zeros((frames, 156))
    poses[:, 0] = np.pi / 2  # SMPL's rest pose has y up, AMASS's world has z up
    trans = np.tile([0.3, 0.2, 0.97], (frames, 1))
    arrays = {
        "poses": poses, "trans": trans, "betas": np.zeros(16), "mocap_framerate": np.array(fps)
    } | changes  # fmt: skip
    np.savez(path, **{key: value for key, value in arrays.items() if value is not None})
    return path
