"""Embedded clips are made only if they are asked for, and once."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from questsim.motion.spec import load_motions
from questsim.motion.synthesis import kept, synthetic
from questsim.motion.synthesis.wish import Wish


@pytest.fixture
def fresh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """Neither memory nor cache has a clip; the kinds that are made from now on."""
    monkeypatch.setenv("QUESTSIM_CACHE", str(tmp_path))
    synthetic._kept_clip.cache_clear()
    made: list[str] = []
    poses = synthetic._poses

    def counted(asked: Wish, rng: np.random.Generator) -> np.ndarray:
        made.append(asked.kind)
        return poses(asked, rng)

    monkeypatch.setattr(synthetic, "_poses", counted)
    yield made
    synthetic._kept_clip.cache_clear()


def test_only_requested_clips_are_made_and_only_once(fresh: list[str]) -> None:
    first = load_motions("synthetic:stand")
    assert fresh == ["stand"] * 3
    again = load_motions("synthetic:stand")
    assert len(fresh) == 3
    synthetic._kept_clip.cache_clear()  # as in another process
    from_disk = load_motions("synthetic:stand")
    assert len(fresh) == 3
    for clips in (again, from_disk):
        for a, b in zip(first, clips, strict=True):
            assert (a.name, a.kind) == (b.name, b.kind)
            np.testing.assert_array_equal(a.qpos, b.qpos)
            np.testing.assert_array_equal(a.link_velocity, b.link_velocity)


def test_writing_to_a_clip_does_not_change_the_next_one(fresh: list[str]) -> None:
    clip = load_motions("synthetic:stand")[0]
    kept_qpos = clip.qpos.copy()
    clip.qpos[:] = 7.0
    np.testing.assert_array_equal(load_motions("synthetic:stand")[0].qpos, kept_qpos)


@pytest.mark.parametrize("content", [b"", b"not an array", None])
def test_a_damaged_cache_is_made_anew(
    fresh: list[str], tmp_path: Path, content: bytes | None
) -> None:
    first = load_motions("synthetic:stand")
    for file in (tmp_path / "synthetic").iterdir():
        if content is None:
            np.save(file, np.full((3, 40), np.nan))
        else:
            file.write_bytes(content)
    synthetic._kept_clip.cache_clear()
    again = load_motions("synthetic:stand")
    assert fresh == ["stand"] * 6
    np.testing.assert_array_equal(first[0].qpos, again[0].qpos)


def test_without_a_cache_folder_clips_are_made_all_the_same(
    fresh: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("QUESTSIM_CACHE", str(tmp_path / "file" / "below"))
    assert len(load_motions("synthetic:stand")) == 3
    assert fresh == ["stand"] * 3


def test_poses_of_other_code_are_not_taken(
    fresh: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    load_motions("synthetic:stand")
    monkeypatch.setattr(kept, "_code_digest", lambda: "another version")
    synthetic._kept_clip.cache_clear()
    load_motions("synthetic:stand")
    assert len(fresh) == 6
