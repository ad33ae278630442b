"""Pictures are looked at here as a program can: sizes, colours, where objects are in them."""

import os
import subprocess
import sys
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
from PIL import Image
from rollouts import moving_clip, rollout, shifted, still_clip

from questsim.errors import InputError
from questsim.heightfield import HeightField
from questsim.motion import spec
from questsim.objects import ObjectShape, ObjectTrack
from questsim.skeleton import LINKS
from questsim.viewing import contact_sheet as sheets
from questsim.viewing import gl
from questsim.viewing.camera import Camera, following_cameras, three_quarter_azimuth
from questsim.viewing.captions import caption
from questsim.viewing.costume import convex_hull
from questsim.viewing.films import (
    _picture,
    _shot,
    clip_cameras,
    clip_frames,
    one_of_each_kind,
    rollout_frames,
    rollout_video,
)
from questsim.viewing.outline import outline_points, stick_picture
from questsim.viewing.render import DrawnAvatar, SceneRenderer, metre_tile
from questsim.viewing.show_command import ShowArgs, file_name, show_clip
from questsim.viewing.video import write_video

needs_gl = pytest.mark.skipif(gl.find_gl() is None, reason=gl.missing_gl())


@pytest.fixture
def no_gl(monkeypatch):
    """A machine on which no backend renders."""
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(gl, "_renders", lambda backend: False)
    gl._find.cache_clear()
    yield
    gl._find.cache_clear()


def standing(height_m: float = 1.75) -> np.ndarray:
    return still_clip(1, height_m).qpos[0]


def orange(picture: np.ndarray) -> np.ndarray:
    red, green, blue = np.moveaxis(picture.astype(int), -1, 0)
    return (red > green + 50) & (green > blue)


def blue(picture: np.ndarray) -> np.ndarray:
    red, _, blue = np.moveaxis(picture.astype(int), -1, 0)
    return blue > red + 60


def rgb_of_size(width: int, height: int, value: int = 100) -> np.ndarray:
    return np.full((height, width, 3), value, np.uint8)


# --- OpenGL ---------------------------------------------------------------------------------


def test_without_a_backend_one_line_names_the_debian_packages(no_gl):
    assert gl.find_gl() is None
    with pytest.raises(gl.NoGLError) as error:
        gl.use_gl()
    assert "libosmesa6" in str(error.value) and "libegl1" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_library_that_cannot_be_loaded_is_no_backend(monkeypatch):
    # PyOpenGL refuses every platform but the one named, as it does a library that is not there.
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setenv("PYOPENGL_PLATFORM", "no-such-platform")
    assert not gl._renders("osmesa")
    assert not gl._renders("egl")


@pytest.mark.parametrize(
    ("value", "word"), [("egl", "libegl1"), ("osmesa", "libosmesa6"), ("off", "switched off")]
)
def test_a_users_mujoco_gl_that_fails_is_respected_and_explained(no_gl, monkeypatch, value, word):
    monkeypatch.setenv("MUJOCO_GL", value)
    assert gl._candidates(value, display=False) == (value,)
    assert gl.find_gl() is None
    assert word in gl.missing_gl()


def test_a_display_adds_glfw():
    assert "glfw" in gl._candidates(None, display=True) or not sys.platform.startswith("linux")
    assert "glfw" not in gl._candidates(None, display=False)


@needs_gl
def test_a_backend_can_be_chosen_after_mujoco_was_imported():
    code = (
        "import mujoco\n"
        "from questsim.viewing.render import DrawnAvatar, SceneRenderer\n"
        "SceneRenderer([DrawnAvatar()], 32, 32).close()\n"
        "print('ok')"
    )
    env = {k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True)
    assert done.stdout == "ok\n", done.stderr
    assert not done.stderr  # MuJoCo has nothing to warn of


# --- camera and outline ---------------------------------------------------------------------


def test_camera_projects_its_target_to_the_middle_and_left_to_the_left():
    camera = Camera(np.array([1.0, 2.0, 0.9]), 3.0, azimuth_deg=90.0, elevation_deg=0.0)
    # It looks along +y: x is to the right, z up.
    points = camera.lookat + np.array([[0, 0, 0], [-0.5, 0, 0], [0, 0, 0.5], [0, -4.0, 0]])
    middle, left, above, behind = camera.project(points, 640, 480)
    assert middle == pytest.approx([320, 240])
    assert left[0] < 320 and left[1] == pytest.approx(240)
    assert above[0] == pytest.approx(320) and above[1] < 240
    assert np.isnan(behind).all()


