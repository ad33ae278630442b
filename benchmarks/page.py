"""Start-up time of the live page, and the cost of its viewers for the simulation.

    python -m benchmarks.page [--agent questsim] [--seconds 8] [--json]

Start-up is measured for ``questsim demo``, from the start of the process until the page answers and
until a waiting browser shows the avatar. Then the simulation runs at real time, 36 steps a second,
with zero, one, four and again zero viewers, and every step is timed. The viewers are tabs of one
headless Chromium that renders in software on the same cores; viewers on other machines or with a
graphics card cost less. Without Chromium the measurements with a browser are left out.
"""

from __future__ import annotations

import io
import socket
import statistics
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from typing import Any

import numpy as np
import torch
from PIL import Image

from agents.live.demo import DemoArgs, demo_session, watch
from agents.live.session import DemoSession
from benchmarks.common import arguments, report
from questsim.cli import guarded
from questsim.viewing.page import Page
from questsim.viewing.page_server import LOOPBACK
from tests.browser import missing, new_browser, visit

PATIENCE_S = 120.0
VIEWERS = (0, 1, 4)
WIDTH, HEIGHT = 800, 600


def main() -> None:
    """Measure and print."""
    args = arguments(__doc__ or "", {"agent": "questsim"}, seconds=8)
    torch.set_num_threads(1)
    reason = missing()
    if reason:
        print(f"without viewers: {reason}", file=sys.stderr)
    with nullcontext(None) if reason else new_browser(WIDTH, HEIGHT) as browser:
        figures = start(args.agent, browser)
        figures |= viewers(demo_session(DemoArgs(agent=args.agent)), args.seconds, browser)
    report(figures, args.json)


def start(agent: str, browser: Any = None) -> dict[str, float]:
    """Seconds until ``questsim demo`` answers and, with a browser, until it shows the avatar."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        port = probe.getsockname()[1]
    address = f"http://{LOOPBACK}:{port}"
    command = [sys.executable, "-m", "questsim.cli", "demo", "--agent", agent, "--port", str(port)]
    began = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        while not _answers(address):
            if process.poll() is not None or time.perf_counter() - began > PATIENCE_S:
                raise RuntimeError("the page does not start")
            time.sleep(0.02)
        figures = {"seconds_to_first_answer": time.perf_counter() - began}
        if browser is not None:
            tab = browser.new_page()
            visit(tab, address)
            while not _shows_the_avatar(tab.screenshot()):
                if time.perf_counter() - began > PATIENCE_S:
                    raise RuntimeError("the page shows no avatar")
            figures["seconds_to_first_picture"] = time.perf_counter() - began
            tab.close()
        return figures
    finally:
        process.terminate()
        process.wait()


def _answers(address: str) -> bool:
    try:
        with urllib.request.urlopen(address, timeout=5.0) as answer:
            return answer.status == 200
    except (urllib.error.URLError, OSError):
        return False


def _shows_the_avatar(picture: bytes) -> bool:
    """Whether a screenshot shows the avatar's shirt left of the controls."""
    image = np.asarray(Image.open(io.BytesIO(picture)).convert("RGB")).astype(int)
    red, green, blue = np.moveaxis(image[:, : WIDTH // 2], -1, 0)
    return bool(((red > green + 60) & (green > blue)).sum() > 200)


def viewers(session: DemoSession, seconds: float, browser: Any = None) -> dict[str, float]:
    """Steps a second and time per step by number of viewers, as figures and ratios.

    Args:
        session: is restarted; nothing else may run it.
        seconds: duration for each number of viewers.
        browser: browser with one page; None leaves viewers out.
    """
    counts = VIEWERS if browser is not None else (0,)
    rates: dict[int, list[float]] = {count: [] for count in counts}
    step_us: dict[int, list[float]] = {count: [] for count in counts}
    with _served(session) as (page, times):
        for count in (*counts, 0) if browser is not None else counts:
            if browser is not None:
                _look(browser, page, count)
            rate, step = measured(session, times, seconds)
            rates[count].append(rate)
            step_us[count].append(step)
    figures = {}
    for count in counts:
        figures[f"steps_a_second_with_{count}"] = statistics.mean(rates[count])
        figures[f"step_us_with_{count}"] = statistics.mean(step_us[count])
    for count in counts[1:]:
        alone = statistics.mean(step_us[0])
        figures[f"step_with_{count}_over_alone"] = statistics.mean(step_us[count]) / alone
    return figures


def measured(session: DemoSession, times: Sequence[float], seconds: float) -> tuple[float, float]:
    """Steps a second of a running session and the median time of a step in microseconds.

    Args:
        session: the running session.
        times: list to which the session appends the seconds of each step.
        seconds: how long to measure.
    """
    first_step, first_time = session.snapshot().step, len(times)
    began = time.perf_counter()
    time.sleep(seconds)
    steps = session.snapshot().step - first_step
    rate = steps / (time.perf_counter() - began)
    return rate, 1e6 * statistics.median(times[first_time:])


@contextmanager
def _served(session: DemoSession) -> Iterator[tuple[Page, list[float]]]:
    """A page with the running session, and the list of the seconds of each step."""
    times: list[float] = []
    advance = session.advance

    def timed() -> bool:
        began = time.perf_counter()
        went_on = advance()
        times.append(time.perf_counter() - began)
        return went_on

    session.advance = timed
    stop = threading.Event()
    with Page(LOOPBACK, 0) as page:
        thread = threading.Thread(target=watch, args=(page, session, stop))
        thread.start()
        try:
            yield page, times
        finally:
            stop.set()
            thread.join()


def _look(browser: Any, page: Page, count: int) -> None:
    """Open the page in ``count`` tabs of the browser, and wait until all show it."""
    for tab in browser.pages[1:]:
        tab.close()
    for _ in range(count):
        visit(browser.new_page(), page.address)
    deadline = time.perf_counter() + PATIENCE_S
    while page.viewers != count:
        if time.perf_counter() > deadline:
            raise RuntimeError(f"{page.viewers} viewers instead of {count}")
        time.sleep(0.1)


if __name__ == "__main__":
    sys.exit(guarded(main))
