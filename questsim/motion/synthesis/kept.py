"""Cache of embedded clips in the cache folder."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import scipy

from questsim import body, body_proportions, rotations, skeleton
from questsim.assets import mjcf_path
from questsim.errors import InputError
from questsim.files import whole_file
from questsim.motion import clip as clip_module
from questsim.motion import kinematics
from questsim.motion.cache import cache_dir
from questsim.motion.clip import Clip

ARRAYS = {
    "qpos": (7 + skeleton.NUM_DOFS,),
    "qvel": (6 + skeleton.NUM_DOFS,),
    "link_position": (skeleton.NUM_LINKS, 3),
    "link_quat": (skeleton.NUM_LINKS, 4),
    "link_velocity": (skeleton.NUM_LINKS, 3),
    "link_angular_velocity": (skeleton.NUM_LINKS, 3),
    "contacts": (2,),
}
"""Shape of a frame of each array of a clip; a file holds them side by side."""


def kept_clip(key: str, about: dict[str, Any], make: Callable[[], Clip]) -> Clip:
    """A clip from the cache folder; made and stored there if absent.

    Velocities are stored too: computing them anew takes a third of the time in which an
    environment is made. If the cache cannot be read or written, the clip is made without an error.

    Args:
        key: everything that its arrays depend on besides this version's code.
        about: its fields that are not arrays.
        make: makes it.
    """
    digest = hashlib.sha256(f"{_code_digest()} {key}".encode()).hexdigest()[:32]
    path = cache_dir() / "synthetic" / f"{digest}.npy"
    arrays = _read(path)
    if arrays is not None:
        return Clip(**about, **arrays)
    clip = make()
    _write(path, np.concatenate([_flat(getattr(clip, name)) for name in ARRAYS], axis=1))
    return clip


def _flat(values: np.ndarray) -> np.ndarray:
    return np.asarray(values, float).reshape(len(values), -1)


def _read(path: Path) -> dict[str, Any] | None:
    try:
        table = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    sizes = [math.prod(shape) for shape in ARRAYS.values()]
    good = table.ndim == 2 and table.shape[1] == sum(sizes) and table.dtype == float
    if not good or not np.isfinite(table).all():
        return None
    parts = np.split(table, np.cumsum(sizes)[:-1], axis=1)
    arrays = {
        name: part.reshape(len(table), *shape)
        for (name, shape), part in zip(ARRAYS.items(), parts, strict=True)
    }
    return arrays | {"contacts": arrays["contacts"] != 0.0}


def _write(path: Path, table: np.ndarray) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as fresh:
            np.save(fresh, table)
    except (OSError, InputError):
        pass


_MODULES = (body, body_proportions, rotations, skeleton, kinematics, clip_module)


@lru_cache(maxsize=1)
def _code_digest() -> str:
    """Digest of the code, the body and the libraries that make the clips."""
    digest = hashlib.sha256(f"{np.__version__} {scipy.__version__} {mujoco.__version__}".encode())
    sources = sorted(Path(__file__).parent.glob("*.py"))
    sources += [Path(str(m.__file__)) for m in _MODULES]
    for source in [*sources, mjcf_path("humanoid.xml")]:
        digest.update(source.read_bytes())
    return digest.hexdigest()
