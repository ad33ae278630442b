"""Films of a clip, and of rollouts with the avatar beside its user."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Literal, Protocol, TypeVar

import numpy as np

from questsim.bodies import map_of
from questsim.body import DEFAULT_HEIGHT_M
from questsim.errors import InputError, did_you_mean
from questsim.heightfield import HeightField
from questsim.metrics import Rollout
from questsim.metrics_terms import mpjpe_cm
from questsim.motion.clip import FPS, Clip
from questsim.viewing.camera import Camera, following_cameras, three_quarter_azimuth
from questsim.viewing.captions import caption
from questsim.viewing.costume import REFERENCE, Look
from questsim.viewing.outline import outline_points
from questsim.viewing.render import DrawnAvatar, SceneRenderer, device_markers, object_markers
from questsim.viewing.video import write_video


class Named(Protocol):
    """What films are chosen by."""

    @property
    def name(self) -> str:
        """Of the clip."""
        ...

    @property
    def kind(self) -> str:
        """Of motion."""
        ...


T = TypeVar("T", bound=Named)
FilmLayout = Literal["beside", "ghost"]
_BESIDE_M = 1.05  # between two people of 1.75 m
_GHOST_OPACITY = 0.35
LEGEND = "orange: avatar   blue: its user"
_HOLD_S = 0.7  # how long the last picture of a page stays


def clip_frames(
    clip: Clip, width: int = 640, height: int = 480, stride: int = 1
) -> Iterator[np.ndarray]:
    """Pictures ``(height, width, 3)`` of every ``stride``-th frame of a clip, with captions.

    Raises:
        NoGLError: there is no OpenGL library to render with.
    """
    cameras = clip_cameras(clip, width / height)
    with SceneRenderer(
        [DrawnAvatar(clip.height_m, proportions=clip.proportions)], width, height
    ) as renderer:
        for frame in range(0, len(clip), stride):
            picture = renderer.render([clip.qpos[frame]], cameras[frame])
            time = f"{frame / FPS:.2f} s"
            yield caption(picture, {"top left": title(clip), "bottom left": time})


def clip_cameras(clip: Clip, aspect: float, smoothing_s: float = 0.5) -> list[Camera]:
    """A camera for each frame of a clip, for pictures of that width over height."""
    return following_cameras(
        outline_points(clip.link_position, clip.link_quat, clip.height_m),
        clip.qpos[:, :3],
        three_quarter_azimuth(clip.qpos[:, 3:7]),
        aspect,
        smoothing_frames=smoothing_s * FPS,
    )


def title(clip: Clip) -> str:
    """A clip's name, kind and height in one line."""
    about = " ".join(word for word in (clip.style, clip.kind) if word and word not in clip.name)
    return "  ".join(part for part in (clip.name, about, f"{clip.height_m:.2f} m") if part)


@dataclass(frozen=True)
class _Shot:
    """Data for the pictures of one rollout, computed once."""

    rollout: Rollout
    avatar: np.ndarray  # (F, 40)
    person: np.ndarray  # (F, 40), moved aside
    aside: np.ndarray  # (F, 3) metres
    error_cm: np.ndarray  # (F,)
    cameras: list[Camera]

    def __len__(self) -> int:
        return len(self.avatar)


def _shot(rollout: Rollout, aspect: float, layout: FilmLayout, ground: HeightField | None) -> _Shot:
    clip, frames = rollout.reference, len(rollout)
    azimuth = three_quarter_azimuth(clip.qpos[:frames, 3:7])
    root = clip.qpos[:frames, :3]
    aside = np.zeros_like(root)
    if layout == "beside":
        right = Camera(np.zeros(3), 1.0, azimuth).axes()[0]
        aside += right * _BESIDE_M * rollout.height_m / DEFAULT_HEIGHT_M
        if ground is not None:  # it stands on what is there
            aside[:, 2] += ground.ground_at(root + aside) - ground.ground_at(root)
    position, quat = clip.link_position[:frames], clip.link_quat[:frames]
    points = [
        outline_points(rollout.link_position, rollout.link_quat, rollout.height_m),
        outline_points(position + aside[:, None], quat, rollout.height_m),
        *(obj.corners_near(rollout.link_position[:, 0]) for obj in rollout.objects),
    ]
    person = clip.qpos[:frames].copy()
    person[:, :3] += aside
    return _Shot(
        rollout=rollout,
        avatar=rollout.qpos,
        person=person,
        aside=aside,
        error_cm=mpjpe_cm(rollout.link_position, position),
        cameras=following_cameras(
            np.concatenate(points, axis=1),
            root + aside / 2.0,
            azimuth,
            aspect,
            smoothing_frames=0.5 * rollout.fps,
        ),
    )


def _picture(renderer: SceneRenderer, shot: _Shot, frame: int, legend: str) -> np.ndarray:
    """One tile: the avatar with the user's devices as markers, the person, objects, captions."""
    rollout = shot.rollout
    clip = rollout.reference
    markers = device_markers(clip.link_position[frame], clip.link_quat[frame], clip.height_m)
    for obj in rollout.objects:
        markers += object_markers(obj.parts, obj.position[frame], obj.quat[frame])
    picture = renderer.render(
        [shot.avatar[frame], shot.person[frame]], shot.cameras[frame], markers
    )
    fell = rollout.fell and frame == len(shot) - 1
    state = f"fell after {frame / rollout.fps:.1f} s" if fell else f"{frame / rollout.fps:.1f} s"
    return caption(
        picture,
        {
            "top left": title(rollout.reference),
            "bottom left": f"{state}   error {shot.error_cm[frame]:.1f} cm",
            "bottom right": legend,
        },
        alarm=fell,
    )


