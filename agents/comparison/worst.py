"""Each agent's worst clip as a strip of pictures: what its greatest error looks like."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from agents.comparison.conditions import condition_of
from agents.comparison.film import GHOST_OPACITY, FilmFigure, colour_of, figures_of, look_of
from agents.comparison.report import Row
from agents.comparison.run import suiting
from agents.kinematic.first_answers import begun
from questsim.files import whole_file
from questsim.metrics_terms import mpjpe_cm
from questsim.motion.clip import FPS, Clip
from questsim.motion.motion import Motion
from questsim.motion.retarget import to_clip
from questsim.viewing.camera import Camera
from questsim.viewing.captions import INK, Corner, caption, font
from questsim.viewing.costume import REFERENCE
from questsim.viewing.films import clip_cameras
from questsim.viewing.render import DrawnAvatar, SceneRenderer
from questsim.viewing.video import palette

FILE = "worst.png"
MOMENTS = 6
"""Pictures of a strip, evenly spaced from the first frame to the last, or to the loss."""
TILE = (180, 220)
"""Width and height of a picture in pixels."""
HEADER = 24
"""Height of the line above a strip in pixels."""
COLOURS = 128


def worst_strips(rows: Sequence[Row], motions: Sequence[Motion], out: Path, threads: int) -> None:
    """Write ``FILE``: a strip of the worst clip of each row.

    The agent is run again on that clip. Its user is the see-through figure.

    Args:
        rows: with exact signals, one for each agent.
        motions: the comparison's, at 60 Hz.
        out: the folder.
        threads: physics threads.
    """
    by_name = {motion.name: motion for motion in motions}
    strips = [_strip(row, by_name[row.worst], threads) for row in rows if row.worst]
    if not strips:
        return
    page = Image.fromarray(np.concatenate(strips))
    with whole_file(out / FILE) as path:
        reduced = page.quantize(palette=palette(page, COLOURS), dither=Image.Dither.NONE)
        reduced.save(path, "PNG", optimize=True)
    print(f"written to {out / FILE}")


def _strip(row: Row, motion: Motion, threads: int) -> np.ndarray:
    name, start = condition_of(row.scenario)
    scenario = next(each for each in suiting(row.agent) if each.name == name)
    (part,) = figures_of(row.agent, [motion], threads, start, scenario)
    user = begun(to_clip(motion), start)
    frames = moments(part.clip, user)
    cameras = clip_cameras(user, TILE[0] / TILE[1], smoothing_s=0.0)
    errors = mpjpe_cm(part.clip.link_position, user.link_position[: len(part.clip)])
    tiles = []
    for frame, picture in zip(frames, _pictures(part, user, frames, cameras), strict=True):
        lost = frame == len(part.clip) - 1 and len(part.clip) < len(user)
        state = f"{errors[frame]:.0f} cm" + (", lost" if lost else "")
        words: dict[Corner, str] = {"top left": f"{frame / FPS:.1f} s", "bottom left": state}
        tiles.append(caption(picture, words, alarm=lost, size=13))
    title = f"{Path(row.agent).name}, {row.scenario}: {row.worst}, MPJPE {row.worst_cm:.1f} cm"
    return np.concatenate([_header(title, part.kind), np.concatenate(tiles, axis=1)])


def moments(clip: Clip, user: Clip) -> np.ndarray:
    """Evenly spaced frames of the shorter one; a lost avatar's last frame is one of them."""
    last = min(len(clip), len(user)) - 1
    return np.linspace(0, last, MOMENTS).round().astype(int)


def _pictures(
    part: FilmFigure, user: Clip, frames: np.ndarray, cameras: Sequence[Camera]
) -> Iterator[np.ndarray]:
    width, height = TILE
    figures = [
        DrawnAvatar(part.clip.height_m, look_of(part.kind), devices=False),
        DrawnAvatar(user.height_m, REFERENCE.faded(GHOST_OPACITY), devices=False),
    ]
    # Twice as large and reduced: shadows have no smooth edges otherwise.
    with SceneRenderer(figures, 2 * width, 2 * height) as renderer:
        for frame in frames:
            poses = [part.clip.qpos[frame], user.qpos[frame]]
            picture = renderer.render(poses, cameras[frame])
            yield np.asarray(Image.fromarray(picture).reduce(2))


def _header(text: str, kind: str) -> np.ndarray:
    image = Image.new("RGB", (MOMENTS * TILE[0], HEADER), (255, 255, 255))
    draw = ImageDraw.Draw(image)
    draw.rectangle((0, 0, 8, HEADER), fill=colour_of(kind))
    draw.text((16, HEADER / 2), text, font=font(14), fill=INK, anchor="lm")
    return np.asarray(image)
