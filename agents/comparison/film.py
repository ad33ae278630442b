"""The film of a comparison: the user and every agent side by side at the same moment.

Poses of kinematic systems are shown on the avatar at their estimated world position over the user's
floor, so that floating, sinking and skating are visible. An avatar that is lost is removed from the
picture. Each figure has its name and its mean joint error below it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np
from PIL import Image

from agents.comparison.behind import follow_shown, shown_of
from agents.comparison.conditions import Start, starts_of
from agents.comparison.plots import KINDS
from agents.comparison.run import suiting
from agents.evaluation.rollout import env_config, roll_out
from agents.kinematic.estimates import Job, estimated_together
from agents.kinematic.first_answers import begun, begun_in_estimates
from agents.kinematic.physics_behind import until_lost
from agents.kinematic.scenario import Scenario
from agents.kinematic.without_physics import over_users_floor
from agents.loading import load_agent
from agents.resolve import base_of, resolve
from questsim.body import DEFAULT_HEIGHT_M
from questsim.files import whole_file
from questsim.joint_sensors import SENSOR_FPS
from questsim.metrics_terms import mpjpe_cm
from questsim.motion.clip import FPS, Clip
from questsim.motion.motion import Motion
from questsim.motion.retarget import to_clip
from questsim.plots import GREEN
from questsim.sensors import SENSOR_SETS
from questsim.viewing.camera import Camera, following_cameras, three_quarter_azimuth
from questsim.viewing.captions import Label, caption, labelled
from questsim.viewing.costume import AVATAR, REFERENCE, Look
from questsim.viewing.films import chosen_by_name, one_of_each_kind, title
from questsim.viewing.gl import NoGLError, find_gl, missing_gl
from questsim.viewing.outline import outline_points
from questsim.viewing.render import DrawnAvatar, SceneRenderer
from questsim.viewing.video import palette, write_video

VIDEO, SHEET = "comparison.mp4", "comparison.png"
FILES: tuple[str, ...] = (VIDEO, SHEET)
"""What ``film`` writes."""
CLIPS = 4
"""Number of clips in the film if none are named, of different kinds."""
MAX_SECONDS, HOLD_S = 10.0, 0.7
"""Longest time in s that a clip plays, and time in s that its last picture is held."""
STRIDE = 2
"""Every second frame is filmed."""
MOMENTS = (0.3, 0.7)
"""Moments of a clip shown in the sheet, as shares of its length."""
FOVY_DEG = 13.0
"""A small field of view: all figures are seen from nearly the same side."""
GHOST_OPACITY = 0.4
BEHIND_M = 0.12
"""Distance in m of the ghost behind its figure; it is visible only where the two differ."""
_COLOURS: dict[str, str] = {**KINDS, "policy": GREEN}  # blue is the user
_LABEL_SHARE, _TITLE_SHARE = 0.2, 0.08  # shares of a picture's height kept free below and above
_FREE_SHARE = 1.0 - _LABEL_SHARE - _TITLE_SHARE
_HIDDEN = np.array([0.0, 0.0, -50.0])  # metres
_SHEET_SCALE = 0.75
_SHEET_COLOURS = 128


@dataclass(frozen=True)
class Size:
    """Size of pictures in pixels.

    Attributes:
        figure: width per figure.
        height: height of a picture.
        least, most: smallest and largest width of a picture.
    """

    figure: int = 200
    height: int = 440
    least: int = 640
    most: int = 1920

    def scaled(self, by: float) -> Size:
        """The same proportions, scaled."""
        return Size(*(round(by * pixels) for pixels in vars(self).values()))

    def width(self, figures: int) -> int:
        """Width of a picture with ``figures`` figures."""
        return min(max(self.figure * figures, self.least), self.most) // 2 * 2


SIZE = Size()


@dataclass(frozen=True)
class FilmFigure:
    """One figure in one clip.

    Attributes:
        name, devices: name of the agent, and its devices in words.
        kind: one of ``KINDS``; empty for the user.
        clip: its motion; shorter than the user's if it was lost.
    """

    name: str
    devices: str
    kind: str
    clip: Clip


def film(
    agents: Sequence[str],
    motions: Sequence[Motion],
    out: Path,
    threads: int,
    start: Start = "estimate",
) -> bool:
    """Write ``FILES``, or print one line saying why they could not be written.

    Returns whether they are written.

    Args:
        agents: as in ``comparison.compare``.
        motions: at 60 Hz, shown one after the other.
        out: the folder.
        threads: physics threads.
        start: of avatars with physics.
    """
    if not find_gl():
        print(f"video skipped: {missing_gl()}", file=sys.stderr)
        return False
    parts = [figures_of(agent, motions, threads, start) for agent in agents]
    scenes = [
        FilmScene([_user(motion, start), *(of_clip[i] for of_clip in parts)], SIZE)
        for i, motion in enumerate(motions)
    ]
    try:
        write_video(out / VIDEO, chain.from_iterable(map(pictures, scenes)), FPS / STRIDE)
        with whole_file(out / SHEET) as path:
            sheet(scenes).save(path, "PNG", optimize=True)
    except NoGLError as error:
        print(f"video skipped: {error}", file=sys.stderr)
        return False
    print(f"written to {out / VIDEO} and {out / SHEET}")
    return True


def to_be_filmed(motions: Sequence[Motion], names: Sequence[str]) -> list[Motion]:
    """The motions with these names, or ``CLIPS`` motions of all kinds, at 60 Hz.

    Raises:
        InputError: no clip has one of the names.
    """
    if names:
        found = chosen_by_name(motions, names, "--video-clips")
    else:
        found = one_of_each_kind(motions, CLIPS)
    return [motion.resampled(SENSOR_FPS) for motion in found]


# -- motions of the agents ---------------------------------------------------------------------


def _user(motion: Motion, start: Start) -> FilmFigure:
    return FilmFigure("user", "the motion itself", "", begun(to_clip(motion), start))


def figures_of(
    agent: str,
    motions: Sequence[Motion],
    threads: int,
    start: Start = "estimate",
    scenario: Scenario | None = None,
) -> list[FilmFigure]:
    """An agent's result on each motion, as the comparison computes it.

    Args:
        agent, motions, threads, start: see ``film``.
        scenario: of the agent; by default see ``shown_scenario``.
    """
    kinematic, physics, policy = KINDS
    if resolve(agent).torques:
        loaded = load_agent(agent)
        clips = [to_clip(motion) for motion in motions]
        config = replace(env_config(loaded), starts=starts_of(start))
        follow, begin_at = begun_in_estimates(clips, start)
        rollouts = roll_out(loaded, follow, config, threads, begin_at=begin_at)
        devices = _in_words(SENSOR_SETS[loaded.needs.sensors])
        return [FilmFigure(agent, devices, policy, until_lost(rollout)) for rollout in rollouts]
    scenario = scenario or shown_scenario(suiting(agent))
    base = base_of(agent) or agent
    poses = estimated_together([Job(base, scenario, motion) for motion in motions])
    devices, pairs = _in_words(scenario.devices), list(zip(poses, motions, strict=True))
    if base_of(agent) is None:
        clips = [begun(over_users_floor(p, m), start) for p, m in pairs]
        return [FilmFigure(agent, devices, kinematic, clip) for clip in clips]
    rollouts = follow_shown([shown_of(p, m) for p, m in pairs], start, threads)
    return [FilmFigure(agent, devices, physics, until_lost(rollout)) for rollout in rollouts]


def shown_scenario(found: Sequence[Scenario]) -> Scenario:
    """The scenario with six trackers, otherwise the first."""
    return next((scenario for scenario in found if scenario.name == "6"), found[0])


def _in_words(devices: Sequence[str]) -> str:
    """Devices in a few words."""
    kinds = [device.split("_")[-1] for device in devices]
    imus, trackers = kinds.count("imu"), kinds.count("tracker")
    if trackers:
        return f"{len(kinds) - imus} trackers"
    words = ["headset"] if "headset" in kinds else []
    words += ["controllers"] if "controller" in kinds else []
    return " + ".join(words + ([f"{imus} IMUs"] if imus else []))


# -- pictures ----------------------------------------------------------------------------------


class FilmScene:
    """Figures side by side in one clip.

    Args:
        parts: the user first.
        size: of the pictures.
    """

    def __init__(self, parts: Sequence[FilmFigure], size: Size) -> None:
        self.parts, self.size = parts, size
        self.user = parts[0].clip
        self.frames = min(len(self.user), round(MAX_SECONDS * FPS))
        self.width = size.width(len(parts))
        azimuth = three_quarter_azimuth(self.user.qpos[: self.frames, 3:7])
        right = Camera(np.zeros(3), 1.0, azimuth).axes()[0]
        self.offsets = np.arange(len(parts))[:, None] * self._spacing(right) * right
        self.cameras = self._cameras(azimuth)
        self.errors_cm = [self._errors(part.clip) for part in parts]

    def _spacing(self, right: np.ndarray) -> float:
        """Metres between two figures: by the widest pose, or by the width of the picture."""
        clip = self.user
        points = outline_points(clip.link_position, clip.link_quat, clip.height_m)[: self.frames]
        across = (points - clip.qpos[: self.frames, None, :3]) @ right
        ratio = clip.height_m / DEFAULT_HEIGHT_M
        needed = np.clip(across.max() - across.min() + 0.1, 0.75 * ratio, 1.5 * ratio)
        high = (points[..., 2].max() - points[..., 2].min()) / _FREE_SHARE
        room = high * self.width / self.size.height / len(self.parts)
        return float(max(needed, room))

    def _cameras(self, azimuth: float) -> list[Camera]:
        """One camera per frame that shows every figure not yet lost, above the labels."""
        user, height = self.user, self.user.height_m
        points = []
        for part, offset in zip(self.parts, self.offsets, strict=True):
            there = len(part.clip)
            position = np.concatenate([part.clip.link_position, user.link_position[there:]])
            quat = np.concatenate([part.clip.link_quat, user.link_quat[there:]])
            points.append(outline_points(position, quat, height)[: self.frames] + offset)
        cameras = following_cameras(
            np.concatenate(points, axis=1),
            user.qpos[: self.frames, :3] + self.offsets.mean(axis=0),
            azimuth,
            self.width / (self.size.height * _FREE_SHARE),
            smoothing_frames=0.5 * FPS,
            margin=0.96 * _FREE_SHARE,
            fovy_deg=FOVY_DEG,
        )
        # The free area is not centred in the picture.
        down = (_LABEL_SHARE - _TITLE_SHARE) * np.tan(np.radians(FOVY_DEG) / 2.0)
        return [replace(c, lookat=c.lookat - [0.0, 0.0, down * c.distance]) for c in cameras]

    def _errors(self, clip: Clip) -> np.ndarray:
        return mpjpe_cm(clip.link_position, self.user.link_position[: len(clip)])

    def figures(self) -> list[DrawnAvatar]:
        """The user, then each agent and the user's ghost."""
        height = self.user.height_m
        ghost = DrawnAvatar(height, REFERENCE.faded(GHOST_OPACITY), devices=False)
        figures = [DrawnAvatar(height, REFERENCE)]
        for part in self.parts[1:]:
            figures += [DrawnAvatar(part.clip.height_m, look_of(part.kind), devices=False), ghost]
        return figures

    def poses(self, frame: int) -> list[np.ndarray]:
        """``qpos`` of ``figures``; lost ones are placed out of sight."""
        user, behind = self.user.qpos[frame], BEHIND_M * self.cameras[frame].axes()[2]
        poses = [_moved(user, self.offsets[0])]
        for part, offset in zip(self.parts[1:], self.offsets[1:], strict=True):
            lost = frame >= len(part.clip)
            own = _moved(user, _HIDDEN) if lost else part.clip.qpos[frame]
            poses.append(_moved(own, offset))
            poses.append(_moved(user, offset if lost else offset + behind))
        return poses

    def labels(self, frame: int) -> list[Label]:
        """Names and errors, each below its figure."""
        camera = self.cameras[frame]
        places = camera.lookat + self.offsets - self.offsets.mean(axis=0)
        across = camera.project(places, self.width, self.size.height)[:, 0]
        labels = []
        for x, part, errors in zip(across, self.parts, self.errors_cm, strict=True):
            lost = frame >= len(errors)
            state = f"lost at {len(errors) / FPS:.1f} s" if lost else f"{errors[frame]:.1f} cm"
            lines = (Path(part.name).name, part.devices, state if part.kind else "")
            labels.append(Label(x, lines, colour_of(part.kind), lost))
        return labels


