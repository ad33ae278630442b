import os
from pathlib import Path

import numpy as np
import pytest
from mocap_files import LAFAN1_JOINTS, LAFAN1_T_POSE, standing, write_bvh

from questsim.errors import InputError
from questsim.motion.library import Library, load_library, save_library
from questsim.motion.reading import ReadOptions, read_motion
from questsim.motion.retarget import to_clip
from questsim.motion.retarget_back import to_motion
from questsim.motion.spec import load_motions, load_recordings


@pytest.fixture(scope="module")
def library(tmp_path_factory) -> Library:
    folder = tmp_path_factory.mktemp("library")
    motions = []
    for name, frames in (("first", 20), ("second", 31)):
        pose = LAFAN1_T_POSE | {"LeftForeArm": np.linspace((0, 0, 0), (-60, 0, 0), frames)}
        path = write_bvh(folder / f"{name}.bvh", LAFAN1_JOINTS, standing(frames, 93.6), pose)
        motions.append(read_motion(path, ReadOptions(licence="CC0-1.0"))[0])
    return Library(motions, [to_clip(motion) for motion in motions])


@pytest.fixture
def saved(library, tmp_path) -> Path:
    path = tmp_path / "library.npz"
    save_library(path, library.motions, library.clips)
    return path


def test_a_library_may_end_in_capitals(tmp_path):
    clips = load_motions("synthetic:stand")
    save_library(tmp_path / "mine.NPZ", [], clips)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.NPZ"]
    assert [c.name for c in load_motions(str(tmp_path / "mine.NPZ"))] == [c.name for c in clips]


def test_a_library_comes_back_as_it_was_saved(saved, library):
    loaded = load_library(saved)
    assert len(loaded.motions) == len(loaded.clips) == 2
    for got, kept in zip(loaded.motions, library.motions, strict=True):
        np.testing.assert_allclose(got.rotations, kept.rotations, atol=1e-6)
        np.testing.assert_allclose(got.root_position, kept.root_position, atol=1e-6)
        np.testing.assert_array_equal(got.offsets, kept.offsets)
        for key in ("name", "fps", "source", "source_sha256", "licence", "kind", "style"):
            assert getattr(got, key) == getattr(kept, key)
        assert len(got.source_sha256) == 64
    for got, kept in zip(loaded.clips, library.clips, strict=True):
        for key in ("qpos", "link_position", "link_quat"):
            np.testing.assert_allclose(getattr(got, key), getattr(kept, key), atol=1e-5)
        for key in ("qvel", "link_velocity", "link_angular_velocity"):
            np.testing.assert_allclose(getattr(got, key), getattr(kept, key), atol=2e-4)
        assert (got.name, got.height_m, got.licence) == (kept.name, kept.height_m, kept.licence)


def test_saving_again_what_was_loaded_changes_nothing(saved, tmp_path):
    loaded = load_library(saved)
    save_library(tmp_path / "again.npz", loaded.motions, loaded.clips)
    again = load_library(tmp_path / "again.npz")
    for a, b in zip(loaded.clips, again.clips, strict=True):
        np.testing.assert_array_equal(a.qpos.astype(np.float32), b.qpos.astype(np.float32))
        assert a.contacts.tolist() == b.contacts.tolist()


def test_chosen_names_and_parts_alone_are_read(saved):
    assert [c.name for c in load_library(saved, names={"second"}).clips] == ["second"]
    assert load_library(saved, motions=False).motions == []
    assert load_library(saved, clips=False).clips == []


def test_an_empty_library_can_be_kept(tmp_path):
    save_library(tmp_path / "empty.npz", [], [])
    assert load_library(tmp_path / "empty.npz") == Library()


def test_recordings_of_a_library_of_clips_alone_are_made_from_its_clips(saved, tmp_path):
    clips = load_library(saved).clips
    save_library(tmp_path / "varied.npz", [], clips)
    for motion, clip in zip(load_recordings(str(tmp_path / "varied.npz")), clips, strict=True):
        made = to_motion(clip)
        assert motion.name == clip.name
        np.testing.assert_allclose(motion.root_position, made.root_position, atol=1e-6)
        np.testing.assert_allclose(motion.rotations, made.rotations, atol=1e-6)
    save_library(tmp_path / "empty.npz", [], [])
    with pytest.raises(InputError, match=r"no motions in .*empty\.npz"):
        load_recordings(str(tmp_path / "empty.npz"))