def test_camera_keeps_everything_in_the_picture():
    clip = moving_clip(40)
    points = outline_points(clip.link_position, clip.link_quat, clip.height_m)
    for aspect in (0.75, 1.8):
        cameras = clip_cameras(clip, aspect)
        assert len({camera.distance for camera in cameras}) == 1
        for frame, camera in enumerate(cameras):
            x, y = camera.project(points[frame], round(100 * aspect), 100).T
            assert (x > 0).all() and (x < 100 * aspect).all()
            assert (y > 0).all() and (y < 100).all()


def test_camera_follows_smoothly():
    root = np.zeros((60, 3))
    root[30:, 0] = 1.0
    jump = np.diff(
        [c.lookat[0] for c in following_cameras(root[:, None], root, 0.0, 1.0, 18.0)]
    ).max()
    still = np.diff(
        [c.lookat[0] for c in following_cameras(root[:, None], root, 0.0, 1.0, 0.0)]
    ).max()
    assert still == pytest.approx(1.0)
    assert jump < 0.05


def test_view_is_of_the_front_and_a_side():
    clip = still_clip(4)
    camera = Camera(np.zeros(3), 3.0, three_quarter_azimuth(clip.qpos[:, 3:7]))
    forward_of_camera = camera.axes()[2]
    assert -0.9 < forward_of_camera[0] < -0.3  # it looks into the face of somebody facing +x


def test_outline_reaches_from_floor_to_crown():
    clip = still_clip(1, 1.6)
    points = outline_points(clip.link_position, clip.link_quat, 1.6)
    assert points[..., 2].max() == pytest.approx(1.6, abs=0.02)
    assert points[..., 2].min() == pytest.approx(0.0, abs=0.02)


def test_convex_hull_of_a_sphere_is_that_sphere():
    vertices, normals, faces = convex_hull(np.array([[1.0, 2.0, 3.0, 0.5, 0.5, 0.5]]))
    assert np.linalg.norm(vertices - [1, 2, 3], axis=-1) == pytest.approx(0.5)
    assert normals == pytest.approx((vertices - [1, 2, 3]) / 0.5)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    assert (np.sum(np.cross(b - a, c - a) * (a - [1, 2, 3]), axis=-1) > 0).all()


def test_floor_repeats_every_metre_but_for_its_checks():
    tile = metre_tile(64).astype(int)
    assert (tile[:32, :32] == tile[32:, 32:]).all()
    assert (tile[:32, :32] != tile[:32, 32:]).any()


# --- rendering ------------------------------------------------------------------------------


@needs_gl
def test_taller_people_are_taller_in_the_picture_and_stand_where_they_should():
    camera = Camera(np.array([0.0, 0.0, 0.9]), 4.0, 180.0, 0.0)
    extents = []
    for height in (1.4, 1.9):
        with SceneRenderer([DrawnAvatar(height)], 160, 240) as renderer:
            person = renderer.render([standing(height)], camera)
            aside = standing(height) + np.eye(40)[1] * 50.0
            difference = np.abs(person.astype(int) - renderer.render([aside], camera)).sum(-1)
        # The shadow falls behind the person, so what changed above the soles is the person.
        rows = np.flatnonzero((difference > 30).any(axis=1))
        crown = camera.project(np.array([0.0, 0.0, height]), 160, 240)[1]
        assert rows[0] == pytest.approx(crown, abs=4)
        extents.append(rows[0])
    assert extents[1] < extents[0]


@needs_gl
def test_a_clip_is_rendered_with_a_caption():
    frames = list(clip_frames(still_clip(5), 160, 120, stride=2))
    assert [frame.shape for frame in frames] == [(120, 160, 3)] * 3
    assert orange(frames[0]).sum() > 100
    assert (frames[0][-30:, :50] > 180).mean() > 0.3  # the light label of the time


