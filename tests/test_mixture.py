"""Mixture files: training and validation sets in one TOML file."""

from __future__ import annotations

import re
import shutil
import tomllib
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from itertools import chain
from pathlib import Path

import numpy as np
import pytest
from bvh_files import BvhText
from command_line import ROOT, questsim
from mocap_files import write_amass
from test_formats import MORE as MORE_MOTIONS

from agents.kinematic.data import MotionBank
from agents.run_folder import data_record
from questsim.errors import InputError
from questsim.motion.clip import Clip, source_kind
from questsim.motion.library import save_library
from questsim.motion.mixture import read_mixture
from questsim.motion.retarget import mirror_clip, to_clip
from questsim.motion.retarget_back import to_motion
from questsim.motion.spec import load_motions, load_recordings
from questsim.motion.synthesis.synthetic import synthetic_clips
from questsim.motion.variation import vary

MIXTURE = """
[[validation]]
motions = "synthetic:random:3"
seed = 7
count = 2

[[validation]]
motions = "walks.npz"
include = ["*walk-0.*"]
exclude = ["*walk-0.7"]
exclude_list = "kept.txt"
longest_s = 7

[[train]]
motions = "walks.npz"
kind = "mine-{kind}"

[[train]]
motions = "synthetic:random:3"
seed = 7

[[train]]
motions = "synthetic:random:3"
seed = 8
"""


