"""The runs of a sweep: each one a whole training, in a process of its own or on a Ray node."""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from agents.policy.checkpoint import read_card
from agents.resolve import policy_folder
from agents.run_folder import RECORD, packed, read_run, unpack, versions
from agents.sweep.options import SweepArgs
from agents.sweep.settings import Setting
from agents.training.learner import TrainingError
from agents.training.options import TrainArgs
from agents.training.ray_session import (
    RETRIES,
    as_in_the_command,
    check_room,
    ray_cluster,
)
from agents.training.ray_session import result as result_of
from agents.training.train_policy import train
from questsim.errors import InputError
from questsim.extensions import load_extensions
from questsim.files import whole_file

RESULT, LOG = "result.json", "log.txt"
FIGURES = ("score", "tracked", "link_error_cm")
"""Figures of a run: of its best checkpoint on the fixed validation clips."""


@dataclass(frozen=True)
class Run:
    """One training of a sweep.

    Attributes:
        setting, seed: what distinguishes it from the other runs.
        args: the options of the training.
    """

    setting: Setting
    seed: int
    args: TrainArgs

    @property
    def folder(self) -> Path:
        """Folder of the run."""
        return self.args.out


def runs_of(args: SweepArgs, setting: Setting) -> list[Run]:
    """The runs of a setting, one per seed."""
    names = {field.name for field in fields(TrainArgs)}
    shared: dict[str, Any] = {name: getattr(args, name) for name in names}
    shared |= {"workers": 0, "ray": None, "resume": False}
    shared["set"] = (*args.set, *setting.overrides)
    runs = []
    for seed in range(args.seed, args.seed + args.seeds):
        out = args.out / "runs" / f"{setting.folder}-seed-{seed}"
        runs.append(Run(setting, seed, TrainArgs(**shared | {"out": out, "seed": seed})))
    return runs


def finished(run: Run) -> dict[str, Any] | None:
    """The result of a run, or None if it has not ended.

    Raises:
        InputError: the folder holds the result of other values.
    """
    path = run.folder / RESULT
    if not path.is_file():
        return None
    try:
        result = json.loads(path.read_text(encoding="utf-8"))
        values = result["values"]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError("is not the result of a run", path, "delete this run") from error
    if values != run.setting.values:
        raise InputError(
            f"is of {values}, not of {run.setting.values}", path, "take the options of its start"
        )
    return result


@contextmanager
def executor(args: SweepArgs) -> Iterator[Callable[[Run], Future[dict[str, Any]]]]:
    """A function that starts a run and returns its future result.

    Raises:
        InputError: Ray is not installed, or no cluster answers at the address.
    """
    if args.ray is not None:
        with ray_cluster(args.ray, args.workers * args.threads), _on_nodes(args) as submit:
            check_room(args.workers, args.threads)
            yield submit
        return
    # A new process for each run: nothing of one run can change the bits of the next.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(args.workers, context, load_extensions, max_tasks_per_child=1)
    try:
        yield lambda run: pool.submit(train_run, run)
    except BaseException:
        pool.shutdown(wait=True, cancel_futures=True)
        raise
    pool.shutdown()


def as_finished(futures: dict[Future[Any], Run]) -> Iterator[tuple[Run, dict[str, Any]]]:
    """Runs with their results, in the order in which they end."""
    for future in as_completed(futures):
        yield futures[future], future.result()


def train_run(run: Run) -> dict[str, Any]:
    """Train a run in this process, continuing an interrupted one, and write its result.

    Raises:
        InputError: the options or motions cannot be used.
        KeyboardInterrupt: the training was stopped; it can be continued.
    """
    run.folder.mkdir(parents=True, exist_ok=True)
    resume = (run.folder / RECORD).exists()
    failure = None
    with (run.folder / LOG).open("a", encoding="utf-8") as log, contextlib.redirect_stdout(log):
        try:
            code = train(replace(run.args, resume=resume))
        except TrainingError as error:  # a setting that diverges is a result
            code, failure = 0, str(error)
    if code:
        raise KeyboardInterrupt
    result = _result(run, failure)
    with whole_file(run.folder / RESULT) as path:
        path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return result


def _result(run: Run, failure: str | None) -> dict[str, Any]:
    """What the sweep keeps of a run. A failed run has no figures."""
    best = None if failure else policy_folder(run.folder)
    training = {} if best is None else read_card(best)["training"]
    evaluation = training.get("evaluation", {})
    return {
        "values": run.setting.values,
        "seed": run.seed,
        "failure": failure,
        "stage": training.get("stage"),
        "steps": training.get("steps"),
        "figures": {name: evaluation[name] for name in FIGURES} if best else None,
        "data_sha256": read_run(run.folder)["data"]["sha256"],
        "versions": versions(),
    }


# -- on a cluster ------------------------------------------------------------------------------


@contextmanager
def _on_nodes(args: SweepArgs) -> Iterator[Callable[[Run], Future[dict[str, Any]]]]:
    """Start runs as Ray tasks; at most ``--workers`` are trained at the same time."""
    from concurrent.futures import ThreadPoolExecutor

    import ray
    from ray import exceptions as errors

    task = ray.remote(num_cpus=args.threads, max_retries=RETRIES, max_calls=1)(_train_on_node)
    own, here = versions(), os.getcwd()

    def call(run: Run) -> dict[str, Any]:
        try:
            found, files = result_of(task.remote(run, own, here))
        except (errors.WorkerCrashedError, errors.NodeDiedError, errors.OutOfMemoryError):
            fix = "see Ray's logs, then continue by --resume"
            raise InputError(f"died {RETRIES + 1} times", run.folder, fix) from None
        unpack(files, run.folder)
        return found

    pool = ThreadPoolExecutor(args.workers)
    try:
        yield lambda run: pool.submit(call, run)
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()


def _train_on_node(run: Run, wanted: dict[str, str], here: str) -> tuple[dict[str, Any], bytes]:
    """Train a run in a temporary folder of this node; its result, and its files as a tar."""
    with as_in_the_command(wanted, here, 1), tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "run"
        found = train_run(replace(run, args=replace(run.args, out=folder)))
        return found, packed(folder)
