"""``questsim sweep``: train several settings with several seeds, and compare them."""

from __future__ import annotations

import shutil
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import yaml

from agents.run_folder import RECORD as RUN_RECORD
from agents.run_folder import plain
from agents.sweep import report
from agents.sweep.options import SweepArgs
from agents.sweep.runs import Run, as_finished, executor, finished, runs_of
from agents.sweep.settings import SettingSource, settings_of
from agents.training.watched import beside_ray
from questsim.errors import InputError, at_least, usable_seed
from questsim.files import read_yaml, whole_file

RECORD = "sweep.yaml"
MAY_DIFFER = ("out", "resume", "workers", "ray", "seeds", "trials", "values")
"""Options that may change when a sweep is continued."""


def sweep(args: SweepArgs) -> int:
    """Train every setting with every seed, write the results; returns the exit code.

    Raises:
        InputError: for options, motions or a folder that cannot be used.
    """
    return _sweep(args) if args.ray is None else _sweep_on_cluster(args)


@beside_ray
def _sweep_on_cluster(args: SweepArgs) -> int:
    return _sweep(args)


def _sweep(args: SweepArgs) -> int:
    at_least(1, seeds=args.seeds, workers=args.workers, threads=args.threads, trials=args.trials)
    usable_seed(args.seed)
    settings = settings_of(args)
    made = not args.out.exists()
    _begin(args)
    try:
        outcomes = _outcomes(args, settings)
    except InputError:
        if made and not any(args.out.glob(f"runs/*/{RUN_RECORD}")):
            shutil.rmtree(args.out)  # refused by the first run: nothing was trained
        raise
    report.show(outcomes)
    print(f"written to {args.out}: sweep.csv, sweep.json, runs/")
    return 0


def _outcomes(args: SweepArgs, settings: SettingSource) -> list[report.Outcome]:
    """Train batch after batch; the files of the report are written after each."""
    outcomes: list[report.Outcome] = []
    with executor(args) as submit:
        for batch in settings.batches():
            runs = [run for setting in batch for run in runs_of(args, setting)]
            results = _results(args, runs, submit)
            for setting in batch:
                own = [results[run.folder] for run in runs if run.setting is setting]
                outcomes.append(report.Outcome(setting, own))
                scores = outcomes[-1].of("score")
                settings.tell(setting, sum(scores) / len(scores))
            _check_same_data(outcomes)
            report.write(args.out, outcomes)
    return outcomes


def _results(args: SweepArgs, runs: list[Run], submit: Any) -> dict[Path, dict[str, Any]]:
    """Results of all runs by folder; finished ones are not trained again."""
    results = {run.folder: finished(run) for run in runs}
    # By folder: a search may propose the same values twice.
    left = {run.folder: run for run in runs if results[run.folder] is None}
    if len(left) < len(results):
        print(f"{len(results) - len(left)} of {len(results)} runs are finished already", flush=True)
    futures: dict[Future[Any], Run] = {submit(run): run for run in left.values()}
    for run, result in as_finished(futures):
        results[run.folder] = result
        figures = result["figures"]
        text = f"score {figures['score']:.3f}" if figures else f"failed: {result['failure']}"
        print(f"{run.folder.name}: {run.setting.label}: {text}", flush=True)
    return {folder: result for folder, result in results.items() if result is not None}


def _begin(args: SweepArgs) -> None:
    """Write the record of a new sweep, or check that of a continued one.

    Raises:
        InputError: --out has a sweep already; or --resume finds none, or one of other options.
    """
    path = args.out / RECORD
    given = plain(args)
    if not args.resume:
        if path.exists():
            fix = "add --resume or choose another --out"
            raise InputError("holds a sweep already", args.out, fix)
        if args.out.exists() and not args.out.is_dir():
            raise InputError("is a file", args.out, "choose another --out")
        args.out.mkdir(parents=True, exist_ok=True)
    else:
        _check_same(args, given)
    with whole_file(path) as fresh:
        fresh.write_text(yaml.safe_dump(given, sort_keys=False), encoding="utf-8")


def _check_same(args: SweepArgs, given: dict[str, Any]) -> None:
    path = args.out / RECORD
    try:
        before = read_yaml(path, "sweep record")
    except FileNotFoundError:
        raise InputError("there is no sweep to continue", args.out, "leave out --resume") from None
    for name, value in given.items():
        if name not in MAY_DIFFER and before.get(name, value) != value:
            option = "--" + name.replace("_", "-")
            raise InputError(f"{option} was {before[name]}, not {value}", path, "use it again")


def _check_same_data(outcomes: list[report.Outcome]) -> None:
    """Refuse results of different motions, as nodes may have them.

    Raises:
        InputError: naming the run.
    """
    first = outcomes[0].results[0]
    for setting, results in outcomes:
        for result in results:
            if result["data_sha256"] != first["data_sha256"]:
                raise InputError(
                    f"setting {setting.number}, seed {result['seed']} was trained on other motions "
                    "than the first run",
                    "--motions",
                    "put the same motions on every node, delete that run and add --resume",
                )
