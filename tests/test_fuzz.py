"""Damaged inputs of every kind of reader end in success or in one clear line."""

import gzip
import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.fuzz import CaseResult, case_files, fuzz, run_case
from benchmarks.fuzz_inputs import READERS, Reader
from questsim.errors import InputError
from questsim.motion.reading import read_motion
from questsim.recordings import read_recording


def test_300_damaged_inputs_are_read_or_refused_in_one_line():
    outcomes = fuzz(seed=0, count=300, names=list(READERS), processes=1)
    assert len(outcomes) == 300
    assert [outcome for outcome in outcomes if outcome.failed] == []
    # Both ends are reached: damage that does not matter, and damage that does.
    kinds = [outcome.kind for outcome in outcomes]
    assert min(kinds.count("ok"), kinds.count("refused")) > 30


def test_a_case_without_an_end_is_stopped_by_its_own_processor_time():
    code = "from benchmarks.fuzz import limit_cpu; limit_cpu(0)\nwhile True: pass"
    done = subprocess.run([sys.executable, "-c", code], check=False)
    assert done.returncode == -signal.SIGXCPU


def test_a_seed_makes_the_same_cases_and_another_others(tmp_path):
    def content(seed: int, folder: str) -> list[bytes]:
        paths = [
            case_files(READERS["bvh"], seed, number, tmp_path / folder / str(number))
            for number in range(8)
        ]
        return [path.read_bytes() for path in paths]

    assert content(0, "a") == content(0, "b") != content(1, "c")


def _refuses(message: str):
    def read(path: Path) -> None:
        raise InputError(message)

    return read


@pytest.mark.parametrize(
    ("read", "kind"),
    [
        (lambda path: 1 / 0, "exception"),
        (lambda path: np.zeros(0).mean(), "exception"),  # a warning on stderr
        (_refuses("two\nlines"), "message"),
        (_refuses("one line"), "refused"),
        (lambda path: None, "ok"),
    ],
)
def test_a_mishandled_case_is_a_failure(read, kind, tmp_path):
    outcome = run_case(Reader("own", READERS["bvh"].inputs, read), 0, 0, tmp_path)
    assert outcome.kind == kind
    assert outcome.failed == (kind not in ("ok", "refused"))
    assert CaseResult("own", 0, "killed").failed


def own(path: Path, *lines: str) -> Path:
    header = {"format": "questsim-recording", "version": 1, "convention": "openxr"}
    path.write_bytes(gzip.compress("\n".join((json.dumps(header), *lines)).encode()))
    return path


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("[" * 50_000, "line 2: is not JSON: nested too deeply"),
        ('{"t": ' + "1" * 5000 + "}", "line 2: is not JSON: a number is too long"),
        (" " * 200_000, "line 2: the line is too long"),
    ],
)
def test_recordings_that_would_overload_a_parser_are_refused(line, reason, tmp_path):
    with pytest.raises(InputError, match=reason):
        read_recording(own(tmp_path / "r.jsonl.gz", line))


def test_a_recording_with_damaged_packing_is_refused(tmp_path):
    path = own(tmp_path / "r.jsonl.gz", '{"t": 0.0, "headset": [0, 1.6, 0, 0, 0, 0, 1]}')
    data = bytearray(path.read_bytes())
    data[12:30] = b"\xff" * 18
    path.write_bytes(bytes(data))
    with pytest.raises(InputError, match="is not gzip-compressed text"):
        read_recording(path)


def test_a_smpl_model_that_is_not_finite_is_refused(tmp_path):
    from questsim.motion.reading import ReadOptions

    files = READERS["smpl"].inputs()[0]
    (tmp_path / "walk.npz").write_bytes(files["walk.npz"])
    (tmp_path / "model.npz").write_bytes(files["model.npz"])
    with np.load(tmp_path / "model.npz") as model:
        arrays = dict(model)
    for key in arrays:
        wrong = arrays[key].copy()
        wrong.reshape(-1)[0] = np.nan
        np.savez(tmp_path / "model.npz", **arrays | {key: wrong})
        with pytest.raises(InputError, match=f"{key} is not finite"):
            read_motion(tmp_path / "walk.npz", ReadOptions(smpl_file=str(tmp_path / "model.npz")))
