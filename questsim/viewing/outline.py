"""The figure as points and lines, for camera framing and for drawing without OpenGL."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np
from PIL import Image, ImageDraw

from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M, build_body
from questsim.skeleton import LINK_PARENTS, LINKS
from questsim.viewing.camera import Camera

# Ends of the figure that are not the beginning of a link: metres of the 1.75 m body. Those of
# the head are counted from the headset.
_TIPS: tuple[tuple[str, tuple[float, float, float]], ...] = (
    ("head", (-0.09, 0.0, 0.1125)),
    ("head", (0.02, 0.0, 0.0)),
    ("left_hand", (0.0, 0.0, -0.17)),
    ("right_hand", (0.0, 0.0, -0.17)),
    ("left_foot", (0.18, 0.0, -0.065)),
    ("right_foot", (0.18, 0.0, -0.065)),
    ("left_foot", (-0.06, 0.0, -0.065)),
    ("right_foot", (-0.06, 0.0, -0.065)),
)
_COLOURS = {"left": (42, 111, 196), "right": (214, 88, 40), "": (60, 66, 78)}


def outline_points(position: np.ndarray, quat: np.ndarray, height_m: float) -> np.ndarray:
    """Link origins and tips ``(T, 24, 3)`` of link positions ``(T, 16, 3)`` and quaternions."""
    links = [LINKS.index(link) for link, _ in _TIPS]
    offsets = _tip_offsets() * height_m / DEFAULT_HEIGHT_M
    tips = position[:, links] + rot.quat_rotate(quat[:, links], offsets)
    return np.concatenate([position, tips], axis=1)


@lru_cache(maxsize=1)
def _tip_offsets() -> np.ndarray:
    """The tips ``(8, 3)`` in their links' frames, metres of the 1.75 m body."""
    headset = build_body().model.site("headset").pos
    return np.array([tip + headset * (link == "head") for link, tip in _TIPS])


def _bones() -> list[tuple[int, int, str]]:
    """Pairs of indices into the outline, and the side of the body that each is on."""
    pairs = [(p, i, LINKS[i]) for i, p in enumerate(LINK_PARENTS) if p != i]
    tips = [(LINKS.index(link), len(LINKS) + i, link) for i, (link, _) in enumerate(_TIPS)]
    pairs += [tip for tip in tips if tip[2] != "head"]  # the head is drawn as an ellipse
    return [(a, b, link.split("_")[0] if "_" in link else "") for a, b, link in pairs]


def stick_picture(points: np.ndarray, camera: Camera, width: int, height: int) -> np.ndarray:
    """A stick figure ``(height, width, 3)`` uint8 over the metre grid: left blue, right red.

    Args:
        points: ``(24, 3)`` of ``outline_points``.
        camera: the view.
        width: of the picture in pixels.
        height: of the picture in pixels.
    """
    over = 2  # drawn twice as large and reduced, for smooth lines
    image = Image.new("RGB", (width * over, height * over), (244, 246, 249))
    draw = ImageDraw.Draw(image)
    _draw_grid(draw, camera, *image.size)
    pixels = camera.project(points, *image.size)
    shadow = camera.project(points * [1.0, 1.0, 0.0], *image.size)
    thick = max(2, round(image.height / camera.distance / 45))
    for a, b, _ in _bones():
        draw.line([*shadow[a], *shadow[b]], fill=(205, 209, 216), width=thick)
    depth = points @ camera.axes()[2]
    for a, b, side in sorted(_bones(), key=lambda bone: -(depth[bone[0]] + depth[bone[1]])):
        draw.line([*pixels[a], *pixels[b]], fill=_COLOURS[side], width=2 * thick)
        for x, y in (pixels[a], pixels[b]):
            draw.ellipse((x - thick, y - thick, x + thick, y + thick), fill=_COLOURS[side])
    neck, crown = pixels[LINKS.index("head")], pixels[len(LINKS)]
    radius = 0.4 * float(np.linalg.norm(crown - neck))
    x, y = neck + 0.6 * (crown - neck)
    draw.ellipse((x - 0.8 * radius, y - radius, x + 0.8 * radius, y + radius), fill=_COLOURS[""])
    return np.asarray(image.reduce(over))


def _draw_grid(draw: ImageDraw.ImageDraw, camera: Camera, width: int, height: int) -> None:
    centre = np.round(camera.lookat[:2])
    for k in range(-4, 5):
        for line in (
            [[centre[0] + k, centre[1] - 4, 0], [centre[0] + k, centre[1] + 4, 0]],
            [[centre[0] - 4, centre[1] + k, 0], [centre[0] + 4, centre[1] + k, 0]],
        ):
            # Short pieces, so that only those behind the camera are left out.
            ends = np.linspace(line[0], line[1], 33)
            pixels = camera.project(ends, width, height)
            for a, b in pairwise(pixels):
                if np.isfinite([a, b]).all() and np.abs([a, b]).max() < 1e5:
                    draw.line([*a, *b], fill=(208, 212, 219), width=2)
