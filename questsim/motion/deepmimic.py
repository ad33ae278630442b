"""DeepMimic's JSON files (also as pybullet ships them, with the ending .txt).

Source: Peng et al., "DeepMimic: Example-Guided Deep Reinforcement Learning of Physics-Based
Character Skills", SIGGRAPH 2018, and its released data: ``Frames`` are rows of 44 numbers, a
duration, the root's position and the joints' rotations.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from questsim import rotations as rot
from questsim.errors import InputError
from questsim.files import parse_json
from questsim.motion.recording import AGAIN, MAX_LENGTH, Recording, check_rate, decode, read_bytes

# Name, parent, place in the parent in metres, where the joint's turn begins in a row, and how
# many numbers it has: 4 quaternion wxyz, 1 angle about z, 0 fixed. x forward, y up, z right. Head
# and toes have no joint in the files: the head's base is the lower end of its sphere (radius 0.103
# around 0.176 above the neck), the ball of the foot seven tenths along its box of 0.177.
JOINTS: tuple[tuple[str, int, tuple[float, float, float], int, int], ...] = (
    ("root", -1, (0.0, 0.0, 0.0), 4, 4),
    ("chest", 0, (0.0, 0.236151, 0.0), 8, 4),
    ("neck", 1, (0.0, 0.223894, 0.0), 12, 4),
    ("head_base", 2, (0.0, 0.073, 0.0), 0, 0),
    ("right_hip", 0, (0.0, 0.0, 0.084887), 16, 4),
    ("right_knee", 4, (0.0, -0.421546, 0.0), 20, 1),
    ("right_ankle", 5, (0.0, -0.409870, 0.0), 21, 4),
    ("right_ball", 6, (0.080, -0.040, 0.0), 0, 0),
    ("right_shoulder", 1, (-0.02405, 0.24350, 0.18311), 25, 4),
    ("right_elbow", 8, (0.0, -0.274788, 0.0), 29, 1),
    ("right_wrist", 9, (0.0, -0.258947, 0.0), 0, 0),
    ("left_hip", 0, (0.0, 0.0, -0.084887), 30, 4),
    ("left_knee", 11, (0.0, -0.421546, 0.0), 34, 1),
    ("left_ankle", 12, (0.0, -0.409870, 0.0), 35, 4),
    ("left_ball", 13, (0.080, -0.040, 0.0), 0, 0),
    ("left_shoulder", 1, (-0.02405, 0.24350, -0.18311), 39, 4),
    ("left_elbow", 15, (0.0, -0.274788, 0.0), 43, 1),
    ("left_wrist", 16, (0.0, -0.258947, 0.0), 0, 0),
)
NUM_VALUES = 44
MAX_DURATION_S = 0.5
QUATERNION_LENGTHS = (0.3, 3.0)
"""Accepted range of quaternion norms; some released files blend them without normalising."""


def is_deepmimic(path: Path) -> bool:
    """Whether a text file is DeepMimic's: a JSON object with ``Frames``."""
    try:
        with path.open("rb") as file:
            start = file.read(4096)
    except OSError:
        return False
    return start.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{") and b'"Frames"' in start


def read_deepmimic(path: str | Path, fps: float | None = None) -> Recording:
    """Reads one DeepMimic file.

    Frames of different durations are resampled to the most frequent one, with linear positions
    and slerped rotations. The last frame's duration is ignored and may be zero.

    Args:
        path: the file.
        fps: the true frame rate; it overrides the durations.

    Raises:
        InputError: the file is missing, not JSON, not of the humanoid, or has bad numbers.
    """
    path = Path(path)
    data = read_bytes(path)
    frames = _frames(decode(data, path), path)
    if fps is None:
        times = _times(frames, path)
        step = float(np.median(np.diff(times))) if len(times) > 1 else 1 / 30
        fps = check_rate(1.0 / step, f"a frame of {step:g} s", path)
        even = np.arange(len(times)) * step
        # Durations are rounded to five digits: below half a frame in all it is still even.
        uneven = bool(abs(times - even).max() > 0.5 * step)
    else:
        times, uneven = np.arange(len(frames)) / fps, False
    positions = np.tile(np.array([offset for _, _, offset, _, _ in JOINTS]), (len(frames), 1, 1))
    positions[:, 0] = frames[:, 1:4]
    rotations = np.stack([_turns(frames, j, path) for j in range(len(JOINTS))], axis=1)
    if uneven:
        even = np.arange(int(times[-1] * fps + 1e-6) + 1) / fps
        root = rot.resample_points(positions[:, 0], times, even)
        positions = np.tile(positions[:1], (len(even), 1, 1))
        positions[:, 0] = root
        rotations = rot.resample_quat(rot.continuous(rotations), times, even)
    return Recording(
        path=path,
        names=tuple(name for name, *_ in JOINTS),
        parents=np.array([parent for _, parent, *_ in JOINTS]),
        positions=positions,
        rotations=rotations,
        fps=float(round(fps)) if abs(fps - round(fps)) < 2e-3 * fps else fps,
        sha256=hashlib.sha256(data).hexdigest(),
        notes=("frames of unequal duration put on the most frequent one",) if uneven else (),
    )


def _frames(text: str, path: Path) -> np.ndarray:
    """The rows ``(T, 44)`` of a file's text."""
    try:
        document = parse_json(text)
    except ValueError as error:
        raise InputError(f"is not JSON ({error})", path, AGAIN) from None
    rows = document.get("Frames") if isinstance(document, dict) else None
    if not isinstance(rows, list) or not rows:
        raise InputError("has no list 'Frames'", path, "give a DeepMimic motion file")
    for number, row in enumerate(rows):
        if not isinstance(row, list) or not all(type(v) in (int, float) for v in row):
            raise InputError(f"frame {number} is not a list of numbers", path, AGAIN)
        if len(row) != NUM_VALUES:
            raise InputError(
                f"frame {number} has {len(row)} numbers, the humanoid's have {NUM_VALUES}",
                path,
                "give a motion of DeepMimic's humanoid" if not number else AGAIN,
            )
    try:
        frames = np.array(rows, float)
    except OverflowError:
        frames = np.full((1, NUM_VALUES), np.inf)
    bad = np.flatnonzero(~(abs(frames) <= MAX_LENGTH).all(axis=1))
    if len(bad):
        raise InputError(f"frame {bad[0]} holds a number that is not finite", path, AGAIN)
    return frames


def _times(frames: np.ndarray, path: Path) -> np.ndarray:
    """Time of each frame in seconds ``(T,)``."""
    durations = frames[:-1, 0]
    bad = np.flatnonzero((durations <= 0) | (durations > MAX_DURATION_S))
    if len(bad):
        raise InputError(
            f"frame {bad[0]} lasts {durations[bad[0]]:g} s", path, "declare the rate with --fps"
        )
    return np.concatenate([[0.0], np.cumsum(durations)])


def _turns(frames: np.ndarray, joint: int, path: Path) -> np.ndarray:
    """Quaternions ``(T, 4)`` of a joint."""
    name, _, _, at, count = JOINTS[joint]
    if count == 0:
        return np.tile([1.0, 0.0, 0.0, 0.0], (len(frames), 1))
    if count == 1:
        return rot.as_quat(Rotation.from_euler("z", frames[:, [at]]), (len(frames),))
    quat = frames[:, at : at + 4]
    norm = np.linalg.norm(quat, axis=-1, keepdims=True)
    low, high = QUATERNION_LENGTHS
    bad = np.flatnonzero((norm[:, 0] < low) | (norm[:, 0] > high))
    if len(bad):
        raise InputError(f"{name} of frame {bad[0]} is not a unit quaternion", path, AGAIN)
    return quat / norm
