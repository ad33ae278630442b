"""Damaged inputs for every reader: each ends in success or in one clear line.

``python -m benchmarks.fuzz --seed 0 --count 10000 [--readers bvh,npz] [--keep FOLDER]``

Each case damages one small whole input and hands it to its reader, in a process with limited
memory and time. A failure is any exception but ``InputError``, an error message of several lines or
over a thousand characters, a killed process, or a case of more than five seconds of processor time.
Failures are printed with reader and number; ``--keep`` writes their files. The same seed makes the
same cases.
"""

from __future__ import annotations

import argparse
import contextlib
import faulthandler
import io
import multiprocessing
import os
import pickle
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from random import Random

from benchmarks.fuzz_inputs import READERS, Reader
from benchmarks.fuzz_mutations import damage

LIMIT_S, LIMIT_BYTES = 5.0, 1 << 30
LONGEST_LINE = 1000
HUNG_S = 20
"""A case without an end is stopped after so much processor time: the machine may be shared."""
ASLEEP_S = 900.0
"""A process that sends nothing for so long by the clock waits for something that never comes."""


@dataclass(frozen=True)
class CaseResult:
    """How a case ended: ``ok``, ``refused``, or how it failed, and the message."""

    reader: str
    number: int
    kind: str
    message: str = ""

    @property
    def failed(self) -> bool:
        """Whether it ended in anything but success or a refusal."""
        return self.kind not in ("ok", "refused")


def case_files(reader: Reader, seed: int, number: int, folder: Path) -> Path:
    """Write the files of a case; returns what its reader is given."""
    rng = Random(f"{seed} {reader.name} {number}")
    files = dict(rng.choice(reader.inputs()))
    victim = rng.choice(sorted(files))
    given = next(iter(files))
    files[victim] = damage(files[victim], victim, rng)
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return folder / given


def run_case(reader: Reader, seed: int, number: int, folder: Path) -> CaseResult:
    """One case, in this process."""
    from questsim.errors import InputError

    given = case_files(reader, seed, number, folder)
    began = time.process_time()
    kind, message = "ok", ""
    try:
        # What a reader writes on stderr is a user's as well: no warnings of libraries.
        with warnings.catch_warnings(), contextlib.redirect_stderr(io.StringIO()):
            warnings.simplefilter("error")
            reader.read(given)
    except InputError as error:
        kind, message = "refused", str(error)
        if len(message) > LONGEST_LINE or "\n" in message.strip():
            kind = "message"
    except Exception:  # whatever it is, it is a failure of the reader
        kind, message = "exception", traceback.format_exc()
    took = time.process_time() - began
    if took > LIMIT_S:
        kind, message = "slow", f"{took:.1f} s; {message}"
    return CaseResult(reader.name, number, kind, message)


def _work(connection: Connection, seed: int) -> None:
    """A process of the pool: cases come, outcomes go."""
    faulthandler.enable()
    prepared: set[str] = set()
    while (task := connection.recv()) is not None:
        name, number = task
        reader = READERS[name]
        if name not in prepared:  # imports and compiled loops are not what is limited
            resource.setrlimit(
                resource.RLIMIT_CPU, (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
            )
            reader.prepare()
            prepared.add(name)
            _limit_memory()
        limit_cpu(HUNG_S)
        with tempfile.TemporaryDirectory(prefix="fuzz") as folder:
            connection.send(run_case(reader, seed, number, Path(folder)))


def _limit_memory() -> None:
    """One GiB more than is in use, on Linux."""
    if not Path("/proc/self/statm").exists():
        return
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    limit = pages * resource.getpagesize() + LIMIT_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))


