"""Training curves: a CSV file always, and the real clients of other loggers without a network."""

from __future__ import annotations

import csv
import json
import sys
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from agents.training.loggers import check_logger, training_logger
from questsim.cli import main
from questsim.errors import InputError


def log_two(folder: Path, log, first: int = 0) -> None:
    logger = training_logger(folder, log, {"envs": 4})
    for step in (first + 8, first + 16):
        logger.record("rollout/reward", step / 100)
        logger.dump(step)
    logger.close()


def test_every_logger_writes_csv_and_a_resumed_run_another_file(tmp_path):
    for first in (0, 16):
        log_two(tmp_path / "run" / "teacher" / "curves", "csv", first)
    files = sorted((tmp_path / "run" / "teacher" / "curves").iterdir())
    assert [file.name for file in files] == ["progress-1.csv", "progress-2.csv"]
    with files[1].open(newline="") as table:
        rows = list(csv.DictReader(table))
    assert [row["rollout/reward"] for row in rows] == ["0.24", "0.32"]


def test_tensorboard_has_the_settings_of_a_run_beside_its_curves(tmp_path):
    messages: Any = import_module("tensorboard.plugins.hparams.plugin_data_pb2")
    folder = tmp_path / "run" / "teacher" / "tensorboard"
    config = {"seed": 3, "learning": {"epochs": 4, "betas": (0.9, 0.99)}, "mirror": True}
    training_logger(folder, "tensorboard", config).close()
    (file,) = folder.glob("events.*")
    content = EventAccumulator(str(file)).Reload().summary_metadata
    start = content["_hparams_/session_start_info"].plugin_data.content
    values = messages.HParamsPluginData.FromString(start).session_start_info.hparams
    assert values["seed"].number_value == 3 and values["learning.epochs"].number_value == 4
    assert (
        values["mirror"].number_value == 1
        and values["learning.betas"].string_value == "(0.9, 0.99)"
    )
    log_two(folder, "csv")
    assert "hparams" not in (folder / "progress-2.csv").read_text()


def rewards_in(file: Path) -> list[float]:
    """The rewards in a file of Weights & Biases.

    After a header of 7 bytes it has blocks of 32 KiB with records: checksum, length (2 bytes),
    type, and a protobuf message.
    """
    messages: Any = pytest.importorskip("wandb.proto.wandb_internal_pb2")

    data, at, found = file.read_bytes(), 7, []
    assert len(data) < 32 * 1024
    while at + 7 <= len(data):
        length = int.from_bytes(data[at + 4 : at + 6], "little")
        record = messages.Record.FromString(data[at + 7 : at + 7 + length])
        items = {i.key or "/".join(i.nested_key): i.value_json for i in record.history.item}
        found += [json.loads(items[name]) for name in ("rollout/reward",) if name in items]
        at += 7 + length
    return found


def test_weights_and_biases_offline_keeps_curves_and_continues_its_run(tmp_path, monkeypatch):
    pytest.importorskip("wandb", reason="Weights & Biases is not installed")
    monkeypatch.setenv("WANDB_MODE", "offline")
    check_logger("wandb")
    folder = tmp_path / "run" / "teacher" / "curves"
    for first in (0, 16):
        log_two(folder, "wandb", first)
        ended = int(time.time())
        while int(time.time()) == ended:  # its folders are named by the second in which a run began
            time.sleep(0.05)
    files = sorted((folder / "wandb").glob("offline-run-*/run-*.wandb"))
    assert len({file.name for file in files}) == 1  # both parts have the same id
    rewards = [value for file in files for value in rewards_in(file)]
    assert rewards == [0.08, 0.16, 0.24, 0.32]


def test_trackio_keeps_curves_on_this_machine(tmp_path, monkeypatch):
    monkeypatch.setenv("TRACKIO_DIR", str(tmp_path / "trackio"))
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    reason = "trackio is not installed (it needs pillow < 13)"
    pytest.importorskip("trackio", reason=reason)
    storage: Any = pytest.importorskip("trackio.sqlite_storage").SQLiteStorage
    log_two(tmp_path / "run" / "teacher" / "curves", "trackio")
    rows = storage.get_logs("questsim", "run/teacher")
    assert [row["rollout/reward"] for row in rows] == [0.08, 0.16]


def test_weights_and_biases_without_an_account_is_refused_before_the_run(
    tmp_path, monkeypatch, capsys
):
    pytest.importorskip("wandb", reason="Weights & Biases is not installed")
    monkeypatch.delenv("WANDB_MODE", raising=False)
    monkeypatch.delenv("WANDB_API_KEY", raising=False)
    monkeypatch.setenv("NETRC", str(tmp_path / "netrc"))
    monkeypatch.setenv("HOME", str(tmp_path))
    assert main(f"train --preset smoke --out {tmp_path / 'run'} --log wandb".split()) == 2
    assert "set WANDB_MODE=offline" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("name", ["wandb", "trackio"])
def test_a_logger_that_is_not_installed_is_refused(monkeypatch, name):
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(InputError, match=f"needs {name}.*pip install 'questsim\\[{name}\\]'"):
        check_logger(name)