def rollout_frames(
    rollouts: Sequence[Rollout],
    width: int = 1280,
    height: int = 720,
    columns: int = 2,
    stride: int = 2,
    max_seconds: float = 10.0,
    layout: FilmLayout = "beside",
    ground: HeightField | None = None,
) -> Iterator[np.ndarray]:
    """Pictures ``(height, width, 3)`` of a page of rollouts that play at the same time.

    The avatar is orange, its user is blue. The blue boxes on the avatar are the user's headset and
    controllers. A rollout that has ended keeps its last picture.

    Raises:
        NoGLError: there is no OpenGL library to render with.
    """
    columns = min(columns, len(rollouts))
    rows = -(-len(rollouts) // columns)
    tile_width, tile_height = width // columns, height // rows
    shots = [_shot(rollout, tile_width / tile_height, layout, ground) for rollout in rollouts]
    person = REFERENCE if layout == "beside" else REFERENCE.faded(_GHOST_OPACITY)
    renderers: dict[Any, SceneRenderer] = {}
    try:
        for rollout in rollouts:
            if (key := _body_of(rollout)) not in renderers:
                figures = _figures(rollout, person, devices=layout == "beside")
                renderers[key] = SceneRenderer(figures, tile_width, tile_height, ground)
        page = np.full((height, width, 3), 255, np.uint8)
        fps = rollouts[0].fps
        seconds = min(max(len(shot) for shot in shots), round(max_seconds * fps))
        drawn = [-1] * len(shots)
        for frame in range(0, seconds + round(_HOLD_S * fps), stride):
            for i, shot in enumerate(shots):
                now = min(frame, len(shot) - 1, seconds - 1)
                if now == drawn[i]:
                    continue
                drawn[i] = now
                x, y = i % columns * tile_width, i // columns * tile_height
                tile = _picture(renderers[_body_of(shot.rollout)], shot, now, "" if i else LEGEND)
                page[y : y + tile_height, x : x + tile_width] = tile
            yield page.copy()
    finally:
        for renderer in renderers.values():
            renderer.close()


def _body_of(rollout: Rollout) -> tuple[Any, ...]:
    return rollout.height_m, rollout.reference.proportions, rollout.body


def _figures(rollout: Rollout, person: Look, devices: bool) -> list[DrawnAvatar]:
    """The avatar and its user."""
    own = None if rollout.body is None else map_of(rollout.body)
    parts, height = rollout.reference.proportions, rollout.height_m
    return [
        DrawnAvatar(height, devices=False, body=own, proportions=parts),
        DrawnAvatar(height, person, devices, body=own, proportions=parts),
    ]


def rollout_video(
    rollouts: Sequence[Rollout],
    path: str | Path,
    *,
    max_clips: int = 4,
    width: int = 1280,
    height: int = 720,
    columns: int = 2,
    stride: int = 2,
    max_seconds: float = 10.0,
    layout: FilmLayout = "beside",
    ground: HeightField | None = None,
) -> Path:
    """Film rollouts, four to a page, page after page: the avatar beside the person it follows.

    Args:
        rollouts: what evaluation produced.
        path: the MP4 file.
        max_clips: number of clips: first the middle one of each kind, then others of each kind.
        width: of the video in pixels.
        height: of the video in pixels.
        columns: pictures side by side; two rows make a page.
        stride: show every n-th frame; the film keeps its speed.
        max_seconds: the longest that a page plays.
        layout: ``"beside"``, or ``"ghost"``: the user transparent at the same place.
        ground: the ground; None for a plane.

    Returns:
        The path.

    Raises:
        NoGLError: there is no OpenGL library to render with.
        InputError, OSError: the folder cannot be made or written.
    """
    chosen = one_of_each_kind(rollouts, max_clips)
    size = 2 * columns
    pages = [chosen[i : i + size] for i in range(0, len(chosen), size)]
    frames = chain.from_iterable(
        rollout_frames(page, width, height, columns, stride, max_seconds, layout, ground)
        for page in pages
    )
    fps = rollouts[0].fps if rollouts else FPS
    write_video(path, frames, fps / stride)
    return Path(path)


def one_of_each_kind(rollouts: Sequence[T], count: int) -> list[T]:
    """Select ``count`` clips: the middle one of each kind, then the next of each, cyclically.

    Libraries often begin and end a kind with its extremes. The scores of clips are not used.
    """
    by_kind: dict[str, list[T]] = {}
    for rollout in rollouts:
        by_kind.setdefault(rollout.kind, []).append(rollout)
    by_kind = {kind: _from_the_middle(group) for kind, group in by_kind.items()}
    longest = max(map(len, by_kind.values()), default=0)
    turns = [group[i] for i in range(longest) for group in by_kind.values() if i < len(group)]
    return turns[:count]


def chosen_by_name(choices: Sequence[T], names: Sequence[str], option: str) -> list[T]:
    """Rollouts or motions by their names, in the order of the names.

    Raises:
        InputError: an unknown name.
    """
    by_name = {one.name: one for one in reversed(choices)}
    for name in names:
        if name not in by_name:
            known = sorted(by_name)
            hint = ", ".join(known[:3]) + (", ..." if len(known) > 3 else "")
            fix = f"{did_you_mean(name, known)}there are {hint}"
            raise InputError(f"there is no clip {name!r} among the evaluated ones", option, fix)
    return [by_name[name] for name in names]


def _from_the_middle(group: list[T]) -> list[T]:
    middle = len(group) // 2
    return group[middle:] + group[:middle]