@needs_gl
def test_avatar_and_its_user_stand_side_by_side():
    clip = still_clip(3)
    frame = next(iter(rollout_frames([rollout(clip)], 320, 180)))[40:150]
    assert orange(frame).sum() > 150 and blue(frame).sum() > 150
    assert np.nonzero(orange(frame))[1].mean() + 30 < np.nonzero(blue(frame))[1].mean()


@needs_gl
def test_objects_are_drawn_where_they_were():
    clip = still_clip(2)
    ball, box = (
        ObjectShape("ball", (0.11,), (0.0, 0.0, 0.11)),
        ObjectShape("box", (0.1,) * 3, (0.0,) * 3),
    )
    there = np.array([[0.7, -0.2, 0.0], [0.7, 0.6, 0.5]])
    objects = tuple(
        ObjectTrack((part,), at + np.zeros((2, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)))
        for part, at in zip((ball, box), there, strict=True)
    )
    (shot,) = (_shot(rollout(clip, objects=objects), 320 / 240, "ghost", None),)
    figures = [DrawnAvatar(devices=False), DrawnAvatar(devices=False)]
    with SceneRenderer(figures, 320, 240) as renderer:
        picture = _picture(renderer, shot, 0, "").astype(int)
    yellow = (picture[..., 0] > picture[..., 2] + 90) & (picture[..., 1] > picture[..., 2] + 50)
    middles = there + np.array([[0.0, 0.0, 0.11], [0.0, 0.0, 0.0]])
    for x, y in shot.cameras[0].project(middles, 320, 240).round().astype(int):
        assert yellow[y - 3 : y + 4, x - 3 : x + 4].all()
    assert 100 < yellow.sum() < 3000


def test_the_camera_has_room_for_objects_that_are_near():
    clip = still_clip(2)
    turn = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))

    def seen(metres: float) -> np.ndarray:
        place = np.tile([metres, 0.0, 0.0], (2, 1))
        obj = ObjectTrack((ObjectShape("box", (0.1, 0.1, 0.1), (0.0, 0.0, 0.1)),), place, turn)
        np.testing.assert_allclose(obj.corners().max(axis=1)[0], [metres + 0.1, 0.1, 0.2])
        camera = _shot(rollout(clip, objects=(obj,)), 1.0, "beside", None).cameras[0]
        return camera.project(obj.corners()[0], 100, 100)

    assert ((seen(0.9) > 0.0) & (seen(0.9) < 100.0)).all()
    assert (seen(3.0)[:, 1] > 100.0).any()  # nobody wants to see everything from afar


def test_the_person_beside_stands_on_the_ground_that_is_there():
    slope = HeightField.of(np.tile(np.linspace(-2.0, 2.0, 41), (41, 1)), 0.5)
    clip = still_clip(2)
    flat, sloping = (_shot(rollout(clip), 1.0, "beside", g) for g in (None, slope))
    np.testing.assert_allclose(sloping.person[:, :2], flat.person[:, :2])
    rise = 0.2 * sloping.aside[:, 0]
    np.testing.assert_allclose(sloping.person[:, 2] - flat.person[:, 2], rise, atol=1e-6)
    assert np.abs(rise).min() > 0.05


@needs_gl
def test_ghost_is_drawn_over_the_avatar_and_shows_the_difference():
    clip = still_clip(3)
    moved = rollout(clip, link_position=shifted(clip, (0.0, 0.0, 0.4)))
    frames = [
        next(iter(rollout_frames([r], 160, 120, layout="ghost"))) for r in (rollout(clip), moved)
    ]
    assert np.abs(frames[0].astype(int) - frames[1]).sum(-1).max() > 100


@needs_gl
def test_a_fall_is_marked_in_red():
    clip = still_clip(3)
    fallen, upright = (
        list(rollout_frames([rollout(clip, fell=fell)], 320, 240))[-1][200:, :160]
        for fell in (True, False)
    )

    def red(picture: np.ndarray) -> int:
        return int((picture[..., 0] > picture[..., 1].astype(int) + 80).sum())

    assert red(fallen) > 20 + red(upright)


