"""A batch of avatars spread over Ray actors; each plays whole rollouts for a single learner.

Per update, a worker receives the policy's weights once and returns one rollout together with its
state. If a worker dies, its replacement starts from that state and plays the same rollout again,
bit for bit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor

from agents.evaluation.mapping import JobT, ResultT
from agents.policy.networks import TorquePolicy
from agents.run_folder import versions
from agents.training.buffers import TensorRolloutBuffer
from agents.training.players import AfterStep, Truncated
from agents.training.ray_session import (
    check_head,
    check_room,
    check_versions,
    head_answers,
    result,
)
from agents.training.rollout_worker import (
    ROLLOUT,
    BatchSpec,
    Played,
    RolloutWorker,
    weights_of,
)
from agents.training.workers import Workers
from envs.avatar import avatar_of
from envs.sb3 import QuestVecEnv
from questsim.errors import InputError
from questsim.motion.clip import Clip

SEED_STEP = 1_000_003
"""Seed difference between workers; the first has the seed of a training without workers."""
ATTEMPTS = 5
"""Attempts per worker and rollout before the training gives up."""


class ActorPool(VecEnv):
    """All workers behind the interface of a single batch, as learners and checkpoints expect.

    The pool cannot be stepped: ``policy_player`` and ``student_player`` play whole rollouts.

    Args:
        batch: the whole batch; each worker gets an equal part.
        count: number of workers.

    Raises:
        InputError: the avatars cannot be divided equally, or a worker has other versions.
    """

    worker: type[RolloutWorker] = RolloutWorker

    def __init__(self, batch: BatchSpec, count: int) -> None:
        import ray

        if batch.num_envs % count:
            raise InputError(
                f"{batch.num_envs} environments cannot be divided equally among {count} workers",
                "--workers",
                f"take a multiple of {count}, as in --envs {count * -(-batch.num_envs // count)}",
            )
        self._ray = ray
        self._part = batch.num_envs // count
        self._batch = replace(batch, num_envs=self._part)
        check_room(count, batch.threads, self._batch.memory)
        self._shared = ray.put(self._batch)
        self._change: tuple[Any, int] | None = None
        self._new: dict[int, Any] = {}  # versions of workers that were replaced
        self._actors: list[Any] = [self._make(k) for k in range(count)]
        self._states: list[dict[str, Any] | None] = [None] * count
        self._ready: list[tuple[str, tuple[Any, ...]]] = []
        self._episodes: list[tuple[np.ndarray, ...]] = []
        about = self._all(lambda actor: actor.call.remote("describe"))
        for number, found in enumerate(about):
            check_versions(found["versions"], versions(), f"worker {number}")
        self.layout: dict[str, slice] = about[0]["layout"]
        self.torque_limits: np.ndarray = about[0]["torque_limits"]
        self.damping: np.ndarray = about[0]["damping"]
        self.render_mode, self.config = None, batch.config
        self.avatar = avatar_of(batch.config.body)
        self.reward_names: tuple[str, ...] = about[0]["reward_names"]
        self.reward_terms = np.zeros((batch.num_envs, len(self.reward_names)))
        self.unstable_count = 0
        self.bytes_a_rollout = 0
        super().__init__(
            batch.num_envs,
            gym.spaces.Box(-np.inf, np.inf, (about[0]["size"],), np.float32),
            gym.spaces.Box(-1.0, 1.0, (len(self.avatar.dofs),), np.float32),
        )

    def _make(self, k: int) -> Any:
        actor = _actor(self._ray, self._batch, self.worker)
        return actor.remote(self._shared, self._batch.seed + SEED_STEP * k)

    @property
    def count(self) -> int:
        """Number of workers."""
        return len(self._actors)

    def _all(self, call: Callable[[Any], Any]) -> list[Any]:
        """Results of a call to every worker, in the workers' order."""
        references = [call(actor) for actor in self._actors]
        return [self._result(k, ref, call) for k, ref in enumerate(references)]

    def _result(self, k: int, reference: Any, call: Callable[[Any], Any]) -> Any:
        from ray import exceptions as errors

        for _ in range(ATTEMPTS):
            try:
                return result(reference)
            except (errors.RayActorError, errors.ObjectLostError, errors.OwnerDiedError):
                check_head()  # without it Ray would wait for ever for a new worker
                self._replace(k)
                reference = call(self._actors[k])
        fix = "see Ray's logs; a worker may need more memory than its node has (fewer --envs)"
        raise InputError(f"died {ATTEMPTS} times in one rollout", f"worker {k}", fix)

    def _replace(self, k: int) -> None:
        """Replace a dead or unreachable worker by a new one in its last known state."""
        self._ray.kill(self._actors[k])  # one that is only unreachable would keep its cores
        self._actors[k] = self._make(k)
        self._prepare(k)

    def _prepare(self, k: int) -> None:
        """Bring a new worker into the state after the last rollout."""
        actor = self._actors[k]
        self._new[k] = actor.call.remote("versions")
        for method, args in self._ready:
            actor.call.remote(method, *args)
        if self._states[k] is not None:
            actor.call.remote("set_state", self._states[k])
        if self._change is not None:
            self._send_change(k)

    def change_clips(self, clips: Sequence[Clip], seed: int) -> None:
        """Replace the clips of all workers; the next rollout begins new episodes."""
        self._change = self._ray.put(list(clips)), seed
        self._batch = replace(self._batch, clips=clips)
        self._episodes = []  # they are of the clips before
        for k in range(self.count):
            self._send_change(k)

    def _send_change(self, k: int) -> None:
        assert self._change is not None
        clips, seed = self._change
        self._actors[k].call.remote("change_clips", clips, seed + SEED_STEP * k)

    def get_ready(self, method: str, *args: Any) -> None:
        """Call a worker's ``learn_...`` on all workers and on every later replacement."""
        self._ready = [(method, tuple(self._ray.put(arg) for arg in args))]
        self._all(lambda actor: actor.call.remote(method, *self._ready[0][1]))
        for k, state in enumerate(self._states):
            if state is not None:
                self._actors[k].call.remote("set_state", state)

    def play(
        self, policy: TorquePolicy, steps: int, share: float, after: AfterStep
    ) -> list[Played]:
        """One rollout of every worker; ``after`` is called as for one stepped batch."""
        weights, episodes = self._ray.put(weights_of(policy)), self._ray.put(self._episodes)
        played: list[Played] = self._all(
            lambda actor: actor.call.remote("play", weights, episodes, steps, share)
        )
        self._take(played, steps, after)
        return played

    def _take(self, played: list[Played], steps: int, after: AfterStep) -> None:
        """Keep the states after a rollout and report its steps."""
        while self._new:  # a node that joined may have others
            number, found = self._new.popitem()
            check_versions(result(found), versions(), f"worker {number}")
        self._states = [part.state for part in played]
        if self._change is not None:  # from now on replaced workers begin with these clips
            self._change, self._shared = None, self._ray.put(self._batch)
        self._episodes = [ended for part in played for ended in part.episodes]
        self.unstable_count = sum(part.unstable for part in played)
        self.bytes_a_rollout = sum(a.nbytes for part in played for a in part.arrays.values())
        for t in range(steps):
            infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
            for k, part in enumerate(played):
                for i, info in part.ended[t]:
                    infos[k * self._part + i] = info
            self.reward_terms = np.concatenate([part.terms[t] for part in played])
            rewards = np.concatenate([part.rewards[t] for part in played])
            after(rewards, np.concatenate([part.dones[t] for part in played]), infos)

    def map(self, function: Callable[[JobT], ResultT], jobs: Iterable[JobT]) -> Iterator[ResultT]:
        """Like ``map``; the workers, which must be idle, take the jobs in turn."""
        shared, waiting = self._ray.put(function), deque[tuple[int, Any, JobT]]()

        def next_result() -> ResultT:
            k, reference, job = waiting.popleft()
            return self._result(k, reference, lambda a: a.call.remote("apply", shared, job))

        for number, job in enumerate(jobs):
            if len(waiting) == 2 * self.count:
                yield next_result()
            k = number % self.count
            waiting.append((k, self._actors[k].call.remote("apply", shared, job), job))
        while waiting:
            yield next_result()

    def cpu_seconds(self) -> float:
        """CPU time of all workers so far."""
        return sum(self._all(lambda actor: actor.call.remote("cpu_seconds")))

    def policy_player(self, seed: int, workers: Workers) -> RemotePolicyPlayer:
        """Player of a policy's rollouts; workers have their own seeds and threads."""
        return RemotePolicyPlayer(self)

    def student_player(
        self, teacher: TorquePolicy, student: TorquePolicy, exploration: float
    ) -> RemoteStudentPlayer:
        """Player of a student's rollouts."""
        return RemoteStudentPlayer(self, teacher, student, exploration)

    def get_state(self) -> dict[str, Any]:
        """The state of every worker, and the episodes that are not yet shared between workers."""
        states = self._states
        if any(state is None for state in states):
            states = self._all(lambda actor: actor.call.remote("get_state"))
        return {"workers": states, "episodes": [list(ended) for ended in self._episodes]}

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore a state from ``get_state`` with the same number of workers."""
        self._states = list(state["workers"])
        self._episodes = [tuple(np.asarray(a) for a in e) for e in state["episodes"]]
        for actor, part in zip(self._actors, self._states, strict=True):
            actor.call.remote("set_state", part)

    def close(self) -> None:
        """Stop the workers."""
        if head_answers():
            for actor in self._actors:
                self._ray.kill(actor)
        self._actors = []

    # Required by VecEnv; a learner with workers never steps the pool.

    def reset(self) -> np.ndarray:
        """Not available."""
        raise NotImplementedError("workers play whole rollouts")

    def step_async(self, actions: np.ndarray) -> None:
        """Not available."""
        raise NotImplementedError("workers play whole rollouts")

    def step_wait(self) -> Any:
        """Not available."""
        raise NotImplementedError("workers play whole rollouts")

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The pool's attribute, repeated for each requested environment."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Not available."""
        raise NotImplementedError("workers play whole rollouts")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> Any:
        """Not available."""
        raise NotImplementedError("workers play whole rollouts")

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper], indices: Any = None) -> list[bool]:
        """Return False for every environment: none is wrapped."""
        return [False for _ in self._get_indices(indices)]


