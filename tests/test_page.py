"""The page in a real browser: it draws, its controls work, and the simulation obeys."""

import asyncio
import io
import os
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import browser
import numpy as np
import pytest
import viser
import websockets
from helpers import swaying_clip
from PIL import Image

from agents.agent import RandomAgent, ZeroAgent
from agents.live.demo import watch
from agents.live.drivers import TorqueDriver
from agents.live.load_driver import load_driver
from agents.live.session import DemoSession
from agents.live.users import Recordings
from agents.loading import load_agent
from benchmarks.page import viewers
from questsim.errors import InputError
from questsim.viewing.live import Settings
from questsim.viewing.page import Page
from questsim.viewing.page_server import LOOPBACK, check_address, is_loopback, warn_if_open

needs_browser = pytest.mark.skipif(bool(browser.missing()), reason=browser.missing())
PATIENCE_S = 60.0


def make_session() -> DemoSession:
    clips = [swaying_clip("first", frames=360), swaying_clip("second", frames=360)]
    drivers = {
        "demo": lambda: TorqueDriver(load_agent("demo")),
        "zero": lambda: TorqueDriver(ZeroAgent()),
        "random": lambda: TorqueDriver(RandomAgent()),
        "hmdposer": lambda: load_driver("hmdposer", Recordings("synthetic", clips)),
    }
    return DemoSession(clips, drivers, Settings("first", "demo"))


@contextmanager
def served(session: DemoSession) -> Iterator[Page]:
    """A page that shows a running session."""
    stop = threading.Event()
    with Page(LOOPBACK, 0) as page:
        thread = threading.Thread(target=watch, args=(page, session, stop))
        thread.start()
        try:
            yield page
        finally:
            stop.set()
            thread.join()


@pytest.fixture(scope="module")
def live() -> Iterator[tuple[DemoSession, Page]]:
    session = make_session()
    with served(session) as page:
        yield session, page


def eventually(true: Callable[[], bool], wait: Callable[[float], object] = time.sleep) -> bool:
    """Whether it comes true while a busy machine still may be at it."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        if true():
            return True
        wait(0.05)
    return False


def picture(tab) -> np.ndarray:
    """The canvas alone ``(h, w, 3)``: the part of the window left of the panel."""
    box = {"x": 0, "y": 0, "width": 440, "height": 600}
    image = Image.open(io.BytesIO(tab.screenshot(clip=box)))
    return np.asarray(image.convert("RGB")).astype(int)


@pytest.fixture(scope="module")
def tab(live):
    with browser.browser_page(live[1].address) as tab:
        tab.get_by_role("button", name="Restart").wait_for()
        tab.locator("button.mantine-Notification-closeButton").first.click()
        yield tab


def wait_in(tab) -> Callable[[float], object]:
    return lambda seconds: tab.wait_for_timeout(1000.0 * seconds)


def field_showing(tab, value: str):
    """The input field that shows a value, or None."""
    fields = [f for f in tab.locator("input").all() if f.input_value() == value]
    return next((f for f in fields if f.is_visible()), None)


# --- in the browser -------------------------------------------------------------------------


@needs_browser
def test_the_canvas_shows_the_avatar_and_it_moves(live, tab):
    session, _ = live
    wait = wait_in(tab)
    assert eventually(lambda: len(np.unique(picture(tab).reshape(-1, 3), axis=0)) > 500, wait)
    red, green, blue = np.moveaxis(picture(tab), -1, 0)
    assert ((red > green + 60) & (green > blue)).sum() > 200  # the avatar's shirt
    session.pause(False)
    first = picture(tab)
    assert eventually(lambda: (abs(picture(tab) - first).sum(-1) > 30).sum() > 200, wait)


@needs_browser
def test_pause_step_and_go_on(live, tab):
    session, _ = live
    wait = wait_in(tab)
    session.pause(False)
    tab.get_by_role("button", name="Pause").click()
    assert eventually(lambda: session.snapshot().paused, wait)
    step = session.snapshot().step
    tab.get_by_role("button", name="Step").click()
    assert eventually(lambda: session.snapshot().step == step + 1, wait)
    wait(0.3)
    assert session.snapshot().step == step + 1
    tab.get_by_role("button", name="Go on").click()
    assert eventually(lambda: session.snapshot().step > step + 3, wait)


@needs_browser
def test_the_push_button_pushes(live, tab, monkeypatch):
    session, _ = live
    wait = wait_in(tab)
    session.restart()
    session.pause(True)
    pushes = []
    push = session._sim.pusher.push
    monkeypatch.setattr(session._sim.pusher, "push", lambda *a: (pushes.append(a), push(*a)))
    tab.get_by_role("button", name="Push", exact=True).click()
    assert eventually(lambda: bool(pushes), wait)
    assert np.linalg.norm(pushes[0][1]) == pytest.approx(100.0)
    session.step_once()
    assert eventually(lambda: bool(session.snapshot().push_n.any()), wait)
    session.pause(False)


@needs_browser
def test_a_clip_and_an_agent_are_chosen(live, tab):
    session, _ = live
    wait = wait_in(tab)
    for field, value in (("clip", "second"), ("agent", "zero")):
        chooser = field_showing(tab, getattr(session.settings, field))
        assert chooser
        chooser.click()
        tab.get_by_role("option", name=value, exact=True).click()
        assert eventually(lambda f=field, v=value: getattr(session.settings, f) == v, wait)
    assert eventually(lambda: tab.get_by_text("second", exact=True).count() > 0, wait)
    session.change(agent="demo")
    assert eventually(lambda: field_showing(tab, "demo") is not None, wait)


@needs_browser
def test_a_kinematic_system_is_chosen_and_a_push_is_answered_in_words(live, tab):
    session, _ = live
    wait = wait_in(tab)
    session.pause(False)
    chooser = field_showing(tab, session.settings.agent)
    assert chooser
    chooser.click()
    tab.get_by_role("option", name="hmdposer", exact=True).click()
    assert eventually(lambda: session.settings.agent == "hmdposer", wait)
    assert eventually(lambda: tab.get_by_text("no physics").count() > 0, wait)
    step = session.snapshot().step
    tab.get_by_role("button", name="Push", exact=True).click()
    assert eventually(lambda: tab.get_by_text("cannot be pushed").count() > 0, wait)
    assert eventually(lambda: session.snapshot().step > step + 10, wait)
    session.change(agent="demo")
    assert eventually(lambda: tab.get_by_text("no physics").count() == 0, wait)


@needs_browser
def test_a_height_can_be_typed_and_one_out_of_range_is_refused(live, tab):
    session, _ = live
    wait = wait_in(tab)
    session.pause(False)
    field = field_showing(tab, f"{session.settings.height_m:g}")
    assert field
    field.fill("1.6")
    field.press("Enter")
    assert eventually(lambda: session.settings.height_m == 1.6, wait)
    field.fill("9")
    field.press("Enter")
    step = session.snapshot().step
    assert eventually(lambda: session.snapshot().step > step + 20, wait)
    assert 1.2 <= session.settings.height_m <= 2.2
    assert eventually(lambda: float(field.input_value()) == session.settings.height_m, wait)
    session.change(height_m=1.75)


@needs_browser
def test_a_viewer_that_vanishes_does_not_disturb_the_others(live, tab):
    session, page = live
    wait = wait_in(tab)
    session.pause(False)
    assert eventually(lambda: page.viewers == 1, wait)
    send(page.address)
    step = session.snapshot().step
    assert eventually(lambda: session.snapshot().step > step + 10, wait)
    before = picture(tab)
    assert eventually(lambda: (abs(picture(tab) - before).sum(-1) > 30).sum() > 100, wait)
    assert page.viewers == 1


# --- without one ----------------------------------------------------------------------------


def send(address: str, *messages: bytes | str) -> None:
    """What somebody who is no browser may send to a page's websocket."""

    async def talk() -> None:
        url = address.replace("http", "ws")
        protocol = websockets.Subprotocol(f"viser-v{viser.__version__}")
        async with websockets.connect(url, subprotocols=[protocol], max_size=None) as connection:
            for message in messages:
                await connection.send(message)
            await asyncio.sleep(0.2)

    # Playwright has an event loop of its own in this thread.
    thread = threading.Thread(target=lambda: asyncio.run(talk()))
    thread.start()
    thread.join()


