"""A policy trained by backpropagation through a learned model of the simulator (SuperTrack).

    python -m docs.figures.learned_simulator --motions clips.npz --minutes 40 --out runs/learned

After Fussell, Bergamin & Holden, "SuperTrack: Motion Tracking for Physically Simulated Characters
using Supervised Learning", 2021: a network learns from what the policy did how the 16 links move
(windows of 8 steps), and the policy follows the reference through this network (windows of 16
steps), by the gradient of the links' distance from the reference. Both restart every cycle with new
steps of the simulator. The torque head (``agents/policy/networks.py``) with its values before
training belongs to the simulator here; the policy adds to its torques.

Prints, every ``--every`` minutes, how many of the clips are completed, as the evaluations of a
teacher's training do, and writes them to ``curve.csv``. docs/experiments.md has the result; its
picture is made of ``learned_simulator.csv`` in this folder by ``--picture``.
"""

from __future__ import annotations

import csv
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import tyro
from torch import Tensor, nn

from agents.policy.networks import TorquePolicy
from agents.policy.policy_agent import head_alone
from agents.policy.spec import Layout
from agents.training.presets import TEACHER
from docs.figures.training_curves import read
from envs.config import EnvConfig
from envs.core import BatchSim
from questsim.body import DEFAULT_HEIGHT_M
from questsim.differentiable import heading_matrix, quat_to_matrix
from questsim.errors import InputError
from questsim.motion.clip import FPS, Clip
from questsim.motion.spec import load_motions
from questsim.plots import figure_file

KEPT = Path(__file__).with_suffix(".csv")
DT = 1.0 / FPS
AHEAD = 0.625
"""Share of a step's change of velocity that its positions have: MuJoCo takes 4 substeps."""
WEIGHTS = {"place": 10.0, "axes": 2.0, "velocity": 0.5, "spin": 0.1}
"""Of the mean absolute differences of the links, in m, columns of matrices, m/s and rad/s."""


@dataclass(frozen=True)
class Args:
    """Train a policy through a learned model of the simulator."""

    motions: str = "synthetic"
    """Clips to follow; all of them are also evaluated."""
    out: Path = Path("learned-simulator")
    """Folder of the curve."""
    picture: bool = False
    """Train nothing; draw the kept curves."""
    minutes: float = 40.0
    """Processor time of one core for all of it."""
    every: float = 5.0
    """Minutes between evaluations."""
    envs: int = 256
    """Simulations."""
    steps: int = 32
    """Steps of every simulation in a cycle."""
    updates: int = 20
    """Gradient steps of the model, and of the policy, in a cycle."""
    model_batch: int = 256
    """Windows in a gradient step of the model."""
    policy_batch: int = 128
    """Windows in a gradient step of the policy."""
    model_window: int = 8
    """Steps of a window of the model."""
    policy_window: int = 16
    """Steps of a window of the policy."""
    hidden: int = 512
    """Width of the model's two hidden layers."""
    policy_hidden: tuple[int, ...] = (400, 300, 200)
    """Widths of the policy's hidden layers."""
    model_rate: float = 1e-3
    """Learning rate of the model."""
    policy_rate: float = 5e-4
    """First learning rate of the policy; the last one is a tenth of it."""
    noise: float = 0.08
    """Standard deviation of the noise on the actions, in half of the simulations a quarter."""
    keep: int = 12
    """Cycles whose steps are learnt from."""
    threads: int = 1
    """Threads."""
    seed: int = 0
    """Random seed."""


class Links(NamedTuple):
    """State of the links ``(..., 16, k)`` in the world: place, axes (3 x 3), velocity, spin."""

    place: Tensor
    axes: Tensor
    velocity: Tensor
    spin: Tensor

    def at(self, index) -> Links:
        """The rows of an index over the leading axes."""
        return Links(*(part[index] for part in self))


class Record(NamedTuple):
    """A cycle: states and reference rows before each step ``(T, n, ...)``, and what was done.

    ``whole[t]`` says whether the step from t to t + 1 stayed within an episode.
    """

    links: Links
    row: Tensor
    action: Tensor
    whole: Tensor


