import re
import threading
import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mocap_files import SMPL_JOINTS, standing, write_amass, write_bvh

from questsim.errors import InputError
from questsim.motion import datasets, loaded, many
from questsim.motion.library import load_library, save_library
from questsim.motion.motions_command import (
    ImportArgs,
    ListMotionsArgs,
    import_motions,
    list_motions,
)
from questsim.motion.spec import check_seed, load_motions, load_recordings
from questsim.processes import processes


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("QUESTSIM_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def folder(tmp_path) -> Path:
    folder = tmp_path / "clips"
    (folder / "deep").mkdir(parents=True)
    for name in ("dataset-2_walk_elderly_001", "stand"):
        write_bvh(folder / f"{name}.bvh", SMPL_JOINTS, standing(20, 0.95))
    write_amass(folder / "deep" / "other.npz")
    return folder


def test_a_file_and_a_folder_are_read(folder):
    assert [c.name for c in load_motions(str(folder / "stand.bvh"))] == ["stand"]
    clips = load_motions(str(folder))
    assert sorted(c.name for c in clips) == ["dataset-2_walk_elderly_001", "other", "stand"]
    walk = next(c for c in clips if c.name.startswith("dataset"))
    assert (walk.kind, walk.style) == ("walk", "elderly")
    assert [m.name for m in load_recordings(str(folder))] == [c.name for c in clips]


def test_the_second_call_reads_the_cache_and_agrees_to_the_bit(folder, monkeypatch):
    first = load_motions(str(folder))
    monkeypatch.setattr(loaded, "read_many", lambda *a: pytest.fail("retargeted again"))
    second = load_motions(str(folder))
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.qpos, b.qpos)
        np.testing.assert_array_equal(a.link_velocity, b.link_velocity)


def test_processes_that_begin_together_import_once(folder, monkeypatch):
    began, read_many = threading.Event(), loaded.read_many
    calls: list[int] = []

    def slowly(*args, **options):
        calls.append(1)
        began.set()
        time.sleep(0.3)
        return read_many(*args, **options)

    monkeypatch.setattr(loaded, "read_many", slowly)
    # A lock of a file is between open files: threads stand for processes.
    first = threading.Thread(target=load_motions, args=(str(folder),))
    first.start()
    began.wait(10)
    assert len(load_motions(str(folder))) == 3
    first.join()
    assert len(calls) == 1


def test_a_changed_file_is_read_again(folder):
    assert len(load_motions(str(folder / "stand.bvh"))[0]) < 30
    write_bvh(folder / "stand.bvh", SMPL_JOINTS, standing(60, 0.95))
    assert len(load_motions(str(folder / "stand.bvh"))[0]) > 60


def test_two_processes_make_the_same_clips_as_one(tmp_path, monkeypatch):
    folder = tmp_path / "many"
    folder.mkdir()
    for i in range(6):
        pose = {"L_Elbow": np.linspace((0, 0, 0), (0, 5 * i, 0), 12)}
        write_bvh(folder / f"clip{i}.bvh", SMPL_JOINTS, standing(12, 0.95), pose)
    one = load_motions(str(folder))
    monkeypatch.setattr(many, "MANY", 2)
    monkeypatch.setenv("QUESTSIM_CACHE", str(tmp_path / "cache2"))
    with processes(2):
        two = load_motions(str(folder))
    for a, b in zip(one, two, strict=True):
        assert a.name == b.name
        np.testing.assert_array_equal(a.qpos, b.qpos)


def test_several_are_joined_and_equal_names_numbered(folder):
    stand = str(folder / "stand.bvh")
    names = ["stand", "dataset-2_walk_elderly_001", "stand-2"]
    parts = [stand, f"{folder / 'dataset-2_walk_elderly_001.bvh'},{stand}"]
    assert [c.name for c in load_motions(parts)] == names
    assert [c.name for c in load_motions(",".join(parts))] == names


def test_heights_and_mirrored_copies_on_request(folder):
    clips = load_motions(str(folder), height_m=1.9, mirrored=True)
    assert {clip.height_m for clip in clips} == {1.9}
    assert [c.name for c in clips[:2]] == [clips[0].name, f"{clips[0].name}-mirrored"]
    assert len(load_recordings(str(folder), mirrored=True)) == 6


