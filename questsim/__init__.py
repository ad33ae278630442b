"""QuestSim: a physically simulated avatar driven by a headset and two controllers."""

import importlib.util
import os
import sys

__version__ = "0.1.0"


class _MujocoWithoutDrawing:
    """Imports MuJoCo where the OpenGL library that MUJOCO_GL names may be missing.

    MuJoCo loads that library when it is imported and fails without it, although most of this
    package draws nothing. Whatever draws looks for a library that works (questsim/viewing/gl.py).
    """

    def find_spec(self, name: str, path: object = None, target: object = None) -> object:
        """Of MuJoCo alone: its own spec, with an import that does not see MUJOCO_GL."""
        if name != "mujoco":
            return None
        sys.meta_path.remove(self)  # type: ignore[arg-type]
        spec = importlib.util.find_spec(name)
        if spec is None or spec.loader is None:
            return spec
        load = spec.loader.exec_module

        def load_without_drawing(module: object) -> None:
            wanted = os.environ.pop("MUJOCO_GL", None)
            try:
                load(module)  # type: ignore[arg-type]
            finally:
                if wanted is not None:
                    os.environ["MUJOCO_GL"] = wanted

        spec.loader.exec_module = load_without_drawing  # type: ignore[method-assign]
        return spec


if os.environ.get("MUJOCO_GL") and "mujoco" not in sys.modules:
    sys.meta_path.insert(0, _MujocoWithoutDrawing())  # type: ignore[arg-type]
