"""Pictures of what a policy does: ten clips of each group, and the ten worst falls.

    python -m docs.figures.falls --motions docs/mixtures/wide.toml:validation --out falls

Writes a sheet of each group and ``worst.png`` with a row a clip: the avatar, and its user
transparent at the same place. Prints a table of the groups (sliding feet, trembling, leaning, late
hands) and one of the falls, the earliest of their clips first: where pelvis and feet were when the
avatar began to lose its user.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from PIL import Image, ImageDraw

from agents.evaluation.groups import grouped_clips
from agents.evaluation.rollout import env_config, roll_out
from agents.loading import load_agent
from agents.resolve import DEFAULT_POLICY
from questsim import rotations as rot
from questsim.metrics import Rollout, summarise
from questsim.skeleton import FOOT_LINKS, LINKS
from questsim.viewing.camera import following_cameras, three_quarter_azimuth
from questsim.viewing.captions import INK, font
from questsim.viewing.costume import REFERENCE
from questsim.viewing.outline import outline_points
from questsim.viewing.render import DrawnAvatar, SceneRenderer

TILE = (150, 200)
"""Width and height of a picture in pixels."""
PICTURES, HEADER = 10, 22
LOST_M = 0.15
"""From this mean link error on until its fall, an avatar has lost its user."""
BEFORE_S = 2.0
"""A row of a fall begins this long before it."""
LATEST = 12
"""Hands are compared with those of the user up to this many frames earlier."""


@dataclass(frozen=True)
class Args:
    """Draw clips of each group and the worst falls of a policy."""

    out: Path
    """Folder for the pictures."""
    motions: str = "synthetic"
    """Motions, as for evaluate.py."""
    agent: str = DEFAULT_POLICY
    """A torque policy."""
    each: int = 10
    """Clips of each group in a sheet, and falls in ``worst.png``."""
    threads: int = 1
    """Threads of physics and networks."""


def offsets_cm(rollout: Rollout, frame: int, link: int) -> np.ndarray:
    """``(3,)`` how far a link is ahead, left of and above the user's, along the user's heading."""
    clip = rollout.reference
    off = rollout.link_position[frame, link] - clip.link_position[frame, link]
    yaw = rot.heading(clip.link_quat[frame : frame + 1, 0])
    return 100.0 * rot.quat_rotate(rot.quat_conjugate(rot.yaw_quat(yaw)), off[None])[0]


def lost_at(rollout: Rollout) -> int:
    """First frame from which on the error stays above ``LOST_M``."""
    near = np.flatnonzero(rollout.link_error_m <= LOST_M)
    return min(int(near[-1]) + 1 if len(near) else 0, len(rollout) - 1)


def leaning_deg(rollout: Rollout) -> float:
    """Mean pitch of the chest beyond its user's; forwards is positive."""
    count, chest = len(rollout), LINKS.index("chest")
    pitch = [
        np.arcsin(np.clip(rot.quat_to_matrix(quat[:count, chest])[:, 2, 0], -1.0, 1.0))
        for quat in (rollout.link_quat, rollout.reference.link_quat)
    ]
    return float(np.degrees(pitch[1] - pitch[0]).mean())


def hands_late_ms(rollouts: Sequence[Rollout]) -> float:
    """By how much the hands are late: the delay at which they are nearest to the user's."""
    hands = [LINKS.index(f"{side}_hand") for side in ("left", "right")]
    errors = np.zeros(LATEST + 1)
    for rollout in rollouts:
        count = len(rollout)
        if count <= LATEST:
            continue
        own = rollout.link_position[:, hands] - rollout.link_position[:, :1]
        want = rollout.reference.link_position[:count, hands]
        want = want - rollout.reference.link_position[:count, :1]
        for late in range(LATEST + 1):
            apart = own[LATEST:] - want[LATEST - late : count - late]
            errors[late] += float(np.linalg.norm(apart, axis=-1).sum())
    return 1000.0 * int(errors.argmin()) / rollouts[0].fps


