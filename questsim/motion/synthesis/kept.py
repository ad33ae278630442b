"""Cache of the poses of synthetic clips, in this process and in the cache folder."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np
import scipy

from questsim import body, rotations, skeleton
from questsim.assets import mjcf_path
from questsim.errors import InputError
from questsim.files import whole_file
from questsim.motion import kinematics


def kept_poses(key: str, make: Callable[[], np.ndarray]) -> np.ndarray:
    """Poses ``(T, 40)`` from the cache folder; generated and stored there if absent.

    If the cache cannot be read or written, the poses are generated without an error.

    Args:
        key: everything that they depend on besides this version's code.
        make: generates them.
    """
    digest = hashlib.sha256(f"{_code_digest()} {key}".encode()).hexdigest()[:32]
    from questsim.motion.datasets import cache_dir  # late, for the download library it imports

    path = cache_dir() / "synthetic" / f"{digest}.npy"
    poses = _read(path)
    if poses is None:
        poses = make()
        _write(path, poses)
    return poses


def _read(path: Path) -> np.ndarray | None:
    try:
        poses = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    good = poses.ndim == 2 and poses.shape[1] == 7 + skeleton.NUM_DOFS and poses.dtype == float
    return poses if good and np.isfinite(poses).all() else None


def _write(path: Path, poses: np.ndarray) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as fresh:
            np.save(fresh, poses)
    except (OSError, InputError):
        pass


@lru_cache(maxsize=1)
def _code_digest() -> str:
    """Digest of the code, the body and the libraries that make the poses."""
    digest = hashlib.sha256(f"{np.__version__} {scipy.__version__} {mujoco.__version__}".encode())
    sources = sorted(Path(__file__).parent.glob("*.py"))
    sources += [Path(str(m.__file__)) for m in (body, rotations, skeleton, kinematics)]
    for source in [*sources, mjcf_path("humanoid.xml")]:
        digest.update(source.read_bytes())
    return digest.hexdigest()
