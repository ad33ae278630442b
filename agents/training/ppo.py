"""PPO on stable-baselines3, with batched value estimates and a KL-adaptive learning rate."""

from __future__ import annotations

from copy import deepcopy
from functools import partial
from typing import Any, Protocol, cast

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor

from agents.policy.networks import TorquePolicy
from agents.training.buffers import Targets, TensorRolloutBuffer
from agents.training.learner import StepObserver, TrainingError
from agents.training.peers import ALONE, Peers
from agents.training.players import AfterStep, PolicyPlayer, Truncated
from agents.training.workers import Workers

LEARNING_RATE_RANGE = (1e-9, 3e-3)
"""A distilled policy can be ten times as sensitive to its weights as a teacher: `questsim` needs a
rate of 1e-7 to 1e-6, and above that its updates end early."""

SPENT = 1.5
"""An update ends when its KL divergence reaches this multiple of the desired one."""


class Player(Protocol):
    """What fills a rollout; see ``PolicyPlayer``."""

    observation: np.ndarray | None

    def play(
        self, policy: TorquePolicy, buffer: TensorRolloutBuffer, after: AfterStep
    ) -> Truncated | None:
        """See ``PolicyPlayer.play``."""
        ...

    def get_state(self) -> dict[str, Any]:
        """What the next rollout depends on."""
        ...

    def set_state(self, state: dict[str, Any]) -> None:
        """Take up what ``get_state`` gave."""
        ...


