"""QuestSim: a physically simulated avatar driven by a headset and two controllers."""

import contextlib
import os
import sys

__version__ = "0.1.0"


def _import_mujoco_without_drawing() -> None:
    """Import MuJoCo even if the OpenGL library that MUJOCO_GL names is missing.

    MuJoCo loads that library at import and fails without it, although most of this package renders
    nothing. Rendering code finds a library that works (questsim/viewing/gl.py).
    """
    from questsim.viewing.gl import switch_imported_mujoco

    wanted = os.environ.pop("MUJOCO_GL")
    try:
        import mujoco  # noqa: F401
    finally:
        os.environ["MUJOCO_GL"] = wanted
    with contextlib.suppress(Exception):  # a missing library can raise any exception
        switch_imported_mujoco(wanted.lower().strip())


if os.environ.get("MUJOCO_GL") and "mujoco" not in sys.modules:
    _import_mujoco_without_drawing()
