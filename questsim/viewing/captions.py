"""Words on pictures, in Pillow's own font, so that they look the same everywhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from PIL import Image, ImageDraw, ImageFont

Corner = Literal["top left", "top right", "bottom left", "bottom right"]
INK, ALARM = (32, 36, 44), (196, 40, 32)
_PAPER = (255, 255, 255, 190)


@lru_cache(maxsize=8)
def font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Pillow's default font, ``size`` pixels high."""
    return ImageFont.load_default(size)


def text_size(height: int) -> int:
    """A legible size of letters in pixels for a picture of that height."""
    return max(12, round(height / 26))


def caption(
    frame: np.ndarray, texts: dict[Corner, str], alarm: bool = False, size: int | None = None
) -> np.ndarray:
    """A copy of a picture with a line of text on a light label in some corners.

    A right label that would cover the left one of its row moves one line towards the middle.

    Args:
        frame: ``(H, W, 3)`` uint8.
        texts: the line for each corner; empty ones are left out.
        alarm: whether the line at the bottom left is printed in red.
        size: of the letters in pixels; by default to suit the picture.
    """
    image = Image.fromarray(frame)
    draw = ImageDraw.Draw(image, "RGBA")
    size = size or text_size(image.height)
    pad, edge = size // 3, size // 2
    height, taken = 1.3 * size + pad, {"top": 0.0, "bottom": 0.0}
    for corner, text in sorted(texts.items(), key=lambda item: item[0].endswith("right")):
        if not text:
            continue
        text = _fitted(draw, text, size, image.width - 2 * (pad + edge))
        width, row = draw.textlength(text, font(size)) + 2 * pad, corner.split()[0]
        x = edge if corner.endswith("left") else image.width - edge - width
        inward = round(height + pad) if x < taken[row] else 0
        taken[row] = x + width + pad
        y = edge + inward if row == "top" else image.height - edge - height - inward
        draw.rounded_rectangle((x, y, x + width, y + height), radius=pad, fill=_PAPER)
        ink = ALARM if alarm and corner == "bottom left" else INK
        draw.text((x + pad, y + height / 2), text, font=font(size), fill=ink, anchor="lm")
    return np.asarray(image)


@dataclass(frozen=True)
class Label:
    """Lines of text on one light label, centred.

    Attributes:
        x: of the middle, in pixels.
        lines: from top to bottom; the first is larger.
        colour: of a bar above the lines, as red, green and blue in 0 to 255.
        alarm: whether the last line is printed in red.
    """

    x: float
    lines: tuple[str, ...]
    colour: tuple[int, int, int]
    alarm: bool = False


def labelled(frame: np.ndarray, labels: Sequence[Label], width: float, size: int) -> np.ndarray:
    """A copy of a picture with labels side by side at its lower edge.

    Args:
        frame: ``(H, W, 3)`` uint8.
        labels: what to print.
        width: of each in pixels; longer lines are cut.
        size: of the letters of first lines in pixels.
    """
    image = Image.fromarray(frame)
    draw = ImageDraw.Draw(image, "RGBA")
    small, pad = max(9, round(0.85 * size)), size // 3
    for label in labels:
        sizes = [size] + [small] * (len(label.lines) - 1)
        top = image.height - pad - sum(1.25 * s for s in sizes) - 2 * pad
        left = label.x - width / 2.0
        box = (left, top, left + width, image.height - pad)
        draw.rounded_rectangle(box, radius=pad, fill=_PAPER)
        draw.rectangle((left, top, left + width, top + pad - 1), fill=label.colour)
        y = top + pad
        for i, (line, letters) in enumerate(zip(label.lines, sizes, strict=True)):
            alarm = label.alarm and i == len(sizes) - 1
            line = _fitted(draw, line, letters, width - pad)
            at = (label.x, y + 0.625 * letters)
            draw.text(at, line, font=font(letters), fill=ALARM if alarm else INK, anchor="mm")
            y += 1.25 * letters
    return np.asarray(image)


def _fitted(draw: ImageDraw.ImageDraw, text: str, size: int, width: float) -> str:
    """The text, cut with an ellipsis where it is wider than ``width`` pixels."""
    if draw.textlength(text, font(size)) <= width:
        return text
    while text and draw.textlength(text + "...", font(size)) > width:
        text = text[:-1]
    return text + "..."
