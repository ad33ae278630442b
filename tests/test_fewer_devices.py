"""A policy that begins with the weights of one that observes more devices."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from agents.agent import Needs
from agents.policy.checkpoint import find_policy, load_policy, save_policy
from agents.policy.policy_agent import PolicyAgent, new_policy
from agents.policy.spec import SPARSE_BLOCKS, Layout, PolicySpec
from agents.training.fewer_devices import with_devices
from envs.config import EnvConfig, offsets_of
from envs.layout import observation_layout
from questsim.cli import main
from questsim.errors import InputError
from questsim.sensors import sensor_set


def agent(sensors: str = "H+2C", frames: int = 6) -> PolicyAgent:
    """A policy with the statistics of random observations."""
    torch.manual_seed(0)
    config = EnvConfig(sensors=sensors, future_frames=frames, privileged=True)
    layout = Layout.of(observation_layout(config)).within(SPARSE_BLOCKS)
    spec = PolicySpec(critic_blocks=(), hidden=(24, 16), balance="placement")
    policy = new_policy(spec, layout)
    columns = max(stop for _, stop in layout.blocks.values())
    policy.update_norm(
        torch.randn(columns) + (1.0 + torch.rand(columns)) * torch.randn(500, columns)
    )
    return PolicyAgent(policy, replace(Needs(), sensors=sensors, future_frames=frames), "wide")


def parts(of: PolicyAgent, observations: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The state, the user ``(n, frames, devices, 9)`` and the stature of observations."""
    first, end = of.policy.layout.blocks["o_user"]
    shape = len(offsets_of(of.needs.future_frames)), len(sensor_set(of.needs.sensors)), 9
    user = observations[:, first:end].reshape(len(observations), *shape)
    return observations[:, :first], user, observations[:, end:]


def joined(state: np.ndarray, user: np.ndarray, stature: np.ndarray) -> np.ndarray:
    return np.concatenate([state, user.reshape(len(user), -1), stature], 1).astype(np.float32)


@pytest.mark.parametrize(("sensors", "frames"), [("H", 6), ("H+2C", 0), ("H", 1), ("H+2C", 3)])
def test_it_acts_the_same_where_the_user_keeps_still_and_missing_devices_are_at_their_mean(
    sensors: str, frames: int
) -> None:
    old = agent()
    new = with_devices(old, sensors, frames)
    assert (new.needs.sensors, new.needs.future_frames) == (sensors, frames)
    columns = max(stop for _, stop in new.policy.layout.blocks.values())
    state, user, stature = parts(
        new, np.random.default_rng(1).normal(size=(5, columns)).astype(np.float32)
    )
    # In the old observation, each device that is observed keeps its place in the frames that the
    # new policy lacks; the others are at their mean over the earlier training.
    mean = parts(old, old.policy.actor.norm.mean.numpy()[None])[1]
    before = np.repeat(mean, 5, axis=0)
    ours = [sensor_set("H+2C").index(name) for name in sensor_set(sensors)]
    offsets = np.array(offsets_of(frames))
    for row, frame in enumerate(offsets_of(6)):
        before[:, row, ours] = user[:, np.argmin(np.abs(offsets - frame))]
    expected = old.act(joined(state, before, stature))
    np.testing.assert_allclose(new.act(joined(state, user, stature)), expected, atol=2e-5)
    elsewhere = joined(state, user + 1.0, stature)
    assert np.abs(new.act(elsewhere) - expected).max() > 0.01  # it does observe the user


def test_a_policy_of_the_same_devices_is_taken_as_it_is_and_more_devices_are_refused() -> None:
    old = agent("H", 6)
    assert with_devices(old, "H", 6) is old
    three = agent()
    assert with_devices(three, "3T", 6) is three  # the same devices by another name
    with pytest.raises(InputError, match="does not observe left_controller, right_controller"):
        with_devices(old, "H+2C", 6)


def test_more_future_frames_begin_with_the_nearest_one_and_its_statistics() -> None:
    old = agent("H", 0)
    new = with_devices(old, "H", 2)
    first, end = new.policy.layout.blocks["o_user"]
    name = "actor.layers.0.weight"
    before = old.policy.state_dict()[name][:, first : first + 9]
    weights = new.policy.state_dict()[name][:, first:end].reshape(24, 2, 9)
    assert torch.equal(weights[:, 0], before)
    assert torch.all(weights[:, 1] == 0.0)
    # Without statistics a position of 1.6 m would be 160 deviations, for as long as the new
    # observations are few beside those that the earlier policy counted.
    ours, theirs = new.policy.actor.norm, old.policy.actor.norm
    for got, expected in ((ours.mean, theirs.mean), (ours.var, theirs.var)):
        assert torch.equal(got[first:end], expected[first : first + 9].repeat(2))
        assert torch.equal(got[end:], expected[first + 9 :])


@pytest.mark.parametrize(
    ("sensors", "frames", "message"),
    [("H", 1_000_000_000_000, "future_frames is 1000000000000"), ("H+2C+2IMU", 6, "no pose")],
)
def test_what_no_policy_can_observe_is_refused(sensors: str, frames: int, message: str) -> None:
    with pytest.raises(InputError, match=message):
        with_devices(agent(), sensors, frames)


def test_a_student_of_a_headset_starts_from_questsim(tmp_path: Path, capsys) -> None:
    out = tmp_path / "run"
    words = (
        "--motions synthetic:stand:2 --sensors H --stage student --teacher tracker --envs 4 "
        f"--start questsim --steps 64 --threads 1 --out {out}"
    ).split()
    assert main(["train", *words]) == 0
    shipped = load_policy(find_policy("questsim"))
    trained = load_policy(find_policy(out))
    assert trained.needs.sensors == "H"
    assert trained.policy.spec.hidden == shipped.policy.spec.hidden
    first = shipped.policy.layout.blocks["o_user"][0]
    ours, theirs = trained.policy.actor.norm, shipped.policy.actor.norm
    assert torch.equal(ours.mean[:first], theirs.mean[:first])

    save_policy(tmp_path / "headset", trained.policy, trained.needs, {})
    words[words.index("H")] = "H+2C"
    words[words.index("questsim")] = str(tmp_path / "headset")
    words[-1] = str(tmp_path / "more")
    assert main(["train", *words]) == 2
    error = capsys.readouterr().err
    assert "does not observe left_controller, right_controller" in error
    assert not (tmp_path / "more").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--stage student --teacher runs/none", "runs/none"),
        ("--stage student --teacher tracker --specialists runs/none:walk", "runs/none"),
        ("--specialists runs/none:walk", "runs/none"),
        ("--stage student", "has no teacher of its own"),
        ("--stage finetune", "student"),
        ("--stage student --teacher tracker --start questsim-headset", "does not observe left_con"),
    ],
)
def test_policies_are_looked_up_before_the_motions_are_loaded(
    words: str, message: str, tmp_path: Path, capsys
) -> None:
    """Loading a wide mixture takes minutes."""
    run = ["train", "--out", str(tmp_path / "run"), "--motions", "no-such-file.npz"]
    assert main([*run, *words.split()]) == 2
    error = capsys.readouterr().err
    assert message in error and "no-such-file" not in error
    assert not (tmp_path / "run").exists()