def with_rates_of(saved: dict[str, Any], env: QuestVecEnv | ActorPool) -> dict[str, Any]:
    """The state of ``env``, with the failure rates from the saved state of another environment.

    Args:
        saved: state saved with another number of workers, or without workers.
        env: the environment in which the training continues.
    """
    rates = saved["workers"][0]["sampler"] if "workers" in saved else saved["sampler"]
    state = env.get_state()
    if not isinstance(env, ActorPool):
        return state | {"sampler": rates}
    workers = [
        part | {"sampler": rates, "env": part["env"] | {"sampler": rates}}
        for part in state["workers"]
    ]
    return {"workers": workers, "episodes": saved.get("episodes", [])}


class RemotePolicyPlayer:
    """``PolicyPlayer`` on the workers of a pool."""

    def __init__(self, pool: ActorPool) -> None:
        self._pool, self._ready = pool, False
        self.observation: np.ndarray | None = None

    def play(
        self, policy: TorquePolicy, buffer: TensorRolloutBuffer, after: AfterStep
    ) -> Truncated | None:
        """See ``PolicyPlayer.play``; rollouts of workers cannot be stopped early."""
        if not self._ready:
            self._pool.get_ready("learn_policy", policy)
            self._ready = True
        return self._filled(self._pool.play(policy, len(buffer.rewards), 0.0, after), buffer)

    def _filled(self, played: list[Played], buffer: TensorRolloutBuffer) -> Truncated:
        """Copy the workers' parts of a rollout into the buffer."""
        width = buffer.rewards.shape[1] // len(played)
        truncated: Truncated = []
        for k, part in enumerate(played):
            columns = slice(k * width, (k + 1) * width)
            for name in ROLLOUT:
                getattr(buffer, name)[:, columns] = torch.as_tensor(np.array(part.arrays[name]))
            truncated += [(t, k * width + i, last) for t, i, last in part.truncated]
        self.observation = np.concatenate([part.observation for part in played])
        return sorted(truncated, key=lambda entry: entry[:2])

    def get_state(self) -> dict[str, Any]:
        """Empty: the pool saves the state."""
        return {}

    def set_state(self, state: dict[str, Any]) -> None:
        """Does nothing: the pool restores the state."""


