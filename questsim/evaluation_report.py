"""Files of an evaluation: metrics.json, clips.csv and plots, and a table for the terminal."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from questsim import plots
from questsim.errors import InputError
from questsim.metrics import METRICS, Rollout, evaluate, summarise

FILES: tuple[str, ...] = (
    "clips.csv",
    "error_over_time.png",
    "by_kind.png",
    "contacts.png",
    "error_histogram.png",
    "metrics.json",
)
"""Files of ``write_report``; metrics.json is written last and marks a complete report."""

LABELS: dict[str, str] = {
    "clips": "clips",
    "frames": "frames",
    "success": "success (%)",
    "mpjpe_cm": "MPJPE (cm)",
    "mpjpe_root_aligned_cm": "MPJPE, root aligned (cm)",
    "mpjre_deg": "MPJRE (deg)",
    "root_cm": "root (cm)",
    "root_deg": "root (deg)",
    "sip_deg": "SIP (deg)",
    "jitter_km_s3": "jitter (km/s³)",
    "reference_jitter_km_s3": "  of the reference",
    "mpjve_cm_s": "MPJVE (cm/s)",
    "mhpe_cm": "MHPE, devices (cm)",
    "mhre_deg": "MHRE, devices (deg)",
    "foot_skate_cm_s": "foot skate (cm/s)",
    "reference_foot_skate_cm_s": "  of the reference",
    "penetration_cm": "penetration (cm)",
    "real_time_factor": "real-time factor",
}

BY_GROUP = ("clips", "success", "mpjpe_cm", "mpjre_deg", "root_cm", "sip_deg", "jitter_km_s3")
"""Figures of each kind and style in the table; metrics.json contains all figures."""


def check_writable(out: str | Path) -> None:
    """Reject a folder that a report cannot be written to; leaves no files behind.

    Call it before an evaluation starts.

    Raises:
        InputError: a file is in the way, or writing is not allowed.
    """
    created: list[Path] = []
    # Try to write: permissions alone do not show read-only file systems and invalid names.
    try:
        _make_folder(Path(out), created)
        with tempfile.TemporaryFile(dir=out):
            pass
    except (OSError, ValueError) as error:
        blocked = isinstance(error, FileExistsError | NotADirectoryError)
        reason = "a file is in the way" if blocked else getattr(error, "strerror", None) or error
        fix = "choose another output folder"
        raise InputError(f"cannot be written: {reason}", out, fix) from error
    finally:
        _remove_empty(created)


def _make_folder(folder: Path, created: list[Path]) -> None:
    """Make a folder and its parents; append each new one to ``created``, topmost first."""
    missing = [path for path in (folder, *folder.parents) if not os.path.lexists(path)]
    for path in reversed(missing):
        path.mkdir()
        created.append(path)
    folder.mkdir(exist_ok=True)


def _remove_empty(created: Sequence[Path]) -> None:
    """Remove the created folders that are still empty, lowest first."""
    for path in reversed(created):
        with contextlib.suppress(OSError):
            path.rmdir()


def write_report(
    rollouts: Sequence[Rollout], out_dir: str | Path, context: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Write ``FILES`` into a folder; other files there are not touched.

    The files are made in a temporary folder inside ``out_dir`` and moved into place when all are
    complete. A failure leaves an older report unchanged.

    Args:
        rollouts: one per clip.
        out_dir: created if missing.
        context: data to record beside the figures: agent, motions, config, versions, hashes.

    Returns:
        The content of metrics.json, see ``metrics.evaluate``.

    Raises:
        InputError: no rollouts, or a folder that cannot be written.
    """
    check_writable(out_dir)
    metrics = evaluate(rollouts, _plain(context or {}))
    folder, created = Path(out_dir), []
    _make_folder(folder, created)
    working = Path(tempfile.mkdtemp(prefix=".report-", dir=folder))
    try:
        _write_files(rollouts, metrics, working)
        for name in FILES:
            os.replace(working / name, folder / name)
    finally:
        shutil.rmtree(working, ignore_errors=True)
        _remove_empty(created)
    return metrics


