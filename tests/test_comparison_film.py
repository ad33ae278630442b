"""The film of a comparison: who is in it, where they stand, what is written."""

from dataclasses import replace

import imageio.v3 as iio
import numpy as np
import pytest
from PIL import Image

from agents.comparison import film as comparison_film
from agents.comparison import worst
from agents.comparison.compare import FILES as TABLES
from agents.comparison.compare import compare
from agents.comparison.film import (
    FILES,
    GHOST_OPACITY,
    STRIDE,
    FilmFigure,
    FilmScene,
    Size,
    figures_of,
    over_users_floor,
    to_be_filmed,
)
from agents.comparison.options import CompareArgs
from agents.evaluation import EvaluateArgs, evaluate
from agents.kinematic.first_answers import SETTLED_FRAMES
from agents.kinematic.interface import Poses
from questsim.errors import InputError
from questsim.metrics_terms import mpjpe_cm
from questsim.motion.clip import FPS
from questsim.motion.kinematics import clip_from_qpos
from questsim.motion.library import save_library
from questsim.motion.retarget import to_clip
from questsim.motion.retarget_back import to_motion
from questsim.viewing import gl
from questsim.viewing.outline import outline_points
from tests.helpers import swaying_clip

needs_gl = pytest.mark.skipif(gl.find_gl() is None, reason=gl.missing_gl())
MOTION = replace(to_motion(swaying_clip(frames=20)), name="sway", kind="stand").resampled(60.0)
SMALL = Size(figure=80, height=120, least=160)


@pytest.fixture
def library(tmp_path):
    path = tmp_path / "motions.npz"
    others = [replace(MOTION, name=f"other-{i}") for i in range(2)]
    save_library(path, [others[0], MOTION, others[1]], [])
    return str(path)


def scene(lost_after: int | None = None) -> FilmScene:
    user = to_clip(MOTION)
    moved = user.qpos + np.eye(40)[0] * 0.05
    shorter = clip_from_qpos("sway", moved[:lost_after], user.height_m)
    parts = [
        FilmFigure("user", "", "", user),
        FilmFigure("ik", "6 trackers", "kinematic", user),
        FilmFigure("questsim", "headset", "policy", shorter),
    ]
    return FilmScene(parts, SMALL)