@needs_gl
def test_rollout_video_can_be_read_back(tmp_path):
    long, short = moving_clip(12, kind="a", name="long"), still_clip(6, 1.6, kind="b", name="short")
    path = rollout_video(
        [rollout(long), rollout(short)], tmp_path / "new" / "r.mp4", width=320, height=120, stride=4
    )
    video = iio.imread(path)
    held = round(0.7 * 36)
    assert video.shape == (len(range(0, 12 + held, 4)), 120, 320, 3)
    left, right = video[:, 30:90, :160].astype(int), video[:, 30:90, 160:].astype(int)
    assert left.std() > 10 and right.std() > 10
    assert np.abs(left[2] - left[0]).max() > 60
    assert os.listdir(path.parent) == ["r.mp4"]


def test_qpos_of_a_rollout_gives_back_the_clip():
    clip = moving_clip(5)
    assert LINKS[0] == "pelvis"
    qpos = rollout(clip).qpos
    assert qpos[:, :3] == pytest.approx(clip.qpos[:, :3], abs=1e-6)
    assert qpos[:, 7:] == pytest.approx(clip.qpos[:, 7:])


def test_films_show_the_middle_one_of_each_kind_first():
    kinds = ["walk", "walk", "run", "walk", "wave"]
    rollouts = [
        rollout(still_clip(2, name=f"{kind}-{i}", kind=kind)) for i, kind in enumerate(kinds)
    ]
    names = [r.name for r in one_of_each_kind(rollouts, 4)]
    assert names == ["walk-1", "run-2", "wave-4", "walk-3"]


# --- videos and captions --------------------------------------------------------------------


def test_video_has_the_frames_and_the_speed_it_was_given(tmp_path):
    values = (20, 120, 220)
    count = write_video(tmp_path / "v.mp4", (rgb_of_size(65, 49, v) for v in values), fps=18.0)
    video = iio.imread(tmp_path / "v.mp4")
    assert count == 3 and video.shape == (3, 48, 64, 3)  # odd sizes are cut
    assert video.mean(axis=(1, 2, 3)) == pytest.approx(values, abs=6)
    about = iio.immeta(tmp_path / "v.mp4")
    assert about["fps"] == 18.0 and about["codec"] == "h264" and "yuv420p" in about["pix_fmt"]


def test_an_interrupted_video_leaves_the_old_one(tmp_path):
    path = tmp_path / "v.mp4"
    path.write_bytes(b"old")

    def frames():
        yield rgb_of_size(64, 48)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_video(path, frames())
    assert path.read_bytes() == b"old" and os.listdir(tmp_path) == ["v.mp4"]


def test_video_of_nothing_or_of_mixed_sizes_is_refused(tmp_path):
    with pytest.raises(InputError, match="at least one frame"):
        write_video(tmp_path / "v.mp4", [])
    with pytest.raises(InputError, match="frame 1"):
        write_video(tmp_path / "v.mp4", [rgb_of_size(64, 48), rgb_of_size(64, 64)])
    assert not list(tmp_path.iterdir())


def test_long_captions_stay_in_the_picture():
    frame = rgb_of_size(200, 60)
    written = caption(frame, {"top left": "a very long name of a clip " * 5})
    assert (frame == 100).all()  # the argument is not drawn on
    assert (written[:30] != 100).any() and (written[:, -5:] == 100).all()
    assert (written[35:] == 100).all()


def test_captions_of_one_edge_do_not_cover_each_other():
    frame, left, right = rgb_of_size(220, 120), "fell after 12.3 s", "orange: avatar   blue: user"
    alone = [caption(frame, {"bottom left": left}), caption(frame, {"bottom right": right})]
    both = caption(frame, {"bottom right": right, "bottom left": left})
    assert ((alone[0] != 100) & (alone[1] != 100)).any()
    drawn = [(picture != 100).sum() for picture in (both, *alone)]
    assert drawn[0] == drawn[1] + drawn[2]


# --- contact sheets and the command ---------------------------------------------------------


@needs_gl
def test_contact_sheet_is_rendered(tmp_path):
    assert sheets.contact_sheet(still_clip(9), tmp_path / "new" / "s.png", columns=2, rows=2)
    image = np.asarray(Image.open(tmp_path / "new" / "s.png"))
    width, height = sheets.TILE
    assert image.shape == (sheets.HEADER + 2 * height + sheets.STRIP, 2 * width, 3)
    for row in range(2):
        tile = image[sheets.HEADER + row * height :][:height, :width]
        assert orange(tile).sum() > 1000
    # Both feet stand all the time: two full bars.
    strip = image[-sheets.STRIP :]
    assert orange(strip).sum() > 3000 and blue(strip).sum() > 3000


