"""All training settings by preset: ``paper`` (as published), ``cpu`` (two cores), ``smoke``."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from agents.policy.spec import SPARSE_BLOCKS, TRACKER_BLOCKS, PolicySpec
from agents.training.dagger import DaggerConfig
from questsim.errors import within
from questsim.reward import PAPER_REWARD, RewardConfig


@dataclass(frozen=True)
class PPOConfig:
    """Settings of PPO.

    Attributes:
        rollout_steps: steps of every environment between updates.
        epochs, minibatch: passes over a rollout, and samples per gradient step.
        gamma, gae_lambda: discount per step, and lambda of advantage estimation.
        clip: clipping range of the probability ratio.
        learning_rate: of the actor; with ``desired_kl`` only the start value.
        critic_learning_rate: of the critic; None for the actor's.
        desired_kl: target KL divergence of an update; None for a fixed learning rate.
        final_kl: value to which ``desired_kl`` falls over the budget; None keeps it.
        max_grad_norm: largest gradient norm of the actor and of the critic.
        reward_scale: factor on rewards, so that values are of order one.
        noise_legs_and_trunk, noise_arms_and_neck: start values of the exploration noise.
        learn_noise: whether the noise is trained.
        bfloat16: whether training uses bfloat16 matrix products if the processor supports them;
            otherwise float32.
        critic_warmup_steps: environment steps in which only the critic learns.
    """

    rollout_steps: int = 16
    epochs: int = 4
    minibatch: int = 1024
    gamma: float = 0.97
    gae_lambda: float = 0.95
    clip: float = 0.2
    learning_rate: float = 3e-4
    critic_learning_rate: float | None = 1e-3
    desired_kl: float | None = 0.03
    final_kl: float | None = None
    max_grad_norm: float = 0.5
    reward_scale: float = 0.2
    noise_legs_and_trunk: float = 0.12
    noise_arms_and_neck: float = 0.04
    learn_noise: bool = True
    bfloat16: bool = True
    critic_warmup_steps: int = 0

    def __post_init__(self) -> None:
        within("PPO", 0.0, 1.0, gamma=self.gamma, gae_lambda=self.gae_lambda, clip=self.clip)
        within("PPO", 0.0, 1.0, learning_rate=self.learning_rate)
        within("PPO", 0.0, 1.0, critic_learning_rate=self.critic_learning_rate)
        within("PPO", 0.0, 10.0, desired_kl=self.desired_kl, final_kl=self.final_kl)
        within("PPO", 0.0, 1e6, max_grad_norm=self.max_grad_norm, reward_scale=self.reward_scale)
        legs, arms = self.noise_legs_and_trunk, self.noise_arms_and_neck
        within("PPO", 1e-9, 10.0, noise_legs_and_trunk=legs, noise_arms_and_neck=arms)


@dataclass(frozen=True)
class StageConfig:
    """One stage of a training.

    Attributes:
        share: share of the whole time budget.
        policy: networks and head.
        learning: settings of PPO or DAgger.
        steps: largest number of environment steps; None for no limit.
        evaluate_every: environment steps between evaluations on the fixed set.
        reward: reward of the environment.
        sampling: of clips and first frames: ``uniform``, ``failure`` (those that end in falls more
            often) or ``kind`` (as ``failure``, and rare kinds of motion more often).
        max_error_m: mean link error at which training episodes end early, to save simulation.
            Evaluations always allow 0.5 m.
        keep_checkpoints: whether every evaluated policy is kept, for ``questsim average``.
    """

    share: float
    policy: PolicySpec
    learning: PPOConfig | DaggerConfig
    steps: int | None = None
    evaluate_every: int = 400_000
    reward: RewardConfig = field(default_factory=RewardConfig)
    sampling: str = "failure"
    max_error_m: float = 0.5
    keep_checkpoints: bool = False

    def __post_init__(self) -> None:
        within("a stage", 0.0, 1.0, share=self.share)


@dataclass(frozen=True)
class Preset:
    """A whole training.

    Attributes:
        minutes: default time budget; None for none.
        num_envs: number of parallel simulations.
        body_preset: see ``questsim.body``.
        stages: by name, in order: ``teacher``, ``student``, ``finetune``, or ``ppo`` alone.
        validation_clips: number of training clips in the fixed evaluation set.
        expect: what to expect, and when; printed at the start.
    """

    minutes: float | None
    num_envs: int
    stages: dict[str, StageConfig]
    body_preset: str = "default"
    validation_clips: int = 48
    expect: str = ""

    def __post_init__(self) -> None:
        within("a preset", 0.0, 1e6, minutes=self.minutes)


TEACHER = PolicySpec(
    actor_blocks=TRACKER_BLOCKS,
    critic_blocks=TRACKER_BLOCKS,
    activation="elu",
    reference_head=True,
    balance="steps",
)
STUDENT = PolicySpec(
    actor_blocks=SPARSE_BLOCKS,
    critic_blocks=(),
    hidden=(512, 400, 300),
    activation="elu",
    balance="feet",
)
SHOWN_ESTIMATES = replace(TEACHER, critic_blocks=())
"""A student that follows the estimates of kinematic systems; as large as a teacher."""
# The critic is used only in training, so it may observe what the actor cannot.
FINETUNED = replace(STUDENT, critic_blocks=(*SPARSE_BLOCKS, "privileged"))

TRACKING_REWARD = RewardConfig(
    joint_angles=0.2,
    joint_velocities=0.1,
    link_positions=0.3,
    link_velocities=0.1,
    contact=0.0,
    link_orientations=0.3,
    k_link_positions=60.0,
)
"""Teacher reward. Sharper kernels than the paper's penalise errors well before they cause a fall.