def _write_files(rollouts: Sequence[Rollout], metrics: dict[str, Any], folder: Path) -> None:
    (folder / "clips.csv").write_text(clips_csv(rollouts), encoding="utf-8")
    plots.plot_error_over_time(rollouts, folder / "error_over_time.png")
    plots.plot_by_kind(metrics, folder / "by_kind.png")
    plots.plot_contacts(_longest_completed(rollouts), folder / "contacts.png")
    plots.plot_error_histogram(rollouts, folder / "error_histogram.png")
    text = json.dumps(metrics, indent=2, allow_nan=False, ensure_ascii=False)
    (folder / "metrics.json").write_text(text + "\n", encoding="utf-8")


def _longest_completed(rollouts: Sequence[Rollout]) -> Rollout:
    """The clip whose foot contacts are plotted: the longest completed one, else the longest."""
    return max(rollouts, key=lambda rollout: (rollout.completed, len(rollout)))


def clips_csv(rollouts: Sequence[Rollout]) -> str:
    """One line per clip: name and kind, frames followed, and figures until the fall."""
    text = io.StringIO()
    figures = [*METRICS, "real_time_factor"]
    about = ["name", "kind", "style", "height_m", "clip_frames", "frames", "completed"]
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*about, *figures])
    for rollout in rollouts:
        row = summarise([rollout])
        writer.writerow(
            [
                rollout.name,
                rollout.kind,
                rollout.style,
                f"{rollout.height_m:.4g}",
                len(rollout.reference),
                row["frames"],
                int(rollout.completed),
                *("" if row[name] is None else f"{row[name]:.6g}" for name in figures),
            ]
        )
    return text.getvalue()


def format_table(metrics: Mapping[str, Any], width: int = 100) -> str:
    """The figures as text for a terminal: all and completed clips, then each kind and style.

    Args:
        metrics: what ``metrics.evaluate`` or ``write_report`` returns.
        width: columns of the terminal.
    """
    whole = Table(
        title="All clips until the fall, and those completed (95 % interval over clips)",
        title_justify="left",
    )
    whole.add_column("metric")
    for column in ("all", "completed"):
        whole.add_column(column, justify="right")
    for name, label in LABELS.items():
        whole.add_row(
            label, *(with_interval(metrics, column, name) for column in ("all", "completed"))
        )
    console = Console(file=io.StringIO(), width=width, color_system=None, markup=False)
    console.print(whole)
    console.print(_groups("kind of motion", metrics["by_kind"]))
    # A single style repeats the figures of the whole.
    if len(metrics["by_style"]) > 1:
        console.print(_groups("style", metrics["by_style"]))
    lines = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    return "\n".join(line.rstrip() for line in lines)


def _groups(label: str, groups: Mapping[str, Any]) -> Table:
    """A row of the main figures for each kind or style."""
    title = f"By {label}, all clips until the fall (95 % interval of more than ten clips)"
    table = Table(title=title, title_justify="left")
    table.add_column(label.split()[0], no_wrap=True)
    for name in BY_GROUP:
        table.add_column(LABELS[name].replace(" (", "\n("), justify="right")
    for group, columns in groups.items():
        table.add_row(group, *(with_interval(columns, "all", name, "\n") for name in BY_GROUP))
    return table


def with_interval(metrics: Mapping[str, Any], column: str, name: str, gap: str = "  ") -> str:
    """A figure and, where there are clips enough, its 95 % interval over clips.

    Args:
        metrics: of all clips or of a group, see ``metrics.evaluate``.
        column: ``all`` or ``completed``.
        name: of the figure.
        gap: between both.
    """
    text = cell(name, metrics[column][name])
    ends = metrics.get("intervals", {}).get(column, {}).get(name)
    if ends is None:
        return text
    return f"{text}{gap}({cell(name, ends[0])} to {cell(name, ends[1])})"


def cell(name: str, value: float | None) -> str:
    """Format a figure for the table; ``-`` if there was nothing to average."""
    if value is None:
        return "-"
    if name in ("clips", "frames"):
        return f"{value:d}"
    return f"{100.0 * value:.1f}" if name == "success" else f"{value:.2f}"


def _plain(value: Any) -> Any:
    """Convert a value for JSON: dataclasses to mappings, paths to text, arrays to lists."""
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value if value is None or isinstance(value, (bool, int, float, str)) else str(value)
