"""Training curves: a CSV file always, and TensorBoard, Weights & Biases or trackio (``--log``)."""

from __future__ import annotations

import importlib
import os
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stable_baselines3.common.logger import HParam, KVWriter, Logger, make_output_format

from agents.training.options import LogName
from questsim.errors import InputError

PROJECT = "questsim"
"""Project of the runs in Weights & Biases and trackio; the libraries' own settings change it."""
_RUN_ID = "wandb-id.txt"
COMPARED = ("evaluation/score", "evaluation/tracked", "evaluation/link_error_cm", "rollout/reward")
"""Curves whose last values TensorBoard lists beside the settings of a run."""


def check_logger(log: LogName) -> None:
    """Check that a logger can be used, before anything is written.

    Raises:
        InputError: its library is not installed, or needs an account first.
    """
    if log in ("wandb", "trackio"):
        try:
            library = importlib.import_module(log)
        except ImportError as error:
            fix = f"pip install 'questsim[{log}]'"
            raise InputError(
                f"needs {log}, which cannot be imported ({error})", "--log", fix
            ) from None
        online = os.environ.get("WANDB_MODE", "online") not in ("offline", "disabled", "dryrun")
        if log == "wandb" and online and not library.api.api_key:
            fix = "run wandb login, or set WANDB_MODE=offline"
            raise InputError("no account of Weights & Biases is logged in", "--log wandb", fix)


def training_logger(
    folder: Path, log: LogName = "tensorboard", config: Mapping[str, Any] | None = None
) -> Logger:
    """Writes curves to ``log`` and to ``progress-1.csv``; a resumed run starts ``-2``.

    Args:
        folder: folder of the files; the one above it is the stage's, in the run's folder.
        log: see ``LogName``.
        config: settings to show beside the curves; TensorBoard's page HPARAMS compares runs by
            them.
    """
    part = len(list(folder.glob("progress-*.csv"))) + 1
    writers: list[KVWriter] = [make_output_format("csv", str(folder), f"-{part}")]
    if log == "tensorboard":
        board = make_output_format("tensorboard", str(folder), f"-{part}")
        if config:
            table = HParam(flat(config), dict.fromkeys(COMPARED, 0.0))
            board.write({"hparams": table}, {"hparams": ()}, 0)
        writers.append(board)
    elif log != "csv":
        writers.append(RunWriter(log, folder, config or {}))
    return Logger(str(folder), writers)


def flat(config: Mapping[str, Any], before: str = "") -> dict[str, bool | float | str]:
    """Settings of nested mappings by names such as ``config.learning.epochs``; others as text."""
    found: dict[str, bool | float | str] = {}
    for name, value in config.items():
        if isinstance(value, Mapping):
            found |= flat(value, f"{before}{name}.")
        else:
            found[before + name] = value if isinstance(value, bool | int | float) else str(value)
    return found


class RunWriter(KVWriter):
    """Sends curves to a run of Weights & Biases or of trackio, which have the same interface.

    Args:
        library: ``wandb`` or ``trackio``.
        folder: as for ``training_logger``; Weights & Biases keeps its files there.
        config: settings to show beside the curves.
    """

    def __init__(self, library: str, folder: Path, config: Mapping[str, Any]) -> None:
        self._library = importlib.import_module(library)
        stage = folder.absolute().parent
        options: dict[str, Any] = {
            "project": os.environ.get(f"{library.upper()}_PROJECT", PROJECT),
            "name": f"{stage.parent.name}/{stage.name}",
            "config": dict(config),
            "resume": "allow",
        }
        if library == "wandb":
            quiet = self._library.Settings(console="off", silent=True)
            options |= {"dir": str(folder), "id": self._run_id(folder), "settings": quiet}
        self._run = self._library.init(**options)

    def _run_id(self, folder: Path) -> str:
        """The run's id, kept in the folder, so that a resumed training continues the same run."""
        path = folder / _RUN_ID
        if not path.is_file():
            folder.mkdir(parents=True, exist_ok=True)
            path.write_text(secrets.token_hex(8), encoding="utf-8")
        return path.read_text(encoding="utf-8").strip()

    def write(
        self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0
    ) -> None:
        """Send the numbers of one log point."""
        numbers = {k: float(v) for k, v in key_values.items() if not isinstance(v, str)}
        self._run.log(numbers, step=step)

    def close(self) -> None:
        """End the run."""
        self._run.finish()
