"""Draw the way of a frame from the real modules: ``python -m docs.figures.data_way``.

One embedded clip goes from motion to metrics; every picture and number in the figure is what the
module in its title made of it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, Rectangle
from matplotlib.transforms import Bbox

from agents.live.drivers import TorqueDriver
from agents.live.session import DemoSession
from agents.loading import load_agent
from agents.policy.policy_agent import PolicyAgent
from envs.config import EnvConfig
from envs.layout import observation_layout
from questsim import rotations as rot
from questsim.motion.clip import FPS, Clip
from questsim.motion.motion import Motion
from questsim.motion.spec import load_motions, load_recordings
from questsim.sensors import SENSOR_SETS, device_poses
from questsim.skeleton import DOFS, JOINT_PARENTS, JOINTS, LINK_PARENTS
from questsim.viewing.live import Settings

CLIP, FRAME, STEPS = "synthetic-walk-1.3", 60, 144
OUT = Path("docs/images/data-way.png")
INK, BLUE, ORANGE, GREEN = "#20242c", "#2a6fc4", "#d65828", "#1ea05a"


def draw() -> None:
    """Write the figure."""
    clip = next(c for c in load_motions("synthetic:walk") if c.name == CLIP)
    motion = next(m for m in load_recordings("synthetic:walk") if m.name == CLIP)
    agent = load_agent("demo")
    assert isinstance(agent, PolicyAgent)
    rows = _follow(clip, agent)
    figure = Figure(figsize=(14.0, 6.6), dpi=110, facecolor="white")
    axes = figure.subplots(2, 4).ravel()
    _file(axes[0], motion)
    pose = motion.forward_kinematics()[0][round(FRAME * motion.fps / FPS)]
    about = f"{len(motion)} frames x 22 joints, {motion.fps:g} a second"
    lines = ("questsim/motion/motion.py", about)
    _skeleton(axes[1], pose, JOINT_PARENTS, BLUE, "2  Motion", lines)
    lines = ("questsim/motion/retarget.py", f"{len(clip)} frames x 16 links, 33 hinges, 36 Hz")
    _skeleton(axes[2], clip.link_position[FRAME], LINK_PARENTS, ORANGE, "3  Clip", lines)
    _sensors(axes[3], clip)
    _observation(axes[4], EnvConfig())
    _agent(axes[5], agent)
    _torques(axes[6], rows)
    _metrics(axes[7], rows)
    figure.subplots_adjust(0.04, 0.08, 0.965, 0.86, wspace=0.3, hspace=0.68)
    _arrows(figure, axes)
    OUT.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(OUT)
    print(OUT, f"{OUT.stat().st_size / 1000:.0f} kB")


def _follow(clip: Clip, agent: PolicyAgent) -> dict[str, np.ndarray]:
    """Torques, reward terms and errors while the agent follows the clip on flat ground."""
    session = DemoSession(
        [clip], {"demo": lambda: TorqueDriver(agent)}, Settings(clip.name, "demo")
    )
    rows: dict[str, list[Any]] = {"torque": [], "reward": [], "error": []}
    for _ in range(STEPS):
        session.advance()
        sim = session._sim
        rows["torque"].append(sim.ctrl[0].copy())
        rows["reward"].append(float(sim.reward[0]))
        rows["error"].append(100.0 * float(sim.error[0]))
    return {name: np.array(values) for name, values in rows.items()}


def _title(axes: Axes, name: str, lines: tuple[str, str]) -> None:
    axes.set_title(name, loc="left", fontsize=13, fontweight="bold", color=INK, pad=32)
    for i, line in enumerate(lines):
        axes.text(0.0, 1.0 + 0.115 - 0.085 * i, line, transform=axes.transAxes, fontsize=8.5,
                  color="#5a6270", family="monospace" if i == 0 else "sans-serif")  # fmt: skip


def _small(axes: Axes, x: str, y: str) -> None:
    axes.set_xlabel(x, fontsize=8, labelpad=1)
    axes.set_ylabel(y, fontsize=8, labelpad=1)
    axes.tick_params(labelsize=7.5, length=2.5)
    axes.spines[["top", "right"]].set_visible(False)


def _file(axes: Axes, motion: Motion) -> None:
    """Some of the recording's joint rotations as curves, as a file has them."""
    turned = np.degrees(2.0 * np.arccos(np.clip(np.abs(motion.rotations[..., 0]), 0.0, 1.0)))
    for joint, colour in (("left_knee", BLUE), ("right_knee", ORANGE)):
        curve = turned[:, JOINTS.index(joint)]
        axes.plot(np.arange(len(motion)) / motion.fps, curve, color=colour, label=joint)
    axes.legend(fontsize=7, frameon=False, loc="upper right", ncols=2)
    axes.set_ylim(0.0, 1.25 * float(turned[:, JOINTS.index("left_knee")].max()))
    _small(axes, "time (s)", "joint turned by (°)")
    _title(axes, "1  Motion file", ("questsim/motion/reading.py", "BVH, AMASS, or made: " + CLIP))


def _skeleton(
    axes: Axes,
    points: np.ndarray,
    parents: tuple[int, ...],
    colour: str,
    name: str,
    lines: tuple[str, str],
) -> None:
    """A pose from the side: bones from parent to child."""
    for child, parent in enumerate(parents):
        axes.plot(points[[parent, child], 0], points[[parent, child], 2], color=colour, lw=2.5)
    axes.plot(points[:, 0], points[:, 2], "o", color=INK, ms=3)
    axes.axhline(0.0, color="#b8bec8", lw=1)
    _side_view(axes, float(points[0, 0]))
    _title(axes, name, lines)


def _side_view(axes: Axes, middle: float) -> None:
    axes.set_xlim(middle - 1.1, middle + 1.1)
    axes.set_ylim(-0.1, 1.9)
    axes.set_aspect("equal")
    _small(axes, "x (m)", "z (m)")


