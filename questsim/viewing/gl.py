"""Find an OpenGL library that can render off screen, without risk for this process.

MuJoCo picks its OpenGL backend from the environment variable ``MUJOCO_GL`` when it is imported, and
a backend without its library may raise any exception or abort. So each candidate renders one
picture in a separate process, and this process uses only a backend that has worked.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from functools import lru_cache

PACKAGES = {"egl": "libegl1", "osmesa": "libosmesa6", "glfw": "libgl1"}
"""The Debian package that brings each backend's library."""

_DISABLED = ("disable", "disabled", "off", "false", "0")
_PROBE_SECONDS = 60.0
_PROBE = """
import mujoco
model = mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody><light pos='0 0 3'/><geom size='1'/></worldbody></mujoco>")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 16, 16) as renderer:
    renderer.update_scene(data)
    assert renderer.render().any()
print("rendered")
"""


@dataclass(frozen=True)
class GL:
    """An OpenGL backend that has rendered a picture on this machine.

    Attributes:
        backend: ``"egl"``, ``"osmesa"``, ``"glfw"``, another value that the user gave in
            ``MUJOCO_GL``, or ``""`` for the operating system's own.
    """

    backend: str


class NoGLError(RuntimeError):
    """No OpenGL backend works; the message is one line that says what to install."""


def find_gl() -> GL | None:
    """The OpenGL backend to render with, or None; ``missing_gl()`` then says why.

    If ``MUJOCO_GL`` is set, only that backend is tried. Otherwise EGL, OSMesa and, with a display,
    GLFW are tried in this order. The answer is cached for the process.
    """
    wanted = os.environ.get("MUJOCO_GL")
    return _find(wanted, bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")))


def missing_gl() -> str:
    """One line: why rendering does not work here, and which Debian package to install."""
    wanted = os.environ.get("MUJOCO_GL", "").lower().strip()
    if wanted in _DISABLED:
        return f"rendering is switched off by MUJOCO_GL={wanted}"
    if wanted:
        package = PACKAGES.get(wanted)
        remedy = f"install Debian's {package} or unset MUJOCO_GL" if package else "unset MUJOCO_GL"
        return f"no picture can be rendered with MUJOCO_GL={wanted}; {remedy}"
    return "no OpenGL library to render with; install Debian's libosmesa6 or libegl1"


def use_gl() -> GL:
    """Find a backend and make MuJoCo use it in this process, imported already or not.

    Raises:
        NoGLError: none works; the message is ``missing_gl()``.
    """
    gl = find_gl()
    if gl is None:
        raise NoGLError(missing_gl())
    if gl.backend:
        os.environ["MUJOCO_GL"] = gl.backend
        switch_imported_mujoco(gl.backend)
    return gl


@lru_cache(maxsize=8)
def _find(wanted: str | None, display: bool) -> GL | None:
    if wanted and wanted.lower().strip() in _DISABLED:
        return None
    for backend in _candidates(wanted, display):
        if _renders(backend):
            return GL(backend)
    return None


def _candidates(wanted: str | None, display: bool) -> tuple[str, ...]:
    if wanted:
        return (wanted,)
    if not sys.platform.startswith("linux"):
        return ("",)
    return ("egl", "osmesa", "glfw") if display else ("egl", "osmesa")


def _renders(backend: str) -> bool:
    """Whether a fresh process renders a picture with ``MUJOCO_GL=backend``."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", _PROBE],
            env={**os.environ, "MUJOCO_GL": backend},
            capture_output=True,
            timeout=_PROBE_SECONDS,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0 and b"rendered" in done.stdout


def switch_imported_mujoco(backend: str) -> None:
    """Set MuJoCo's backend as if ``MUJOCO_GL`` had been set at its import.

    Its Renderer looks the context class up in ``gl_context`` at each use, and its C library reads
    the environment when the first context is made, so both follow.
    """
    if sys.platform != "linux" or "mujoco" not in sys.modules:
        return
    from mujoco.rendering.classic import gl_context

    if backend == "egl":
        from mujoco.egl import GLContext
    elif backend == "osmesa":
        from mujoco.osmesa import GLContext
    else:
        return
    gl_context.GLContext = GLContext