def test_synthetic_motion_needs_no_files():
    clips = load_motions("synthetic", seed=0)
    assert len(clips) > 5


def test_synthetic_motion_of_some_kinds_is_a_part_of_all():
    some, whole = load_motions("synthetic:walk+wave"), load_motions("synthetic")
    assert {clip.kind for clip in some} == {"walk", "wave"}
    assert [c.name for c in some] == [c.name for c in whole if c.kind in ("walk", "wave")]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("synthetic:walk+fly", "synthetic:walk\\+fly: there is no kind 'fly'.*walk"),
        ("synthetic:walk+walk", "has the kind 'walk' twice"),
        ("synthetic:walk+all", "all stands alone.*synthetic:all"),
        ("synthetic:all:5", "all stands alone.*synthetic:random:500"),
        ("synthetic:walk+bow+duck:2", "2 clips cannot be of 3 kinds; ask for 3"),
        ("synthetic:walk+bow:0", "'0' is not a number of clips.*synthetic:walk\\+bow:500"),
        ("synthetic:walk:1234567890", "up to 9 digits"),
        ("nowhere", "no motions 'nowhere'.*synthetic, bandai-namco-2"),
        (" , ", "no motions named"),
        ("bandai-namco-2", "has not been fetched.*questsim motions fetch bandai-namco-2"),
        ("bandai-namco-2:valid", "no split 'valid'"),
    ],
)
def test_an_argument_that_names_no_motions_is_refused(text, reason):
    with pytest.raises(InputError, match=reason):
        load_motions(text)


def test_a_folder_without_motions_and_other_files_are_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(InputError, match="there is no motion in it"):
        load_motions(str(tmp_path))
    with pytest.raises(InputError, match="is not JSON"):
        load_motions(str(tmp_path / "notes.txt"))
    (tmp_path / "notes.docx").write_text("hello")
    with pytest.raises(
        InputError, match=r"extension '\.docx' is not one of \.bvh.*; give BVH.* folder or zip"
    ):
        load_motions(str(tmp_path / "notes.docx"))


def test_a_dataset_is_split_by_its_test_list(tmp_path, monkeypatch):
    names = ["dataset-2_walk_normal_001", "dataset-2_walk_normal_002"]
    folder = datasets.dataset_folder("bandai-namco-2")
    folder.mkdir(parents=True)
    for name in names:
        write_bvh(folder / f"{name}.bvh", SMPL_JOINTS, standing(15, 0.95))
    digests = {f"{name}.bvh": "0" * 64 for name in names}
    monkeypatch.setattr(datasets, "manifest", lambda name: digests)
    (tmp_path / "bandai-namco-2-test.txt").write_text(names[1])
    monkeypatch.setattr(datasets, "DATA", tmp_path)
    (folder / "verified.sha256").write_text(datasets.manifest_digest("bandai-namco-2"))
    assert [c.name for c in load_motions("bandai-namco-2:train")] == names[:1]
    assert [c.name for c in load_motions("bandai-namco-2:test")] == names[1:]
    both = load_motions("bandai-namco-2")
    assert [c.name for c in both] == names
    assert {c.licence for c in both} == {"CC-BY-NC-4.0"}


def test_import_writes_a_library_and_prints_how_each_file_was_taken(folder, tmp_path, capsys):
    out = tmp_path / "lib.npz"
    given = ImportArgs(paths=(str(folder),), out=str(out), mirrored=True, licence="CC0-1.0")
    import_motions(given)
    plain = capsys.readouterr().out.splitlines()
    assert len(plain) == 5 and "stand: 0.6 s, 1.68 m tall" in plain
    assert re.fullmatch(rf"look at one: questsim motions show \S+ --motions {out}", plain[-1])
    import_motions(replace(given, explain=True))
    text = capsys.readouterr().out
    assert "    20 frames, SMPL skeleton, units m (detected), up y (detected), 30 fps" in text
    assert "retargeting error in cm: " in text and "left_knee" in text
    assert text.count("    feet: still soles at 0.") == 3 and "feet, mean of all: " in text
    library = load_library(out)
    assert len(library.clips) == len(library.motions) == 6
    assert {clip.licence for clip in library.clips} == {"CC0-1.0"}
    assert [c.name for c in load_motions(str(out))] == [c.name for c in library.clips]
    import_motions(ImportArgs(paths=(str(out),), out=str(tmp_path / "copy.npz")))
    assert len(load_library(tmp_path / "copy.npz").clips) == 6


