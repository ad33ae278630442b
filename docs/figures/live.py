"""Photograph the page of ``questsim live``: ``python -m docs.figures.live --seconds 10``.

Chromium with an emulated headset enters VR and shows the page the shipped recording, one row a
frame. A second page watches; it is photographed at the end. The page must be built (``make page``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import tyro
from PIL import Image

from agents.resolve import LIVE_POLICY
from questsim.cli import guarded
from questsim.errors import InputError
from questsim.files import whole_file
from questsim.recordings import read_recording
from questsim.viewing.video import palette
from tests.browser import missing, new_browser
from tests.emulated_headset import polled, rows_of, running, wear, why_no_page

SMALL = {"width": 160, "height": 120}
"""Windows of this size until the picture: drawing in software is slow."""
COLOURS = 160


@dataclass(frozen=True)
class PictureArgs:
    """Photograph the page of questsim live, driven by an emulated headset."""

    agent: str = LIVE_POLICY
    """The agent that follows."""
    seconds: float = 10.0
    """When in the shipped recording the picture is taken."""
    width: int = 960
    """Of the picture in pixels."""
    height: int = 600
    """Of the picture in pixels."""
    options: tuple[str, ...] = ()
    """Further options of questsim live."""
    out: Path = Path("docs/images/live.png")
    """The picture."""


def take(args: PictureArgs) -> None:
    """Drive the page, look at it in a browser, write the picture.

    Raises:
        InputError: there is no browser, or the page is not built.
    """
    if fault := why_no_page(missing()):
        raise InputError(fault, "docs.figures.live", "make page")
    frames = read_recording(Path("synthetic")).frames
    end = frames[0].time_s + args.seconds
    rows = rows_of([frame for frame in frames if frame.time_s < end])
    words = ("--agent", args.agent, *args.options)
    with running(*words) as address, new_browser(**SMALL) as browser:
        picture = Image.open(BytesIO(_photographed(browser, address, rows, args)))
    args.out.parent.mkdir(parents=True, exist_ok=True)
    reduced = picture.convert("RGB")
    reduced = reduced.quantize(palette=palette(reduced, COLOURS), dither=Image.Dither.NONE)
    with whole_file(args.out) as path:
        reduced.save(path, "PNG", optimize=True)
    print(args.out, f"{args.out.stat().st_size / 1000:.0f} kB")


def _photographed(
    browser: Any, address: str, rows: Sequence[dict[str, Any]], args: PictureArgs
) -> bytes:
    watcher = browser.pages[0]
    watcher.goto(address)
    wear(browser.new_page(), address, rows)
    polled(watcher, f"window.lastPose?.seen >= {rows[-1]['t'] - 1e-3}", 120.0)
    watcher.set_viewport_size({"width": args.width, "height": args.height})
    watcher.wait_for_timeout(1500)
    print(watcher.inner_text("#panel").replace("\n", " | "))
    return watcher.screenshot()


if __name__ == "__main__":
    raise SystemExit(guarded(lambda: take(tyro.cli(PictureArgs))))
