"""Search for the start values of the head that follows steps (``agents/policy/stepping.py``).

    python -m docs.figures.head_search --motions synthetic:side-left+step-back --generations 30

An evolution strategy (separable, after Ros & Hansen 2008) over 22 numbers of a teacher whose
network outputs nothing: springs of eight groups of joints, three groups of a leg in swing, the
gains of the centre of mass and the laws of stepping. A candidate's value is its reward per
reference frame until it falls, over all clips. All candidates of a generation act in one batch of
simulations. It prints the final mean as factors of the values in ``stepping.py`` and
``balance.py``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
import tyro

from agents.policy.networks import TorquePolicy
from agents.policy.observed_state import LEG_DOFS
from agents.policy.policy_agent import head_alone
from agents.policy.spec import Layout
from agents.training.presets import TEACHER, TRACKING_REWARD
from envs.config import EnvConfig
from envs.core import BatchSim
from questsim.motion.clip import Clip
from questsim.motion.spec import load_motions
from questsim.skeleton import DOFS

CONFIG = EnvConfig(privileged=True, fixed_start=True, reward=TRACKING_REWARD, max_error_m=0.35)
SPRINGS = ("hip_y", "hip_x", "hip_z", "knee_y", "ankle_y", "ankle_x", "trunk", "arms")
SWING = ("hip", "knee", "ankle")
LAWS = ("ahead", "place", "damp", "pelvis")
NAMES = (
    *(f"stiffer {name}" for name in SPRINGS),
    *(f"softer {name}" for name in SWING),
    *(f"{gain} {axis}" for gain in ("kp", "kd") for axis in "xyz"),
    "limit",
    *LAWS,
)
SIGMA = 0.2
"""First standard deviation of every number, as the logarithm of a factor."""


@dataclass
class Args:
    """Search for start values of the torque head."""

    motions: str = "synthetic:side-left+side-right+backwards+turn-left+walk"
    """Clips to follow: training clips, never a test split."""
    generations: int = 30
    """How many generations."""
    population: int = 8
    """Candidates of a generation; half of them mirror the others."""
    frames: int = 260
    """Follow at most this many frames of each clip."""
    seed: int = 0
    """Random seed."""


def main(args: Args) -> None:
    """Search, printing each generation."""
    torch.set_grad_enabled(False)
    clips = load_motions(args.motions)
    sim = BatchSim(list(clips) * args.population, CONFIG)
    spec = replace(TEACHER, critic_blocks=(), hidden=(8,))
    policies = [head_alone(spec, Layout.of(sim.layout)) for _ in range(args.population)]
    first = {name: value.clone() for name, value in policies[0].state_dict().items()}
    rng = np.random.default_rng(args.seed)
    mean, sigma = np.zeros(len(NAMES)), np.full(len(NAMES), SIGMA)
    parents = args.population // 2
    weights = math.log(parents + 0.5) - np.log(np.arange(1, parents + 1))
    weights /= weights.sum()
    for generation in range(args.generations):
        half = rng.standard_normal((args.population // 2, len(NAMES)))
        drawn = np.concatenate([half, -half])
        for policy, row in zip(policies, mean + sigma * drawn, strict=True):
            _set(policy, first, row)
        value = _values(sim, policies, clips, args.frames)
        best = np.argsort(-value)[:parents]
        mean = mean + 0.8 * sigma * (weights @ drawn[best])
        sigma *= np.exp(0.08 * np.clip(weights @ (drawn[best] ** 2 - 1.0), -1.0, 1.0))
        print(f"{generation}: mean {value.mean():.3f}, best {value.max():.3f}", flush=True)
    print(", ".join(f"{n} x {math.exp(x):.2f}" for n, x in zip(NAMES, mean, strict=True)))


def _set(policy: TorquePolicy, first: dict[str, torch.Tensor], row: np.ndarray) -> None:
    """Set the head to its start values times exp(row), in the order of ``NAMES``."""
    factor = dict(zip(NAMES, row.tolist(), strict=True))
    state = {name: value.clone() for name, value in first.items()}
    for i, dof in enumerate(DOFS):
        hinge = dof.split("_", 1)[1]
        trunk = dof.startswith(("spine", "chest"))
        name = hinge if i < LEG_DOFS else "trunk" if trunk else "arms"
        state["head.log_gain"][i] += factor[f"stiffer {name}"]
        if i < LEG_DOFS:
            softer = factor[f"softer {hinge.split('_')[0]}"]
            state["head.balance.stepping.softer"][i] *= math.exp(softer)
    for k, axis in enumerate("xyz"):
        state["head.balance.log_kp"][k] += factor[f"kp {axis}"]
        state["head.balance.log_kd"][k] += factor[f"kd {axis}"]
    state["head.balance.log_limit"] += factor["limit"]
    for law in LAWS:
        state[f"head.balance.stepping.log_{law}"] += factor[law]
    policy.load_state_dict(state)


def _values(
    sim: BatchSim, policies: Sequence[TorquePolicy], clips: Sequence[Clip], frames: int
) -> np.ndarray:
    """Reward per reference frame of each policy, zero after a fall."""
    count = len(clips)
    length = np.tile([min(len(clip) - 1, frames) for clip in clips], len(policies))
    total, active = np.zeros(len(length)), np.ones(len(length), bool)
    sim.reset()
    step = 0
    while active.any():
        rows = sim.observation.reshape(len(policies), count, -1)
        action = [
            p.predict_batch(np.ascontiguousarray(o)) for p, o in zip(policies, rows, strict=True)
        ]
        sim.step(np.concatenate(action))
        step += 1
        good = active & ~sim.unstable
        total[good] += sim.reward[good]
        active &= ~(sim.fell | sim.ended) & (step < length)
    return (total / length).reshape(len(policies), count).mean(1)


if __name__ == "__main__":
    main(tyro.cli(Args))