class RemoteStudentPlayer:
    """``StudentPlayer`` on the workers of a pool."""

    def __init__(
        self, pool: ActorPool, teacher: TorquePolicy, student: TorquePolicy, exploration: float
    ) -> None:
        self._pool, self._student = pool, student
        self._args = (teacher, student, exploration)
        self._ready = False

    def play(self, steps: int, teacher_share: float, after: AfterStep) -> tuple[Tensor, Tensor]:
        """See ``StudentPlayer.play``."""
        if not self._ready:
            self._pool.get_ready("learn_student", *self._args)
            self._ready = True
        played = self._pool.play(self._student, steps, teacher_share, after)
        return tuple(  # type: ignore[return-value]
            torch.cat([torch.as_tensor(np.array(part.arrays[name])) for part in played])
            for name in ("visited", "labels")
        )

    def get_state(self) -> dict[str, Any]:
        """Empty: the pool saves the state."""
        return {}

    def set_state(self, state: dict[str, Any]) -> None:
        """Does nothing: the pool restores the state."""


def _actor(ray: Any, batch: BatchSpec, kind: type[RolloutWorker]) -> Any:
    """A worker's class as a Ray actor that reserves the cores and memory of a batch."""

    class Worker:
        def __init__(self, batch: BatchSpec, seed: int) -> None:
            self.worker = kind(replace(batch, seed=seed))

        def call(self, method: str, *args: Any) -> Any:
            return getattr(self.worker, method)(*args)

    return ray.remote(num_cpus=batch.threads, memory=batch.memory)(Worker)