def changed(path: Path, **changes) -> Path:
    with np.load(path) as archive:
        arrays = {key: archive[key] for key in archive.files}
    arrays |= changes
    np.savez(path, **{key: value for key, value in arrays.items() if value is not None})
    return path


@pytest.mark.parametrize(
    ("key", "value", "reason"),
    [
        ("format", None, "is not a QuestSim library"),
        ("version", np.array(99), "has version 99, not 1"),
        ("units", np.array("cm"), "has units cm, not m"),
        ("up", np.array("y"), "has up y, not z"),
        ("clip_fps", np.array(30.0), "has clip_fps 30.0, not 36.0"),
        ("links", None, "lacks 'links'"),
        ("motion_offsets", None, "lacks 'motion_offsets';"),
        ("clip_frames", np.array([1, 1]), "has .* frames, not 2"),
        ("clip_frames", np.array([-1, 60]), "not counts above zero"),
        ("clip_height_m", np.array([1.8]), "clip_height_m does not fit"),
        ("motion_licence", np.array(["a"]), "motion_licence does not fit"),
        ("clip_height_m", np.array([1.75, 0.0]), "clip second is 0 m tall"),
        ("clip_name", np.array("first"), r"clip_name is <U5 of shape \(\)"),
        ("clip_qpos", np.zeros((51, 39)), r"clip_qpos is float64 of shape \(51, 39\)"),
        ("clip_qpos", np.zeros((60, 40)), "clip first has rotations that are not unit"),
        ("clip_source_sha256", None, "lacks 'clip_source_sha256';"),
        ("clip_source_sha256", np.array(["", "beef"]), "of second is not a SHA-256 hash"),
    ],
)
def test_a_library_that_does_not_fit_is_refused(key, value, reason, saved):
    with pytest.raises(InputError, match=reason) as error:
        load_library(changed(saved, **{key: value}))
    assert "library.npz" in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("key", ["joints", "joint_parents", "links", "dofs"])
def test_another_order_of_names_is_refused(key, saved):
    with np.load(saved) as archive:
        other = archive[key][::-1]
    with pytest.raises(InputError, match=f"another list of {key}"):
        load_library(changed(saved, **{key: other}))


@pytest.mark.parametrize("key", ["motion_root", "motion_rotations", "clip_qpos"])
def test_numbers_that_are_not_finite_are_refused_with_the_motions_name(key, saved):
    with np.load(saved) as archive:
        array = archive[key].copy()
    array[-1] = np.nan
    with pytest.raises(InputError, match=f"{key} of second is not finite"):
        load_library(changed(saved, **{key: array}))


def test_pickled_objects_are_never_loaded(saved):
    with pytest.raises(InputError, match="motion_name holds object, not numbers or text"):
        load_library(changed(saved, motion_name=np.array([{"a": 1}, None], dtype=object)))


@pytest.mark.parametrize("key", ["clip_qpos", "motion_root", "motion_offsets"])
def test_numbers_too_large_for_any_motion_are_refused(key, saved):
    with np.load(saved) as archive:
        arrays = dict(archive)
    large = arrays[key].astype(float)
    large.reshape(-1)[0] = 1e300
    np.savez(saved, **(arrays | {key: large}))
    with pytest.raises(InputError, match=rf"{key}.* is not finite or above 1e\+06"):
        load_library(saved)


@pytest.mark.parametrize("key", ["format", "motion_name", "clip_kind"])
def test_damaged_characters_are_refused(key, saved):
    with np.load(saved) as archive:
        arrays = dict(archive)
    text = np.array(arrays[key]).reshape(-1).astype("U40")
    text.view(np.uint32)[3] |= 1 << 27
    arrays[key] = text.reshape(np.shape(arrays[key]))
    np.savez(saved, **arrays)
    with pytest.raises(InputError, match=f"{key} holds damaged text"):
        load_library(saved)


def test_files_that_are_no_library_are_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load_library(tmp_path / "none.npz")
    for name, content in (("empty.npz", b""), ("text.npz", b"hello"), ("cut.npz", b"PK\x03\x04")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match="cannot be read as a library"):
            load_library(tmp_path / name)


def test_a_failed_save_leaves_the_old_library_and_no_other_file(saved, library, monkeypatch):
    before = saved.read_bytes()

    def full(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(InputError, match="No space left"):
        save_library(saved, library.motions, library.clips)
    assert saved.read_bytes() == before
    assert os.listdir(saved.parent) == [saved.name]


def test_a_folder_that_is_not_there_is_refused(library, tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        save_library(tmp_path / "none" / "a.npz", library.motions, library.clips)
