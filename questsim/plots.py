"""Figures of an evaluation, as PNG files.

Each function draws one file and leaves no figure open. The colours are those of Okabe & Ito,
"Color Universal Design" (2008), which people with any common colour vision can tell apart.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from questsim.metrics import MAX_LINK_ERROR_M, Rollout
from questsim.skeleton import FEET

BLUE, ORANGE, GREEN, VERMILLION = "#0072B2", "#E69F00", "#009E73", "#D55E00"
GREY = "#8C8C8C"

STYLE: dict[str, Any] = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E6E6E6",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
}
MAX_PANELS = 24


@contextmanager
def figure_file(path: Path, width: float, height: float) -> Iterator[Figure]:
    """A figure, size in inches, that is written to ``path`` when the block ends.

    It is made without pyplot, so there is no global state to close and no display is needed.
    """
    with matplotlib.rc_context(STYLE):  # type: ignore[arg-type]
        figure = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasAgg(figure)
        yield figure
        figure.savefig(path, dpi=120)


def _panels(figure: Figure, count: int, columns: int, **kwargs: Any) -> list[Axes]:
    """``count`` axes in a grid; the remaining cells stay empty."""
    rows = -(-count // columns)
    axes = figure.subplots(rows, columns, squeeze=False, **kwargs).ravel()
    for unused in axes[count:]:
        unused.set_visible(False)
    # With shared axes only the lowest panel of a column has tick labels: not always the last row.
    for axis in axes[max(count - columns, 0) : count]:
        axis.xaxis.set_tick_params(labelbottom=True)
    return list(axes[:count])


def _by_kind(rollouts: Sequence[Rollout]) -> dict[str, list[Rollout]]:
    kinds: dict[str, list[Rollout]] = {}
    for rollout in rollouts:
        kinds.setdefault(rollout.kind or "unknown", []).append(rollout)
    return dict(sorted(kinds.items()))


def plot_error_over_time(rollouts: Sequence[Rollout], path: Path) -> None:
    """Mean link error against time, one panel for each kind of motion.

    A thin line is a clip, a cross marks its loss. The thick line is the median of the other clips.
    At most 24 kinds are shown, those with the most clips.
    """
    kinds = _by_kind(rollouts)
    shown = sorted(sorted(kinds, key=lambda kind: -len(kinds[kind]))[:MAX_PANELS])
    columns = min(len(shown), 4)
    rows = -(-len(shown) // columns)
    with figure_file(path, max(2.6 * columns, 4.5), 2.0 * rows + 0.5) as figure:
        axes = _panels(figure, len(shown), columns, sharex=True, sharey=True)
        for axis, kind in zip(axes, shown, strict=True):
            _draw_errors(axis, kinds[kind])
            lost = sum(not rollout.completed for rollout in kinds[kind])
            clips = f"{len(kinds[kind])} clip" + "s" * (len(kinds[kind]) > 1)
            axis.set_title(f"{kind}: {clips}" + (f", {lost} lost" if lost else ""))
        worst = max(
            float(rollout.link_error_m[: rollout.scored_frames].max(initial=0.0))
            for rollout in rollouts
        )
        axes[0].set(ylim=(0.0, max(107.0 * worst, 1.0)))
        axes[0].set_xlim(left=0.0)
        left_out = f" ({len(shown)} of {len(kinds)} kinds)" if len(shown) < len(kinds) else ""
        figure.supxlabel(f"Time (s){left_out}", fontsize=9)
        figure.supylabel("Mean link error (cm)", fontsize=9)


def _draw_errors(axis: Axes, rollouts: Sequence[Rollout]) -> None:
    longest = max(len(rollout) for rollout in rollouts)
    curves = np.full((len(rollouts), longest), np.nan)
    for curve, rollout in zip(curves, rollouts, strict=True):
        frames = rollout.scored_frames
        curve[:frames] = 100.0 * rollout.link_error_m[:frames]
        times = np.arange(frames) / rollout.fps
        axis.plot(times, curve[:frames], color=BLUE, alpha=0.3, linewidth=0.7)
        if not rollout.completed and frames:
            axis.plot(times[-1], curve[frames - 1], "x", color=VERMILLION, markersize=6, zorder=3)
    # The median: a mean would jump down whenever a clip that is being lost leaves it.
    alive = np.isfinite(curves).any(axis=0)
    times = np.flatnonzero(alive) / rollouts[0].fps
    axis.plot(times, np.nanmedian(curves[:, alive], axis=0), color=BLUE, linewidth=2.0)


def plot_by_kind(metrics: Mapping[str, Any], path: Path) -> None:
    """Bars of success and mean link error by kind of motion, from the result of ``evaluate``."""
    kinds = dict(sorted(metrics["by_kind"].items(), reverse=True))
    figures = [columns["all"] for columns in kinds.values()]
    labels = [f"{kind} ({f['clips']})" for kind, f in zip(kinds, figures, strict=True)]
    success = [100.0 * f["success"] for f in figures]
    error = [f["mpjpe_cm"] or 0.0 for f in figures]
    with figure_file(path, 7.5, 0.32 * len(kinds) + 1.1) as figure:
        left, right = figure.subplots(1, 2, sharey=True)
        left.barh(labels, success, color=BLUE, height=0.65)
        left.set(xlim=(0, 112), xticks=range(0, 101, 25), xlabel="Clips not lost (%)")
        right.barh(labels, error, color=ORANGE, height=0.65)
        right.set(xlim=(0, 1.15 * max(*error, 0.1)), xlabel="Mean link error until the fall (cm)")
        for axis, text in ((left, "%.0f"), (right, "%.1f")):
            axis.bar_label(axis.containers[0], fmt=text, padding=3, fontsize=8)  # type: ignore[arg-type]
            axis.grid(axis="y", visible=False)
            axis.tick_params(axis="y", length=0)


def plot_contacts(rollout: Rollout, path: Path) -> None:
    """Vertical force on each foot against time; the reference's contacts are shaded.

    Without forces (a pose shown without physics) the height of the feet is drawn instead.
    """
    times = np.arange(len(rollout)) / rollout.fps
    force = rollout.contact_force
    values = force if force is not None else 100.0 * rollout.foot_clearance
    label = "Vertical force (N)" if force is not None else "Height of sole (cm)"
    with figure_file(path, 7.5, 3.6) as figure:
        axes = figure.subplots(2, 1, sharex=True, sharey=True)
        for axis, foot, value, contact in zip(
            axes, FEET, values.T, rollout.reference.contacts[: len(rollout)].T, strict=True
        ):
            axis.fill_between(
                times,
                0,
                1,
                where=contact,
                step="mid",
                transform=axis.get_xaxis_transform(),
                color=ORANGE,
                alpha=0.3,
                linewidth=0,
                label="reference stands",
            )
            axis.plot(times, value, color=BLUE, linewidth=1.2, label="avatar")
            axis.set_title(foot.replace("_", " ").capitalize())
            axis.grid(axis="x", visible=False)
        axes[0].set_xlim(0.0, max(times[-1], 1.0 / rollout.fps))
        axes[1].set_xlabel(f"Time in {rollout.name} (s)")
        figure.supylabel(label, fontsize=9)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)


def plot_error_histogram(rollouts: Sequence[Rollout], path: Path) -> None:
    """Histogram of the clips' mean link errors until their fall."""
    rollouts = [rollout for rollout in rollouts if rollout.scored_frames]
    error = np.array([100.0 * r.link_error_m[: r.scored_frames].mean() for r in rollouts])
    completed = np.array([rollout.completed for rollout in rollouts], bool)
    top = max(float(error.max(initial=0.0)), 1.0)
    bins = np.linspace(0.0, min(1.02 * top, 100.0 * MAX_LINK_ERROR_M), 31)
    with figure_file(path, 6.0, 3.0) as figure:
        axis = figure.subplots()
        axis.hist(
            [error[completed], error[~completed]],
            bins=list(bins),
            stacked=True,
            color=[BLUE, VERMILLION],
            label=[f"completed ({completed.sum()})", f"lost ({(~completed).sum()})"],
        )
        axis.set(xlabel="Mean link error of a clip until its fall (cm)", ylabel="Clips")
        axis.set_xlim(left=0.0)
        axis.yaxis.set_major_locator(MaxNLocator(integer=True))
        axis.grid(axis="x", visible=False)
        axis.legend()
