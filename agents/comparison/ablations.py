"""Ablations: compare a kinematic system, or QuestSim, with variants that lack one part each.

``questsim ablations --agent SYSTEM --motions bandai-namco-2:train --test bandai-namco-2:test
--minutes 3 --out DIR`` trains the full system and every variant in its registry entry, one after
the other, with the same seed and the same small budget. It scores all of them on the same motions,
as ``agents.comparison.compare`` does. Variants that differ only at run time use the full system's
weights. ``--seeds`` trains the full system with further seeds, ``--hold-out`` without a performer's
styles.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch

from agents.comparison.ablated import Ablated, ablated
from agents.comparison.ablation_report import Result, table, write
from agents.comparison.compare import at_sensor_rate
from agents.comparison.options import AblationsArgs
from agents.comparison.report import Row
from agents.kinematic.data import motions_record
from agents.kinematic.scenario import Variant
from agents.overrides import overridden
from agents.run_folder import (
    RECORD,
    check_same_run,
    packed,
    read_run,
    refuse_existing,
    start_run,
    unpack,
    versions,
)
from agents.training.hold_out import without_styles
from agents.training.ray_session import ray_map
from agents.training.watched import beside_ray
from questsim.errors import InputError, at_least, usable_seed
from questsim.files import whole_file
from questsim.motion.motion import Motion

FULL = "full"
SCORES = "scores.json"
"""File with a variant's rows in its folder. A variant with this file is done."""
HELD_OUT = "held-out"
MAY_DIFFER_ON_RESUME = {"resume", "out", "threads", "variants", "seeds", "workers", "ray"}


@beside_ray
def ablations(args: AblationsArgs) -> int:
    """Train, score and write the table; returns the exit code.

    Raises:
        InputError: options, motions or a folder cannot be used.
    """
    from questsim.motion.spec import load_recordings

    out, variants = _checked(args)
    motions = at_sensor_rate(load_recordings(args.test, seed=args.seed), args.max_clips)
    without_styles(motions, args.hold_out)
    if args.hold_out and not (out / HELD_OUT / SCORES).exists():  # before anything is trained
        without_styles(load_recordings(args.motions, seed=args.seed), args.hold_out)
    data = motions_record(args.test, motions)
    there = out.exists()
    if args.resume:
        check_same_run(read_run(out), args, data, MAY_DIFFER_ON_RESUME, out)
    else:
        start_run(out, args, _family(args).preset(args.preset, ()), data)
    results = []
    try:
        _on_workers(args, variants, out, motions)
        for variant in variants:
            if not (out / variant.name / SCORES).exists():
                code = _train_and_score(args, variant, out, motions)
                if code:
                    print(f"stopped; continue with the same command and --resume, --out {out}")
                    return code
            results.append(_result(_family(args), variant, out))
    except InputError:
        _leave_nothing(out, there)
        raise
    context = {
        "agent": args.agent,
        "preset": args.preset,
        "stage": args.stage,
        "teacher": args.teacher and str(args.teacher),
        "motions": args.motions,
        "minutes": args.minutes,
        "steps": args.steps,
        "set": list(args.set),
        "data": data,
        "versions": versions(),
        "threads": args.threads,
        "seed": args.seed,
        "seeds": args.seeds,
        "hold_out": args.hold_out,
    }
    write(results, context, out)
    print(table(results, args.agent, "pooled"))
    print(f"written to {out}")
    return 0


def _family(args: AblationsArgs) -> Ablated:
    return ablated(args.agent, args.stage, args.teacher)


def _checked(args: AblationsArgs) -> tuple[Path, list[Variant]]:
    """The folder, and the full system with the requested variants."""
    family = _family(args)
    if args.out is None:
        raise InputError("is missing", "--out", "add --out DIR")
    if args.minutes is None and args.steps is None:
        raise InputError("ablations need a budget", "--minutes", "e.g. --minutes 3, or --steps")
    if args.minutes is not None and not args.minutes > 0:
        raise InputError(f"is {args.minutes:g}, not above 0", "--minutes")
    at_least(1, steps=args.steps, threads=args.threads, max_clips=args.max_clips)
    usable_seed(args.seed)
    at_least(1, seeds=args.seeds)
    repeated = _repeated(args)
    known = {v.name: v for v in (*repeated, *family.variants(args.preset))}
    for name in args.variants:
        if name not in known:
            raise InputError(f"there is no {name!r}", "--variants", f"known: {', '.join(known)}")
    for variant in repeated if args.variants else ():
        done = args.resume and (args.out / variant.name / SCORES).exists()
        if variant.name not in args.variants and not done:
            option = "--hold-out" if variant.name == HELD_OUT else "--seeds"
            what = f"trains {variant.name}, which --variants leaves out"
            raise InputError(what, option, f"add {variant.name} to --variants, or leave it out")
    if not args.resume:
        refuse_existing(args.out)
    full = Variant(FULL, "the whole system")
    variants = [full, *(v for v in known.values() if not args.variants or v.name in args.variants)]
    for variant in variants:
        family.preset(args.preset, overridden(args.set, variant.set))
    return args.out, variants


