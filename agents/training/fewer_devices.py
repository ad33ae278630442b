"""Begin a policy with the weights of one that observes more devices or other frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from agents.policy.networks import MIN_STD, TorquePolicy
from agents.policy.policy_agent import PolicyAgent, new_policy
from agents.policy.spec import Layout
from envs.config import EnvConfig, offsets_of
from envs.layout import POSE_SIZE
from questsim.errors import InputError
from questsim.sensors import sensor_set

USER = "o_user"


def with_devices(agent: PolicyAgent, sensors: str, future_frames: int) -> PolicyAgent:
    """A policy that observes some of an agent's devices, with its weights.

    Each input of a device that both observe is taken over by the same device's nearest frame;
    several inputs that fall on one frame are added. The others count as at their mean over the
    earlier training. Frames that only the new policy observes have no effect at first, and the
    statistics of the nearest earlier one. The policy therefore acts like the agent where the user
    keeps still and the missing devices are where they are on average, and has to learn the rest.

    Args:
        agent: the policy to begin with.
        sensors, future_frames: what the new policy observes.

    Returns:
        the agent itself if it observes the same, or no devices at all.

    Raises:
        InputError: it lacks a device that the new policy observes, or no policy can observe this.
    """
    needs, blocks = agent.needs, agent.policy.layout.blocks
    same = sensor_set(sensors) == sensor_set(needs.sensors) and future_frames == needs.future_frames
    if same or USER not in blocks:
        return agent
    EnvConfig(sensors=sensors, future_frames=future_frames)  # refuses what cannot be observed
    lacks = [name for name in sensor_set(sensors) if name not in sensor_set(needs.sensors)]
    if lacks:
        raise InputError(
            f"does not observe {', '.join(lacks)}",
            agent.name,
            f"start from a policy of {sensors} or more devices",
        )
    source, spec = agent.policy, agent.policy.spec
    width = POSE_SIZE * len(sensor_set(sensors)) * len(offsets_of(future_frames))
    policy = new_policy(spec, _with_user_of(source.layout, width), hinges=source.log_std.numel())
    old, new = (needs.sensors, needs.future_frames), (sensors, future_frames)
    state = {name: value.clone() for name, value in source.state_dict().items()}
    state |= _with_inputs(source, policy, state, _places(*old, *new), _places(*new, *old))
    policy.load_state_dict(state)
    fewer = replace(needs, sensors=sensors, future_frames=future_frames)
    return PolicyAgent(policy, fewer, agent.name, agent.card)


def _with_user_of(layout: Layout, width: int) -> Layout:
    """The layout with a block of the user that is ``width`` wide."""
    first, end = layout.blocks[USER]
    moved = width - (end - first)
    blocks = {
        name: (at + moved, to + moved) if at >= end else (at, to)
        for name, (at, to) in layout.blocks.items()
    }
    return Layout(blocks | {USER: (first, first + width)})


def _places(old_set: str, old_future: int, new_set: str, new_future: int) -> np.ndarray:
    """Of each old number of the user its place in the new frame nearest to it, -1 without one."""
    old_devices, new_devices = sensor_set(old_set), sensor_set(new_set)
    frames = np.array(offsets_of(new_future))
    places = []
    for frame in offsets_of(old_future):
        nearest = int(np.argmin(np.abs(frames - frame)))
        for device in old_devices:
            at = -1
            if device in new_devices:
                at = nearest * len(new_devices) + new_devices.index(device)
            places += [at * POSE_SIZE + k if at >= 0 else -1 for k in range(POSE_SIZE)]
    return np.array(places)


def _with_inputs(
    source: TorquePolicy,
    target: TorquePolicy,
    state: dict[str, Tensor],
    places: np.ndarray,
    origins: np.ndarray,
) -> dict[str, Tensor]:
    """Normaliser and first layer of ``source`` for the inputs of ``target``.

    Args:
        source, target: the policies.
        state: weights of ``source``.
        places: of each old number of the user its place among the new ones, -1 without one.
        origins: of each new number of the user the old one whose statistics it has.
    """
    old, new = source.actor.columns.numpy(), target.actor.columns.numpy()
    to = _new_inputs(source.layout, target.layout, old, new, places)
    origin = torch.as_tensor(_new_inputs(target.layout, source.layout, new, old, origins))
    kept = np.flatnonzero(to >= 0)
    old_mean, old_var = state["actor.norm.mean"], state["actor.norm.var"]
    weight = state["actor.layers.0.weight"]
    mean, var = old_mean[origin], old_var[origin]
    deviation = var.sqrt().clamp_min(MIN_STD)
    old_deviation = old_var.sqrt().clamp_min(MIN_STD)
    rows = torch.as_tensor(to[kept])
    scaled = weight[:, kept] * (deviation[rows] / old_deviation[kept])
    fresh = torch.zeros(len(weight), len(new)).index_add_(1, rows, scaled)
    shift = (mean[rows] - old_mean[kept]) / old_deviation[kept]
    return {
        "actor.norm.mean": mean,
        "actor.norm.var": var,
        "actor.layers.0.weight": fresh,
        "actor.layers.0.bias": state["actor.layers.0.bias"] + weight[:, kept] @ shift,
    }


def _new_inputs(
    source: Layout, target: Layout, old: np.ndarray, new: np.ndarray, places: np.ndarray
) -> np.ndarray:
    """Of each input of one actor its number among the other's, -1 without one."""
    (first, end), moved = source.blocks[USER], target.blocks[USER][1] - source.blocks[USER][1]
    column = np.where(old >= end, old + moved, old)
    user = (old >= first) & (old < end)
    place = places[old[user] - first]
    column[user] = np.where(place >= 0, first + place, -1)
    number = {int(at): index for index, at in enumerate(new)}
    return np.array([number.get(int(at), -1) for at in column])
