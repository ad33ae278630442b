"""The newest policy of a training that goes on."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from pathlib import Path

from agents.agent import PolicyAgent
from agents.checkpoint import CARD_FILE, load_policy
from agents.live.drivers import TorqueDriver
from agents.live.session import DemoSession
from questsim.errors import InputError

CHECKPOINTS = ("best", "last")
POLL_S = 2.0


@dataclass(frozen=True)
class Checkpoint:
    """A policy folder at one time; ``stamp`` changes when the folder is replaced."""

    folder: Path
    stamp: int


def newest_checkpoint(run: Path) -> Checkpoint | None:
    """The policy that was written last in a run, stage or policy folder; None if there is none.

    Folders that a training is about to write or to remove do not count.
    """
    found = [run] + [path for name in CHECKPOINTS for path in (run / name, *run.glob(f"*/{name}"))]
    stamps = []
    for folder in found:
        try:
            stamps.append(Checkpoint(folder, (folder / CARD_FILE).stat().st_mtime_ns))
        except OSError:  # none there, or replaced at this moment
            continue
    return max(stamps, key=lambda checkpoint: checkpoint.stamp, default=None)


def load_checkpoint(run: Path, checkpoint: Checkpoint) -> tuple[TorqueDriver, str]:
    """What drives the avatar by a checkpoint, and a few words about it.

    Raises:
        InputError: it cannot be read, or was replaced meanwhile.
    """
    agent = load_policy(checkpoint.folder)
    if newest_checkpoint(checkpoint.folder) != checkpoint:
        raise InputError("was replaced while it was read", checkpoint.folder)
    return TorqueDriver(agent), describe(run, checkpoint.folder, agent)


def describe(run: Path, folder: Path, agent: PolicyAgent) -> str:
    """Which checkpoint of the run it is, and after how much training."""
    place = folder.relative_to(run).as_posix() if folder != run else folder.name
    training = agent.card.get("training")
    training = training if isinstance(training, dict) else {}
    words = [place]
    if isinstance(training.get("steps"), int):
        words.append(f"{training['steps'] / 1e6:.2f} M steps")
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
    """

    def __init__(self, run: Path, name: str, session: DemoSession, shown: Checkpoint) -> None:
        self._run, self._name, self._session, self._shown = run, name, session, shown
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
            driver, note = load_checkpoint(self._run, newest)
            self._session.replace_driver(self._name, driver, note)
        except (InputError, OSError):
            return False
        self._shown = newest
        return True

    def _watch(self) -> None:
        while not self._stop.wait(POLL_S):
            self.poll()
