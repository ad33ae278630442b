"""The real command line, in forks of a process that has imported PyTorch and has no threads."""

from __future__ import annotations

import multiprocessing
import os
import runpy
import sys
import traceback
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NoReturn

from questsim import cli

ROOT = Path(__file__).parents[1]

# A fork of the test process can hang: it copies the locks that other threads hold at that moment.
_PROCESSES = multiprocessing.get_context("forkserver")
_PROCESSES.set_forkserver_preload(
    [
        "agents.commands.evaluate",
        "agents.training.train_policy",
        "agents.headset.command",
        "agents.live.demo",
        __name__,
    ]
)


@dataclass
class Attempt:
    """One run of the real command line, and what it left behind."""

    code: int
    out: str
    err: str
    left: set[str] = field(default_factory=set)


def questsim(folder: Path, *words: object, script: str | None = None) -> Attempt:
    """Run ``questsim WORDS`` (or ``script WORDS``) in ``folder``."""
    before = set(folder.rglob("*"))
    with TemporaryDirectory() as written:
        out, err = Path(written, "out"), Path(written, "err")
        given = folder, list(map(str, words)), script, dict(os.environ), out, err
        command = _PROCESSES.Process(target=_become, args=given)
        command.start()
        command.join(600.0)  # a busy machine is not a failure
        if command.exitcode is None:
            command.kill()
            command.join()
            raise AssertionError(f"the command still ran after 600 s: {err.read_text()}")
        texts = out.read_text(), err.read_text()
    left = {path.relative_to(folder).as_posix() for path in set(folder.rglob("*")) - before}
    return Attempt(command.exitcode, *texts, left - {"MUJOCO_LOG.TXT"})


def _become(
    folder: Path,
    words: list[str],
    script: str | None,
    environment: dict[str, str],
    out: Path,
    err: Path,
) -> NoReturn:
    """Run the command in the forked child, and end it."""
    code: Any = 70
    try:
        os.environ.clear()
        os.environ.update(environment)
        os.chdir(folder)
        for number, path in ((1, out), (2, err)):
            os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT), number)
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
