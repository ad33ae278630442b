"""A web page that shows a running simulation and lets viewers control it."""

from __future__ import annotations

import threading
import time

from questsim.viewing.live import Session
from questsim.viewing.page_panel import PagePanel
from questsim.viewing.page_scene import PageScene
from questsim.viewing.page_server import address_of, close_server, open_server, warn_if_open

PICTURES_A_SECOND = 36.0
_WORDS_A_SECOND = 5.0


class Page:
    """A page at an address; it is empty until ``watch`` is given a session.

    Args:
        host: address to listen on. Other machines can reach every address except loopback; a
            warning says so.
        port: port; 0 for any free one.
        title: title above the controls.

    Raises:
        InputError: the address is in use or cannot be listened at.
    """

    def __init__(self, host: str, port: int, title: str = "QuestSim") -> None:
        warn_if_open(host)
        self._server = open_server(host, port, title)
        gui = self._server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(214, 88, 40))
        gui.main_panel.dock_right()
        self._loading = gui.add_markdown("Loading motions and the agent ...")
        self._scene = PageScene(self._server)

    def __enter__(self) -> Page:
        return self

    def __exit__(self, *exception: object) -> None:
        close_server(self._server)

    @property
    def address(self) -> str:
        """For a browser on this machine."""
        return address_of(self._server)

    @property
    def viewers(self) -> int:
        """How many browsers watch now."""
        return len(self._server.get_clients())

    def watch(self, session: Session, stop: threading.Event) -> None:
        """Show a session to all viewers until ``stop`` is set."""
        self._loading.remove()
        panel = PagePanel(self._server, session, self._scene)
        shown, words_due = -1, 0.0
        self._scene.show(session.snapshot())
        while not stop.wait(1.0 / PICTURES_A_SECOND / 2.0):
            snapshot = session.snapshot()
            panel.record(snapshot)
            if not self._server.get_clients():
                continue  # no page is open
            if snapshot.step != shown or snapshot.paused:
                shown = snapshot.step
                self._scene.show(snapshot)
            now = time.monotonic()
            if now >= words_due:
                words_due = now + 1.0 / _WORDS_A_SECOND
                panel.show(snapshot)
                if session.settings != panel.refreshed:  # changed by something else than it
                    panel.refresh()
