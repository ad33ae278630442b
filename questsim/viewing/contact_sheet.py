"""One PNG that shows a whole clip: pictures, times, foot contacts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Chart
from PIL import Image, ImageDraw

from questsim.files import whole_file
from questsim.motion.clip import FPS, Clip
from questsim.skeleton import FEET
from questsim.viewing.camera import Camera
from questsim.viewing.captions import INK, caption, font
from questsim.viewing.films import clip_cameras, title
from questsim.viewing.gl import NoGLError
from questsim.viewing.outline import outline_points, stick_picture

TILE = (240, 320)
"""Width and height of a picture in pixels."""

HEADER, STRIP = 64, 150
"""Height of the lines above and of the chart below the pictures in pixels."""


def contact_sheet(clip: Clip, path: str | Path, columns: int = 8, rows: int = 2) -> bool:
    """Write a PNG with evenly spaced frames of a clip over a chart of its foot contacts.

    Without an OpenGL library the pictures are stick figures, so there always is a sheet.

    Args:
        clip: the clip.
        path: the PNG file; its folder is made.
        columns: pictures in a row.
        rows: rows of pictures; a short clip gets fewer.

    Returns:
        Whether the pictures are rendered; False for stick figures.

    Raises:
        InputError, OSError: the folder cannot be made or written.
    """
    rows = max(1, min(rows, len(clip) // columns))
    frames = np.linspace(0, len(clip) - 1, min(columns * rows, len(clip))).round().astype(int)
    width, height = TILE
    cameras = clip_cameras(clip, width / height, smoothing_s=0.0)
    tiles, rendered = pictures(clip, frames, [cameras[frame] for frame in frames])
    sheet = Image.new("RGB", (columns * width, HEADER + rows * height + STRIP), (255, 255, 255))
    _draw_header(ImageDraw.Draw(sheet), clip)
    for i, (frame, tile) in enumerate(zip(frames, tiles, strict=True)):
        tile = caption(tile, {"bottom left": f"{frame / FPS:.2f} s"}, size=15)
        sheet.paste(Image.fromarray(tile), (i % columns * width, HEADER + i // columns * height))
    lines = ImageDraw.Draw(sheet)
    for column in range(1, columns):
        x = column * width
        lines.line((x, HEADER, x, HEADER + rows * height), fill=(255, 255, 255), width=2)
    strip = _contact_strip(clip, frames, columns * width)
    sheet.paste(strip, (0, HEADER + rows * height))
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as fresh:
        sheet.save(fresh, "PNG", optimize=True)
    return rendered


def pictures(
    clip: Clip, frames: np.ndarray, cameras: Sequence[Camera]
) -> tuple[list[np.ndarray], bool]:
    """A picture of the size of ``TILE`` of each frame, and whether they are rendered.

    Without an OpenGL library they are stick figures.
    """
    try:
        return list(_rendered(clip, frames, cameras)), True
    except NoGLError:
        return list(_sticks(clip, frames, cameras)), False


def _rendered(clip: Clip, frames: np.ndarray, cameras: Sequence[Camera]) -> Iterator[np.ndarray]:
    from questsim.viewing.render import DrawnAvatar, SceneRenderer

    width, height = TILE
    # Twice as large and reduced: shadows have no smooth edges otherwise.
    with SceneRenderer(
        [DrawnAvatar(clip.height_m, proportions=clip.proportions)], 2 * width, 2 * height
    ) as renderer:
        for frame, camera in zip(frames, cameras, strict=True):
            picture = renderer.render([clip.qpos[frame]], camera)
            yield np.asarray(Image.fromarray(picture).reduce(2))


def _sticks(clip: Clip, frames: np.ndarray, cameras: Sequence[Camera]) -> Iterator[np.ndarray]:
    width, height = TILE
    points = outline_points(clip.link_position, clip.link_quat, clip.height_m)
    for frame, camera in zip(frames, cameras, strict=True):
        yield stick_picture(points[frame], camera, width, height)


def _draw_header(draw: ImageDraw.ImageDraw, clip: Clip) -> None:
    """The clip's name, and what is known about it."""
    travelled = float(np.linalg.norm(np.diff(clip.qpos[:, :2], axis=0), axis=-1).sum())
    speed = travelled / clip.duration if clip.duration else 0.0
    facts = [
        " ".join(word for word in (clip.style, clip.kind) if word),
        f"{clip.duration:.2f} s, {len(clip)} frames",
        f"{travelled:.1f} m at {speed:.2f} m/s",
        Path(clip.source).name,
        clip.licence,
    ]
    draw.text((12, 20), title(clip), font=font(22), fill=INK, anchor="lm")
    facts_line = "   |   ".join(fact for fact in facts if fact)
    draw.text((12, 46), facts_line, font=font(15), fill=(96, 102, 114), anchor="lm")


def _contact_strip(clip: Clip, frames: np.ndarray, width: int) -> Image.Image:
    """Chart of foot contacts, the root's speed, and the times of the pictures."""
    dpi = 100
    chart = Chart(figsize=(width / dpi, STRIP / dpi), dpi=dpi)
    canvas = FigureCanvasAgg(chart)
    axes = chart.add_axes((90 / width, 0.28, 1 - 160 / width, 0.66))
    times = np.arange(len(clip)) / FPS
    for row, colour in enumerate(("#2a6fc4", "#d65828")):
        edges = np.diff(np.concatenate([[0], clip.contacts[:, row].astype(int), [0]]))
        starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
        spans = [(s / FPS, (e - s) / FPS) for s, e in zip(starts, ends, strict=True)]
        axes.broken_barh(spans, (1.12 - row, 0.76), color=colour, alpha=0.85)
        axes.axhline(1.0 - row, color="#d0d4db", linewidth=0.8)
    axes.set_yticks([1.5, 0.5], [foot.replace("_", " ") for foot in FEET], fontsize=9)
    axes.set_ylim(0, 2)
    axes.set_xlim(0, max(times[-1], 1 / FPS))
    axes.set_xlabel("time (s); bars: foot on the floor; dots: pictures", fontsize=9, labelpad=1)
    axes.tick_params(labelsize=9, length=3)
    axes.plot(frames / FPS, np.full(len(frames), 0.0), "k.", markersize=5, clip_on=False)
    speed = axes.twinx()
    speed.plot(times, np.linalg.norm(clip.qvel[:, :2], axis=-1), color="#20242c", linewidth=1.0)
    speed.set_ylim(bottom=0.0)
    speed.set_ylabel("root (m/s)", fontsize=9)
    speed.tick_params(labelsize=9, length=3)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())