@pytest.fixture(scope="module")
def mixture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A mixture of a library beside it and of synthetic motions."""
    from questsim.motion.library import save_library

    folder = tmp_path_factory.mktemp("mixture")
    walks = load_motions("synthetic:walk")
    save_library(folder / "walks.npz", load_recordings("synthetic:walk"), walks)
    (folder / "kept.txt").write_text("synthetic-walk-0.9\n")
    (folder / "mine.toml").write_text(MIXTURE)
    return folder / "mine.toml"


def test_parts_share_no_clip_and_clips_of_other_seeds_stay(mixture: Path) -> None:
    validation = load_motions(f"{mixture}:validation")
    train = load_motions(f"{mixture}:train")
    assert [clip.name for clip in validation[2:]] == ["synthetic-walk-0.5"]
    assert len(validation) == 3
    assert len(train) == 11 + 1 + 3
    assert not {c.qpos.tobytes() for c in validation} & {c.qpos.tobytes() for c in train}
    assert {clip.kind for clip in train[:11]} == {"mine-walk"}


def test_recordings_of_a_mixture_are_those_of_its_clips(mixture: Path) -> None:
    clips, motions = load_motions(f"{mixture}:train"), load_recordings(f"{mixture}:train")
    assert [clip.name for clip in clips] == [motion.name for motion in motions]
    assert [clip.kind for clip in clips] == [motion.kind for motion in motions]


def test_the_command_line_takes_a_part(mixture: Path) -> None:
    run = questsim(mixture.parent, "motions", "list", "mine.toml:validation", "--clips")
    assert run.code == 0, run.err
    assert "synthetic-walk-0.5 " in run.out
    assert "synthetic-walk-0.7 " not in run.out


@pytest.mark.parametrize(
    ("text", "part", "words"),
    [
        ("", "", ["has no part", "[[train]]"]),
        ("[train]\nmotions = 'synthetic:walk'", "", ["not a list of tables", "[[train]]"]),
        ("[[train]]\nmotion = 'a'", "", ["[[train]] number 1", "did you mean motions"]),
        ("[[train]]\ncount = 3", "", ["has no motions"]),
        ("[[train]]\nmotions = 'synthetic:walk'\ncount = 13", "", ["count is 13 of 12"]),
        ("[[train]]\nmotions = 'synthetic:walk'\ncount = -1", "", ["count is -1"]),
        (
            "[[train]]\nmotions = 'synthetic:walk'\ncount = true",
            "",
            ["count is True, not a whole number"],
        ),
        ("[[train]]\nmotions = ['synthetic']", "", ["motions is ['synthetic'], not a text"]),
        ("[[train]]\nmotions = 'synthetic'\ninclude = 'a'", "", ["include is 'a', not a list"]),
        ("[[train]]\nmotions = 'synthetic'\ninclude = []", "", ["include is empty"]),
        ("[[train]]\nmotions = 'synthetic'\ninclude = ['']", "", ["include is empty"]),
        ("[[train]]\nmotions = 'synthetic'\nkind = ''", "", ["kind is empty"]),
        ("[[train]]\nmotions = 'synthetic'\nlongest_s = 0", "", ["longest_s is 0, not"]),
        ("[[train]]\nmotions = 'synthetic'\nlongest_s = nan", "", ["longest_s is nan, not"]),
        ("[[train]]\nmotions = 'synthetic'\ncount = 0", "", ["count is 0, not a number from 1"]),
        ("[[train]]\nmotions = 'synthetic'\nweight = 0", "", ["weight is 0", "0.001 to 1000"]),
        ("[[train]]\nmotions = 'synthetic'\nweight = true", "", ["weight is True, not a number"]),
        ("[[train]]\nmotions = 'a.npz'\nseed = 1", "", ["seed has no effect", "leave it out"]),
        ("train = []", "", ["'train' has no entry", "[[train]]"]),
        ("[[train]]\nmotions = 'synthetic'\nkind = 'a+b'", "", ["kind is 'a+b'", "variations"]),
        ("[[train]]\nmotions = 'synthetic'\nkind = '{kind:>99999999999}'", "", ["use {kind}"]),
        ("[[train]]\nmotions = 'synthetic:sit'\nkind = 'mine'", "", ["needs a chair", "'sit'"]),
        ("[[train]]\nmotions = 'synthetic:wlak'", "", ["[[train]] number 1: ", "mean walk"]),
        ("[[train]]\nmotions = 'synthetic:walk'\ninclude = ['run*']", "", ["fits 'run*'"]),
        ("[[train]]\nmotions = 'synthetic:walk'\nexclude = ['*']", "", ["no clip is left"]),
        ("[[train]]\nmotions = 'synthetic:walk'\nkind = '{x}'", "", ["kind is '{x}'"]),
        ("[[train]]\nmotions = 'synthetic:walk'\nexclude_list = 'no.txt'", "", ["no.txt cannot"]),
        ("[[train]]\nmotions = 'other.toml'", "", ["names a mixture file"]),
        (
            "[[train]]\nmotions = 'synthetic:walk'\nlicence = 'CC-BY-4.0'",
            "",
            ["number 1: licence is CC-BY-4.0", "is MIT", "leave out"],
        ),
        ("[[train]]\nmotions = 'nothing'", "", ["[[train]] number 1: no motions 'nothing'"]),
        ("[[train]]\nmotions = 'synthetic:walk'", ":test", ["no part 'test'", "it has train"]),
        ("[[a]]\nmotions = 'x'\n[[b]]\nmotions = 'x'", "", ["several parts", ":a"]),
        ("[[a]\n", "", ["cannot be read"]),
    ],
)
def test_a_faulty_mixture_is_refused_in_one_line(
    tmp_path: Path, text: str, part: str, words: list[str]
) -> None:
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(InputError) as caught:
        load_motions(f"{tmp_path / 'mine.toml'}{part}")
    message = str(caught.value)
    assert "\n" not in message
    assert all(word in message for word in words), message


PARTS = """
[[validation]]
motions = "{}"
{}

