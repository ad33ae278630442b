"""Many files: one that cannot be used never loses the others."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from mocap_files import SMPL_JOINTS, standing, write_bvh

from questsim.cli import main
from questsim.errors import InputError
from questsim.motion import many
from questsim.motion.checks import toes_ahead
from questsim.motion.library import load_library
from questsim.motion.naming import split_parts, unique_names
from questsim.motion.spec import load_motions, load_recordings
from questsim.skeleton import JOINTS


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("QUESTSIM_CACHE", str(tmp_path / "cache"))


def person(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return write_bvh(path, SMPL_JOINTS, standing(12, 0.95))


@pytest.fixture
def mixed(tmp_path) -> Path:
    """Two people, an empty file, half a file and something else that is called .npz."""
    folder = tmp_path / "mixed"
    whole = person(folder / "a.bvh")
    person(folder / "z.bvh")
    (folder / "empty.bvh").write_text("")
    (folder / "half.bvh").write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    (folder / "weights.npz").write_bytes(b"PK no zip")
    return folder


def test_import_skips_and_names_files_that_cannot_be_used(mixed, tmp_path, capsys):
    out = tmp_path / "out.npz"
    (mixed / "notes.docx").write_text("hello")
    # Also what a shell's * adds, and a file that is not there.
    paths = [str(mixed), str(mixed / "notes.docx"), str(mixed / "gone.bvh")]
    assert main(["motions", "import", *paths, "--out", str(out)]) == 0
    assert [clip.name for clip in load_library(out).clips] == ["a", "z"]
    said = capsys.readouterr()
    lines = said.err.splitlines()
    skipped = [line for line in lines if line.startswith("skipped ")]
    for file, reason in (
        ("empty.bvh", "is empty"),
        ("half.bvh", ""),
        ("weights.npz", "cannot be read"),
        ("notes.docx", "is not one of"),
        ("gone.bvh", "no such file"),
    ):
        assert sum(str(mixed / file) in line and reason in line for line in skipped) == 1, file
    assert said.out.splitlines()[-2].endswith("; 5 skipped")


def test_strict_import_and_import_of_nothing_write_no_library(mixed, tmp_path, capsys):
    out = tmp_path / "out.npz"
    assert main(["motions", "import", str(mixed), "--out", str(out), "--strict"]) == 2
    assert "empty.bvh: is empty" in capsys.readouterr().err
    (mixed / "a.bvh").unlink()
    (mixed / "z.bvh").unlink()
    assert main(["motions", "import", str(mixed), "--out", str(out)]) == 2
    assert "none of 3 files can be imported" in capsys.readouterr().err
    # One file alone is refused in one line.
    assert main(["motions", "import", str(mixed / "empty.bvh"), "--out", str(out)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not out.exists()


def test_a_folder_as_motions_skips_alike_also_from_the_cache_and_moved(mixed, tmp_path, capsys):
    assert [clip.name for clip in load_motions(str(mixed))] == ["a", "z"]
    first = capsys.readouterr().err
    assert f"warning: skipped {mixed / 'empty.bvh'}: is empty" in first
    assert f"warning: 3 of 5 files in {mixed} skipped" in first
    elsewhere = mixed.rename(tmp_path / "elsewhere")
    assert [motion.name for motion in load_recordings(str(elsewhere))] == ["a", "z"]
    assert f"warning: skipped {elsewhere / 'empty.bvh'}: is empty" in capsys.readouterr().err
    with pytest.raises(InputError, match=r"empty\.bvh: is empty"):
        load_motions(str(elsewhere), strict=True)
    with pytest.raises(InputError, match=r"empty\.bvh: is empty"):
        load_motions(str(elsewhere / "empty.bvh"))
    for name in ("a.bvh", "z.bvh"):
        (elsewhere / name).unlink()
    with pytest.raises(InputError, match=r"none of 3 files can be used; the first: .*empty"):
        load_motions(str(elsewhere))


def test_an_amc_without_its_skeleton_is_skipped(mixed, capsys):
    (mixed / "01_01.amc").write_text(
        "#!OML:ASF H:\n:FULLY-SPECIFIED\n:DEGREES\n1\nroot 0 0 0 0 0 0\n"
    )
    assert [clip.name for clip in load_motions(str(mixed))] == ["a", "z"]
    assert "01_01.amc: its skeleton is missing" in capsys.readouterr().err


def test_a_damaged_library_among_libraries_is_skipped(mixed, tmp_path, capsys):
    folder = tmp_path / "libraries"
    folder.mkdir()
    for name in ("a", "z"):
        command = ["motions", "import", str(mixed / f"{name}.bvh"), "--out"]
        assert main([*command, str(folder / f"{name}.npz")]) == 0
    whole = (folder / "z.npz").read_bytes()
    (folder / "half.npz").write_bytes(whole[: len(whole) // 2])
    capsys.readouterr()
    assert [clip.name for clip in load_motions(str(folder))] == ["a", "z"]
    assert "half.npz" in capsys.readouterr().err
    assert main(["motions", "import", str(folder), "--out", str(tmp_path / "all.npz")]) == 0
    assert len(load_library(tmp_path / "all.npz").clips) == 2
    assert "; 1 skipped" in capsys.readouterr().out


def test_equal_names_in_two_folders_get_the_folders_names(tmp_path):
    for folder in ("a", "b"):
        person(tmp_path / "x" / folder / "walk.bvh")
    out = tmp_path / "both.npz"
    assert main(["motions", "import", str(tmp_path / "x"), "--out", str(out)]) == 0
    library = load_library(out)
    assert [clip.name for clip in library.clips] == ["a-walk", "b-walk"]
    assert [motion.name for motion in library.motions] == ["a-walk", "b-walk"]
    assert [clip.name for clip in load_motions(str(tmp_path / "x"))] == ["a-walk", "b-walk"]
    parts = [str(tmp_path / "x" / folder) for folder in ("a", "b")]
    assert [clip.name for clip in load_motions(parts)] == ["a-walk", "b-walk"]


@pytest.mark.parametrize(
    ("stems", "folders", "names"),
    [
        (("w", "w"), (("a", "x"), ("b", "x")), ["a-x-w", "b-x-w"]),
        (("w", "w", "v"), (("a",), ("b",), ("a",)), ["a-w", "b-w", "v"]),
        (("w", "w"), (("a",), ("a",)), ["w", "w-2"]),
        (("w", "w", "w-2"), (("a",), ("a",), ("a",)), ["w", "w-3", "w-2"]),
        (("w", "w", "a-w"), (("a",), ("b",), ("c",)), ["a-w", "b-w", "a-w-2"]),
        (("w", "w"), ((), ("b",)), ["w", "b-w"]),
    ],
)
def test_names_are_unique(stems, folders, names):
    assert unique_names(stems, folders) == names


def test_a_path_with_commas_is_one_part(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    person(tmp_path / "left, right" / "walk,slow.bvh")
    person(tmp_path / "b.bvh")
    path = "left, right/walk,slow.bvh"
    assert split_parts(f"{path},b.bvh, synthetic:stand") == [path, "b.bvh", "synthetic:stand"]
    assert split_parts(f"b.bvh,{path}") == ["b.bvh", path]
    assert split_parts("b.bvh,,gone.bvh,") == ["b.bvh", "gone.bvh"]
    assert split_parts([path, "b.bvh,left, right"]) == [path, "b.bvh", "left, right"]
    names = [clip.name for clip in load_motions(f"b.bvh,{path}")]
    assert names == ["b", "walk,slow"]
    command = ["motions", "import", path, "--out", "left, right/lib,1.npz"]
    assert main(command) == 0
    assert main(["motions", "list", "left, right/lib,1.npz"]) == 0


def test_a_script_without_a_main_guard_loads_many_files(tmp_path):
    for i in range(3):
        person(tmp_path / "many" / f"{i}.bvh")
    script = tmp_path / "script.py"
    script.write_text(
        "from questsim.motion import many\n"
        "many.MANY = 2\n"
        "from questsim.motion.spec import load_motions\n"
        f"print(len(load_motions({str(tmp_path / 'many')!r})))\n"
    )
    done = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, timeout=120, env=os.environ
    )
    assert done.stdout.split() == ["3"], done.stderr


def test_command_lines_read_many_files_on_all_cores(tmp_path, monkeypatch):
    for i in range(3):
        person(tmp_path / "many" / f"{i}.bvh")
    asked = []

    class Pool(many.ProcessPoolExecutor):
        def __init__(self, workers, *args):
            asked.append(workers)
            super().__init__(workers, *args)

    monkeypatch.setattr(many, "MANY", 2)
    monkeypatch.setattr(many.os, "cpu_count", lambda: 4)
    monkeypatch.setattr("questsim.cli.own_cores", lambda: 3)
    monkeypatch.setattr(many, "ProcessPoolExecutor", Pool)
    assert main(["motions", "list", str(tmp_path / "many")]) == 0
    assert asked == [3]
    shutil.rmtree(tmp_path / "cache")
    load_motions(str(tmp_path / "many"))
    assert asked == [3]


def test_reading_many_files_shows_a_progress_bar_on_a_terminal(tmp_path, monkeypatch):
    for i in range(3):
        person(tmp_path / "many" / f"{i}.bvh")
    bars = []

    def bar(items, **options):
        bars.append(options)
        return items

    monkeypatch.setattr(many, "MANY", 2)
    monkeypatch.setattr("tqdm.tqdm", bar)
    assert len(load_motions(str(tmp_path / "many"))) == 3  # as evaluate.py reads them
    (options,) = bars
    assert (options["total"], options["desc"]) == (3, "retargeting")
    assert options["disable"] is None  # shown on a terminal alone


def test_the_toes_of_a_runner_bent_forward_do_not_point_backwards():
    import numpy as np

    # Trunk horizontal along +x; one foot stands, the other swings with its toes down and back.
    places = {
        "root": (0, 0, 0.9), "neck": (0.5, 0, 0.85), "head": (0.6, 0, 0.9),
        "left_hip": (0, 0.1, 0.85), "right_hip": (0, -0.1, 0.85),
    }  # fmt: skip
    stands = ((0, 0.08), (0.14, 0.02))
    swings = ((-0.3, 0.6), (-0.38, 0.48))
    position = np.zeros((20, len(JOINTS), 3))
    for name, place in places.items():
        position[:, JOINTS.index(name)] = place
    for side, y, down in (("left", 0.1, slice(0, 10)), ("right", -0.1, slice(10, 20))):
        for joint, (x, z), (back, high) in zip(("ankle", "toe"), stands, swings, strict=True):
            index = JOINTS.index(f"{side}_{joint}")
            position[:, index] = (back, y, high)
            position[down, index] = (x, y, z)
    assert toes_ahead(position) > 0.5
    mirrored = position * [1, -1, 1]
    assert toes_ahead(mirrored) < -0.5
