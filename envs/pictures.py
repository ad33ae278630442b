"""Pictures of a batch's avatars, and a window that shows one."""

from __future__ import annotations

from typing import Any

import numpy as np

from envs.core import BatchSim
from envs.objects import shapes_of
from questsim.errors import InputError
from questsim.skeleton import NUM_DOFS

POSE_SIZE = 7 + NUM_DOFS
"""Root position (m), root quaternion wxyz, 33 joint angles (rad), in the world."""


def check_render_mode(render_mode: Any, modes: list[str]) -> None:
    """Reject an unknown render mode, or a window without pygame.

    Raises:
        InputError: with the valid modes, or what to install.
    """
    if render_mode is not None and render_mode not in modes:
        listed = ", ".join(map(repr, modes))
        what = f"{str(render_mode)[:80]!r} is not a render mode"
        raise InputError(what, "render_mode", f"use None or {listed}")
    if render_mode == "human":
        _pygame()


def _pygame() -> Any:
    try:
        import pygame  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise InputError(
            "'human' shows a window with pygame, which is not installed",
            "render_mode",
            "pip install pygame, or use 'rgb_array'",
        ) from None
    return pygame


class Pictures:
    """Renders the simulations of a batch; the camera is set by the avatar's first heading.

    Args:
        sim: the batch.
    """

    def __init__(self, sim: BatchSim) -> None:
        self._sim = sim
        self._renderers: dict[Any, Any] = {}
        self._azimuth: dict[int, float] = {}

    def of(self, i: int) -> np.ndarray:
        """Simulation ``i`` as an image ``(480, 640, 3)`` uint8.

        Raises:
            NoGLError: there is no OpenGL library to render with.
        """
        from questsim.viewing.camera import Camera, three_quarter_azimuth
        from questsim.viewing.render import DrawnAvatar, SceneRenderer, object_markers

        sim, height = self._sim, float(self._sim.heights[i])
        body = (height, sim.bodies.proportions[i])
        if body not in self._renderers:
            field = sim.placement.field
            figure = DrawnAvatar(height, body=sim.avatar.own, proportions=body[1])
            self._renderers[body] = SceneRenderer([figure], ground=field)
        pose = sim.qpos[i, : 7 + len(sim.avatar.dofs)]
        if i not in self._azimuth:
            self._azimuth[i] = three_quarter_azimuth(pose[None, 3:7])
        markers = []
        for obj, place in zip(sim.config.objects, sim.objects.pose[i], strict=True):
            markers += object_markers(shapes_of(obj, height), place[:3], place[3:])
        lookat = np.array([pose[0], pose[1], sim.floor[i] + height / 2.0])
        camera = Camera(lookat, 2.0 * height, self._azimuth[i])
        return self._renderers[body].render([pose], camera, markers)

    def close(self) -> None:
        """Free the OpenGL contexts."""
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers.clear()


class Window:
    """A window of pygame's.

    Args:
        fps: pictures a second, at most.
    """

    def __init__(self, fps: float) -> None:
        self._pygame, self._fps = _pygame(), fps
        self._screen: Any = None
        self._clock: Any = None

    def show(self, picture: np.ndarray) -> None:
        """Show a picture ``(height, width, 3)`` uint8; waits to keep the frame rate."""
        pygame = self._pygame
        if self._screen is None:
            pygame.display.init()
            self._screen = pygame.display.set_mode(picture.shape[1::-1])
            pygame.display.set_caption("QuestSim")
            self._clock = pygame.time.Clock()
        surface = pygame.surfarray.make_surface(picture.swapaxes(0, 1))
        self._screen.blit(surface, (0, 0))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(self._fps)

    def close(self) -> None:
        """Close the window."""
        if self._screen is not None:
            self._pygame.display.quit()
            self._screen = None