[[train]]
motions = "{}"
{}
"""


def angles(clips: Sequence[Clip]) -> set[bytes]:
    return {clip.qpos[:, 7:].astype(np.float32).tobytes() for clip in clips}


@pytest.mark.parametrize(
    ("validation", "drawn", "train", "seed", "left"),
    [
        ("walks.npz", "count = 2\nseed = 3", "walks.npz", "", 10),
        ("synthetic:walk", "", "walks.npz,synthetic:bow", "", 4),
        ("a", "", "a,b", "", 1),
        ("a,b", "", "b,synthetic:bow", "", 4),
        ("synthetic:sit:6", "seed = 3", "synthetic:sit:6", "seed = 2", 4),
    ],
)
def test_a_clip_is_not_shared_under_another_name_or_seed(
    mixture: Path, validation: str, drawn: str, train: str, seed: str, left: int
) -> None:
    for folder, frames in (("a", 60), ("b", 70)):
        (mixture.parent / folder).mkdir(exist_ok=True)
        (mixture.parent / folder / "walk.bvh").write_text(str(BvhText(frames=frames)))
    file = mixture.with_name("parts.toml")
    file.write_text(PARTS.format(validation, drawn, train, seed))
    taken, learnt = (load_motions(f"{file}:{part}") for part in ("validation", "train"))
    assert len(learnt) == left
    assert not angles(taken) & angles(learnt)
    names = [motion.name for motion in load_recordings(f"{file}:train")]
    assert names == [clip.name for clip in learnt]


def test_clips_of_two_libraries_may_have_one_name(tmp_path: Path) -> None:
    from questsim.motion.library import save_library

    for name, kind in (("a", "walk"), ("b", "squat")):
        clips = load_motions(f"synthetic:{kind}")[:1]
        clips = [replace(c, name="chain-0-0", source=f"chain of {c.name}") for c in clips]
        save_library(tmp_path / f"{name}.npz", [], clips)
    (tmp_path / "mine.toml").write_text(PARTS.format("a.npz", "", "b.npz", ""))
    (clip,) = load_motions(f"{tmp_path / 'mine.toml'}:train")
    assert clip.kind == "squat"


def test_files_of_an_editor_on_windows_are_read(tmp_path: Path) -> None:
    text = "[[train]]\r\nmotions = 'synthetic:walk'\r\nexclude_list = 'kept.txt'\r\n"
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8-sig")
    (tmp_path / "kept.txt").write_text("synthetic-walk-0.9\r\n", encoding="utf-8-sig")
    assert len(load_motions(str(tmp_path / "mine.toml"))) == 11


@pytest.mark.parametrize("text", ["", "synthetic-walk-0.9.bvh\n"])
def test_a_list_that_excludes_nothing_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "kept.txt").write_text(text)
    entry = "[[train]]\nmotions = 'synthetic:walk'\nexclude_list = 'kept.txt'\n"
    (tmp_path / "mine.toml").write_text(entry)
    with pytest.raises(InputError, match=r"number 1: none of the . names in .*kept\.txt"):
        load_motions(str(tmp_path / "mine.toml"))


def test_variations_of_a_kind_stay_variations_of_it(tmp_path: Path) -> None:
    from questsim.motion.library import save_library

    (clip, *_) = load_motions("synthetic:walk")
    clips = [replace(clip, kind="walk+crouch"), replace(clip, name="a+b", kind="walk")]
    save_library(tmp_path / "varied.npz", [], clips)
    entry = "[[train]]\nmotions = 'varied.npz'\nkind = '{kind}-1'\n"
    (tmp_path / "mine.toml").write_text(entry)
    kinds = [clip.kind for clip in load_motions(str(tmp_path / "mine.toml"))]
    assert kinds == ["walk-1+crouch", "walk-1"]
    assert {source_kind(kind) for kind in kinds} == {"walk-1"}
    (tmp_path / "mine.toml").write_text(entry.replace("{kind}-1", "{name}"))
    assert load_motions(str(tmp_path / "mine.toml"))[1].kind == "a-b"


def test_clips_and_what_is_made_of_them_have_the_weight_of_their_entry(tmp_path: Path) -> None:
    file = tmp_path / "mix.toml"
    entries = ("walk-0.5", "weight = 2.5"), ("walk-1.1", "")
    file.write_text(
        "".join(
            f"[[train]]\nmotions = 'synthetic:walk'\ninclude = ['*{name}']\n{key}\n"
            for name, key in entries
        )
    )
    heavy, plain = load_motions(str(file))
    assert (heavy.weight, plain.weight) == (2.5, 1.0)
    assert [motion.weight for motion in load_recordings(str(file))] == [2.5, 1.0]
    assert mirror_clip(heavy).weight == to_clip(to_motion(heavy)).weight == 2.5
    (varied,) = vary([heavy], 1, seed=1)
    assert varied.weight == 2.5
    bank = MotionBank(load_recordings(str(file)), 18)
    chance, starts = bank.probability, bank.starts
    assert chance[0] / chance[1] == pytest.approx(2.5 * starts[0] / starts[1])
    held = MotionBank(load_recordings(str(file)), 18, load_recordings(str(file))).validation
    chance, starts = held.probability, held.starts
    assert chance[0] / chance[1] == pytest.approx(starts[0] / starts[1])
    same, other = (data_record("m", [replace(heavy, weight=w)])["sha256"] for w in (1.0, 2.5))
    assert same != other


def test_a_mixture_states_the_licence_of_files_that_state_none(tmp_path: Path) -> None:
    write_amass(tmp_path / "mine.npz")
    text = "[[train]]\nmotions = 'mine.npz'\n"
    (tmp_path / "mixture.toml").write_text(text + "licence = 'CC-BY-4.0'")
    (clip,) = load_motions(f"{tmp_path / 'mixture.toml'}")
    (recording,) = load_recordings(f"{tmp_path / 'mixture.toml'}")
    assert (clip.licence, recording.licence) == ("CC-BY-4.0", "CC-BY-4.0")
    (tmp_path / "mixture.toml").write_text(text)
    assert load_motions(f"{tmp_path / 'mixture.toml'}")[0].licence == ""


def test_the_shipped_mixture_is_one() -> None:
    file = ROOT / "docs" / "mixtures" / "wide.toml"
    assert (
        list(read_mixture(file)) == ["validation", "train"] == list(tomllib.loads(file.read_text()))
    )


def test_the_shipped_chains_are_eight_kinds_of_each_library(tmp_path: Path) -> None:
    file = ROOT / "docs" / "mixtures" / "chains.toml"
    shutil.copy(file, tmp_path)
    libraries = re.findall(r"--out docs/mixtures/(\S+\.npz)", file.read_text())
    assert len(libraries) == 2
    made = [replace(c, name=f"chain-{i}") for i, c in enumerate(synthetic_clips()[:10])]
    for library in libraries:
        save_library(tmp_path / library, [], made)
    clips = load_motions(f"{tmp_path / 'chains.toml'}:train")
    assert {clip.kind for clip in clips} == {
        f"{kind}-{digit}" for kind in ("walked", "chained") for digit in range(8)
    }


@pytest.mark.parametrize("name", ["sit.toml", "steps.toml"])
def test_the_shipped_mixtures_of_embedded_clips_are_read(name: str) -> None:
    assert "train" in read_mixture(ROOT / "docs" / "mixtures" / name)


def test_a_file_that_cannot_be_read_may_be_excluded_by_name(tmp_path: Path) -> None:
    folder = tmp_path / "captures"
    folder.mkdir()
    write_amass(folder / "standing.npz")
    (folder / "broken_1.bvh").write_text("HIERARCHY\n")
    entry = "[[train]]\nmotions = 'captures'\nexclude = ['{}']\n"
    (tmp_path / "mine.toml").write_text(entry.format("broken_*"))
    assert [clip.name for clip in load_motions(str(tmp_path / "mine.toml"))] == ["standing"]
    (tmp_path / "mine.toml").write_text(entry.format("broke_*"))
    with pytest.raises(InputError, match=r"no clip fits 'broke_\*'"):
        load_motions(str(tmp_path / "mine.toml"))


@pytest.mark.skipif(not MORE_MOTIONS.exists(), reason="needs the shared more-motions.zip")
@pytest.mark.parametrize("name", ["wide.toml", "others.toml"])
def test_the_patterns_of_a_shipped_mixture_fit_its_files(name: str) -> None:
    with zipfile.ZipFile(MORE_MOTIONS) as archive:
        files = [Path(file) for file in archive.namelist()]
    fitted = 0
    for entry in chain(*read_mixture(ROOT / "docs" / "mixtures" / name).values()):
        folder = Path(entry.motions)
        stems = [file.stem for file in files if file.is_relative_to(folder)]
        for pattern in (*entry.include, *entry.exclude) if stems else ():
            assert any(fnmatchcase(stem, pattern) for stem in stems), (entry.motions, pattern)
            fitted += 1
    assert fitted > 2
