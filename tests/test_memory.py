"""A training that does not fit into the memory is warned of before it begins."""

from __future__ import annotations

from pathlib import Path

import pytest

from agents.training import memory, train_policy
from agents.training.memory import memory_bytes, memory_warning
from questsim.cli import main

HOUR = 36 * 3600


def test_motions_that_fit_need_no_warning_and_others_say_how_much_they_need() -> None:
    assert memory_warning(HOUR, 0.0, 1, 8_000_000_000) is None
    assert memory_warning(10 * HOUR, 0.0, 1, None) is None
    line = memory_warning(10 * HOUR, 0.0, 1, 8_000_000_000)
    assert line is not None
    assert "10.0 h of motion need about 9 GB of memory, this machine has 8" in line
    assert line.endswith("give fewer --motions")
    varied = memory_warning(10 * HOUR, 0.5, 1, 8_000_000_000)
    assert varied is not None and "about 18 GB" in varied
    assert varied.endswith("give fewer --motions or less --vary")
    shared = memory_warning(10 * HOUR, 0.0, 3, 8_000_000_000)
    assert shared is not None and "about 28 GB" in shared
    assert shared.endswith("give fewer --motions or fewer --workers")


def test_a_container_has_the_memory_of_its_limit(tmp_path: Path, monkeypatch) -> None:
    pytest.importorskip("resource", reason="Windows does not tell")
    monkeypatch.setattr(memory, "_LIMITS", ())
    whole = memory_bytes()
    assert whole is not None and whole > 100_000_000
    for text, expected in (("max\n", whole), ("50000000\n", 50_000_000)):
        (tmp_path / "memory.max").write_text(text)
        monkeypatch.setattr(memory, "_LIMITS", (tmp_path / "none", tmp_path / "memory.max"))
        assert memory_bytes() == expected


def test_the_command_warns_and_goes_on(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(train_policy, "memory_bytes", lambda: 1_000_000_000)
    words = "--motions synthetic:stand:2 --preset smoke --envs 4 --steps 64 --stage teacher"
    assert main(["train", *words.split(), "--out", str(tmp_path / "run")]) == 0
    assert "GB of memory, this machine has 1: give fewer --motions" in capsys.readouterr().out
