"""One PNG of a clip's feet close up, above a chart of the height of their soles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Chart
from PIL import Image, ImageDraw

from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M
from questsim.files import whole_file
from questsim.motion.clip import FPS, Clip
from questsim.motion.kinematics import sole_positions
from questsim.motion.stance import still_feet
from questsim.skeleton import FEET, FOOT_LINKS
from questsim.viewing.camera import Camera
from questsim.viewing.captions import INK, caption, font
from questsim.viewing.contact_sheet import TILE, pictures
from questsim.viewing.films import title

HEADER, STRIP = 40, 200
"""Height of the line above and of the chart below the pictures in pixels."""
DISTANCE_M, ELEVATION_DEG = 1.1, -5.0
SHOWN_CM = (-3.0, 15.0)
"""Of the chart."""


def feet_sheet(clip: Clip, path: str | Path, columns: int = 8) -> bool:
    """Write a PNG with the feet of evenly spaced frames, seen from the side, and their heights.

    Args:
        clip: the clip.
        path: the PNG file; its folder is made.
        columns: number of pictures.

    Returns:
        Whether the pictures are rendered; False for stick figures.

    Raises:
        InputError, OSError: the folder cannot be made or written.
    """
    frames = np.linspace(0, len(clip) - 1, min(columns, len(clip))).round().astype(int)
    tiles, rendered = pictures(clip, frames, [_camera(clip, frame) for frame in frames])
    width, height = TILE
    sheet = Image.new("RGB", (columns * width, HEADER + height + STRIP), (255, 255, 255))
    draw = ImageDraw.Draw(sheet)
    draw.text((12, 20), f"{title(clip)}, feet", font=font(18), fill=INK, anchor="lm")
    for i, (frame, tile) in enumerate(zip(frames, tiles, strict=True)):
        tile = caption(tile, {"bottom left": f"{frame / FPS:.2f} s"}, size=15)
        sheet.paste(Image.fromarray(tile), (i * width, HEADER))
    sheet.paste(_heights(clip, frames, columns * width), (0, HEADER + height))
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as fresh:
        sheet.save(fresh, "PNG", optimize=True)
    return rendered


def _camera(clip: Clip, frame: int) -> Camera:
    """At the lower foot, from the right of the body, just above the floor."""
    ratio = clip.height_m / DEFAULT_HEIGHT_M
    ankles = clip.link_position[frame, list(FOOT_LINKS)]
    middle = ankles[int(ankles[:, 2].argmin())]
    azimuth = float(np.degrees(rot.heading(clip.qpos[frame, 3:7]))) + 90.0
    return Camera(middle.copy(), DISTANCE_M * ratio, azimuth, ELEVATION_DEG)


def _heights(clip: Clip, frames: np.ndarray, width: int) -> Image.Image:
    """Lowest and highest point of each sole over time; thick where the foot is still."""
    dpi = 100
    chart = Chart(figsize=(width / dpi, STRIP / dpi), dpi=dpi)
    canvas = FigureCanvasAgg(chart)
    axes = chart.add_axes((90 / width, 0.24, 1 - 120 / width, 0.72))
    links = list(FOOT_LINKS)
    position, quat = clip.link_position[:, links], clip.link_quat[:, links]
    heights = 100.0 * sole_positions(position, quat, clip.height_m)[..., 2]
    still = still_feet(position, quat, clip.height_m)
    times = np.arange(len(clip)) / FPS
    for foot, colour in enumerate(("#2a6fc4", "#d65828")):
        lowest, highest = heights[:, foot].min(axis=-1), heights[:, foot].max(axis=-1)
        axes.fill_between(times, lowest, highest, color=colour, alpha=0.2, linewidth=0)
        axes.plot(times, lowest, color=colour, linewidth=1.0, label=FEET[foot].replace("_", " "))
        axes.plot(times, np.where(still[:, foot], lowest, np.nan), color=colour, linewidth=4.0)
    axes.axhline(0.0, color="#20242c", linewidth=0.8)
    axes.set_ylim(*SHOWN_CM)
    axes.set_xlim(0, max(times[-1], 1 / FPS))
    axes.set_ylabel("sole (cm)", fontsize=9)
    axes.set_xlabel(
        "time (s); line: lowest point, shade: to the highest, thick: still; dots: pictures",
        fontsize=9,
        labelpad=1,
    )
    axes.tick_params(labelsize=9, length=3)
    axes.plot(frames / FPS, np.full(len(frames), SHOWN_CM[0]), "k.", markersize=5, clip_on=False)
    axes.legend(loc="upper right", fontsize=8, ncols=2)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())