def _sensors(axes: Axes, clip: Clip) -> None:
    """The headset's and controllers' poses: two axes each, seen from the side."""
    devices = SENSOR_SETS["H+2C"]
    position, quat = device_poses(
        clip.link_position[FRAME], clip.link_quat[FRAME], devices, clip.height_m
    )
    for child, parent in enumerate(LINK_PARENTS):
        points = clip.link_position[FRAME][[parent, child]]
        axes.plot(points[:, 0], points[:, 2], color="#d5dae2", lw=2.5)
    for where, matrix in zip(position, rot.quat_to_matrix(quat), strict=True):
        for axis, colour in ((0, "#d03030"), (2, "#3050d0")):
            end = where + 0.22 * matrix[:, axis]
            axes.plot([where[0], end[0]], [where[2], end[2]], color=colour, lw=2.5)
    axes.axhline(0.0, color="#b8bec8", lw=1)
    _side_view(axes, float(clip.link_position[FRAME, 0, 0]))
    _title(
        axes, "4  Sensors", ("questsim/sensors.py", f"{len(devices)} poses: position, orientation")
    )


def _observation(axes: Axes, config: EnvConfig) -> None:
    """The blocks of an observation as bars."""
    layout = observation_layout(config)
    inner = [name for name in layout if name != "o_sim"]
    sizes = [layout[name].stop - layout[name].start for name in inner]
    colours = [BLUE if name == "o_user" else ORANGE for name in inner]
    colours[inner.index("o_scale")] = GREEN
    rows = np.arange(len(inner))[::-1]
    axes.barh(rows, sizes, color=colours, height=0.72)
    for row, name, size in zip(rows, inner, sizes, strict=True):
        axes.text(size + 3, row, f"{name.replace('_', ' ')} {size}", fontsize=7.5, va="center")
    axes.set_yticks([])
    axes.set_xlim(0, 330)
    _small(axes, "numbers", "")
    _title(axes, "5  Environment", ("envs/core.py", f"an observation of {sum(sizes)} numbers"))


def _agent(axes: Axes, agent: PolicyAgent) -> None:
    """The policy's layers as boxes as tall as they are wide."""
    spec = agent.policy.spec
    columns = len(agent.policy.layout.columns(spec.actor_blocks))
    widths = [columns, *spec.hidden, 33]
    for i, width in enumerate(widths):
        tall = width / max(widths)
        colour = BLUE if i == 0 else ORANGE if i == len(widths) - 1 else INK
        box = Rectangle((i - 0.22, -tall / 2), 0.44, tall, color=colour, alpha=0.85)
        axes.add_patch(box)
        axes.text(i, tall / 2 + 0.03, str(width), ha="center", fontsize=8)
        if i:
            axes.annotate("", (i - 0.25, 0), (i - 0.75, 0), arrowprops={"arrowstyle": "->"})
    axes.set_xlim(-0.5, len(widths) - 0.5)
    axes.set_ylim(-0.62, 0.62)
    axes.axis("off")
    kind = f"{spec.activation}, {'with' if spec.torque_head else 'without'} torque head"
    _title(axes, "6  Agent", ("agents/policy/networks.py", f"policy {agent.name!r}: {kind}"))


def _torques(axes: Axes, rows: dict[str, np.ndarray]) -> None:
    """What goes back into physics."""
    time = np.arange(len(rows["torque"])) / FPS
    for dof, colour in (("left_knee_y", BLUE), ("right_knee_y", ORANGE)):
        axes.plot(time, rows["torque"][:, DOFS.index(dof)], color=colour, lw=1, label=dof)
    axes.legend(fontsize=7, frameon=False, loc="upper right", ncols=2)
    _small(axes, "time (s)", "torque (N m)")
    _title(axes, "7  Physics", ("envs/core.py, MuJoCo", "33 torques, 4 physics steps each 1/36 s"))


def _metrics(axes: Axes, rows: dict[str, np.ndarray]) -> None:
    """Reward and error of every step."""
    time = np.arange(len(rows["error"])) / FPS
    axes.plot(time, rows["error"], color=ORANGE)
    axes.set_ylim(bottom=0.0)
    _small(axes, "time (s)", "link error (cm)")
    axes.yaxis.label.set_color(ORANGE)
    right = axes.twinx()
    right.plot(time, rows["reward"], color=BLUE)
    right.set_ylim(0.0, 1.0)
    right.set_ylabel("reward", fontsize=8, color=BLUE, labelpad=2)
    right.tick_params(labelsize=7.5, length=2.5)
    right.spines[["top"]].set_visible(False)
    lines = ("questsim/reward.py, metrics.py", f"mean error {rows['error'].mean():.1f} cm")
    _title(axes, "8  Reward and metrics", lines)


def _arrows(figure: Figure, axes: np.ndarray) -> None:
    """From each step to the next, and from physics back to the environment."""

    def box(i: int) -> Bbox:
        return axes[i].get_position()

    def arrow(start: tuple[float, float], end: tuple[float, float]) -> None:
        style = {"arrowstyle": "-|>", "mutation_scale": 16, "lw": 2, "color": "#8a92a0"}
        patch = FancyArrowPatch(start, end, transform=figure.transFigure, **style)
        figure.add_artist(patch)

    for i in (0, 1, 2, 4, 5, 6):
        y = box(i).y1 + 0.088
        arrow((box(i).x1 - 0.03, y), (box(i + 1).x0 - 0.01, y))
    # From the end of the upper row to the beginning of the lower one.
    y = box(4).y1 + 0.137
    arrow((box(3).x1, y), (box(4).x0 - 0.02, y))


if __name__ == "__main__":
    draw()