def test_strict_import_writes_nothing_if_one_file_is_bad(folder, tmp_path):
    (folder / "zz.bvh").write_text("HIERARCHY\n")
    with pytest.raises(InputError, match=r"zz\.bvh"):
        import_motions(ImportArgs((str(folder),), str(tmp_path / "lib.npz"), strict=True))
    assert not list(tmp_path.glob("*lib.npz*"))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"out": "lib.txt"}, "ends in .npz"),
        ({"out": "none/lib.npz"}, "no such folder"),
        ({"paths": ()}, "no files given"),
        ({"paths": ("nowhere",)}, "no such file or folder"),
        ({"units": "miles"}, "units 'miles'"),
        ({"fps": -3.0}, "not within 10-1000"),
        ({"paths": ("mine.npz",), "licence": "MIT"}, "--licence: has no effect.*libraries"),
        ({"paths": ("mine.npz",), "height": 1.8}, "--height: has no effect"),
        ({"paths": ("mine.npz",), "out": "mine.npz"}, "mine.npz: is the only one"),
        ({"paths": ("clips/stand.bvh",), "smpl": "no.npz"}, "--smpl: has no effect"),
        ({"out": "folder.npz"}, "folder.npz: is a folder"),
    ],
)
def test_import_refuses_wrong_arguments(changes, reason, folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_library("mine.npz", [], load_motions("synthetic:stand"))
    (tmp_path / "folder.npz").mkdir()
    args = {"paths": (str(folder),), "out": "lib.npz"} | changes
    with pytest.raises(InputError, match=reason):
        import_motions(ImportArgs(**args))
    assert not (tmp_path / "lib.npz").exists()


def test_clips_without_a_motion_are_recordings_too(folder, tmp_path):
    clips = load_motions("synthetic:stand")
    save_library(folder / "chains.npz", [], clips)
    import_motions(ImportArgs((str(folder),), str(tmp_path / "all.npz")))
    for spec in (str(folder), str(tmp_path / "all.npz")):
        names = [clip.name for clip in load_motions(spec)]
        assert len(names) == 3 + len(clips)
        assert [motion.name for motion in load_recordings(spec)] == names
    with pytest.raises(InputError, match="synthetic-stand-1: has no motion"):
        load_motions(str(tmp_path / "all.npz"), own_proportions=True)


@pytest.mark.parametrize(
    ("text", "reads"),
    [
        ("mine.npz", False),
        ("mine.npz,synthetic:bow", True),
        ("drawn.toml", True),
        ("seeded.toml", False),
        ("whole.toml", False),
    ],
)
def test_a_seed_without_embedded_or_drawn_motions_is_refused(text, reads, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, keys in (("drawn", "count = 1"), ("seeded", "count = 1\nseed = 3"), ("whole", "")):
        (tmp_path / f"{name}.toml").write_text(f"[[train]]\nmotions = 'mine.npz'\n{keys}\n")
    check_seed(text, 0)
    with nullcontext() if reads else pytest.raises(InputError, match="--seed: has no effect"):
        check_seed(text, 4)


def test_list_of_nothing_names_the_datasets_and_the_embedded_kinds(capsys):
    list_motions(ListMotionsArgs())
    text = capsys.readouterr().out
    assert "get it with questsim motions fetch bandai-namco-2" in text
    assert {"walk", "wave", "sit"} <= set(re.findall(r"[a-z-]+", text.split("kinds are")[1]))


def test_list_counts_clips_by_kind(folder, capsys):
    list_motions(ListMotionsArgs(str(folder)))
    lines = capsys.readouterr().out.splitlines()
    assert any(line.split()[:3] == ["walk", "elderly", "1"] for line in lines)
    assert any(line.split()[:2] == ["all", "3"] for line in lines)
    list_motions(ListMotionsArgs("synthetic:stand"))
    assert capsys.readouterr().out.endswith("\nlicence: MIT.\n")