def strip(rollout: Rollout, first: int) -> Image.Image:
    """A row of pictures of a rollout from frame ``first`` to its last one."""
    width, height = TILE
    clip, count = rollout.reference, len(rollout)
    points = [
        outline_points(position[:count], quat[:count], rollout.height_m)
        for position, quat in (
            (rollout.link_position, rollout.link_quat),
            (clip.link_position, clip.link_quat),
        )
    ]
    cameras = following_cameras(
        np.concatenate(points, axis=1)[first:],
        clip.qpos[first:count, :3],
        three_quarter_azimuth(clip.qpos[first:count, 3:7]),
        width / height,
        0.0,
    )
    frames = np.linspace(first, count - 1, PICTURES).round().astype(int)
    row = Image.new("RGB", (PICTURES * width, HEADER + height), (255, 255, 255))
    end = "fell" if rollout.fell else "end"
    says = f"{rollout.name}   {first / rollout.fps:.1f} s to {end} at {count / rollout.fps:.1f} s"
    says += f" of {len(clip) / rollout.fps:.1f} s"
    ImageDraw.Draw(row).text((6, HEADER // 2), says, font=font(13), fill=INK, anchor="lm")
    figures = [
        DrawnAvatar(rollout.height_m, devices=False),
        DrawnAvatar(rollout.height_m, REFERENCE.faded(0.35), devices=False),
    ]
    with SceneRenderer(figures, 2 * width, 2 * height) as renderer:
        for i, frame in enumerate(frames):
            poses = [rollout.qpos[frame], clip.qpos[frame]]
            tile = Image.fromarray(renderer.render(poses, cameras[frame - first])).reduce(2)
            row.paste(tile, (i * width, HEADER))
    return row


def sheet(rows: Sequence[Image.Image], path: Path) -> None:
    """Write rows of pictures below each other."""
    height = rows[0].height
    page = Image.new("RGB", (rows[0].width, len(rows) * height), (255, 255, 255))
    for i, row in enumerate(rows):
        page.paste(row, (0, i * height))
    page.save(path, "PNG", optimize=True)


def group_line(name: str, rollouts: Sequence[Rollout]) -> str:
    """A row of the table of groups; figures until the fall, those of the users in brackets."""
    found = summarise(rollouts)
    lean = np.mean([leaning_deg(rollout) for rollout in rollouts])
    cells = [
        name,
        f"{sum(rollout.completed for rollout in rollouts)} of {len(rollouts)}",
        f"{found['foot_skate_cm_s']:.1f} ({found['reference_foot_skate_cm_s']:.1f})",
        f"{found['jitter_km_s3']:.2f} ({found['reference_jitter_km_s3']:.2f})",
        f"{lean:+.1f}",
        f"{found['mhpe_cm']:.1f}",
        f"{hands_late_ms(rollouts):.0f}",
    ]
    return f"| {' | '.join(cells)} |"


def fall_line(rollout: Rollout) -> str:
    """A row of the table of falls."""
    at = lost_at(rollout)
    parts = [offsets_cm(rollout, at, link) for link in (0, *FOOT_LINKS)]
    places = [" / ".join(f"{value:+.0f}" for value in part) for part in parts]
    seconds = [count / rollout.fps for count in (at, len(rollout), len(rollout.reference))]
    return f"| {rollout.name} | {' | '.join([*(f'{s:.1f}' for s in seconds), *places])} |"


def main() -> None:
    """Print the tables and write the sheets."""
    args = tyro.cli(Args)
    torch.set_num_threads(args.threads)
    args.out.mkdir(parents=True, exist_ok=True)
    agent = load_agent(args.agent)
    clips, groups = grouped_clips(args.motions, 0, None)
    rollouts = roll_out(agent, clips, env_config(agent), args.threads)
    members: dict[str, list[Rollout]] = {}
    for rollout in rollouts:
        members.setdefault(groups[rollout.name], []).append(rollout)
    print("| group | completed | skate (cm/s) | jitter (km/s³) | leans (deg) | MHPE (cm) |", end="")
    print(" hands late (ms) |\n|" + "---|" * 7)
    for name, group in members.items():
        print(group_line(name, group))
    fallen = [rollout for rollout in rollouts if not rollout.completed]
    fallen.sort(key=lambda rollout: len(rollout) / len(rollout.reference))
    print("\n| fall | lost after (s) | fell after | of | pelvis ahead / left / up (cm) |", end="")
    print(" left foot | right foot |\n|" + "---|" * 7)
    for rollout in fallen:
        print(fall_line(rollout))
    for number, group in enumerate(members.values()):
        even = np.unique(np.linspace(0, len(group) - 1, args.each).round().astype(int))
        sheet([strip(group[i], 0) for i in even], args.out / f"group-{number + 1}.png")
    rows = [
        strip(rollout, max(len(rollout) - round(BEFORE_S * rollout.fps), 0))
        for rollout in fallen[: args.each]
    ]
    if rows:
        sheet(rows, args.out / "worst.png")
    print(f"written to {args.out}")


if __name__ == "__main__":
    main()