def links_of(sim: BatchSim) -> Links:
    """The links of all simulations; their velocities are observed in the frame of the heading."""
    place = torch.tensor(sim.link_positions, dtype=torch.float32)
    axes = quat_to_matrix(torch.tensor(sim.link_quats, dtype=torch.float32))
    seen = torch.as_tensor(sim.observation)
    velocity, spin = (
        seen[:, sim.layout[f"link_{name}_velocities"]].unflatten(1, (16, 3))
        @ heading_matrix(axes[:, 0]).mT
        for name in ("linear", "angular")
    )
    return Links(place, axes, velocity, spin)


class Reference:
    """The reference's links, angles and torques of all rows, as tensors."""

    def __init__(self, sim: BatchSim) -> None:
        own = sim.reference
        self.links = Links(
            torch.as_tensor(own.position),
            quat_to_matrix(torch.as_tensor(own.quat)),
            torch.as_tensor(own.velocity),
            torch.as_tensor(own.angular_velocity),
        )
        self.angles = torch.as_tensor(own.qpos[:, 7:])
        self.torque = torch.as_tensor(own.torque)
        last = np.zeros(len(own.qpos), np.int64)
        for start, end in zip(own.start, own.end, strict=True):
            last[start:end] = end - 1
        self.last = torch.as_tensor(last)

    def next(self, row: Tensor) -> Tensor:
        """The rows after these, within the clip."""
        return torch.minimum(row + 1, self.last[row])


def inputs_of(now: Links, row: Tensor, reference: Reference) -> Tensor:
    """Links and the next reference in the frame of the root's heading, ``(m, 546)``."""
    after = reference.next(row)
    goal = reference.links.at(after)
    heading = heading_matrix(now.axes[:, 0])
    origin = now.place[:, :1] * torch.tensor([1.0, 1.0, 0.0])

    def turned(vectors: Tensor) -> Tensor:
        return (vectors @ heading).flatten(1)

    def columns(axes: Tensor) -> Tensor:
        return (heading.mT[:, None] @ axes[..., :2]).flatten(1)

    middle = 0.5 * (reference.angles[row] + reference.angles[after])
    torque = 0.5 * (reference.torque[row] + reference.torque[after])
    return torch.cat(
        [
            turned(now.place - origin), columns(now.axes), turned(now.velocity), turned(now.spin),
            turned(goal.place - now.place), columns(goal.axes),
            turned(goal.velocity), turned(goal.spin), middle, torque,
        ],
        dim=1,
    )  # fmt: skip


def network(inputs: int, hidden: Sequence[int], outputs: int) -> nn.Sequential:
    """Layers with ELU between them; the last one begins at zero."""
    sizes = [inputs, *hidden]
    layers: list[nn.Module] = []
    for before, after in zip(sizes, hidden, strict=False):
        layers += [nn.Linear(before, after), nn.ELU()]
    last = nn.Linear(sizes[-1], outputs)
    nn.init.zeros_(last.weight)
    nn.init.zeros_(last.bias)
    return nn.Sequential(*layers, last)


class Normal(nn.Module):
    """A network of inputs with mean 0 and deviation 1 over the first cycle, in bfloat16."""

    mean: Tensor
    scale: Tensor

    def __init__(self, layers: nn.Sequential, sample: Tensor) -> None:
        super().__init__()
        self.layers = layers
        self.register_buffer("mean", sample.mean(0))
        self.register_buffer("scale", sample.std(0) + 0.02)

    def forward(self, values: Tensor, *more: Tensor) -> Tensor:
        """Outputs for values ``(m, k)``, and for more inputs that are not normalised."""
        normal = ((values - self.mean) / self.scale).clamp(-6.0, 6.0)
        with torch.autocast("cpu", torch.bfloat16):
            return self.layers(torch.cat([normal, *more], 1)).float()


