"""Shipping a kinematic system: weights, description and card, like those of a policy."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from math import ceil
from pathlib import Path
from typing import Any

from agents.comparison.costs import parameters
from agents.comparison.report import LABELS, SCHEMA, SCHEMA_VERSION
from agents.kinematic.interface import KinematicSystem
from agents.kinematic.options import TrainSystemArgs
from agents.kinematic.registry import AGENTS
from agents.kinematic.store import CARD_FILE, find_system, load_system, read_system_card
from agents.kinematic.training_faults import EXACT
from agents.licence import strictest
from agents.resolve import base_of
from agents.run_folder import read_run
from agents.shipping.model_card import card_text, read_report, time_text
from agents.shipping.portable import nameable, names_for_cards, portable, texts_of_files
from agents.shipping.provenance import options_of, run_of
from questsim.errors import InputError

SHOWN: tuple[str, ...] = (
    "mpjre_deg", "mpjpe_cm", "mpjve_cm_s", "jitter_100_m_s3", "h_pe_cm", "l_pe_cm", "pos_cm",
    "rot_deg", "root_cm", "ee_cm", "foot_skate_cm_s", "floating_cm", "root_force_bw",
)  # fmt: skip
"""Figures of a comparison that a card includes."""

USE = """\
Research, teaching and experiments: estimates of a user's full-body pose, frame by frame, from the
devices named above. Do not use it for medical or safety-relevant purposes, or to infer a person's
identity or health."""

LIMITS = """\
- It was trained on the motions above. It guesses what no device measures.
- It has no physics: feet may slide, float or sink.
- The device signals in training were synthetic, {signals}.
- It works only at 60 Hz and with this order of joints; anything else is refused.
- Bodies differ only in the lengths of their bones; sex, age and weight are not modelled."""


def system_provenance(folder: Path, called: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Training information for a system's card; same keys as ``provenance.provenance``.

    Commands and stages of the system that it started from come first. The licence is the strictest
    of all motions.

    Args:
        folder: the checkpoint's folder, inside its run.
        called: see ``names_for_cards``.

    Raises:
        InputError: it is not inside a run, it has no file of ``called``, or the system it started
            from is missing.
    """
    run = run_of(folder)
    record = read_run(run)
    training = read_system_card(folder)["training"]
    files = names_for_cards([training["motions"], *texts_of_files(record["args"])], called)
    stages = []
    for stage in training["trained"]:
        last = run / stage / "last"
        end = read_system_card(last)["training"] if (last / CARD_FILE).exists() else training
        stages.append(
            {
                "stage": stage,
                "steps": end["steps"],
                "minutes": end["minutes"],
                "motions": portable(training["motions"], files),
            }
        )
    minutes = ceil(sum(stage["minutes"] for stage in stages))
    words = options_of(record["args"], TrainSystemArgs, files)
    words += ["--minutes", str(minutes), "--out", "runs/NAME"]
    before: dict[str, Any] = {"commands": [], "stages": [], "licences": []}
    if start := record["args"].get("start"):
        before, name = _start_provenance(start, record.get("behind", {}).get("start"))
        words += ["--start", name]
    compared = dict(training.get("validation", {}))
    if compared:
        compared["motions"] = portable(compared["motions"], files)
    return {
        **({"validation": compared} if compared else {}),
        "commands": [*before["commands"], shlex.join(["python", "train.py", *words])],
        "stages": [*before["stages"], *stages],
        "licence": strictest([*training["licences"], *before["licences"]]),
        "versions": record["versions"],
    }


def _start_provenance(start: str, shipped: dict[str, Any] | None) -> tuple[dict[str, Any], str]:
    """Commands, stages and licences of the system a training started from, and its run's name.

    Args:
        start: value of ``--start``.
        shipped: training record of that system if it was a shipped one; the name may refer to
            another version by now.

    Raises:
        InputError: the system is missing.
    """
    record, name = shipped, f"runs/{Path(start).name}"
    if record is None:
        folder = find_system(start)
        record = read_system_card(folder)["training"]
        name = f"runs/{folder.name}"
        if "stages" not in record:
            record, name = system_provenance(folder), f"runs/{run_of(folder).name}"
    *earlier, last = record["commands"]
    words = [name if word == "runs/NAME" else word for word in shlex.split(last)]
    found = {
        "commands": [*earlier, shlex.join(words)],
        "stages": list(record["stages"]),
        "licences": [record["licence"]],
    }
    return found, name


