"""MP4 files from pictures."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from contextlib import closing
from itertools import chain
from pathlib import Path

import imageio_ffmpeg
import numpy as np

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
