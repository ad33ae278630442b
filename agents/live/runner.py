"""Real time: a thread that advances a session 36 times a second."""

from __future__ import annotations

import threading
import time

from agents.live.session import DemoSession
from questsim.motion.clip import FPS

LATE_S = 0.25
"""A simulation that lags more than this many seconds skips the lag instead of catching up."""


class Runner:
    """Advances a session in its own thread at the speed of its settings.

    Viewers read snapshots, so they cannot delay the simulation.

    Args:
        session: the session to advance.
        stop: ends the thread when set; set by the thread when it fails.

    Attributes:
        failure: the exception that ended the thread, if one did.
    """

    def __init__(self, session: DemoSession, stop: threading.Event | None = None) -> None:
        self._session = session
        self._stop = stop or threading.Event()
        self._thread = threading.Thread(target=self._run, name="simulation", daemon=True)
        self.failure: BaseException | None = None

    def __enter__(self) -> Runner:
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._stop.set()
        self._thread.join()

    @property
    def running(self) -> bool:
        """Whether the simulation is running."""
        return self._thread.is_alive()

    def _run(self) -> None:
        due = time.monotonic()
        try:
            while not self._stop.is_set():
                self._session.advance()
                due += 1.0 / (FPS * self._session.settings.speed)
                now = time.monotonic()
                if now > due + LATE_S:
                    due = now
                # Always pause briefly, so that viewers can access the session.
                self._stop.wait(max(due - now, 0.0005))
        except Exception as failure:
            self.failure = failure
            self._stop.set()
