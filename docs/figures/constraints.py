"""DragPoser with constraints that its user gives at run time: a film and a sheet of moments.

    python -m docs.figures.constraints [MOTIONS] [--out FOLDER]

Writes ``constraints.mp4`` and ``constraints.png``: the user, DragPoser with three trackers (pelvis
and hands), and the same with each constraint. Head, trunk and feet have no tracker, so a constraint
can move them.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from agents.comparison.film import FilmFigure as Part
from agents.comparison.film import FilmScene, Size, pictures, sheet
from agents.comparison.plots import KINDS
from agents.kinematic import UserBody, load_system
from agents.kinematic.dragposer.constraints import (
    Constraint,
    above_floor,
    joint_distance,
    look_at,
    weighted,
)
from agents.kinematic.interface import Poses
from agents.kinematic.scenario import HANDS
from agents.kinematic.without_physics import over_users_floor
from questsim.cli import guarded
from questsim.files import whole_file
from questsim.joint_sensors import SENSOR_FPS, readings
from questsim.motion.clip import FPS
from questsim.motion.motion import Motion
from questsim.motion.retarget import to_clip
from questsim.motion.retarget_back import to_motion
from questsim.motion.spec import load_motions
from questsim.viewing.video import write_video

PLACES, LOOKS = 20.0, 0.05
"""Weights of positions and directions; the trackers' are 5 to 10, and 0.01 to 10."""
TRACKERS = ("pelvis_tracker", *HANDS)
SECONDS = 3.0
SIZE = Size(figure=260)


def constraints_for(motion: Motion) -> dict[str, tuple[Constraint, ...]]:
    """The constraints of the film by label."""
    # A point 1.5 m above the floor, ahead of the user's path and to its left.
    (x, y, _), (from_x, from_y, _) = motion.root_position[-1], motion.root_position[0]
    ahead = np.array([x - from_x, y - from_y]) / np.hypot(x - from_x, y - from_y)
    left = np.array([-ahead[1], ahead[0]])
    at = motion.root_position[-1, :2] + 2.0 * ahead + 3.0 * left
    looks = look_at((float(at[0]), float(at[1]), 1.5))
    apart = joint_distance("left_ankle", "right_ankle", 0.6)
    return {
        "no constraint": (),
        "looks to its left": (weighted(LOOKS, looks),),
        "ankles 60 cm apart": (weighted(PLACES, apart),),
        "floor 15 cm higher": (weighted(PLACES, above_floor(0.15)),),
    }


def parts(motion: Motion) -> list[Part]:
    """The user, and DragPoser with each of the constraints; prints how well each is met."""
    seen, body = readings(motion, TRACKERS), UserBody.of(motion)
    wanted = constraints_for(motion)
    poses = {
        label: load_system("dragposer", constraints=given).predict(seen, body)
        for label, given in wanted.items()
    }
    found = [Part("user", "the motion itself", "", to_clip(motion))]
    for label, given in wanted.items():
        clip = over_users_floor(poses[label], motion)
        found.append(Part(label, "3 trackers", next(iter(KINDS)), clip))
        if given:
            without, with_it = (_loss(given[0], poses[name]) for name in ("no constraint", label))
            print(f"{label}: loss {without:.3f} without and {with_it:.3f} with the constraint")
    return found


def _loss(constraint: Constraint, poses: Poses) -> float:
    position, quat = poses.forward_kinematics()
    return float(constraint(torch.as_tensor(position), torch.as_tensor(quat)).mean())


def main() -> None:
    """Make the film and the sheet."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("motions", nargs="?", default="synthetic:walk")
    parser.add_argument("--out", type=Path, default=Path("runs/constraints"))
    args = parser.parse_args()
    whole = to_motion(load_motions(args.motions)[0])
    frames = slice(round(SECONDS * whole.fps))
    motion = replace(
        whole, rotations=whole.rotations[frames], root_position=whole.root_position[frames]
    ).resampled(SENSOR_FPS)
    scene = FilmScene(parts(motion), SIZE)
    args.out.mkdir(parents=True, exist_ok=True)
    write_video(args.out / "constraints.mp4", pictures(scene), FPS / 2)
    with whole_file(args.out / "constraints.png") as path:
        sheet([scene]).save(path, "PNG", optimize=True)
    errors = [float(np.mean(errors)) for errors in scene.errors_cm]
    print(", ".join(f"{p.name}: {e:.1f} cm" for p, e in zip(scene.parts, errors, strict=True)))


if __name__ == "__main__":
    raise SystemExit(guarded(main))