@needs_gl
def test_a_comparison_is_filmed_beside_its_table(library, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(comparison_film, "SIZE", SMALL)
    monkeypatch.setattr(worst, "TILE", (60, 80))
    out = tmp_path / "scores"
    args = CompareArgs(
        agents=("ik",), motions=library, out=out, threads=1, max_clips=1,
        video=True, video_clips=("sway",),
    )  # fmt: skip
    assert compare(args) == 0
    assert {file.name for file in out.iterdir()} == {*TABLES, *FILES, worst.FILE}
    video = iio.imread(out / "comparison.mp4")
    shown = len(range(0, len(to_clip(MOTION)) - SETTLED_FRAMES, STRIDE)) + round(0.7 * FPS / STRIDE)
    assert video.shape == (shown, 120, 160, 3)
    with Image.open(out / "comparison.png") as sheet:
        assert sheet.size == (120, 2 * 90)  # two moments, smaller
    with Image.open(out / worst.FILE) as strip:  # of the one agent
        assert strip.size == (worst.MOMENTS * 60, worst.HEADER + 80)
    assert "comparison.mp4" in capsys.readouterr().out


def test_without_opengl_the_table_is_written_and_one_line_says_why_there_is_no_film(
    library, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(comparison_film, "find_gl", lambda: None)
    out = tmp_path / "scores"
    args = CompareArgs(agents=("ik",), motions=library, out=out, threads=1, max_clips=1, video=True)
    assert compare(args) == 0
    assert {file.name for file in out.iterdir()} == set(TABLES)
    lines = capsys.readouterr().err.strip().splitlines()
    assert [line for line in lines if line.startswith("video")] == lines[-1:]
    assert lines[-1].startswith("video skipped:")


@pytest.mark.parametrize("function", [compare, evaluate])
def test_unknown_clip_names_are_refused_before_anything_is_computed(library, tmp_path, function):
    out = tmp_path / "there"
    filmed = {"motions": library, "out": out, "video": True, "video_clips": ("nobody",)}
    one = CompareArgs(agents=("ik",), threads=1, **filmed)
    args = one if function is compare else EvaluateArgs(agent="zero", threads=1, **filmed)
    with pytest.raises(InputError, match="--video-clips: there is no clip 'nobody'"):
        function(args)
    assert not out.exists()
    with pytest.raises(InputError, match="add --video"):
        function(replace(args, video=False))


def test_named_clips_are_filmed_in_the_order_of_their_names_at_60_hz():
    motions = [replace(to_motion(swaying_clip(frames=8)), name=name) for name in "abc"]
    filmed = to_be_filmed(motions, ["c", "a"])
    assert [(motion.name, motion.fps) for motion in filmed] == [("c", 60.0), ("a", 60.0)]


def test_an_estimate_that_floats_or_skates_does_so_over_the_users_floor():
    aside = np.array([0.10, 0.02, 0.05])
    offsets = np.broadcast_to(MOTION.offsets, (len(MOTION), 22, 3))
    poses = Poses(MOTION.root_position + aside, MOTION.rotations, offsets)
    user, shown = to_clip(MOTION), over_users_floor(poses, MOTION)
    moved = shown.link_position - user.link_position
    np.testing.assert_allclose(moved, np.broadcast_to(aside, moved.shape), atol=0.003)
    assert np.ptp(moved[:, 0], axis=0).max() < 1e-6


def test_all_avatars_show_the_same_frame_above_the_labels():
    film = scene()
    for frame in range(film.frames):
        poses = film.poses(frame)
        camera = film.cameras[frame]
        for i, part in enumerate(film.parts):
            own = poses[2 * i - 1 if i else 0]
            np.testing.assert_allclose(own[7:], part.clip.qpos[frame, 7:])
            np.testing.assert_allclose(own[:3] - part.clip.qpos[frame, :3], film.offsets[i])
            points = outline_points(part.clip.link_position, part.clip.link_quat, 1.75)[frame]
            x, y = camera.project(points + film.offsets[i], film.width, SMALL.height).T
            assert x.min() > 0 and x.max() < film.width
            assert y.min() > 0.05 * SMALL.height and y.max() < 0.82 * SMALL.height


def test_an_avatar_in_the_users_pose_hides_the_ghost():
    film = scene()
    ghost, own = film.poses(3)[2], film.poses(3)[1]
    camera = film.cameras[3]
    behind = camera.axes() @ (ghost[:3] - own[:3])
    assert behind[:2] == pytest.approx([0.0, 0.0], abs=1e-9) and behind[2] > 0.05
    assert [figure.look.shirt[3] for figure in film.figures()] == [
        1.0, 1.0, GHOST_OPACITY, 1.0, GHOST_OPACITY,
    ]  # fmt: skip


def test_the_last_picture_of_a_lost_agents_strip_is_its_last_frame():
    user = to_clip(MOTION)
    lost = clip_from_qpos("sway", user.qpos[:5], user.height_m)
    assert list(worst.moments(lost, user)) == [0, 1, 2, 2, 3, 4]
    assert worst.moments(user, user)[-1] == len(user) - 1


def test_labels_stand_below_their_avatars_and_show_the_error():
    film = scene()
    labels = film.labels(4)
    assert [label.lines[0] for label in labels] == ["user", "ik", "questsim"]
    user, avatar = film.parts[0].clip, film.parts[2].clip
    error = mpjpe_cm(avatar.link_position, user.link_position)[4]
    assert error == pytest.approx(5.0, abs=0.01)
    assert [label.lines[2] for label in labels] == ["", "0.0 cm", "5.0 cm"]
    x = film.cameras[4].project(user.qpos[4, :3] + film.offsets, film.width, SMALL.height)[:, 0]
    assert [label.x for label in labels] == pytest.approx(list(x), abs=6.0)


def test_a_lost_avatar_leaves_the_picture_and_its_ghost_continues():
    film = scene(lost_after=5)
    before, after = film.labels(4)[2], film.labels(5)[2]
    assert before.lines[2] == "5.0 cm" and not before.alarm
    assert after.lines[2] == "lost at 0.1 s" and after.alarm
    assert film.poses(4)[3][2] > 0.5 and film.poses(5)[3][2] < -10.0
    np.testing.assert_allclose(film.poses(5)[4][:3], film.poses(5)[0][:3] + film.offsets[2])


def test_agents_are_labelled_by_kind_and_devices():
    ik, behind, demo = (figures_of(name, [MOTION], 1)[0] for name in ("ik", "ik+physics", "demo"))
    assert (ik.kind, ik.devices) == ("kinematic", "6 trackers")
    assert (behind.kind, behind.devices) == ("with physics behind it", "6 trackers")
    assert (demo.kind, demo.devices) == ("policy", "headset + controllers")
    user = to_clip(MOTION).after(SETTLED_FRAMES)  # all begin when avatars do
    assert len(ik.clip) == len(user) and len(demo.clip) <= len(user)
    assert mpjpe_cm(ik.clip.link_position, user.link_position).mean() < 1.0