def system_card(
    name: str, folder: Path, training: Mapping[str, Any], weights_bytes: int, figures: Sequence[str]
) -> str:
    """The card of a system, as Markdown.

    Args:
        name: shipped name.
        folder: folder of its checkpoint.
        training: ``training`` of its description, with the result of ``system_provenance``.
        weights_bytes: size of the weights file.
        figures: lines of ``comparison_lines``.
    """
    card, system = read_system_card(folder), load_system(folder)
    entry = AGENTS[card["agent"]]
    purpose = (
        f"{entry.title}: estimates the user's pose on 22 joints, 60 times a second, without "
        f"physics. It reads {system.describe().replace('_', ' ')}."
    )
    facts = _facts(system, training, weights_bytes)
    limits = LIMITS.format(signals=_signals(training.get("noise")))
    return card_text(name, purpose, facts, training, figures, USE, limits)


def _signals(noise: Mapping[str, float] | None) -> str:
    """Errors of the devices in training (``agents.kinematic.training_faults``)."""
    if not noise:
        return "without noise, latency or loss of tracking"
    sizes = EXACT | dict(noise)
    return (
        f"with white noise ({1000 * sizes['position_m']:g} mm, {sizes['rotation_rad']:g} rad) and "
        f"devices worn up to {100 * sizes['mount_m']:g} cm and {sizes['mount_rad']:g} rad off, "
        "without latency or loss of tracking"
    )


def _facts(system: KinematicSystem, training: Mapping[str, Any], weights_bytes: int) -> list[str]:
    stages = "; ".join(
        f"{stage['stage']} {stage['steps']:,} steps, {time_text(stage['minutes'])}"
        for stage in training["stages"]
    )
    whole = time_text(sum(stage["minutes"] for stage in training["stages"]))
    versions = training["versions"]
    packages = ", ".join(f"{name} {versions[name]}" for name in ("questsim", "torch"))
    count = parameters(system)
    held = f"without {training['hold_out']}, " if training.get("hold_out") else ""
    rows = {
        "licence": training["licence"],
        "trained on": f"`{training['motions']}`: {training['clips']} clips, {held}"
        f"{time_text(training['seconds'] / 60)}, mirrored, with varied body proportions",
        **_compared_on(training),
        "training": f"preset `{training['preset']}`; {stages}; {whole} in all",
        "seed": str(training["seed"]),
        "network": f"{count:,} parameters, {weights_bytes / 1e6:.1f} MB in safetensors",
        "made with": packages,
    }
    return ["| | |", "|---|---|", *(f"| {key} | {text} |" for key, text in rows.items())]


def _compared_on(training: Mapping[str, Any]) -> dict[str, str]:
    """The row for ``--validation``, if the training had it."""
    found = training.get("validation")
    if not found:
        return {}
    return {"checkpoints compared on": f"`{found['motions']}`: {found['clips']} clips"}


def comparison_lines(path: Path, training: Mapping[str, Any]) -> list[str]:
    """The rows of one system in a ``comparison.json``, as Markdown.

    Args:
        path: the file.
        training: the system's ``training`` as recorded by the comparison.

    Raises:
        InputError: it is missing, not a comparison of this version, or not of this system.
    """
    report = read_report(path, SCHEMA, SCHEMA_VERSION, "a comparison", "comparison.json")
    plain = json.loads(json.dumps(dict(training)))
    agents = [
        agent
        for agent, measured in report["context"]["agents"].items()
        if all(measured.get(key) == value for key, value in plain.items())
    ]
    rows = [row for row in report["rows"] if row["agent"] in agents]
    if not rows:
        raise InputError("has no results of this system", path, "run a comparison with it")
    data = report["context"]["data"]
    names = [name for name in SHOWN if name in rows[0]["pooled"]]
    counts = {row["clips"] for row in rows}
    counted = f"{min(counts)}" if len(counts) == 1 else f"{min(counts)} or {max(counts)}"
    lines = [
        f"### {nameable(data['motions'])}, {counted} clips",
        "",
        "Streamed frame by frame; every frame has the same weight.",
        "",
        f"| scenario | clips | {' | '.join(LABELS[name] for name in names)} |",
        "|" + "---|" * (len(names) + 2),
    ]
    for row in rows:
        found = [row["pooled"][name] for name in names]
        cells = ["-" if value is None else f"{value:.2f}" for value in found]
        behind = base_of(row["agent"]) is not None and "no physics" not in row["scenario"]
        scenario = row["scenario"] + (", with physics" if behind else "")
        lines.append(f"| {scenario} | {row['clips']} | {' | '.join(cells)} |")
    return [*lines, ""]