Link positions weigh more than in the paper, and link orientations are scored. There is no contact
term: early in training it mostly measures exploration noise."""

CPU = Preset(
    minutes=45.0,
    num_envs=256,
    expect=(
        "the teacher follows people on the spot from the start, most embedded walks after 0.3 M "
        "steps (2 minutes on two idle cores), recorded walking, turning and running after about "
        "4 M (15 minutes); the student learns it afterwards; see docs/tutorial.md"
    ),
    stages={
        "teacher": StageConfig(
            share=0.75,
            policy=TEACHER,
            learning=PPOConfig(
                gae_lambda=0.9,
                desired_kl=0.08,
                final_kl=0.015,
                noise_legs_and_trunk=0.08,
                noise_arms_and_neck=0.03,
                critic_warmup_steps=20_000,
            ),
            reward=TRACKING_REWARD,
            max_error_m=0.2,
        ),
        "student": StageConfig(
            share=0.25,
            policy=STUDENT,
            learning=DaggerConfig(),
            evaluate_every=200_000,
            max_error_m=0.3,
        ),
        # Not in the default budget: `--stage finetune` trains a finished student further.
        "finetune": StageConfig(
            share=0.0,
            policy=FINETUNED,
            learning=PPOConfig(
                desired_kl=0.01,
                learning_rate=5e-5,
                noise_legs_and_trunk=0.05,
                noise_arms_and_neck=0.02,
                critic_warmup_steps=200_000,
            ),
        ),
    },
)

PAPER = Preset(
    minutes=None,
    num_envs=4000,
    expect="as published, 14,000 M steps, a month at 5,000 a second; preset cpu learns to walk",
    body_preset="paper",
    stages={
        "ppo": StageConfig(
            share=1.0,
            policy=PolicySpec(torque_head=False),
            learning=PPOConfig(
                rollout_steps=15,
                epochs=5,
                minibatch=15_000,
                learning_rate=1e-4,
                critic_learning_rate=None,
                desired_kl=None,
                max_grad_norm=1.0,
                reward_scale=1.0,
                noise_legs_and_trunk=0.03,
                noise_arms_and_neck=0.03,
                learn_noise=False,
            ),
            steps=14_000_000_000,
            evaluate_every=6_000_000,
            reward=PAPER_REWARD,
            sampling="uniform",
        )
    },
)
"""As published (QuestSim, sections 3 and 4): one stage, sparse observations, plain torques."""

SMOKE = Preset(
    minutes=1.8,
    num_envs=64,
    expect="a test that everything works; it learns to stay on the spot, not to walk",
    validation_clips=8,
    stages={
        "teacher": StageConfig(
            share=0.6,
            policy=replace(TEACHER, hidden=(128, 128)),
            # Few samples an update: small steps, or noise undoes what the head does.
            learning=PPOConfig(
                minibatch=256,
                desired_kl=0.01,
                noise_legs_and_trunk=0.08,
                noise_arms_and_neck=0.03,
                critic_warmup_steps=8_000,
            ),
            steps=80_000,
            evaluate_every=40_000,
        ),
        "student": StageConfig(
            share=0.4,
            policy=replace(STUDENT, hidden=(128, 128)),
            learning=DaggerConfig(minibatch=512, capacity=60_000, mix_steps=20_000),
            steps=50_000,
            evaluate_every=25_000,
        ),
    },
)
"""A two-minute test that training works; the policy learns little."""


PRESETS: dict[str, Preset] = {"cpu": CPU, "paper": PAPER, "smoke": SMOKE}


def preset_of(name: str, estimates: bool = False) -> Preset:
    """A preset's settings, which ``--set`` may change.

    Args:
        name: of ``PRESETS``.
        estimates: whether the policy observes estimates instead of the true motion. Then student
            and finetune train a tracker with a teacher's networks; the reward, also a teacher's,
            scores the true motion.
    """
    preset = PRESETS[name]
    if not estimates:
        return preset
    changes: dict[str, dict[str, Any]] = {
        "student": {"policy": SHOWN_ESTIMATES},
        "finetune": {"policy": TEACHER, "reward": TRACKING_REWARD},
    }
    stages = {
        stage: replace(config, **changes.get(stage, {})) for stage, config in preset.stages.items()
    }
    return replace(preset, stages=stages)