class Model(nn.Module):
    """Predicts how the links' velocities change within a step, and from it their next state."""

    push: Tensor
    twist: Tensor

    def __init__(self, hidden: int, sample: Tensor, changes: tuple[Tensor, Tensor]) -> None:
        super().__init__()
        size = sample.shape[1] + 33
        self.layers = Normal(network(size, (hidden, hidden), 96), sample)
        self.register_buffer("push", changes[0].std())
        self.register_buffer("twist", changes[1].std())

    def forward(self, now: Links, values: Tensor, action: Tensor) -> Links:
        """The links a step later, of the result of ``inputs_of`` and an action ``(m, 33)``."""
        out = self.layers(values, 5.0 * action).unflatten(1, (2, 16, 3))
        heading = heading_matrix(now.axes[:, 0])
        push = self.push * out[:, 0] @ heading.mT
        twist = self.twist * out[:, 1] @ heading.mT
        return Links(
            now.place + DT * (now.velocity + AHEAD * push),
            rotation(DT * (now.spin + AHEAD * twist)) @ now.axes,
            now.velocity + push,
            now.spin + twist,
        )


def rotation(vector: Tensor) -> Tensor:
    """Matrices ``(..., 3, 3)`` of rotation vectors (Rodrigues' formula)."""
    angle = vector.square().sum(-1).add(1e-8).sqrt()[..., None, None]
    zero = torch.zeros_like(vector[..., 0])
    x, y, z = vector.unbind(-1)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))
    return (
        torch.eye(3) + angle.sin() / angle * cross
        + (1.0 - angle.cos()) / angle.square() * (cross @ cross)
    )  # fmt: skip


def apart(a: Links, b: Links) -> Tensor:
    """Weighted mean absolute difference ``(m,)``."""
    total = torch.zeros(())
    for name, weight in WEIGHTS.items():
        total = total + weight * (getattr(a, name) - getattr(b, name)).abs().flatten(1).mean(1)
    return total


class Windows:
    """Windows of the last cycles."""

    def __init__(self, records: Sequence[Record], length: int) -> None:
        self._records = records
        self._starts = []
        for k, record in enumerate(records):
            whole = record.whole.long().cumsum(0)
            whole = torch.cat([torch.zeros_like(whole[:1]), whole])
            found = (whole[length:] - whole[:-length] == length).nonzero()
            self._starts.append(torch.cat([torch.full((len(found), 1), k), found], 1))
        self._starts = torch.cat(self._starts)
        self._length = length

    def draw(self, count: int) -> list[Record]:
        """The ``length + 1`` moments of ``count`` windows, one after another."""
        chosen = self._starts[torch.randint(len(self._starts), (count,))]
        parts: list[list[Record]] = []
        for k in chosen[:, 0].unique():
            _, step, env = chosen[chosen[:, 0] == k].unbind(1)
            record = self._records[k]
            parts.append(
                [
                    Record(record.links.at((step + i, env)), record.row[step + i, env],
                           record.action[step + i, env], record.whole[:0])
                    for i in range(self._length + 1)
                ]
            )  # fmt: skip
        return [
            Record(
                Links(
                    *(torch.cat(p) for p in zip(*(part[i].links for part in parts), strict=True))
                ),
                torch.cat([part[i].row for part in parts]),
                torch.cat([part[i].action for part in parts]),
                parts[0][i].whole,
            )
            for i in range(self._length + 1)
        ]


