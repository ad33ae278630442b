"""Chains of clips: standing, going over, performing from rest to rest."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from questsim import cli
from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M
from questsim.body_proportions import Proportions
from questsim.errors import InputError
from questsim.motion.clip import FPS
from questsim.motion.kinematics import standing_clip
from questsim.motion.library import bare, save_library
from questsim.motion.motions_command import check_library_path
from questsim.motion.spec import load_motions
from questsim.motion.varying.chain import (
    EASED_FRAMES,
    can_be_chained,
    chain,
    chains,
    eased_frames,
    going_over,
    interpolated,
)
from questsim.motion.varying.feasible import fast_joint, in_the_floor
from questsim.motion.varying.figure import figure_of

CLIPS = {clip.name.removeprefix("synthetic-"): clip for clip in load_motions("synthetic")}


def test_a_chain_stands_then_performs_each_clip_from_rest_where_the_last_ended():
    parts = [CLIPS["wave-1"].scaled(1.6), CLIPS["squat-1"]]
    made = chain("me", parts, np.random.default_rng(3))
    assert made.height_m == DEFAULT_HEIGHT_M and made.source.startswith("chain of ")
    still = made.qpos[: round(0.8 * FPS)]
    assert np.ptp(still, axis=0).max() == 0.0
    assert np.allclose(np.delete(still[0, 7:], [21, 22, 24, 27, 28, 30]), 0.0)  # arms alone differ
    assert in_the_floor(made) is False and fast_joint(made) is None
    for part in parts:  # its full-speed frames are in the chain, turned and moved
        want = part.scaled(DEFAULT_HEIGHT_M).qpos[EASED_FRAMES : len(part) - EASED_FRAMES, 7:]
        found = [i for i in range(len(made)) if np.abs(made.qpos[i, 7:] - want[0]).max() < 1e-6]
        assert found
        got = made.qpos[found[-1] : found[-1] + len(want), 7:]
        assert np.allclose(got, want, atol=1e-6)


def test_a_clip_is_eased_from_rest_to_full_speed_and_back():
    speed = np.diff(eased_frames(100))
    assert speed[0] < 0.05 and speed[-1] < 0.05 and np.allclose(speed[40:60], 1.0)
    assert np.abs(np.diff(speed)).max() < 0.04  # no jumps of speed
    assert eased_frames(100)[[0, -1]].tolist() == [0.0, 99.0]


def test_poses_between_frames_take_the_short_way_around():
    ends = standing_clip(DEFAULT_HEIGHT_M, 2).qpos.copy()
    ends[1, 3:7] = -rot.yaw_quat(np.array(0.4))
    (half,) = interpolated(ends, np.array([0.5]))
    assert rot.heading(half[3:7]) == pytest.approx(0.2, abs=1e-6)


def test_a_foot_that_has_to_move_steps_while_the_weight_is_over_the_other():
    before = standing_clip(DEFAULT_HEIGHT_M).qpos[0]
    after = before.copy()
    after[:2] += (0.12, 0.05)
    made = going_over(before, after, 50, np.random.default_rng(0))
    figure = figure_of(np.concatenate([before[None], made, after[None]]))
    up = figure.ankle[:, :, 2] > figure.ankle[0, :, 2] + 0.03
    assert up.any(axis=0).all() and not up.all(axis=1).any()
    for foot in range(2):
        still = ~(figure.ankle[:, foot, 2] > figure.ankle[0, foot, 2] + 1e-3)
        moved = np.linalg.norm(np.diff(figure.ankle[:, foot, :2], axis=0), axis=-1)
        assert moved[still[1:] & still[:-1]].max() < 5e-3
        loaded = np.flatnonzero(up[:, 1 - foot])
        middle = 0.5 * (figure.ankle[:, 0, :2] + figure.ankle[:, 1, :2])
        toward = ((figure.center - middle) * (figure.ankle[:, foot, :2] - middle)).sum(-1)
        assert toward[loaded].mean() > 0.0


def test_feet_that_stay_do_not_step():
    before = standing_clip(DEFAULT_HEIGHT_M).qpos[0]
    after = before.copy()
    after[0] += 0.01
    made = going_over(before, after, 40, np.random.default_rng(0))
    assert np.ptp(figure_of(made).ankle[..., 2], axis=0).max() < 1e-3


def test_chains_are_determined_by_seed_and_number_and_know_their_licences():
    clips = [replace(CLIPS["wave-1"], licence="CC-BY-NC-4.0"), CLIPS["squat-1"], CLIPS["stand-2"]]
    made = list(chains(clips, 3, seed=5))
    again = list(chains(clips, 2, seed=5))
    assert all(np.array_equal(a.qpos, b.qpos) for a, b in zip(made, again, strict=False))
    assert [clip.name for clip in made] == ["chain-5-0", "chain-5-1", "chain-5-2"]
    assert {clip.licence for clip in made} <= {"MIT", "CC-BY-NC-4.0"}
    unknown = [replace(clip, licence="") for clip in clips[:2]]
    assert next(chains(unknown, 1)).licence == ""


def test_only_clips_from_rest_to_rest_without_a_chair_are_chained():
    assert can_be_chained(CLIPS["wave-1"]) and can_be_chained(CLIPS["squat-1"])
    moving = CLIPS["jog-2"]
    assert not can_be_chained(moving)
    assert not any(can_be_chained(clip) for clip in load_motions("synthetic:sit"))
    with pytest.raises(InputError, match="1 of 2 clips begin and end at rest"):
        next(chains([CLIPS["wave-1"], moving], 1))


def test_clips_of_other_proportions_are_refused_by_name():
    own_body = replace(CLIPS["wave-1"], proportions=Proportions())
    with pytest.raises(InputError, match="synthetic-wave-1: chains are of the default body's"):
        chain("me", [CLIPS["squat-1"], own_body], np.random.default_rng(0))
    with pytest.raises(InputError, match="synthetic-wave-1: chains are of the default body's"):
        next(chains([CLIPS["squat-1"], CLIPS["stand-1"], own_body], 1))


def test_the_command_writes_a_library_and_nothing_when_it_cannot(tmp_path, capsys):
    out = tmp_path / "chains.npz"
    line = ["motions", "chain", "synthetic:wave+squat", "--out", str(out)]
    assert cli.main([*line, "--count", "3", "--seed", "2"]) == 0
    said = capsys.readouterr().out
    assert "3 chains" in said and "licence: MIT" in said
    assert len(load_motions(str(out))) == 3
    out.unlink()
    assert cli.main([*line, "--each", "50"]) == 2 and not out.exists()
    assert "a chain needs 50" in capsys.readouterr().err
    assert cli.main(["motions", "chain", "synthetic:sit", "--out", str(out)]) == 2
    assert "0 of 4 clips begin" in (said := capsys.readouterr().err) and "need no chair" in said


@pytest.mark.parametrize("command", ["chain", "vary"])
def test_the_commands_do_not_replace_their_motions_or_a_folder(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    library = tmp_path / "mine.npz"
    save_library(library, [], [CLIPS["wave-1"]])
    (tmp_path / "mine.toml").write_text("[[train]]\nmotions = 'mine.npz'\n")
    before = library.read_bytes()
    for motions in ("mine.npz", ".", "synthetic:bow,mine.toml:train"):
        line = ["motions", command, motions, "--out", "./mine.npz", "--count", "1"]
        assert cli.main(line) == 2
        with pytest.raises(InputError, match=r"mine\.npz: is one of the motions"):
            check_library_path(Path("mine.npz"), motions)
    assert library.read_bytes() == before
    (tmp_path / "folder.npz").mkdir()
    with pytest.raises(InputError, match=r"folder\.npz: is a folder"):
        check_library_path(Path("folder.npz"))
    check_library_path(library, "synthetic:bow")


def test_a_chain_is_kept_in_a_tenth_of_its_memory_and_stored_alike(tmp_path):
    (made,) = chains([CLIPS["wave-1"], CLIPS["squat-1"]], 1)
    small = bare(made)
    sizes = [sum(a.nbytes for a in vars(c).values() if hasattr(a, "nbytes")) for c in (made, small)]
    assert sizes[1] < 0.1 * sizes[0]
    for name, clip in (("made", made), ("small", small)):
        save_library(tmp_path / f"{name}.npz", [], [clip])
    assert (tmp_path / "made.npz").read_bytes() == (tmp_path / "small.npz").read_bytes()
