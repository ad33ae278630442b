"""Find and load the newest policy or kinematic system of a running training."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agents.live.drivers import Driver, TorqueDriver
from agents.live.session import DemoSession
from agents.policy.checkpoint import CARD_FILE, load_policy, read_card
from agents.resolve import SYSTEM_CARD
from agents.run_folder import RECORD
from questsim.errors import InputError
from questsim.motion.motion import Motion

CHECKPOINTS = ("best", "last")
POLL_S = 2.0


@dataclass(frozen=True)
class Checkpoint:
    """A checkpoint's folder at one time; ``stamp`` changes when the folder is replaced."""

    folder: Path
    stamp: int

    @property
    def of_system(self) -> bool:
        """Whether it is a kinematic system rather than a policy."""
        return (self.folder / SYSTEM_CARD).is_file()

    def training(self) -> dict[str, Any]:
        """The training record in its card.

        Raises:
            InputError: the card is missing or cannot be read.
        """
        if self.of_system:
            from agents.kinematic.store import read_system_card

            card = read_system_card(self.folder)
        else:
            card = read_card(self.folder)
        training = card.get("training")
        return training if isinstance(training, dict) else {}


def newest_checkpoint(run: Path) -> Checkpoint | None:
    """The newest checkpoint in a run, stage or checkpoint folder, if there is one.

    Temporary folders that a training is writing or removing are ignored.
    """
    found = [run] + [path for name in CHECKPOINTS for path in (run / name, *run.glob(f"*/{name}"))]
    stamps = []
    for card in (folder / name for folder in found for name in (CARD_FILE, SYSTEM_CARD)):
        try:
            stamps.append(Checkpoint(card.parent, card.stat().st_mtime_ns))
        except OSError:  # missing, or being replaced
            continue
    return max(stamps, key=lambda checkpoint: checkpoint.stamp, default=None)


def first_checkpoint(run: Path) -> Checkpoint:
    """The newest checkpoint of a run; prints a message and waits if there is none yet.

    Raises:
        InputError: no such folder, or it is not a training's.
    """
    if not run.is_dir():
        raise InputError("there is no such folder", run, "name the --out of a training")
    found = newest_checkpoint(run)
    if found is None:
        if not any((folder / RECORD).is_file() for folder in (run, run.absolute().parent)):
            raise InputError("has no policy or system", run, "name the --out of a training")
        print(f"{run} has no checkpoint yet: waiting for the first; Ctrl-C ends", file=sys.stderr)
    while found is None:
        time.sleep(POLL_S)
        found = newest_checkpoint(run)
    return found


def load_checkpoint(
    run: Path, checkpoint: Checkpoint, recording: Callable[[str], Motion]
) -> tuple[Driver, str]:
    """The driver of a checkpoint, and a short description of it.

    Args:
        run: the watched folder.
        checkpoint: a checkpoint in it.
        recording: see ``load_driver``.

    Raises:
        InputError: it cannot be read, or was replaced while it was read.
    """
    driver = _driver(checkpoint, recording)
    words = describe(run, checkpoint.folder, checkpoint.training())
    if newest_checkpoint(checkpoint.folder) != checkpoint:
        raise InputError("was replaced while it was read", checkpoint.folder)
    return driver, words


def _driver(checkpoint: Checkpoint, recording: Callable[[str], Motion]) -> Driver:
    if not checkpoint.of_system:
        return TorqueDriver(load_policy(checkpoint.folder))
    from agents.kinematic.store import load_system
    from agents.live.poses import PoseDriver

    return PoseDriver(load_system(checkpoint.folder), recording)


def describe(run: Path, folder: Path, training: dict[str, Any]) -> str:
    """The checkpoint's place in the run, and its amount of training."""
    place = folder.relative_to(run).as_posix() if folder != run else folder.name
    words = [place]
    steps = training.get("steps")
    if isinstance(steps, int):
        words.append(f"{steps / 1e6:.2f} M steps" if steps >= 10_000 else f"{steps} steps")
    if isinstance(training.get("minutes"), int | float):
        words.append(f"{training['minutes']:.0f} min")
    return ", ".join(words)


class Watcher:
    """Loads each newer checkpoint of a run into a session, from its own thread.

    Args:
        run: the folder.
        name: name of the session's agent to replace.
        session: the session.
        shown: the current checkpoint.
        recording: see ``load_driver``.
    """

    def __init__(
        self,
        run: Path,
        name: str,
        session: DemoSession,
        shown: Checkpoint,
        recording: Callable[[str], Motion],
    ) -> None:
        self._run, self._name, self._session, self._shown = run, name, session, shown
        self._recording = recording
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="checkpoints", daemon=True)

    def __enter__(self) -> Watcher:
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._stop.set()
        self._thread.join()

    def poll(self) -> bool:
        """Check once; returns whether a newer checkpoint was loaded.

        An unreadable checkpoint is retried at the next check: it may be half replaced.
        """
        newest = newest_checkpoint(self._run)
        if newest is None or newest == self._shown:
            return False
        try:
            driver, note = load_checkpoint(self._run, newest, self._recording)
            self._session.replace_driver(self._name, driver, note)
        except (InputError, OSError):
            return False
        self._shown = newest
        return True

    def _watch(self) -> None:
        while not self._stop.wait(POLL_S):
            self.poll()
