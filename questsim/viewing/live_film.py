"""Films of a live session: the avatar, a translucent user, the forces and captions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from questsim import rotations as rot
from questsim.motion.clip import FPS
from questsim.objects import ObjectTrack
from questsim.viewing.camera import following_cameras, three_quarter_azimuth
from questsim.viewing.captions import caption
from questsim.viewing.costume import REFERENCE
from questsim.viewing.live import Settings, Snapshot, force_arrows
from questsim.viewing.outline import outline_points
from questsim.viewing.render import Arrow, DrawnAvatar, Marker, SceneRenderer, object_markers
from questsim.viewing.video import write_gif, write_video

LEGEND = "orange: avatar   blue: its user   green: forces"
GIF_STRIDE, GIF_WIDTH = 3, 360
_GHOST_OPACITY = 0.18
_LEAST_ARROW_M = 0.05
_PUSH_RED = (0.85, 0.15, 0.12, 1.0)
_DEVICE_SIZE_M = (0.035, 0.035, 0.035)


@dataclass(frozen=True)
class Take:
    """One clip of a film.

    Attributes:
        settings: the settings of the session, such as clip and agent.
        moments: one snapshot per frame, all with the same scenery.
    """

    settings: Settings
    moments: Sequence[Snapshot]


def film(takes: Sequence[Take], path: str | Path, width: int = 960, height: int = 540) -> Path:
    """Write the takes one after the other as an MP4 or a GIF, by the file's extension.

    Args:
        takes: what to show.
        path: ``.mp4`` or ``.gif``; a GIF is smaller and contains every third frame.
        width, height: of the MP4 in pixels.

    Raises:
        NoGLError: there is no OpenGL library to render with.
        InputError: there are no takes, or the folder cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() == ".gif":
        height = round(GIF_WIDTH * height / width)
        frames = (f for take in takes for f in take_frames(take, GIF_WIDTH, height, GIF_STRIDE))
        write_gif(path, frames, FPS / GIF_STRIDE)
    else:
        write_video(path, (f for take in takes for f in take_frames(take, width, height)), FPS)
    return path


def take_frames(take: Take, width: int, height: int, stride: int = 1) -> Iterator[np.ndarray]:
    """Pictures ``(height, width, 3)`` of every ``stride``-th moment of a take.

    Raises:
        NoGLError: there is no OpenGL library to render with.
    """
    first = take.moments[0].scenery
    position = np.stack([m.position for m in take.moments])
    quat = np.stack([m.quat for m in take.moments])
    outlines = [outline_points(position, quat, first.height_m)]
    if first.user_m > first.height_m:
        outlines.append(_user_outline(take))
    poses = [m.object_pose for m in take.moments if m.object_pose is not None]
    if poses:
        place, turn = zip(*poses, strict=True)
        outlines.append(
            ObjectTrack(first.parts, np.stack(place), np.stack(turn)).corners_near(position[:, 0])
        )
    cameras = following_cameras(
        np.concatenate(outlines, axis=1),
        position[:, 0],
        three_quarter_azimuth(np.stack([m.reference_quat[0] for m in take.moments])),
        width / height,
        smoothing_frames=0.5 * FPS,
        margin=0.8,
    )
    figures = [
        DrawnAvatar(first.height_m),
        DrawnAvatar(first.user_m, REFERENCE.faded(_GHOST_OPACITY), devices=False),
    ]
    with SceneRenderer(figures, width, height, first.ground) as renderer:
        for moment, camera in list(zip(take.moments, cameras, strict=True))[::stride]:
            poses = [moment.qpos, moment.reference_qpos]
            yield _captioned(renderer.render(poses, camera, _marks(moment)), moment, take.settings)


def _user_outline(take: Take) -> np.ndarray:
    return outline_points(
        np.stack([m.reference_position for m in take.moments]),
        np.stack([m.reference_quat for m in take.moments]),
        take.moments[0].scenery.user_m,
    )


def _marks(moment: Snapshot) -> list[Marker | Arrow]:
    """The devices as boxes, the forces as arrows."""
    matrices = rot.quat_to_matrix(moment.device_quat)
    marks: list[Marker | Arrow] = [
        Marker(position, matrix, _DEVICE_SIZE_M)
        for position, matrix in zip(moment.device_position, matrices, strict=True)
    ]
    if moment.object_pose is not None:
        marks += object_markers(moment.scenery.parts, *moment.object_pose)
    for i, (start, end) in enumerate(force_arrows(moment)):
        if np.linalg.norm(end - start) > _LEAST_ARROW_M:
            marks.append(Arrow(start, end, rgba=_PUSH_RED) if i == 2 else Arrow(start, end))
    return marks


def _captioned(picture: np.ndarray, moment: Snapshot, settings: Settings) -> np.ndarray:
    ground = settings.terrain + (
        f" x {settings.roughness:g}" if moment.scenery.ground is not None else " ground"
    )
    fell = moment.outcome == "fell"
    state = "fell" if fell else f"error {100.0 * moment.error_m:.1f} cm"
    push = np.linalg.norm(moment.push_n)
    pushed = f"   push {push:.0f} N" if push else ""
    scenery, agent = moment.scenery, settings.agent + ("" if moment.physics else " (no physics)")
    differ = scenery.user_m != scenery.height_m
    sizes = f"   {scenery.height_m:.2f} m, its user {scenery.user_m:.2f} m" if differ else ""
    return caption(
        picture,
        {
            "top left": f"{settings.clip}   {ground}   agent {agent}{sizes}",
            "bottom left": f"{moment.time_s:.1f} s   {state}{pushed}",
            "bottom right": LEGEND if picture.shape[1] >= 640 else "",
        },
        alarm=fell,
    )
