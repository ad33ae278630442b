"""``questsim demo`` and ``questsim play``: policies to watch in a browser."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from agents.agent import load_agent
from agents.checkpoint import CARD_FILE, SHIPPED
from agents.live.drivers import Driver, TorqueDriver
from agents.live.runner import Runner
from agents.live.session import DemoSession
from questsim.errors import at_least
from questsim.viewing.live import Settings
from questsim.viewing.page import Page
from questsim.viewing.page_server import DEFAULT_PORT, LOOPBACK

BASELINES = ("zero", "random")


@dataclass(frozen=True)
class DemoArgs:
    """Watch a shipped policy follow a user, in a browser."""

    agent: str = "demo"
    """To begin with: a shipped policy's name, a run folder, a policy folder, zero or random."""
    motions: str = "synthetic"
    """What to follow: synthetic, a dataset (bandai-namco-2:test), a library, file or folder."""
    clip: str | None = None
    """The clip to begin with; by default the first of the motions."""
    host: str = LOOPBACK
    """Where to listen; anything else than the default lets others watch and control."""
    port: int = DEFAULT_PORT
    """The page's port; 0 takes any free one."""
    seed: int = 0
    """Of the embedded motions."""


def demo(args: DemoArgs) -> None:
    """Serve the page until Ctrl-C.

    Raises:
        InputError: an agent, motions, clip or address that cannot be used.
    """
    at_least(0, seed=args.seed)
    with Page(args.host, args.port) as page:
        # The page is there before PyTorch and the motions are.
        print(f"open {page.address} in a browser; Ctrl-C ends", flush=True)
        session = demo_session(args.agent, args.motions, args.clip, args.seed)
        watch(page, session)


def watch(page: Page, session: DemoSession, stop: threading.Event | None = None) -> None:
    """Run a session in real time and show it until ``stop`` or the simulation's failure."""
    stop = stop or threading.Event()
    with Runner(session, stop) as runner:
        page.watch(session, stop)
    if runner.failure is not None:
        raise runner.failure


def demo_session(agent: str, motions: str, clip: str | None, seed: int = 0) -> DemoSession:
    """A session with the shipped policies, the baselines and one agent more, if it is another."""
    from questsim.motion.spec import load_motions

    drivers = available_drivers(agent)
    clips = load_motions(motions, seed=seed)
    return DemoSession(clips, drivers, Settings(clip or clips[0].name, agent))


def available_drivers(agent: str) -> Mapping[str, Callable[[], Driver]]:
    """What can drive the avatar, by name; ``agent`` is the first."""
    shipped = sorted(path.parent.name for path in SHIPPED.glob(f"*/{CARD_FILE}"))
    names = dict.fromkeys([agent, *shipped, *BASELINES])
    return {name: partial(_torque_driver, name) for name in names}


def _torque_driver(name: str | Path) -> Driver:
    return TorqueDriver(load_agent(name))
