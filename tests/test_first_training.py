"""The benchmark of first trainings: its budgets, and what it calls missed."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import pytest

from benchmarks.first_training import Budget, bars, table

GOOD: dict[str, Any] = {
    "budget": "10",
    "seed": 0,
    "first_kl": 0.015,
    "teacher": {"start": 0.72, "end": 0.87},
    "student": {"start": 0.17, "end": 0.73},
    "policy": {"score": 0.8, "followed": 1.0},
    "zero": {"score": 0.04, "followed": 0.0},
}


def test_a_budget_of_steps_sets_those_of_each_stage_and_one_of_minutes_sets_none() -> None:
    steps = Budget(steps=(300_000, 150_000))
    assert str(steps) == "300000+150000"
    assert steps.overrides == ["stages.teacher.steps=300000", "stages.student.steps=150000"]
    assert str(Budget(minutes=4.0)) == "4" and not Budget(minutes=4.0).overrides


@pytest.mark.parametrize(
    ("part", "value", "missed"),
    [
        ("first_kl", 16.0, "first KL"),
        ("first_kl", None, "first KL"),
        ("teacher", {"start": 0.72, "end": 0.71}, "teacher better than its start"),
        ("student", {"start": 0.17, "end": 0.16}, "better than its start"),
        ("policy", {"score": 0.03, "followed": 1.0}, "better than zero torques"),
        ("policy", {"score": 0.8, "followed": 0.9}, "stand and wave"),
    ],
)
def test_a_training_that_does_not_learn_misses_a_bar(part: str, value: Any, missed: str) -> None:
    assert all(bars(GOOD, True).values())
    bad = deepcopy(GOOD) | {part: value}
    assert [name for name, met in bars(bad, True).items() if not met] == [missed]
    assert missed in table([bad | {"bars": bars(bad, True)}])
