"""The trial of a learned model of the simulator (docs/figures/learned_simulator.py)."""

import csv
from typing import Any

import numpy as np
import pytest
import torch

from docs.figures.learned_simulator import (
    Args,
    Links,
    Model,
    Player,
    Windows,
    _fit_model,
    _networks,
    inputs_of,
    links_of,
    main,
    rotation,
)
from questsim import rotations as rot
from questsim.errors import InputError
from tests.helpers import swaying_clip

SMALL: dict[str, Any] = {
    "envs": 4,
    "steps": 12,
    "updates": 2,
    "model_batch": 8,
    "policy_batch": 4,
    "hidden": 16,
}


def test_rotations_are_those_of_rotation_vectors() -> None:
    vectors = np.random.default_rng(0).normal(size=(5, 3))
    wanted = rot.quat_to_matrix(rot.as_quat(rot.from_rotvec(vectors)))
    np.testing.assert_allclose(rotation(torch.as_tensor(vectors)), wanted, atol=1e-6)


def test_the_links_of_a_reference_have_no_error_and_move_as_it_does(tmp_path) -> None:
    clips = [swaying_clip(frames=60)]
    player = Player(clips, Args(out=tmp_path, **SMALL))
    player.judge.reset()
    now, row = links_of(player.judge), torch.as_tensor(player.judge.frame)
    there = player.judged.links.at(row)
    for got, wanted in zip(now, there, strict=True):
        torch.testing.assert_close(got, wanted, atol=2e-2, rtol=0.0)
    values = inputs_of(now, row, player.judged)
    # Turned and moved with the avatar, everything looks the same.
    turn = rotation(torch.tensor([0.0, 0.0, 0.7]))
    moved = Links(now.place @ turn.mT, turn @ now.axes, now.velocity @ turn.mT, now.spin @ turn.mT)
    own = slice(0, 240)
    torch.testing.assert_close(
        inputs_of(moved, row, player.judged)[:, own], values[:, own], atol=1e-5, rtol=0.0
    )


def test_the_model_learns_how_the_links_move(tmp_path) -> None:
    args = Args(
        out=tmp_path, **{**SMALL, "envs": 16, "steps": 24, "updates": 60, "model_batch": 64}
    )
    player = Player([swaying_clip(frames=60)], args)
    torch.manual_seed(0)
    record = player.cycle(None, args.steps, 0.2)
    model, _ = _networks(player, record, args)
    assert isinstance(model, Model)
    windows = Windows([record], args.model_window)
    optimiser = torch.optim.Adam(model.parameters(), 3e-3)
    first = _fit_model(model, optimiser, windows, player, args)
    last = _fit_model(model, optimiser, windows, player, args)
    assert last < 0.8 * first


def test_the_trial_writes_its_curve(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("docs.figures.learned_simulator.load_motions", lambda _: [swaying_clip()])
    main(Args(out=tmp_path, minutes=0.0, **SMALL))
    with (tmp_path / "curve.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert float(rows[-1]["tracked_percent"]) in (0.0, 100.0) and rows[-1]["steps"] == "48"


def test_the_picture_goes_with_no_other_option() -> None:
    with pytest.raises(InputError, match="--picture: trains nothing"):
        main(Args(picture=True, minutes=3.0))
