"""The newest policy or kinematic system of a training that goes on."""

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
        """Whether it is of a kinematic system, and not of a policy."""
        return (self.folder / SYSTEM_CARD).is_file()

    def training(self) -> dict[str, Any]:
        """What its card says of its training.

        Raises:
            InputError: there is no card, or it cannot be read.
        """
        if self.of_system:
            from agents.kinematic.store import read_system_card

            card = read_system_card(self.folder)
        else:
            card = read_card(self.folder)
        training = card.get("training")
        return training if isinstance(training, dict) else {}


def newest_checkpoint(run: Path) -> Checkpoint | None:
    """The checkpoint that was written last in a run, stage or checkpoint folder, if there is one.

    Folders that a training is about to write or to remove do not count.
    """
    found = [run] + [path for name in CHECKPOINTS for path in (run / name, *run.glob(f"*/{name}"))]
    stamps = []
    for card in (folder / name for folder in found for name in (CARD_FILE, SYSTEM_CARD)):
        try:
            stamps.append(Checkpoint(card.parent, card.stat().st_mtime_ns))
        except OSError:  # none there, or replaced at this moment
            continue
    return max(stamps, key=lambda checkpoint: checkpoint.stamp, default=None)


def first_checkpoint(run: Path) -> Checkpoint:
    """The newest checkpoint of a run; where there is none yet, waits for the first, and says so.

    Raises:
        InputError: there is no such folder, or none of a training.
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
    """What drives the avatar by a checkpoint, and a few words about it.

    Args:
        run: the folder that is watched.
        checkpoint: in it.
        recording: see ``load_driver``.

    Raises:
        InputError: it cannot be read, or was replaced meanwhile.
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
    """Which checkpoint of the run it is, and after how much training."""
    place = folder.relative_to(run).as_posix() if folder != run else folder.name
    words = [place]
    steps = training.get("steps")
    if isinstance(steps, int):
        words.append(f"{steps / 1e6:.2f} M steps" if steps >= 10_000 else f"{steps} steps")
    if isinstance(training.get("minutes"), int | float):
        words.append(f"{training['minutes']:.0f} min")
    return ", ".join(words)


class Watcher:
    """Gives a session each newer checkpoint of a run, from a thread of its own.

    Args:
        run: the folder.
        name: of the agent in the session that is replaced.
        session: which to give it to.
        shown: the checkpoint that drives now.
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
        """Look once; whether a newer checkpoint took over.

        One that cannot be read is tried again the next time: it may be half replaced.
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
