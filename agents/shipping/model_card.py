"""The card of shipped weights: description, training data, results and licence."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from agents.licence import NON_COMMERCIAL
from agents.policy.average import AVERAGED, listed
from agents.policy.policy_agent import PolicyAgent
from agents.shipping.portable import nameable
from questsim.errors import InputError
from questsim.evaluation_report import LABELS, with_interval
from questsim.licences import OURS
from questsim.metrics import SCHEMA, SCHEMA_VERSION
from questsim.motion.datasets import DATASETS
from questsim.sensors import sensor_set

NOT_FIGURES = ("real_time_factor",)
"""Report entries omitted from a card: they describe the computer, not the policy."""

LICENCE_TEXTS = {
    OURS: "The weights are under the MIT licence, like the code.",
    NON_COMMERCIAL: (
        "The weights are under [CC BY-NC 4.0](https://creativecommons.org/licenses/by-nc/4.0/), "
        "like the motions that they were trained on: **no commercial use**, and credit is "
        "required. Only the code is under the MIT licence."
    ),
    "LicenseRef-CMU-MoCap": (
        "Some of the motions are of the CMU Graphics Lab Motion Capture Database, which is free "
        "for any use. The data was obtained from mocap.cs.cmu.edu; the database was created with "
        "funding from NSF EIA-0196217."
    ),
}

DRIVER_USE = """\
Research, teaching and experiments with the avatar of this project: full-body motion from a headset,
with or without controllers, and comparisons of methods on the same clips. Do not use it for medical
or safety-relevant purposes, or to infer a person's identity or health."""

TRACKER_USE = """\
The avatar follows a whole-body reference, such as a kinematic estimate or a motion capture clip. It
also serves as the teacher of policies that observe only devices. Do not use it for medical or
safety-relevant purposes."""

LIMITS = """\
- It was trained on the motions above. Different motions can make the avatar fall. An avatar that
  has fallen or lags far behind does not recover.
- It was trained {ground}, without other people.
- It works only with this body, order of joints, observation and 36 Hz; anything else is refused.
- Bodies differ only in height; proportions, strength and age are not modelled."""

SPARSE_LIMITS = """\
- The device signals in training were synthetic: rigid offsets from the clips' head and hands,
  {faults}.
- It can only guess leg movements that are independent of head and hands."""


def model_card(
    name: str, agent: PolicyAgent, weights_bytes: int, metrics: Sequence[Mapping[str, Any]]
) -> str:
    """The model card of a policy, as Markdown.

    Args:
        name: shipped name.
        agent: the policy; the ``training`` of its ``policy.yaml`` must contain the result of
            ``provenance.provenance``.
        weights_bytes: size of the weights file.
        metrics: contents of the ``metrics.json`` of its evaluations.
    """
    training = agent.card["training"]
    tracker = agent.needs.privileged
    figures = [line for part in metrics for line in _figures(part)]
    limits = LIMITS.format(ground=_ground(training))
    if not tracker:
        faults = (
            "with noise, mounting errors, jitter and dropouts up to those of the commands above"
            if training.get("device_faults")
            else "without noise, latency or loss of tracking"
        )
        limits += "\n" + SPARSE_LIMITS.format(faults=faults)
    if not tracker and agent.needs.future_frames:
        delay = round(1000.0 * agent.needs.future_frames / agent.card["fps"], -1)
        limits += (
            f"\n- It needs {agent.needs.future_frames} future frames, a delay of {delay:g} ms."
        )
    return card_text(
        name,
        _purpose(agent),
        _facts(agent, weights_bytes),
        training,
        figures,
        TRACKER_USE if tracker else DRIVER_USE,
        limits,
    )


def card_text(
    name: str,
    purpose: str,
    facts: Sequence[str],
    training: Mapping[str, Any],
    figures: Sequence[str],
    use: str,
    limits: str,
) -> str:
    """The layout of every card, as Markdown.

    Args:
        name: shipped name of the weights.
        purpose: one paragraph.
        facts: lines of a table.
        training: with ``commands``, and the keys that ``licence_lines`` reads.
        figures: lines; empty without an evaluation.
        use, limits: text of these sections.
    """
    lines = [
        f"# {name}",
        "",
        purpose,
        "",
        *facts,
        "",
        "Trained by",
        "",
        "```",
        *training["commands"],
        "```",
        "",
        "## Figures",
        "",
        *(figures or ["It has not been evaluated.", ""]),
        "## Intended use",
        "",
        use,
        "",
        "## Limits",
        "",
        limits,
        "",
        "## Licence",
        "",
        *licence_lines(training),
    ]
    return "\n".join(lines) + "\n"


def read_metrics(path: Path, training: Mapping[str, Any]) -> dict[str, Any]:
    """Read and check the ``metrics.json`` of an evaluation of one policy.

    Args:
        path: the file.
        training: the policy's ``training`` as recorded by the evaluation.

    Raises:
        InputError: it is missing, not a report of this version, or of another policy.
    """
    metrics = read_report(path, SCHEMA, SCHEMA_VERSION, "an evaluation", "metrics.json")
    measured = metrics.get("context", {}).get("training") or {}
    # A report of the shipped policy has more training details than the run's policy.
    plain = json.loads(json.dumps(dict(training)))
    differing = [key for key, value in plain.items() if measured.get(key) != value]
    if differing:
        raise InputError(
            f"is a report of another policy: its {differing[0]} is "
            f"{measured.get(differing[0])!r}, not {plain[differing[0]]!r}",
            path,
            "evaluate this policy",
        )
    return metrics