def _repeated(args: AblationsArgs) -> list[Variant]:
    """The full system again, with other seeds and without the styles of ``--hold-out``."""
    seeds = range(args.seed + 1, args.seed + args.seeds)
    found = [
        Variant(f"seed-{n}", "the full system, another seed", args=(("seed", n),)) for n in seeds
    ]
    if args.hold_out:
        what = "the full system, trained without some styles"
        found.append(Variant(HELD_OUT, what, args=(("hold_out", args.hold_out),)))
    return found


def _train(args: AblationsArgs, variant: Variant, folder: Path) -> int:
    print(f"{variant.name}: {variant.what}")
    options = {
        "out": folder,
        "motions": args.motions,
        "preset": args.preset,
        "minutes": args.minutes,
        "steps": args.steps,
        "resume": (folder / RECORD).exists(),
        "threads": args.threads,
        "seed": args.seed,
        "set": overridden(args.set, variant.set),
        **dict(variant.args),
    }
    return _family(args).train(options)


def _on_workers(
    args: AblationsArgs, variants: Sequence[Variant], out: Path, motions: Sequence[Motion]
) -> None:
    """Train and score on ``--workers`` the variants that have no scores yet."""
    left = [
        variant
        for variant in variants
        if not variant.options and not (out / variant.name / SCORES).exists()
    ]
    with ray_map(args.workers, args.ray, args.threads) as mapper:
        if mapper is map:
            return
        whole = partial(_packed_variant, args, motions)
        for variant, files in zip(left, mapper(whole, left), strict=True):
            unpack(files, out / variant.name)
            print(f"{variant.name}: {variant.what}: trained and scored", flush=True)


def _train_and_score(
    args: AblationsArgs, variant: Variant, out: Path, motions: Sequence[Motion]
) -> int:
    """Write a variant's folder; returns the exit code of its training.

    A variant of options alone uses the weights of the full system.
    """
    code = 0 if variant.options else _train(args, variant, out / variant.name)
    if not code:
        torch.set_num_threads(args.threads)
        _score(args, variant, out, motions)
    return code


def _packed_variant(args: AblationsArgs, motions: Sequence[Motion], variant: Variant) -> bytes:
    """The packed folder of a variant, made in a temporary folder of this node."""
    with tempfile.TemporaryDirectory() as place:
        out = Path(place)
        if _train_and_score(args, variant, out, motions):
            raise KeyboardInterrupt
        return packed(out / variant.name)


def _leave_nothing(out: Path, there: bool) -> None:
    """Remove the record if nothing was trained yet, so that a corrected command can start."""
    if [path.name for path in out.iterdir()] == [RECORD]:
        (out / RECORD).unlink()
        if not there:
            out.rmdir()


def _score(args: AblationsArgs, variant: Variant, out: Path, motions: Sequence[Motion]) -> None:
    """Reconstruct all motions and write the rows into the variant's folder."""
    weights = out / (FULL if variant.options else variant.name)
    family = _family(args)
    found = family.score(weights, variant, motions, args.seed)
    if args.hold_out:
        held = without_styles(motions, args.hold_out)[1]
        again = family.score(weights, variant, held, args.seed)
        found += [replace(row, scenario=f"{row.scenario}; {args.hold_out}") for row in again]
    rows = [replace(row, agent=variant.name) for row in found]
    folder = out / variant.name
    folder.mkdir(exist_ok=True)
    with whole_file(folder / SCORES) as path:
        path.write_text(json.dumps([vars(row) for row in rows], indent=1) + "\n", encoding="utf-8")


def _result(family: Ablated, variant: Variant, out: Path) -> Result:
    """Read the results written by ``_score`` and by the training.

    Raises:
        InputError: the scores are damaged.
    """
    path = out / variant.name / SCORES
    try:
        rows = [Row(**row) for row in json.loads(path.read_text(encoding="utf-8"))]
    except (ValueError, TypeError) as error:
        raise InputError("is damaged", path, "remove it and resume") from error
    run_folder = out / (FULL if variant.options else variant.name)
    training = family.trained(run_folder)
    return Result(
        variant.name, variant.what, variant.set, dict(variant.options), training, rows,
        dict(variant.args),
    )  # fmt: skip