def _moved(qpos: np.ndarray, offset: np.ndarray) -> np.ndarray:
    moved = qpos.copy()
    moved[:3] += offset
    return moved


def colour_of(kind: str) -> tuple[int, int, int]:
    """Red, green and blue, 0 to 255, of the shirt of a kind of agent; the user's for none."""
    if not kind:
        red, green, blue = (round(255 * part) for part in REFERENCE.shirt[:3])
        return red, green, blue
    red, green, blue = (int(_COLOURS[kind][i : i + 2], 16) for i in (1, 3, 5))
    return red, green, blue


def look_of(kind: str) -> Look:
    """The avatar with the shirt of a kind of agent."""
    red, green, blue = (part / 255.0 for part in colour_of(kind))
    return replace(AVATAR, shirt=(red, green, blue, 1.0))


def _picture(renderer: SceneRenderer, scene: FilmScene, frame: int) -> np.ndarray:
    return _captioned(renderer.render(scene.poses(frame), scene.cameras[frame]), scene, frame)


def _captioned(picture: np.ndarray, scene: FilmScene, frame: int) -> np.ndarray:
    size = max(9, round(scene.size.height / 28))
    time = f"{frame / FPS:.1f} s"
    picture = caption(picture, {"top left": title(scene.user), "top right": time}, size=size)
    labels = scene.labels(frame)
    width = 0.96 * min(labels[1].x - labels[0].x, scene.width / len(labels))
    return labelled(picture, labels, width, size)


