"""MP4 and GIF files from pictures."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from contextlib import closing
from itertools import chain
from pathlib import Path

import imageio_ffmpeg
import numpy as np
from PIL import Image

from questsim.errors import InputError
from questsim.files import whole_file


def write_video(
    path: str | Path, frames: Iterable[np.ndarray], fps: float = 36.0, quality: int = 7
) -> int:
    """Write an MP4 that every browser plays: H.264, 4:2:0, even sizes.

    The file appears under its name only when it is complete.

    Args:
        path: where to; its folder is made.
        frames: pictures ``(H, W, 3)`` uint8, all of one size; an odd last row or column is cut.
        fps: frames a second.
        quality: 0 to 10.

    Returns:
        The number of frames.

    Raises:
        InputError: there are no frames, they differ in size, or the folder cannot be written.
    """
    path = Path(path)
    frames = iter(frames)
    first = next(frames, None)
    if first is None:
        raise InputError("a video needs at least one frame", path)
    shape = first.shape
    height, width = shape[0] // 2 * 2, shape[1] // 2 * 2
    path.parent.mkdir(parents=True, exist_ok=True)
    with (
        whole_file(path) as fresh,
        closing(_encoder(fresh, (width, height), fps, quality)) as encoder,
    ):
        count = 0
        for frame in chain([first], frames):
            if frame.shape != shape:
                raise InputError(f"frame {count} is {frame.shape}, the first is {shape}", path)
            encoder.send(np.ascontiguousarray(frame[:height, :width]))
            count += 1
    return count


def write_gif(
    path: str | Path, frames: Iterable[np.ndarray], fps: float = 12.0, colours: int = 64
) -> int:
    """Write an endless GIF, for pages that show pictures but no videos.

    All frames share one palette, so that nothing flickers.

    Args:
        path: where to; its folder is made.
        frames: pictures ``(H, W, 3)`` uint8, all of one size.
        fps: frames a second; GIF rounds to hundredths of a second.
        colours: at most 256; fewer make a smaller file.

    Returns:
        The number of frames.

    Raises:
        InputError: there are no frames, or the folder cannot be written.
    """
    path = Path(path)
    pictures = [Image.fromarray(frame) for frame in frames]
    if not pictures:
        raise InputError("a GIF needs at least one frame", path)
    sample = np.concatenate([np.asarray(p) for p in pictures[:: max(1, len(pictures) // 6)]])
    shared = palette(Image.fromarray(sample), colours)
    flat = [p.quantize(palette=shared, dither=Image.Dither.NONE) for p in pictures]
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as fresh:
        flat[0].save(
            fresh,
            "GIF",
            save_all=True,
            append_images=flat[1:],
            duration=10 * round(100.0 / fps),
            loop=0,
            optimize=False,
        )
    return len(pictures)


def palette(sample: Image.Image, colours: int) -> Image.Image:
    """Mostly the commonest colours, and some so that small things keep theirs, such as arrows."""
    rare = colours // 4
    common = sample.quantize(colours - rare, Image.Quantize.MEDIANCUT).getpalette() or []
    spread = sample.quantize(rare, Image.Quantize.MAXCOVERAGE).getpalette() or []
    shared = Image.new("P", (1, 1))
    shared.putpalette(common[: 3 * (colours - rare)] + spread[: 3 * rare])
    return shared


def _encoder(
    path: Path, size: tuple[int, int], fps: float, quality: int
) -> Generator[None, np.ndarray, None]:
    """An FFmpeg process that is sent pictures."""
    encoder = imageio_ffmpeg.write_frames(
        str(path),
        size,
        fps=fps,  # pyright: ignore[reportArgumentType]  # ffmpeg takes fractions
        codec="libx264",
        pix_fmt_out="yuv420p",
        quality=quality,
        macro_block_size=2,
        ffmpeg_log_level="error",
        output_params=["-movflags", "+faststart"],
    )
    encoder.send(None)
    return encoder
