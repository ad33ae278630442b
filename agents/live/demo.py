"""``questsim demo`` and ``questsim play``: policies and kinematic systems in a browser."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import torch

from agents.evaluation.follow import choose_clips
from agents.live.drivers import Driver
from agents.live.load_driver import load_driver
from agents.live.options import NOTHING, DemoArgs, PlayArgs, WatchArgs
from agents.live.recording import record
from agents.live.runner import Runner
from agents.live.session import DemoSession, check_choices, check_clip
from agents.live.surroundings import needed_object
from agents.live.users import Recordings
from agents.live.watcher import Checkpoint, Watcher, first_checkpoint, load_checkpoint
from agents.policy.checkpoint import read_card
from agents.resolve import (
    BASELINES,
    resolve,
    shipped_policies,
    shipped_systems,
    with_physics,
)
from questsim.errors import InputError, at_least, usable_seed
from questsim.evaluation_report import check_writable
from questsim.motion.clip import Clip
from questsim.motion.motion import Motion
from questsim.motion.spec import check_seed
from questsim.viewing.live import Settings
from questsim.viewing.page import Page

FIRST_CLIP = "synthetic-walk-1.3"
MOST_CLIPS = 80
"""Largest number of clips in the page's list."""


def demo(args: DemoArgs) -> None:
    """Serve the page until Ctrl-C, or write the video.

    Raises:
        InputError: an agent, motions, clip, setting or address cannot be used.
    """
    usable_seed(args.seed)
    check_seed(args.motions, args.seed)
    _refuse_unused(args)
    torch.set_num_threads(1)
    if args.video is not None:
        _write_video(args, args.video)
        return
    check_is_avatar(args.agent, resolve(args.agent).card)
    check_choices(_settings(args, (), args.agent))
    # The page opens before the embedded motions are made and shows that it is loading. Motions and
    # clips that the user names may not exist: they are looked for first.
    named = args.clip is not None or args.motions != DemoArgs.motions
    clips = _clips(args.motions, args.clip, args.seed) if named else None
    with Page(args.host, args.port) as page:
        _announce(page)
        watch(page, demo_session(args, clips))


def _refuse_unused(args: DemoArgs) -> None:
    """Refuse options of the video for a page, and those of the page for a video."""
    page = args.video is None
    options = ("seconds", "push") if page else ("host", "port")
    for option in options:
        if getattr(args, option) != getattr(DemoArgs, option):
            what = f"has no effect {'without' if page else 'beside'} --video"
            raise InputError(what, f"--{option}", "leave it out")


def play(args: PlayArgs) -> None:
    """Serve the page with a run's newest checkpoint until Ctrl-C; waits for the first one.

    Raises:
        InputError: there is no training in the folder, or an argument cannot be used.
    """
    torch.set_num_threads(1)
    name = args.run.resolve().name
    check_choices(_settings(args, (), name))
    given = None if args.motions is None else _clips(args.motions, args.clip)
    checkpoint = first_checkpoint(args.run)
    if not checkpoint.of_system:
        check_is_avatar(name, read_card(checkpoint.folder))
    motions = args.motions or _trained_on(checkpoint)
    if args.clip is not None and given is None:
        given = _clips(motions, args.clip)
    with Page(args.host, args.port, f"QuestSim {name}") as page:
        _announce(page)
        clips = _clips(motions, args.clip) if given is None else given
        recordings = Recordings(motions, clips)
        checkpoint = first_checkpoint(args.run)  # a newer one may exist by now
        driver, note = load_checkpoint(args.run, checkpoint, recordings)
        settings = _settings(args, clips, name)
        session = DemoSession(clips, drivers_beside(name, driver, recordings), settings)
        session.notes[name] = note
        with Watcher(args.run, name, session, checkpoint, recordings):
            watch(page, session)


def check_is_avatar(name: str, card: Mapping[str, Any]) -> None:
    """Refuse a policy for a body of the user's own, which no page shows.

    Raises:
        InputError: says what to do instead.
    """
    needs = card.get("needs")
    if isinstance(needs, dict) and needs.get("body"):
        raise InputError(
            "was trained for a body of your own, and the page shows only the avatar",
            name,
            "film it with questsim evaluate --video",
        )


