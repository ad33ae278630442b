"""Run a command in a process of its own, since Ray ends the process that uses a dead node.

When the Ray node under a program dies, Ray's own code ends that program with exit code 1 and no
word. The parent process here sees that and says what happened.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import wraps
from multiprocessing.connection import Connection, wait
from threading import Thread
from typing import Any, TypeVar

from questsim.cli import guarded
from questsim.errors import InputError
from questsim.extensions import load_extensions

ArgsT = TypeVar("ArgsT")
_watched = False
"""Whether this process is one that ``watched`` started."""


def beside_ray(function: Callable[[ArgsT], Any]) -> Callable[[ArgsT], Any]:
    """Decorator of a command, which runs in a process of its own if it uses Ray.

    Args:
        function: takes options with ``workers`` and ``ray``. Trainings and sweeps of their own
            use ``watched``.
    """

    @wraps(function)
    def run(args: Any) -> Any:
        if args.workers > 0 and not ray_runs() and not _watched:
            return watched(run, args)
        return function(args)

    return run


def ray_runs() -> bool:
    """Whether this process uses a cluster already."""
    ray = sys.modules.get("ray")
    return ray is not None and ray.is_initialized()


def watched(function: Callable[[ArgsT], int], args: ArgsT) -> int:
    """The exit code of ``function(args)``, run in a new process.

    Its errors are printed there. Ctrl-C reaches both processes; the new one answers it.

    Raises:
        InputError: the process died.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_run, args=(sender, function, args))
    before = {
        signal.SIGINT: signal.signal(signal.SIGINT, signal.SIG_IGN),
        signal.SIGTERM: signal.signal(signal.SIGTERM, lambda *_: process.terminate()),
    }
    try:
        process.start()
        sender.close()
        process.join()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if receiver.poll():  # also true of a closed pipe without a message
        with suppress(EOFError):
            return receiver.recv()
    raise InputError(
        "the Ray node of this command died, and Ray ended the command",
        "--workers",
        "start the cluster again, then continue a training by the same command and --resume",
    )


def _end_with_parent() -> None:
    """End this process when its parent is killed, like a command without a process of its own."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)


def _run(sender: Connection, function: Callable[[Any], int], args: Any) -> None:
    global _watched
    _watched = True
    signal.signal(signal.SIGINT, signal.default_int_handler)
    Thread(target=_end_with_parent, daemon=True).start()
    load_extensions()
    code = guarded(lambda: function(args))
    sender.send(code)
    sys.exit(code)