@pytest.mark.parametrize("rubbish", [b"\xff\x00rubbish", "text", b"", os.urandom(1000)])
def test_rubbish_from_a_viewer_is_one_line_and_the_simulation_goes_on(live, rubbish, caplog):
    session, page = live
    session.pause(False)
    send(page.address, rubbish)
    assert eventually(lambda: bool(caplog.records))
    record = caplog.records[0]
    assert "a viewer sent what cannot be read" in record.getMessage()
    assert "\n" not in record.getMessage() and not record.exc_info and not record.exc_text
    step = session.snapshot().step
    assert eventually(lambda: session.snapshot().step > step)


def test_a_viewer_cannot_publish_the_page(live):
    _, page = live
    handlers = page._server._websock_server._incoming_handlers
    assert not [message for message in handlers if message.__name__.startswith("Share")]


def test_a_port_in_use_is_refused_in_one_line():
    with socket.socket() as other:
        other.bind((LOOPBACK, 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(InputError, match=rf"--port: {port} is in use; choose another"):
            Page(LOOPBACK, port)


@pytest.mark.parametrize(
    ("host", "port", "option"),
    [(LOOPBACK, 70000, "--port"), (LOOPBACK, -1, "--port"), ("no.such.host.invalid", 0, "--host")],
)
def test_an_invalid_address_is_refused(host, port, option):
    with pytest.raises(InputError, match=option):
        check_address(host, port)


def test_only_loopback_listens_without_a_warning(capsys):
    assert is_loopback(LOOPBACK) and is_loopback("localhost") and is_loopback("::1")
    assert not is_loopback("::") and not is_loopback("no.such.host.invalid")
    warn_if_open(LOOPBACK)
    assert not capsys.readouterr().err
    warn_if_open("0.0.0.0")
    error = capsys.readouterr().err
    assert error.startswith("warning:") and error.count("\n") == 1


def test_the_pages_benchmark_counts_and_times_the_steps():
    session = make_session()
    figures = viewers(session, 1.0)
    assert set(figures) == {"steps_a_second_with_0", "step_us_with_0"}
    # At most as many as were made at all, and time for each of them.
    assert 1.0 <= figures["steps_a_second_with_0"] <= session.snapshot().step
    assert 10.0 < figures["step_us_with_0"] < 1e6


def test_nothing_listens_beyond_loopback(live):
    _, page = live
    sockets = subprocess.run(["ss", "-ltnH"], capture_output=True, text=True, check=False).stdout
    port = page.address.rpartition(":")[2]
    listening = [line for line in sockets.splitlines() if f":{port} " in line]
    if not listening:
        pytest.skip("ss does not list sockets here")
    assert all(f"{LOOPBACK}:{port}" in line for line in listening)