def test_contact_sheet_without_gl_has_stick_figures(no_gl, tmp_path):
    assert not sheets.contact_sheet(moving_clip(9), tmp_path / "s.png", columns=3, rows=1)
    image = np.asarray(Image.open(tmp_path / "s.png"))
    for column in range(3):
        tile = image[sheets.HEADER : -sheets.STRIP, column * sheets.TILE[0] :][:, : sheets.TILE[0]]
        assert orange(tile).sum() > 100 and blue(tile).sum() > 100
    assert os.listdir(tmp_path) == ["s.png"]


def test_contact_sheet_of_a_single_frame(no_gl, tmp_path):
    sheets.contact_sheet(still_clip(1), tmp_path / "s.png", columns=4)
    width, height = sheets.TILE
    size = (4 * width, sheets.HEADER + height + sheets.STRIP)
    assert Image.open(tmp_path / "s.png").size == size


def test_stick_figure_has_the_left_side_on_the_left_seen_from_behind():
    clip = still_clip(1)
    points = outline_points(clip.link_position, clip.link_quat, clip.height_m)[0]
    picture = stick_picture(points, Camera(np.array([0, 0, 0.9]), 3.5, 0.0), 240, 320)
    assert np.nonzero(blue(picture))[1].mean() < np.nonzero(orange(picture))[1].mean()


@pytest.fixture
def two_clips(monkeypatch):
    clips = [still_clip(6, name="stand/still"), moving_clip(6, name="dance")]
    monkeypatch.setattr(spec, "load_motions", lambda motions: clips)


@needs_gl
def test_show_writes_sheet_and_video(two_clips, tmp_path, capsys):
    show_clip(ShowArgs("stand/still", out=tmp_path, columns=2, width=160, height=120))
    names = ["stand_still-feet.png", "stand_still.mp4", "stand_still.png"]
    assert sorted(os.listdir(tmp_path)) == names
    assert iio.imread(tmp_path / names[0]).shape == (40 + 320 + 200, 480, 3)
    assert iio.imread(tmp_path / "stand_still.mp4").shape == (6, 120, 160, 3)
    assert capsys.readouterr().out.split() == [
        str(tmp_path / "stand_still.png"),
        str(tmp_path / "stand_still-feet.png"),
        str(tmp_path / "stand_still.mp4"),
    ]


def test_show_without_gl_writes_the_sheet_and_one_line(no_gl, two_clips, tmp_path, capsys):
    show_clip(ShowArgs("dance", out=tmp_path))
    assert sorted(os.listdir(tmp_path)) == ["dance-feet.png", "dance.png"]
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and "video skipped" in lines[0] and "libosmesa6" in lines[0]


def test_show_lists_the_clips_if_one_is_unknown(two_clips, tmp_path):
    with pytest.raises(InputError, match=r"no clip 'danse'.*dance"):
        show_clip(ShowArgs("danse", out=tmp_path))
    with pytest.raises(InputError, match="--stride"):
        show_clip(ShowArgs("dance", out=tmp_path, stride=0))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"columns": 100_000}, "--columns: columns is 100000, not 1 to 40"),
        ({"height": 100_000}, "--height: height is 100000, not 64 to 4096"),
        ({"video": False, "stride": 3}, "--stride: has no effect without a video"),
        ({"video": False, "width": 100}, "--width: has no effect without a video"),
        ({"clip": "a.npz", "motions": "b.npz"}, "--motions: has no effect: a.npz is a file"),
        ({"out": Path("a.npz")}, "a.npz: cannot be written: a file is in the way"),
    ],
)
def test_options_that_show_cannot_use_are_refused(options, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.npz").write_bytes(b"")
    with pytest.raises(InputError, match=message):
        show_clip(ShowArgs(**{"clip": "dance", **options}))
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]


def test_file_names_are_plain():
    assert file_name("a/b c:1.5") == "a_b_c_1.5"
    assert file_name("../..") == "_"
