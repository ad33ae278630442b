"""The real command line, run in forks of the test process."""

from __future__ import annotations

import os
import runpy
import signal
import sys
import time
import traceback
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, NoReturn

# Imported once, before the forks.
import agents.commands.evaluate
import agents.commands.train
import agents.headset.command
import agents.live.demo  # noqa: F401
from questsim import cli

ROOT = Path(__file__).parents[1]


@dataclass
class Attempt:
    """One run of the real command line, and what it left behind."""

    code: int
    out: str
    err: str
    left: set[str] = field(default_factory=set)


def questsim(folder: Path, *words: object, script: str | None = None) -> Attempt:
    """Run ``questsim WORDS`` (or ``script WORDS``) in ``folder``.

    The command runs in a fork of this process, so that PyTorch is imported once for all tests.
    """
    before = set(folder.rglob("*"))
    with TemporaryFile("w+") as out, TemporaryFile("w+") as err:
        sys.stdout.flush()
        sys.stderr.flush()
        child = os.fork()
        if child == 0:
            _become(folder, list(map(str, words)), script, out.fileno(), err.fileno())
        code = _exit_code(child, seconds=600.0)  # a busy machine is not a failure
        out.seek(0)
        err.seek(0)
        written = out.read(), err.read()
    left = {path.relative_to(folder).as_posix() for path in set(folder.rglob("*")) - before}
    return Attempt(code, *written, left - {"MUJOCO_LOG.TXT"})


def _become(folder: Path, words: list[str], script: str | None, out: int, err: int) -> NoReturn:
    """Run the command in the forked child, and end it."""
    code: Any = 70
    try:
        os.chdir(folder)
        os.dup2(out, 1)
        os.dup2(err, 2)
        sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")
        path = str(ROOT / script) if script else cli.__file__
        sys.argv = [path, *words]
        try:
            runpy.run_path(path, run_name="__main__")
            code = 0
        except SystemExit as end:
            code = end.code or 0
    except BaseException:  # as the interpreter would
        traceback.print_exc()
        code = 1
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code if isinstance(code, int) else 1)


def _exit_code(child: int, seconds: float) -> int:
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        pid, status = os.waitpid(child, os.WNOHANG)
        if pid:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.01)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    raise AssertionError(f"the command still ran after {seconds} s")
