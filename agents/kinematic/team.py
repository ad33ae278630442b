"""Ray workers that share the batches of a kinematic system's training.

The command's process and each worker compute the gradient of a part of the batch and average them;
then all make the same step. A worker that dies is replaced: the command's process has the state
before the step, and a worker's random numbers depend only on the seed, its number and the step.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from agents.kinematic.data import MotionBank
from agents.kinematic.learning import Learning, Task
from agents.kinematic.registry import AGENTS
from agents.run_folder import versions
from agents.training.peers import (
    ALONE,
    Meeting,
    PeerLostError,
    Peers,
    join,
    packed,
    unpacked,
)
from agents.training.ray_session import (
    check_head,
    check_room,
    check_versions,
    first_error,
    meeting_file,
    own_host,
)
from questsim.errors import InputError
from questsim.motion.motion import Motion

ATTEMPTS = 5
"""Attempts per gradient step before the training gives up."""
PROGRAM_BYTES, FRAME_BYTES = 500_000_000, 4_000
"""Memory of a worker without motions, and of each of their frames at 60 Hz."""


class Descent:
    """Gradient steps of a task.

    Args:
        module: all networks of the system.
        task: batches and loss.
        learning: optimiser and limit of the gradient.
    """

    def __init__(self, module: nn.Module, task: Task, learning: Learning) -> None:
        self.module, self.task, self.learning = module, task, learning
        kind = {"adam": torch.optim.Adam, "adamw": torch.optim.AdamW}[learning.optimiser]
        self.optimiser = kind(task.trained, lr=learning.learning_rate)

    def gradients(self, rng: np.random.Generator) -> tuple[Tensor, dict[str, float]]:
        """Draw a batch and compute its gradients; returns its loss and figures to log."""
        self.module.train()
        self.optimiser.zero_grad(set_to_none=True)
        loss, figures = self.task.loss(self.task.draw(rng))
        loss.backward()
        return loss.detach(), figures

    def average(self, loss: Tensor, peers: Peers) -> Tensor:
        """Average loss and gradients over all workers; returns the loss."""
        mean = peers.mean(loss)
        peers.average_gradients(self.task.trained)
        return mean

    def step(self, rate: float) -> None:
        """Make a step along the gradients."""
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        if self.learning.clip is not None:
            nn.utils.clip_grad_norm_(self.task.trained, self.learning.clip)
        self.optimiser.step()

    def packed(self) -> bytes:
        """The state of networks and optimiser."""
        state = {"module": self.module.state_dict(), "optimiser": self.optimiser.state_dict()}
        return packed(state)

    def load(self, given: bytes) -> None:
        """Take over the state from ``packed``."""
        state = unpacked(given)
        self.module.load_state_dict(state["module"])
        self.optimiser.load_state_dict(state["optimiser"])


class Team(Protocol):
    """The other workers of a stage.

    Attributes:
        count: all processes that share the batches, with the command's own.
    """

    count: int

    def begin(self, descent: Descent, rate: float, step: int) -> None:
        """Let them begin a gradient step."""
        ...

    def average(self, descent: Descent, loss: Tensor) -> Tensor:
        """Average the gradients with theirs; returns the mean loss."""
        ...

    def sync(self, descent: Descent) -> None:
        """Give them the state of networks and optimiser."""
        ...


class Nobody:
    """``Team`` of a training without workers."""

    count = 1

    def begin(self, descent: Descent, rate: float, step: int) -> None:
        """Does nothing."""

    def average(self, descent: Descent, loss: Tensor) -> Tensor:
        """Return the loss."""
        return loss

    def sync(self, descent: Descent) -> None:
        """Does nothing."""


@dataclass(frozen=True)
class SharedStage:
    """What a worker needs of a stage.

    Attributes:
        agent, spec: the system.
        name, learning: of the stage; its batch is that of one worker.
        validation: number of fixed windows.
        seed: of the stage.
        threads: of the networks.
        motions, held: to learn, and held out.
    """

    agent: str
    spec: Any
    name: str
    learning: Learning
    validation: int
    seed: int
    threads: int
    motions: Sequence[Motion]
    held: Sequence[Motion]

    @property
    def memory(self) -> int:
        """Bytes that a worker needs, at most."""
        frames = sum(m.duration * 60.0 for m in (*self.motions, *self.held))
        return PROGRAM_BYTES + int(frames * FRAME_BYTES)


class GradientWorker:
    """One of the other workers."""

    def __init__(self, stage: SharedStage, rank: int) -> None:
        torch.set_num_threads(stage.threads)
        torch.manual_seed(stage.seed)
        entry, learning = AGENTS[stage.agent], stage.learning
        module = entry.build(stage.spec)
        bank = MotionBank(stage.motions, learning.window, stage.held, learning.kind_power)
        task = entry.task(module, stage.name, learning, bank, stage.validation)
        self._descent = Descent(module, task, learning)
        self._seed, self._rank, self._peers = stage.seed, rank, ALONE

    def versions(self) -> dict[str, str]:
        """Versions of the libraries."""
        return versions()

    def pid(self) -> int:
        """Process id."""
        return os.getpid()

    def load(self, given: bytes) -> None:
        """See ``Descent.load``."""
        self._descent.load(given)

    def join(self, address: tuple[str, int], count: int) -> None:
        """Connect to the others."""
        (self._peers,) = join(address, own_host(), self._rank, count, 1)

    def step(self, rate: float, number: int) -> None:
        """One gradient step, in step with the others."""
        rng = np.random.default_rng([self._seed, self._rank, number])
        torch.manual_seed(int(rng.integers(2**62)))
        try:
            loss, _ = self._descent.gradients(rng)
            loss = self._descent.average(loss, self._peers)
        except BaseException:
            self._peers = ALONE  # closes the connections: the others must not wait
            raise
        if bool(torch.isfinite(loss)):  # else the command's process ends the training
            self._descent.step(rate)


class RayTeam:
    """``Team`` on Ray.

    Args:
        stage: of a worker.
        count: number of all workers, with the command's process.

    Raises:
        InputError: the cluster has too little room, or a node has other versions.
    """

    def __init__(self, stage: SharedStage, count: int) -> None:
        import ray

        check_room(count - 1, stage.threads, stage.memory)
        self._ray, self.count = ray, count
        self._kind = ray.remote(num_cpus=stage.threads, memory=stage.memory)(GradientWorker)
        self._stage = ray.put(stage)
        self._actors: list[Any] = self._make()
        self._check()
        self._peers: Peers | None = None  # until the workers are connected
        self._running: list[Any] = []
        self._next = 0.0, 0

    def _make(self) -> list[Any]:
        return [self._kind.remote(self._stage, rank) for rank in range(1, self.count)]

    def _check(self) -> None:
        found = first_error([actor.versions.remote() for actor in self._actors])
        for number, each in enumerate(found, 1):
            check_versions(each, versions(), f"worker {number}")

    def sync(self, descent: Descent) -> None:
        """Give them the state of networks and optimiser."""
        state = self._ray.put(descent.packed())
        for actor in self._actors:
            actor.load.remote(state)

    def begin(self, descent: Descent, rate: float, step: int) -> None:
        """Let them begin a gradient step."""
        try:
            first_error(self._running)
        except PeerLostError:  # after it had sent its gradient of the step before
            self._replace_all()
        self._next, self._running = (rate, step), []
        with suppress(PeerLostError):  # ``average`` tries again
            self._start(descent)

    def average(self, descent: Descent, loss: Tensor) -> Tensor:
        """Average the gradients with theirs; returns the mean loss."""
        for _ in range(ATTEMPTS):
            try:
                if not self._running:
                    self._start(descent)
                assert self._peers is not None
                return descent.average(loss, self._peers)
            except PeerLostError:
                check_head()
                with suppress(PeerLostError):
                    first_error(self._running)  # raises the fault of one that ended by itself
                self._replace_all()
        fix = "see Ray's logs; a worker may need more memory than its node has"
        raise InputError(f"died {ATTEMPTS} times in one step", "a worker", fix)

    def _replace_all(self) -> None:
        self.close()
        self._actors, self._running, self._peers = self._make(), [], None

    def _start(self, descent: Descent) -> None:
        if self._peers is None:
            self._check()  # of replaced workers, too: a node that joined may have other versions
            self.sync(descent)
            self._connect()
        self._running = [actor.step.remote(*self._next) for actor in self._actors]

    def _connect(self) -> None:
        with meeting_file() as file:
            meeting = Meeting(file, own_host())
            calls = [actor.join.remote(meeting.address, self.count) for actor in self._actors]
            (self._peers,) = join(meeting.address, own_host(), 0, self.count, 1, meeting)
            first_error(calls)

    def close(self) -> None:
        """Stop the workers."""
        for actor in self._actors:
            self._ray.kill(actor)


def part_of(learning: Learning, count: int) -> Learning:
    """The settings of one of ``count`` workers.

    Raises:
        InputError: the batch cannot be shared out equally.
    """
    if learning.batch % count:
        raise InputError(
            f"a batch of {learning.batch} cannot be divided equally among {count}",
            "--workers",
            f"take a divisor of {learning.batch}, or change stages.NAME.batch with --set",
        )
    return replace(learning, batch=learning.batch // count)