class AdaptivePPO(PPO):
    """Proximal policy optimisation (Schulman et al. 2017), fast on few cores.

    It differs from stable-baselines3's PPO in these points:

    - Values, also those of truncated episodes, are computed once per rollout in one batch.
    - The rollout stays in torch tensors.
    - The learning rate adapts to the KL divergence of the update (as in rsl_rl). A trial step in
      the first update chooses the initial rate.
    - An update ends early when its KL divergence reaches the limit.
    - The policy's observation normaliser is updated after each update. The first rollout only
      initialises the normaliser.

    Args:
        policy: ``TorquePolicy``, and its ``policy_kwargs``.
        env: a stable-baselines3 VecEnv.
        desired_kl: target KL divergence of an update; None keeps the learning rate fixed.
        final_kl: value to which ``desired_kl`` falls geometrically over the budget; None keeps it.
        reward_scale: factor on rewards; ``1 - gamma`` brings values into the rewards' range.
        bfloat16: whether training computes matrix products in bfloat16.
        threads: parallel threads; the result does not depend on their number.
        **options: those of stable-baselines3's PPO.
    """

    policy: TorquePolicy  # pyright: ignore[reportIncompatibleVariableOverride]
    rollout_buffer: TensorRolloutBuffer  # type: ignore[assignment]

    def __init__(
        self,
        policy: type[TorquePolicy],
        env: VecEnv,
        *,
        desired_kl: float | None = None,
        final_kl: float | None = None,
        reward_scale: float = 1.0,
        bfloat16: bool = False,
        threads: int = 1,
        **options: Any,
    ) -> None:
        self.desired_kl, self.reward_scale = desired_kl, reward_scale
        self._kl_range = desired_kl, final_kl
        self.actor_frozen = False
        super().__init__(
            policy,
            env,
            rollout_buffer_class=TensorRolloutBuffer,  # type: ignore[arg-type]
            device="cpu",
            **options,
        )
        self.policy.use_bfloat16(bfloat16)
        self.actor_rate = float(self.lr_schedule(1))
        self._rate_is_measured = desired_kl is None
        self._observer: _Observer | None = None
        self.generator = torch.Generator().manual_seed(self.seed or 0)
        self._workers = Workers(threads)
        self.actor_peers: Peers = ALONE
        self.critic_peers: Peers = ALONE
        # Workers elsewhere bring a player of their own.
        player = getattr(env, "policy_player", partial(PolicyPlayer, env))
        self.player = cast(Player, player(self.seed or 0, self._workers))

    def collect_rollouts(  # type: ignore[override]
        self,
        env: VecEnv,
        callback: BaseCallback,
        rollout_buffer: TensorRolloutBuffer,
        n_rollout_steps: int,
    ) -> bool:
        """Fill the buffer with ``n_rollout_steps`` of each environment; see SB3."""
        self.policy.set_training_mode(False)
        callback.on_rollout_start()

        def after(rewards: np.ndarray, dones: np.ndarray, infos: list[dict[str, Any]]) -> bool:
            if self.ep_info_buffer is not None:
                self._update_info_buffer([infos[i] for i in np.flatnonzero(dones)])
            self.num_timesteps += env.num_envs
            if not np.isfinite(rewards).all():
                raise TrainingError("the reward is not finite", self.num_timesteps)
            callback.update_locals(locals())
            return callback.on_step()

        truncated = self.player.play(self.policy, rollout_buffer, after)
        if truncated is None:
            return False
        self._estimate_values(truncated)
        callback.on_rollout_end()
        return True

    @torch.no_grad()
    def _estimate_values(self, truncated: list[tuple[int, int, np.ndarray]]) -> None:
        """Values, log probabilities and advantages of the rollout, in few large batches.

        Args:
            truncated: step, environment and last observation of every episode that reached the
                end of its reference without a fall; the critic estimates its remaining return.
        """
        policy, buffer = self.policy, self.rollout_buffer
        buffer.rewards *= self.reward_scale
        shape = buffer.values.shape
        values = self._workers.by_halves(policy.predict_values, buffer.flat_observations())
        buffer.values[:] = values.view(shape)
        log_probs = policy.log_prob(buffer.means.flatten(0, 1), buffer.actions.flatten(0, 1))
        buffer.log_probs[:] = log_probs.view(shape)
        if truncated:
            steps, envs, last = zip(*truncated, strict=True)
            values = policy.predict_values(torch.from_numpy(np.stack(last))).squeeze(1)
            buffer.rewards[list(steps), list(envs)] += self.gamma * values
        assert self.player.observation is not None
        last_values = policy.predict_values(torch.from_numpy(self.player.observation)).squeeze(1)
        buffer.compute_advantages(last_values)

    def train(self) -> None:
        """Update the policy from the rollout, then the normaliser."""
        first = self.policy.actor.norm.count.item() == 0
        if not first:
            self._optimise()
        self.policy.update_norm(self.rollout_buffer.flat_observations(), self.actor_peers.each)

    def _optimise(self) -> None:
        """Train actor and critic on the rollout, each in its own thread.

        They share only read-only data, so on two cores an update takes half the time. Each is
        single-threaded, so the result has the same bits at any number of threads.
        """
        policy, record = self.policy, self.logger.record
        policy.set_training_mode(True)
        targets = self.rollout_buffer.learning_targets(self.actor_peers)
        orders = self.rollout_buffer.orders(self.batch_size, self.n_epochs, self.generator)
        value_loss, figures = self._workers.run(
            partial(self._learn_values, targets, orders),
            partial(self._learn_actions, targets, orders),
        )
        figures = self.actor_peers.mean(torch.tensor(figures, dtype=torch.float64)).tolist()
        self._n_updates += self.n_epochs
        if not self.actor_frozen:
            # Scaled to all steps: those of the next update are as long.
            self._adapt_rate(figures[1] / figures[3])
        names = ("policy_loss", "kl", "clip_fraction", "steps_made")
        for name, figure in zip(names, figures, strict=True):
            record(f"train/{name}", figure)
        value_loss = self.critic_peers.mean(torch.tensor(value_loss, dtype=torch.float64))
        record("train/value_loss", value_loss.item())
        record("train/learning_rate", self.actor_rate)
        record("train/noise", policy.log_std.detach().exp().mean().item())

    def _learn_actions(self, targets: Targets, orders: list[Tensor]) -> tuple[float, ...]:
        """Clipped policy gradient; see ``clipped_gain``.

        Returns:
            Policy loss of all steps; KL divergence and share of clipped ratios of the last epoch;
            share of the steps made before the KL limit ended the update.
        """
        policy, clip = self.policy, float(self.clip_range(1))  # type: ignore[operator]
        if self.actor_frozen:
            return 0.0, 0.0, 0.0, 0.0
        parts = policy.action_inputs(self.rollout_buffer.flat_observations())
        old_log_std = policy.log_std.detach().clone()
        if not self._rate_is_measured:
            self._measure_rate(targets, orders, parts)
        policy.optimizer.param_groups[0]["lr"] = self.actor_rate
        per_epoch = len(orders) // self.n_epochs
        total, recent = torch.zeros(()), []
        for i, rows in enumerate(orders):
            mean = policy.action_mean_of(*(part[rows] for part in parts))
            with torch.no_grad():
                kl = _gaussian_kl(targets.means[rows], old_log_std, mean, policy.log_std)
                kl = self.actor_peers.mean(kl).item()
            if i and self.desired_kl is not None and kl > SPENT * self.desired_kl:
                return total.item() / i, kl, _clipped(recent), i / len(orders)
            loss, clipped = self._surrogate(mean, rows, targets, clip)
            self._descend(loss, policy.optimizer, self.actor_peers)
            total += loss.detach()
            recent = [*recent, (kl, clipped.item())][-per_epoch:]
        kl = sum(kl for kl, _ in recent) / len(recent)
        return total.item() / len(orders), kl, _clipped(recent), 1.0

    def _surrogate(
        self, mean: Tensor, rows: Tensor, targets: Targets, clip: float
    ) -> tuple[Tensor, Tensor]:
        """Loss of a minibatch and its share of clipped ratios."""
        policy = self.policy
        log_ratio = policy.log_prob(mean, targets.actions[rows]) - targets.log_probs[rows]
        ratio = log_ratio.exp()
        loss = -clipped_gain(ratio, targets.advantages[rows], clip).mean()
        if self.ent_coef:
            loss = loss - self.ent_coef * policy.log_std.sum()
        return loss, ((ratio.detach() - 1).abs() > clip).float().mean()

    def _measure_rate(
        self, targets: Targets, orders: list[Tensor], parts: tuple[Tensor, ...]
    ) -> None:
        """Choose the first learning rate by a trial step, which is then undone.

        The KL divergence of a step grows with the square of its length. The steps of an update
        agree partly in direction, so n steps reach between n and n^2 times the divergence of one.
        """
        policy, optimizer = self.policy, self.policy.optimizer
        assert self.desired_kl is not None
        before = [parameter.detach().clone() for parameter in policy.actor_parameters()]
        memory, rows = deepcopy(optimizer.state_dict()), orders[0]
        chosen = tuple(part[rows] for part in parts)
        optimizer.param_groups[0]["lr"] = self.actor_rate
        old = policy.action_mean_of(*chosen)
        old_mean, old_log_std = old.detach(), policy.log_std.detach().clone()
        self._descend(self._surrogate(old, rows, targets, 1.0)[0], optimizer, self.actor_peers)
        with torch.no_grad():
            new = policy.action_mean_of(*chosen)
            kl = _gaussian_kl(old_mean, old_log_std, new, policy.log_std)
            kl = self.actor_peers.mean(kl).item()
            for parameter, value in zip(policy.actor_parameters(), before, strict=True):
                parameter.copy_(value)
        optimizer.load_state_dict(memory)
        aim = self.desired_kl / len(orders) ** 1.5
        longer = float(np.sqrt(aim / max(kl, 1e-12)))
        self.actor_rate = float(np.clip(self.actor_rate * min(longer, 1.0), *LEARNING_RATE_RANGE))
        self._rate_is_measured = True

    def _learn_values(self, targets: Targets, orders: list[Tensor]) -> tuple[float, ...]:
        """Squared error of the values; returns its mean over all steps."""
        policy = self.policy
        critic, optimizer = policy.critic, policy.critic_optimizer
        if critic is None or optimizer is None:
            return (0.0,)
        if policy.settings["critic_learning_rate"] is None:
            optimizer.param_groups[0]["lr"] = self.actor_rate
        inputs = critic.inputs(self.rollout_buffer.flat_observations())
        total = torch.zeros(())
        for rows in orders:
            values = critic.of_inputs(inputs[rows]).squeeze(1)
            loss = (values - targets.returns[rows]).square().mean()
            self._descend(loss, optimizer, self.critic_peers)
            total += loss.detach()
        return (total.item() / len(orders),)

    def _descend(self, loss: Tensor, optimizer: torch.optim.Optimizer, peers: Peers) -> None:
        """One gradient step, along the mean gradient of all workers that share the update.

        Raises:
            TrainingError: the loss is not finite; nothing was changed.
        """
        if not bool(torch.isfinite(loss)):
            raise TrainingError("the loss is not finite", self.num_timesteps)
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        parameters = optimizer.param_groups[0]["params"]
        peers.average_gradients(parameters)
        torch.nn.utils.clip_grad_norm_(parameters, self.max_grad_norm)
        optimizer.step()

    def iterate(self, observe: StepObserver, progress: float) -> dict[str, float]:
        """One rollout and the update after it, outside of ``learn``.

        Args:
            observe: called after every environment step.
            progress: share of the budget that is used, 0 to 1.

        Returns:
            Figures to log.
        """
        if self._observer is None:
            self._logger = Logger(None, [])
            self._observer = _Observer(observe)
            self._observer.init_callback(self)
        self._observer.observe = observe
        first_kl, final_kl = self._kl_range
        if first_kl is not None and final_kl is not None:
            self.desired_kl = first_kl * (final_kl / first_kl) ** min(progress, 1.0)
        assert self.env is not None
        self.collect_rollouts(self.env, self._observer, self.rollout_buffer, self.n_steps)
        self.train()
        return {k: float(v) for k, v in self.logger.name_to_value.items()}

    def begin_anew(self) -> None:
        """Restart all episodes before the next rollout."""
        self.player.observation = None
        self._last_episode_starts = np.ones(self.n_envs, bool)  # type: ignore[assignment]

    def state_dict(self) -> dict[str, Any]:
        """State for resuming, as plain values and tensors."""
        return self.update_state() | {
            "steps": self.num_timesteps,
            "generator": self.generator.get_state(),
            "player": self.player.get_state(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from ``state_dict``."""
        self.num_timesteps = state["steps"]
        self.load_update_state(state)
        self.generator.set_state(state["generator"])
        self.player.set_state(state["player"])

    def update_state(self) -> dict[str, Any]:
        """The part of the state that an update changes, apart from the order of the samples."""
        critic = self.policy.critic_optimizer
        return {
            "policy": self.policy.state_dict(),
            "held": self.policy.held_inputs(),
            "optimizer": self.policy.optimizer.state_dict(),
            "critic_optimizer": critic.state_dict() if critic is not None else {},
            "actor_rate": self.actor_rate,
            "rate_is_measured": self._rate_is_measured,
            "updates": self._n_updates,
        }

    def load_update_state(self, state: dict[str, Any]) -> None:
        """Take over an ``update_state``."""
        self._n_updates = state["updates"]
        self.policy.load_state_dict(state["policy"])
        self.policy.hold_inputs(state.get("held", {}))
        self.policy.optimizer.load_state_dict(state["optimizer"])
        if self.policy.critic_optimizer is not None:
            self.policy.critic_optimizer.load_state_dict(state["critic_optimizer"])
        self.actor_rate = state["actor_rate"]
        self._rate_is_measured = state.get("rate_is_measured", True)

    def _adapt_rate(self, kl: float) -> None:
        """Lower or raise the learning rate if the KL divergence was too large or too small."""
        if self.desired_kl is None or self.actor_frozen:
            return
        if kl > 2.0 * self.desired_kl:
            self.actor_rate /= 2.0
        elif kl > 1.3 * self.desired_kl:
            self.actor_rate /= 1.2
        elif kl < 0.5 * self.desired_kl:
            self.actor_rate *= 2.0
        elif kl < 0.75 * self.desired_kl:
            self.actor_rate *= 1.2
        self.actor_rate = float(np.clip(self.actor_rate, *LEARNING_RATE_RANGE))


class _Observer(BaseCallback):
    """A stable-baselines3 callback that forwards every environment step to ``observe``."""

    def __init__(self, observe: StepObserver) -> None:
        super().__init__()
        self.observe = observe

    def _on_step(self) -> bool:
        self.observe(self.locals["rewards"], self.locals["dones"], self.locals["infos"])
        return True


def clipped_gain(ratio: Tensor, advantages: Tensor, clip: float) -> Tensor:
    """PPO's objective of each sample (Schulman et al. 2017, eq. 7), to be maximised.

    Args:
        ratio: ``(N,)`` probabilities of the actions, divided by those when they were played.
        advantages: ``(N,)``.
        clip: ratios further than this from 1 gain nothing more.
    """
    return torch.minimum(ratio * advantages, ratio.clamp(1 - clip, 1 + clip) * advantages)


def _clipped(recent: list[tuple[float, float]]) -> float:
    return sum(clipped for _, clipped in recent) / max(len(recent), 1)


def _gaussian_kl(mean0: Tensor, log_std0: Tensor, mean1: Tensor, log_std1: Tensor) -> Tensor:
    """Mean KL divergence of diagonal Gaussians 0 from 1 over the batch."""
    var0, var1 = (2 * log_std0).exp(), (2 * log_std1).exp()
    terms = log_std1 - log_std0 + (var0 + (mean0 - mean1).square()) / (2 * var1) - 0.5
    return terms.sum(1).mean()