class Player:
    """Plays the head with the policy's addition in the simulator."""

    def __init__(self, clips: Sequence[Clip], args: Args) -> None:
        config = EnvConfig(
            privileged=True, sampling="failure", max_error_m=0.3,
            heights=(DEFAULT_HEIGHT_M, DEFAULT_HEIGHT_M),
        )  # fmt: skip
        self.sim = BatchSim(clips, config, args.envs, args.seed, args.threads)
        fixed = replace(config, fixed_start=True, max_error_m=0.5)
        self.judge = BatchSim(clips, fixed, None, args.seed, args.threads)
        self.head: TorquePolicy = head_alone(
            replace(TEACHER, critic_blocks=(), hidden=(8,)), Layout.of(self.sim.layout)
        )
        self.reference = Reference(self.sim)
        self.judged = Reference(self.judge)
        if not np.allclose(self.sim.placement.place, (0.0, 0.0, 1.0, 0.0)):
            raise RuntimeError("the clips are not where the reference has them")
        self.sim.reset()

    def _torques(self, sim: BatchSim, addition: Tensor | float) -> np.ndarray:
        own = torch.as_tensor(self.head.predict_batch(np.ascontiguousarray(sim.observation)))
        return (own + addition).clamp(-1.0, 1.0).numpy().astype(np.float32)

    @torch.no_grad()
    def cycle(self, policy: nn.Module | None, steps: int, noise: float) -> Record:
        """Play ``steps`` steps; without a policy, the head and noise alone."""
        sim = self.sim
        spread = torch.where(torch.arange(sim.num_envs) % 2 == 0, noise, noise / 4)[:, None]
        rows: list[tuple[Links, Tensor, Tensor, Tensor]] = []
        for _ in range(steps):
            now, row = links_of(sim), torch.as_tensor(sim.frame).clone()
            mean = 0.0 if policy is None else policy(inputs_of(now, row, self.reference))
            action = mean + spread * torch.randn(sim.num_envs, 33)
            sim.step(self._torques(sim, action))
            done = sim.fell | sim.ended
            rows.append((now, row, action, torch.as_tensor(~done)))
            if done.any():
                ids = np.flatnonzero(done)
                sim.record_ended(ids)
                sim.reset(ids)
        links = Links(*(torch.stack(p) for p in zip(*(r[0] for r in rows), strict=True)))
        whole = torch.stack([r[3] for r in rows])
        whole[-1] = False  # the state after the last step is not kept
        return Record(
            links, torch.stack([r[1] for r in rows]), torch.stack([r[2] for r in rows]), whole
        )

    @torch.no_grad()
    def tracked(self, policy: nn.Module | None) -> tuple[float, float]:
        """Percent of the clips that are completed, and the mean link error in cm until then."""
        sim = self.judge
        sim.reset()
        active, fell = np.ones(sim.num_envs, bool), np.zeros(sim.num_envs, bool)
        error, frames = 0.0, 0
        while active.any():
            values = inputs_of(links_of(sim), torch.as_tensor(sim.frame), self.judged)
            sim.step(self._torques(sim, 0.0 if policy is None else policy(values)))
            error += float(sim.error[active].sum())
            frames += int(active.sum())
            fell |= active & sim.fell
            active &= ~(sim.fell | sim.ended)
        return 100.0 * float(1.0 - fell.mean()), 100.0 * error / frames


def draw() -> None:
    """Draw the kept curves: clips completed and link errors, by minutes on one core."""
    curves = read(KEPT)
    names = {"ppo": "PPO, on the simulator", "model": "gradient through a learned model"}
    columns = {
        "tracked_percent": "clips completed, %", "link_error_cm": "link error until the fall, cm"
    }  # fmt: skip
    with figure_file(KEPT.parents[1] / "images" / "learned-simulator.png", 9.0, 3.4) as figure:
        for axis, (column, label) in zip(figure.subplots(1, 2), columns.items(), strict=True):
            for curve, name in names.items():
                points = [(float(row["minutes"]), float(row[column])) for row in curves[curve]]
                axis.plot(*zip(*points, strict=True), "o-", ms=3, label=name)
            axis.set(xlabel="minutes on one core", ylabel=label)
            axis.set_ylim(bottom=0)
            axis.grid(alpha=0.3)
            axis.legend()


