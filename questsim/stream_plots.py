"""Plot of a recording: device signals by axis, and contact forces of the feet."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from questsim.plots import BLUE, GREY, ORANGE, figure_file
from questsim.skeleton import FEET
from questsim.stream_metrics import Track

_AXES = ("x, forward", "y, left", "z, up")


def plot_signals(track: Track, path: Path) -> None:
    """User's and avatar's devices by axis against time, and the vertical forces on the feet.

    After QuestSim's Fig. 4. A signal is interrupted where its device does not report.

    Args:
        track: track of a replay.
        path: PNG file to write.
    """
    devices = track.names
    with figure_file(path, 9.0, 1.25 * (len(devices) + 1) + 0.8) as figure:
        grid = figure.subplots(len(devices) + 1, 3, sharex=True, squeeze=False)
        for row, (axes, name) in enumerate(zip(grid, devices, strict=False)):
            for axis, axes_name in enumerate(_AXES):
                user = np.where(track.present[:, row], track.user_position[:, row, axis], np.nan)
                avatar = track.position[:, row, axis]
                axes[axis].plot(track.time_s, user, color=GREY, linewidth=2.0, label="user")
                axes[axis].plot(track.time_s, avatar, color=BLUE, linewidth=1.0, label="avatar")
                if row == 0:
                    axes[axis].set_title(axes_name)
            axes[0].set_ylabel(f"{name.replace('_', ' ')}\n(m)")
        grid[0][0].legend(fontsize=7)
        last = grid[-1]
        for axis, foot in zip(last, FEET, strict=False):
            force = track.contact_force[:, FEET.index(foot)]
            axis.fill_between(track.time_s, force, color=ORANGE, linewidth=0.0)
            axis.set_title(f"{foot.replace('_', ' ')}: force (N)")
        last[2].fill_between(track.time_s, track.assist_force, color=BLUE, linewidth=0.0)
        last[2].set_title("assist: force (N)")
        for axis in grid.ravel():
            for time_s, _ in track.events:
                axis.axvline(time_s, color="black", linewidth=0.6, linestyle=":")
        figure.supxlabel("Time (s); dotted: set up again, or carried along", fontsize=9)
