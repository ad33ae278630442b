"""Real-time factor of one avatar on one core: observation, policy and physics.

    python -m benchmarks.realtime [--agent questsim] [--json]

The parts are also timed separately. The policy's network is compared with the same arithmetic in
NumPy, a lower bound of its cost. ``--agent untrained`` takes an untrained policy of the size of the
preset's student, which falls over.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable

import numpy as np
import torch

from agents.agent import Agent, Needs
from agents.loading import load_agent
from agents.policy.networks import CLIP, MIN_STD, PUSH_SCALE
from agents.policy.policy_agent import PolicyAgent, new_policy
from agents.policy.spec import Layout, initial_gains
from agents.training.presets import PRESETS
from benchmarks.common import arguments, clips, report
from envs.config import EnvConfig
from envs.core import BatchSim
from envs.layout import observation_layout
from questsim.body import build_body
from questsim.cli import guarded
from questsim.motion.clip import FPS
from questsim.skeleton import NUM_DOFS

GOAL = 20.0
"""Times real time."""

ACTIVATIONS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "tanh": np.tanh,
    "elu": lambda x: np.where(x > 0, x, np.expm1(np.minimum(x, 0))),
    "silu": lambda x: x / (1 + np.exp(-x)),
}


def main() -> None:
    """Measure and print."""
    args = arguments(__doc__ or "", {"agent": "questsim"}, seconds=20, repeats=5)
    torch.set_num_threads(1)
    agent = untrained() if args.agent == "untrained" else load_agent(args.agent)
    report(measure(agent, int(args.seconds * FPS), args.repeats), args.json)


def untrained() -> PolicyAgent:
    """An untrained policy of the size of preset ``cpu``'s student; its springs dominate."""
    body = build_body()
    policy = new_policy(
        PRESETS["cpu"].stages["student"].policy,
        Layout.of(observation_layout(EnvConfig())),
        gains=initial_gains(body.torque_limits, body.damping),
    )
    return PolicyAgent(policy, Needs(), "untrained")


def measure(agent: Agent, steps: int, repeats: int) -> dict[str, float]:
    """Real-time factors of the whole and of its parts, medians over rounds.

    Args:
        agent: the policy that drives the avatar.
        steps: steps of 1/36 s in each round.
        repeats: number of rounds, after one unmeasured round.
    """
    needs = agent.needs
    config = EnvConfig(
        sensors=needs.sensors,
        future_frames=needs.future_frames,
        privileged=needs.privileged,
        body_preset=needs.body_preset,
    )
    sim = BatchSim(clips(), config, num_envs=1)
    agent.bind(sim)
    sim.reset()
    forward = numpy_forward(agent) if isinstance(agent, PolicyAgent) else None
    rounds = [timed_round(agent, sim, steps, forward) for _ in range(repeats + 1)][1:]
    if forward is not None:
        # The comparison is only valid if both compute the same.
        np.testing.assert_allclose(
            forward(sim.observation), agent.act(sim.observation), rtol=0, atol=1e-4
        )
    policy, physics, plain = (statistics.median(times) for times in zip(*rounds, strict=True))
    whole = statistics.median(policy + physics for policy, physics, _ in rounds)
    return {
        "times_real_time": steps / FPS / whole,
        "goal": GOAL,
        "policy_us": 1e6 * policy / steps,
        "observation_and_physics_us": 1e6 * physics / steps,
        "policy_in_numpy_us": 1e6 * plain / steps,
        "times_real_time_with_numpy": steps / FPS / (plain + physics),
    }


def timed_round(
    agent: Agent,
    sim: BatchSim,
    steps: int,
    forward: Callable[[np.ndarray], np.ndarray] | None,
) -> tuple[float, float, float]:
    """Seconds of the policy, of physics and observation, and of the NumPy policy."""
    policy = physics = plain = 0.0
    for _ in range(steps):
        start = time.perf_counter()
        action = agent.act(sim.observation)
        acted = time.perf_counter()
        if forward is not None:
            forward(sim.observation)
        compared = time.perf_counter()
        sim.step(action)
        if sim.fell[0] or sim.ended[0]:
            sim.reset()
        policy += acted - start
        plain += compared - acted
        physics += time.perf_counter() - compared
    return policy, physics, plain


def numpy_forward(agent: PolicyAgent) -> Callable[[np.ndarray], np.ndarray]:
    """The policy's arithmetic without PyTorch: actions ``(n, 33)`` of observations ``(n, D)``."""
    actor, head = agent.policy.actor, agent.policy.head
    columns, mean = actor.columns.numpy(), actor.norm.mean.numpy()
    deviation = actor.norm.var.sqrt().clamp_min(MIN_STD).numpy()
    linear = [layer for layer in actor.layers if isinstance(layer, torch.nn.Linear)]
    *hidden, last = [
        (layer.weight.detach().numpy().T.copy(), layer.bias.detach().numpy()) for layer in linear
    ]
    activation = ACTIVATIONS[agent.policy.spec.activation]
    gains = None if head is None else head.log_gain.detach().exp().numpy()

    def forward(obs: np.ndarray) -> np.ndarray:
        x = np.clip((obs[:, columns] - mean) / deviation, -CLIP, CLIP)
        for weight, bias in hidden:
            x = activation(x @ weight + bias)
        x = x @ last[0] + last[1]
        x, push = x[:, :NUM_DOFS], x[:, NUM_DOFS:]
        if head is not None:
            if head.balance is not None:
                # Balance stays in PyTorch: it has no weights to multiply by.
                with torch.no_grad():
                    terms = head.balance.terms(torch.from_numpy(obs))
                    asked = PUSH_SCALE * torch.from_numpy(push) if push.shape[1] else None
                    x = x + head.balance(terms, asked).numpy()
            x -= gains * obs[:, head.joint_columns.numpy()]
            if head.reference_columns is not None:
                x += gains * obs[:, head.reference_columns.numpy()]
            if head.torque_columns is not None:
                x += obs[:, head.torque_columns.numpy()]
        return np.clip(x, -1.0, 1.0)

    return forward


if __name__ == "__main__":
    sys.exit(guarded(main))