def main(args: Args) -> None:
    """Train, and print the curve."""
    if args.picture:
        if args != Args(picture=True):
            raise InputError("trains nothing", "--picture", "give it without other options")
        draw()
        return
    torch.set_num_threads(args.threads)
    torch.manual_seed(args.seed)
    clips = load_motions(args.motions)
    began = time.process_time()
    player = Player(clips, args)
    records: deque[Record] = deque(maxlen=args.keep)
    records.append(player.cycle(None, args.steps, args.noise))
    model, policy = _networks(player, records[0], args)
    learn_model = torch.optim.Adam(model.parameters(), args.model_rate)
    learn_policy = torch.optim.Adam(policy.parameters(), args.policy_rate)
    args.out.mkdir(parents=True, exist_ok=True)
    rows, steps, shown, losses = [], args.envs * args.steps, -1.0, (0.0, 0.0)
    while True:
        minutes = (time.process_time() - began) / 60.0
        if minutes >= shown + args.every or minutes >= args.minutes or shown < 0:
            shown = minutes
            tracked, error = player.tracked(policy)
            rows.append((round(minutes, 2), steps, round(tracked, 1), round(error, 2), *losses))
            print(
                f"{minutes:.1f} min, {steps / 1e6:.2f} M steps: tracked {tracked:.0f} %, "
                f"link error {error:.1f} cm; model {losses[0]:.3f}, policy {losses[1]:.3f}",
                flush=True,
            )
            with (args.out / "curve.csv").open("w", newline="") as file:
                names = ("minutes", "steps", "tracked_percent", "error_cm", "model", "policy")
                csv.writer(file).writerows([names, *rows])
        if minutes >= args.minutes:
            return
        rate = args.policy_rate * (1.0 - 0.9 * minutes / args.minutes)
        for group in learn_policy.param_groups:
            group["lr"] = rate
        losses = (
            _fit_model(model, learn_model, Windows(records, args.model_window), player, args),
            _fit_policy(policy, model, learn_policy, Windows(records, 1), player, args),
        )
        records.append(player.cycle(policy, args.steps, args.noise))
        steps += args.envs * args.steps


def _networks(player: Player, record: Record, args: Args) -> tuple[Model, Normal]:
    links = record.links.at(slice(None, -1))
    flat = Links(*(part.flatten(0, 1) for part in links))
    sample = inputs_of(flat, record.row[:-1].flatten(), player.reference)
    inside = record.whole[:-1]
    push = (record.links.velocity[1:] - record.links.velocity[:-1])[inside]
    twist = (record.links.spin[1:] - record.links.spin[:-1])[inside]
    policy = Normal(network(sample.shape[1], args.policy_hidden, 33), sample)
    return Model(args.hidden, sample, (push, twist)), policy


def _fit_model(model, optimiser, windows: Windows, player: Player, args: Args) -> float:
    total = 0.0
    for _ in range(args.updates):
        moments = windows.draw(args.model_batch)
        now, loss = moments[0].links, torch.zeros(())
        for before, after in pairwise(moments):
            values = inputs_of(now, before.row, player.reference)
            now = model(now, values, before.action)
            loss = loss + apart(now, after.links).clamp_max(20.0).mean() / args.model_window
        _descend(loss, model, optimiser)
        total += float(loss.detach())
    return total / args.updates


def _fit_policy(policy, model, optimiser, windows: Windows, player: Player, args: Args) -> float:
    model.requires_grad_(False)
    total = 0.0
    for _ in range(args.updates):
        first = windows.draw(args.policy_batch)[0]
        now, row, loss = first.links, first.row, torch.zeros(())
        for _ in range(args.policy_window):
            values = inputs_of(now, row, player.reference)
            action = policy(values)
            now = model(now, values, action)
            row = player.reference.next(row)
            goal = player.reference.links.at(row)
            loss = loss + (apart(now, goal).clamp_max(20.0).mean() + action.square().mean()) / (
                args.policy_window
            )
        _descend(loss, policy, optimiser)
        total += float(loss.detach())
    model.requires_grad_(True)
    return total / args.updates


def _descend(loss: Tensor, network: nn.Module, optimiser: torch.optim.Optimizer) -> None:
    optimiser.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(network.parameters(), 1.0)
    optimiser.step()


if __name__ == "__main__":
    main(tyro.cli(Args))
