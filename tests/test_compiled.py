"""Compiled loops are kept on disk, and compiled again when anything that they contain changes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

HELPERS = """
from questsim.compiled import jit
@jit
def grown(x):
    return 2.0 * x
"""
RECORDS = """
from typing import NamedTuple
class Pair(NamedTuple):
    first: float
    second: float
"""
SETTINGS = "STEP = 0.5\n"
MIDDLE = """
from loops.helpers import grown
from questsim.compiled import jit
@jit
def raised(x):
    return grown(x) + 1.0
"""
LOOP = """
from loops.middle import raised
from loops.records import Pair
from loops.settings import STEP
from questsim.compiled import jit
@jit
def score(pair):
    return raised(pair.first) - STEP * pair.second
if __name__ == "__main__":
    from loops.loop import score as imported
    value = imported(Pair(first=3.0, second=4.0))
    print(value, sum(imported.stats.cache_hits.values()))
"""
FILES = {"helpers": HELPERS, "records": RECORDS, "settings": SETTINGS, "middle": MIDDLE}


def run(folder: Path) -> tuple[float, int]:
    """The value of the loop, and how many functions came from the disk."""
    command = [sys.executable, "-B", "-m", "loops.loop"]
    path = f"{folder}:{Path(__file__).parent.parent}"
    done = subprocess.run(
        command, cwd=folder, env={"PYTHONPATH": path}, capture_output=True, text=True, check=True
    )
    value, hits = done.stdout.split()
    return float(value), int(hits)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("compiled")
    (folder / "loops").mkdir()
    for name, text in {**FILES, "loop": LOOP, "__init__": ""}.items():
        (folder / "loops" / f"{name}.py").write_text(text)
    assert run(folder) == (2.0 * 3.0 + 1.0 - 0.5 * 4.0, 0)
    assert run(folder) == (5.0, 1)  # nothing has changed: from the disk
    return folder


@pytest.mark.parametrize(
    ("module", "old", "new", "value"),
    [
        ("helpers", "2.0 * x", "5.0 * x", 5.0 * 3.0 + 1.0 - 0.5 * 4.0),  # two modules away
        ("records", "first: float\n    second: float", "second: float\n    first: float", 5.0),
        ("settings", "0.5", "0.25", 2.0 * 3.0 + 1.0 - 0.25 * 4.0),
    ],
)
def test_a_loop_compiles_again_when_a_module_that_it_contains_has_changed(
    folder: Path, module: str, old: str, new: str, value: float
) -> None:
    path = folder / "loops" / f"{module}.py"
    before = path.read_text()
    path.write_text(before.replace(old, new))
    changed, hits = run(folder)
    path.write_text(before)
    assert hits == 0
    assert changed == pytest.approx(value)


def test_a_loop_compiles_again_when_a_record_that_it_takes_was_renamed(folder: Path) -> None:
    files = [folder / "loops" / f"{name}.py" for name in ("records", "loop")]
    before = [file.read_text() for file in files]
    for file, text in zip(files, before, strict=True):
        file.write_text(text.replace("Pair", "Couple"))
    assert run(folder) == (5.0, 0)
    for file, text in zip(files, before, strict=True):
        file.write_text(text)
    assert run(folder) == (5.0, 0)


@pytest.mark.parametrize("kind", ["*loop.score*.nbi", "*loop.score*.nbc"])
def test_a_loop_compiles_again_when_its_stored_file_is_damaged(folder: Path, kind: str) -> None:
    run(folder)
    stored = list((folder / "loops" / "__pycache__").glob(kind))
    assert stored and run(folder) == (5.0, 1)
    for file in stored:
        file.write_bytes(file.read_bytes()[:60])
    assert run(folder) == (5.0, 0)
    assert run(folder) == (5.0, 1)
