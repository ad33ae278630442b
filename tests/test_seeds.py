"""Evaluations over several seeds."""

import json

import numpy as np
import pytest

from agents.commands.evaluate import evaluate
from agents.evaluation.options import EvaluateArgs
from questsim.errors import InputError


def test_seeds_give_mean_and_spread_of_the_random_agent(tmp_path, capsys):
    args = EvaluateArgs("random", "synthetic:stand", max_clips=1, seeds=3, threads=1, out=tmp_path)
    assert evaluate(args) == 0
    assert "over 3 seeds" in capsys.readouterr().out
    found = json.loads((tmp_path / "metrics.json").read_text())["context"]["seeds"]["mpjpe_cm"]
    assert len(set(found["values"])) == 3
    assert found["mean"] == pytest.approx(np.mean(found["values"]))
    assert found["std"] == pytest.approx(np.std(found["values"], ddof=1)) and found["std"] > 0


def test_seeds_are_refused_where_nothing_is_random():
    with pytest.raises(InputError, match="--seeds: nothing in this evaluation is random"):
        evaluate(EvaluateArgs("zero", "synthetic:stand", max_clips=1, seeds=2))