def read_report(path: Path, schema: str, version: int, of: str, usual_name: str) -> dict[str, Any]:
    """Read a JSON report of a given schema and version.

    Args:
        path: the file.
        schema, version: required values.
        of: the subject of the report, for messages.
        usual_name: usual name of such a file, for messages.

    Raises:
        InputError: it is missing, not such a report, or of another version.
    """
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", path) from error
    except ValueError as error:
        raise InputError(f"is not a report of {of}", path) from error
    if not isinstance(report, dict) or report.get("schema") != schema:
        raise InputError(f"is not a report of {of}", path, f"name a {usual_name}")
    if report.get("version") != version:
        raise InputError(f"is of version {report.get('version')!r}, this one reads {version}", path)
    return report


def _ground(training: Mapping[str, Any]) -> str:
    ground = training["ground"]
    where = "on flat ground" if ground == "flat" else f"on `{ground}` ground (see environments)"
    pushed = ", under pushes at the chest" if training["pushed"] else ", without pushes"
    objects = " and ".join(f"`{each}`" for each in training.get("objects", ()))
    return where + pushed + (f", with the object {objects}" if objects else ", without obstacles")


def _purpose(agent: PolicyAgent) -> str:
    if agent.needs.privileged:
        return (
            "Makes the avatar follow any full-body reference by torques on its 33 joints, 36 times "
            "a second. It observes the avatar's state and future frames of the reference."
        ) + (
            " It was trained on references that kinematic systems estimated, to follow the user's "
            "true motion."
            if agent.card["training"].get("shown_estimates")
            else ""
        )
    devices = ", ".join(name.replace("_", " ") for name in sensor_set(agent.needs.sensors))
    frames = agent.needs.future_frames
    when = f"{frames} future frames" if frames else "the current frame"
    return (
        f"Drives the avatar by torques on its 33 joints, 36 times a second. It observes the "
        f"avatar's state and {when} of {devices}."
    )


def _facts(agent: PolicyAgent, weights_bytes: int) -> list[str]:
    training, spec = agent.card["training"], agent.policy.spec
    stages = "; ".join(
        f"{stage['stage']} {stage['steps'] / 1e6:.1f} M steps, {time_text(stage['minutes'])}"
        + "".join(f", first taught by `{name}`" for name in stage.get("teachers", ())[:-1])
        for stage in training["stages"]
    )
    whole = time_text(sum(stage["minutes"] for stage in training["stages"]))
    versions = training["versions"]
    packages = ", ".join(f"{name} {versions[name]}" for name in ("questsim", "mujoco", "torch"))
    layers = "-".join(map(str, spec.hidden))
    rows = {
        "licence": training["licence"],
        "trained on": _data(training),
        "training": f"{stages}; {whole} in all",
        **_averaged(training),
        "seed": str(training["seed"]),
        "body": f"preset `{agent.needs.body_preset}`",
        "network": f"{layers} {spec.activation}, {weights_bytes / 1e6:.1f} MB in safetensors",
        "made with": packages,
    }
    return ["| | |", "|---|---|", *(f"| {name} | {text} |" for name, text in rows.items())]


def _averaged(training: Mapping[str, Any]) -> dict[str, str]:
    """A row about policies of the last stage that were averaged, if any were."""
    if AVERAGED not in training:
        return {}
    steps = listed(training[AVERAGED])
    return {
        "weights": f"the mean of those after {steps} steps of the last stage (`questsim average`)"
    }


def time_text(minutes: float) -> str:
    """Format a duration in minutes, or in hours if it is long."""
    return f"{minutes:.0f} min" if minutes < 120 else f"{minutes / 60:.1f} h"


def _data(training: Mapping[str, Any]) -> str:
    motions = {stage["motions"]: None for stage in training["stages"]}
    own = training["motions"]
    text = f"`{own}`: {training['clips']} clips, {time_text(training['seconds'] / 60)}"
    others = [f"`{name}`" for name in motions if name != own]
    return text + (f"; earlier stages on {', '.join(others)}" if others else "")


def _figures(metrics: Mapping[str, Any]) -> list[str]:
    """Format one evaluation as a heading and two tables."""
    context = metrics["context"]
    motions = (context.get("data") or {}).get("motions", "unnamed motions")
    heights = (context.get("config") or {}).get("heights")
    statures = "the clips' own statures" if heights is None else f"{heights[0]:g} m"
    lines = [
        f"### {nameable(motions)}, {metrics['all']['clips']} clips, {statures}",
        "",
        "Each clip runs once, from its first frame, without noise. *All* includes every clip until "
        "its fall. In brackets: 95 % intervals over clips, where there are more than ten.",
        "",
        "| | all | completed |",
        "|---|---|---|",
    ]
    for key, label in LABELS.items():
        if key not in NOT_FIGURES:
            cells = (with_interval(metrics, part, key) for part in ("all", "completed"))
            lines.append(f"| {label.strip()} | {' | '.join(cells)} |")
    lines += ["", "| kind of motion | clips | success (%) | MPJPE (cm) |", "|---|---|---|---|"]
    for kind, parts in metrics["by_kind"].items():
        row = (with_interval(parts, "all", key) for key in ("clips", "success", "mpjpe_cm"))
        lines.append(f"| {kind} | {' | '.join(row)} |")
    return [*lines, ""]


def licence_lines(training: Mapping[str, Any]) -> list[str]:
    """The licence in words, and credits for the motions of all stages."""
    licences = training["licence"].split(" AND ")
    texts = [LICENCE_TEXTS.get(one, f"The weights are under {one}.") for one in licences]
    lines = "\n\n".join(texts).splitlines()
    motions = " ".join(stage["motions"] for stage in training["stages"])
    used = [dataset for name, dataset in DATASETS.items() if name in motions]
    for dataset in used:
        lines += ["", f"Motions: {dataset.title} ({dataset.licence}). {dataset.credit}"]
    for credit in training.get("credits", ()):
        lines += ["", f"Motions: {credit}"]
    return lines