def _renderer(scene: FilmScene) -> SceneRenderer:
    reach = float(np.linalg.norm(scene.offsets[-1])) / 2.0 + 1.5
    return SceneRenderer(scene.figures(), scene.width, scene.size.height, reach_m=reach)


def pictures(scene: FilmScene) -> Iterator[np.ndarray]:
    """The film of one clip: pictures ``(height, width, 3)`` at ``FPS / STRIDE``."""
    with _renderer(scene) as renderer:
        picture = None
        for frame in range(0, scene.frames, STRIDE):
            picture = _picture(renderer, scene, frame)
            yield picture
    for _ in range(round(HOLD_S * FPS / STRIDE)):
        assert picture is not None
        yield picture


def sheet(scenes: Sequence[FilmScene]) -> Image.Image:
    """A few moments of each clip, one row per clip, smaller than in the film."""
    rows = []
    for scene in scenes:
        small = FilmScene(scene.parts, scene.size.scaled(_SHEET_SCALE))
        with _renderer(scene) as renderer:
            for share in MOMENTS:
                frame = round(share * (scene.frames - 1))
                picture = renderer.render(scene.poses(frame), scene.cameras[frame])
                # Scaled down for smooth shadows before text is drawn on it.
                reduced = Image.fromarray(picture).resize((small.width, small.size.height))
                rows.append(_captioned(np.asarray(reduced), small, frame))
    page = Image.fromarray(np.concatenate(rows))
    return page.quantize(palette=palette(page, _SHEET_COLOURS), dither=Image.Dither.NONE)
