"""A headless Chromium that draws in software, for the page's tests and its picture."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

TIMEOUT_MS = 60_000
"""A busy machine draws a page in half a minute."""

# Software drawing, and no traffic but the page's own.
FLAGS = (
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)


def missing() -> str:
    """Why there is no browser here; empty if there is one."""
    try:
        import playwright.sync_api  # noqa: F401
    except ImportError:
        return "the Python package playwright is not installed"
    if _chromium() is None:
        return "there is no chromium; install Debian's package chromium"
    return ""


def _chromium() -> str | None:
    return shutil.which("chromium") or shutil.which("chromium-browser")


_DRAWS = "[...document.querySelectorAll('canvas')].some(c => c.width > 300 && c.height > 300)"


@contextmanager
def browser_page(address: str, width: int = 800, height: int = 600) -> Iterator[Any]:
    """A Playwright page at an address, in a browser that has never been used.

    Args:
        address: where to go.
        width, height: of the window in pixels.
    """
    with new_browser(width, height) as browser:
        page = browser.pages[0]
        visit(page, address)
        yield page


def visit(page: Any, address: str) -> None:
    """Go to an address and wait until something is drawn there."""
    page.goto(address)
    page.wait_for_function(_DRAWS)  # curves have canvases as well, empty ones at first


@contextmanager
def new_browser(width: int = 800, height: int = 600) -> Iterator[Any]:
    """A browser that has never been used, a Playwright context with one empty page.

    Args:
        width, height: of the windows in pixels.
    """
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as profile, sync_playwright() as playwright:
        browser = playwright.chromium.launch_persistent_context(
            profile,
            executable_path=_chromium(),
            headless=True,
            args=list(FLAGS),
            viewport={"width": width, "height": height},
        )
        try:
            browser.set_default_timeout(TIMEOUT_MS)
            yield browser
        finally:
            browser.close()
