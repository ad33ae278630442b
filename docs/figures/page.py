"""Photograph the demo's page: ``python -m docs.figures.page --agent demo``.

Chromium opens the page as a viewer would; the picture is taken after ``--at`` seconds of the clip,
while the avatar is pushed.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from PIL import Image

from agents.live.demo import DemoArgs, demo_session, watch
from questsim.cli import guarded
from questsim.viewing.live import Session
from questsim.viewing.page import Page
from questsim.viewing.page_server import LOOPBACK
from tests.browser import browser_page


@dataclass(frozen=True)
class PictureArgs(DemoArgs):
    """Photograph the demo's page; the last push comes just before the picture."""

    at: float = 2.0
    """When in the clip the picture is taken, in seconds."""
    width: int = 1280
    """Of the window in pixels."""
    height_px: int = 800
    """Of the window in pixels."""
    out: Path = Path("docs/images/page.png")
    """The picture."""


def take(args: PictureArgs) -> None:
    """Serve the page, look at it in a browser, write the picture."""
    stop = threading.Event()
    with Page(LOOPBACK, 0) as page:
        session = demo_session(args)
        session.pause(True)
        server = threading.Thread(target=watch, args=(page, session, stop))
        server.start()
        try:
            with browser_page(page.address, args.width, args.height_px) as browser:
                picture = _photograph(browser, session, args)
        finally:
            stop.set()
            server.join()
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_bytes(picture)
    Image.open(args.out).convert("RGB").save(args.out, optimize=True)
    print(args.out, f"{args.out.stat().st_size / 1000:.0f} kB")


def _photograph(browser: Any, session: Session, args: PictureArgs) -> bytes:
    browser.get_by_text("Pause").first.wait_for()
    close = browser.locator("button.mantine-Notification-closeButton")
    for _ in range(close.count()):  # viser's note on drawing in software
        close.first.click()
    session.pause(False)
    while session.snapshot().time_s < args.at - 0.15 or session.snapshot().outcome:
        browser.wait_for_timeout(5)
    if args.push and session.snapshot().physics:
        session.push(args.push, 90.0)
    while session.snapshot().time_s < args.at:
        browser.wait_for_timeout(5)
    session.pause(True)
    browser.wait_for_timeout(4000)
    return browser.screenshot()


if __name__ == "__main__":
    raise SystemExit(guarded(lambda: take(tyro.cli(PictureArgs))))