def _trained_on(checkpoint: Checkpoint) -> str:
    """The motion argument of a checkpoint's training."""
    motions = checkpoint.training().get("motions")
    return motions if isinstance(motions, str) and motions else "synthetic"


def _announce(page: Page) -> None:
    print(f"open {page.address} in a browser; Ctrl-C ends", flush=True)


def watch(page: Page, session: DemoSession, stop: threading.Event | None = None) -> None:
    """Run a session in real time and show it until ``stop`` is set or the simulation fails."""
    stop = stop or threading.Event()
    with Runner(session, stop) as runner:
        page.watch(session, stop)
    if runner.failure is not None:
        raise runner.failure


def demo_session(args: DemoArgs, clips: Sequence[Clip] | None = None) -> DemoSession:
    """A session with all shipped agents, the baselines and the given agent.

    Args:
        args: the options.
        clips: of these options, if they are loaded already.
    """
    if clips is None:
        clips = _clips(args.motions, args.clip, args.seed)
    drivers = available_drivers(Recordings(args.motions, clips, args.seed), args.agent)
    return DemoSession(clips, drivers, _settings(args, clips, args.agent))


def _settings(args: WatchArgs, clips: Sequence[Clip], agent: str) -> Settings:
    """Initial settings of a session."""
    known = {clip.name: clip for clip in clips}
    first = args.clip or (FIRST_CLIP if FIRST_CLIP in known else next(iter(known), ""))
    needed = needed_object(known[first]) if first in known else NOTHING
    return Settings(
        clip=first,
        agent=agent,
        sensors="",  # the agent's own
        terrain=args.terrain,
        roughness=args.roughness,
        object=args.object or needed,
        height_m=args.height,
        avatar_height_m=None if args.avatar_height == args.height else args.avatar_height,
    )


def _clips(motions: str, wanted: str | None, seed: int = 0) -> Sequence[Clip]:
    """Clips of every kind of motion, at most ``MOST_CLIPS``, including the wanted one.

    Raises:
        InputError: there are no such motions, or the wanted clip is not among them.
    """
    from questsim.motion.spec import load_motions

    clips = load_motions(motions, seed=seed)
    if wanted is not None:
        check_clip(wanted, [clip.name for clip in clips])
    if len(clips) <= MOST_CLIPS:
        return clips
    chosen = choose_clips(clips, MOST_CLIPS)
    print(f"{MOST_CLIPS} of {len(clips)} clips are listed; --clip NAME adds one", file=sys.stderr)
    named = [clip for clip in clips if clip.name == wanted and clip not in chosen]
    return named + chosen


def available_drivers(
    recording: Callable[[str], Motion], first: str | None = None
) -> Mapping[str, Callable[[], Driver]]:
    """Loaders of drivers by name: ``first``, then the shipped agents, then the baselines.

    A driver is loaded when it is first used.

    Args:
        recording: see ``load_driver``.
        first: an additional agent, if it is not among the others.
    """
    names = [
        *([first] if first else []),
        *shipped_policies(),
        *shipped_systems(),
        *with_physics(),
    ]
    names += BASELINES
    return {name: partial(load_driver, name, recording) for name in names}


def drivers_beside(
    name: str, driver: Driver, recording: Callable[[str], Motion]
) -> Mapping[str, Callable[[], Driver]]:
    """One driver by its name, followed by the other available drivers."""
    available = available_drivers(recording)
    others = {other: make for other, make in available.items() if other != name}
    return {name: lambda: driver, **others}


def _write_video(args: DemoArgs, path: Path) -> None:
    """Film the session, or print one line saying why it could not be filmed."""
    from questsim.viewing.gl import find_gl, missing_gl
    from questsim.viewing.live_film import film

    if path.suffix.lower() not in (".mp4", ".gif"):
        raise InputError(f"{path.name} is neither .mp4 nor .gif", "--video")
    at_least(1, seconds=args.seconds)
    at_least(0, push=args.push)
    check_writable(path.parent)
    if find_gl() is None:
        raise InputError(missing_gl(), "--video")
    takes = record(demo_session(args), args.seconds, args.push)
    print(f"filming {sum(len(take.moments) for take in takes)} frames", file=sys.stderr)
    path.parent.mkdir(parents=True, exist_ok=True)
    print(film(takes, path))