def limit_cpu(seconds: int) -> None:
    """End this process by SIGXCPU after so much more processor time."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    limit = int(used.ru_utime + used.ru_stime) + 1 + seconds
    resource.setrlimit(resource.RLIMIT_CPU, (limit, resource.RLIM_INFINITY))


class _Worker:
    """A process, the case it has, and until when."""

    def __init__(self, seed: int) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_work, args=(theirs, seed), daemon=True)
        self.process.start()
        theirs.close()
        self.task: tuple[str, int] | None = None
        self.until = 0.0

    def give(self, task: tuple[str, int]) -> None:
        self.task, self.until = task, time.monotonic() + ASLEEP_S
        self.connection.send(task)

    def receive(self) -> CaseResult | None:
        """The outcome of its case, if there is one by now."""
        assert self.task is not None
        try:
            if self.connection.poll():
                return self.connection.recv()
        except EOFError:
            self.process.join()
            if self.process.exitcode == -signal.SIGXCPU:
                return CaseResult(*self.task, "hung", f"more than {HUNG_S} s of processor time")
            return CaseResult(*self.task, "killed", f"exit code {self.process.exitcode}")
        except (UnicodeDecodeError, pickle.UnpicklingError) as error:  # memory was overwritten
            self.process.kill()
            return CaseResult(*self.task, "killed", f"an answer that cannot be read: {error}")
        if time.monotonic() > self.until:
            self.process.kill()
            return CaseResult(*self.task, "hung", f"no answer in {ASLEEP_S:g} s")
        return None


def fuzz(seed: int, count: int, names: list[str], processes: int) -> list[CaseResult]:
    """The outcomes of ``count`` cases, the readers in turn."""
    from tqdm import tqdm

    # Threads that wait for each other would count as processor time.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    tasks = [(names[i % len(names)], i // len(names)) for i in range(count)][::-1]
    workers: list[_Worker] = []
    outcomes: list[CaseResult] = []
    bar = tqdm(total=count, unit=" cases", disable=None)
    while len(outcomes) < count:
        workers = [w for w in workers if w.process.is_alive() or w.task]
        while tasks and len(workers) < processes:
            workers.append(_Worker(seed))
        for worker in workers:
            if worker.task is None and tasks:
                worker.give(tasks.pop())
        wait([w.connection for w in workers if w.task], timeout=0.2)
        for worker in [w for w in workers if w.task]:
            outcome = worker.receive()
            if outcome is None:
                continue
            worker.task = None
            if outcome.kind in ("killed", "hung"):
                workers.remove(worker)
            outcomes.append(outcome)
            if outcome.failed:
                what = outcome.message.strip()[-700:]
                print(f"{outcome.reader} {outcome.number}: {outcome.kind}: {what}", flush=True)
            bar.update()
    for worker in workers:
        worker.connection.send(None)
    bar.close()
    return outcomes


def keep(outcomes: list[CaseResult], seed: int, folder: Path) -> None:
    """Write the files of the failures, a folder each."""
    for outcome in outcomes:
        place = folder / f"{outcome.reader}-{outcome.number}"
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True)
        case_files(READERS[outcome.reader], seed, outcome.number, place)
        (place / "outcome.txt").write_text(f"{outcome.kind}\n{outcome.message}", encoding="utf-8")


def main() -> int:
    """The command; returns 1 if a case failed."""
    parser = argparse.ArgumentParser(description="Damaged inputs for every reader.")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--readers", default=",".join(READERS), help="names joined by commas")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--keep", type=Path, help="folder for the files of failures")
    args = parser.parse_args()
    names = args.readers.split(",")
    if unknown := [name for name in names if name not in READERS]:
        parser.error(f"no reader {unknown[0]!r}; there are {', '.join(READERS)}")
    outcomes = fuzz(args.seed, args.count, names, args.processes)
    failures = [outcome for outcome in outcomes if outcome.failed]
    counts = Counter((o.reader, o.kind) for o in outcomes)
    for name in names:
        print(
            f"{name:12}", *(f"{kind} {n}" for (r, kind), n in sorted(counts.items()) if r == name)
        )
    print(f"{len(outcomes)} cases, {len(failures)} mishandled")
    if args.keep:
        keep(failures, args.seed, args.keep)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
