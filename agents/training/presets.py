"""Every number of a training, by preset: what was published, what two cores learn, a smoke test."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from agents.policy.spec import SPARSE_BLOCKS, TRACKER_BLOCKS, PolicySpec
from agents.training.dagger import DaggerConfig
from questsim.reward import PAPER_REWARD, RewardConfig


@dataclass(frozen=True)
class PPOConfig:
    """How a policy learns from its reward.

    Attributes:
        rollout_steps: steps of every environment between updates.
        epochs, minibatch: passes over a rollout, and samples a gradient step.
        gamma, gae_lambda: discount a step, and of advantage estimation.
        clip: of the probability ratio.
        learning_rate: of the actor; with ``desired_kl`` only its start.
        critic_learning_rate: of the critic; None for the actor's.
        desired_kl: KL divergence that an update should come to; None for a fixed learning rate.
        final_kl: what it falls to over the budget; None keeps it.
        max_grad_norm: of the actor's and of the critic's gradient.
        reward_scale: factor on rewards, so that values are of order one.
        noise_legs_and_trunk, noise_arms_and_neck: start values of the exploration noise.
        learn_noise: whether the noise is trained.
        bfloat16: precision of matrix products while training, where the processor has it; float32
            otherwise.
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


@dataclass(frozen=True)
class StageConfig:
    """One stage of a training.

    Attributes:
        share: of the whole time budget.
        policy: networks and head.
        learning: by reward (PPO) or from a teacher (DAgger).
        steps: environment steps after which it ends even if there is time; None for no limit.
        evaluate_every: environment steps between evaluations on the fixed set.
        reward: of the environment.
        sampling: ``uniform`` or ``failure``.
        max_error_m: mean link error at which its episodes end; what comes after is no longer
            worth the simulation. Evaluations always allow 0.5 m.
    """

    share: float
    policy: PolicySpec
    learning: PPOConfig | DaggerConfig
    steps: int | None = None
    evaluate_every: int = 400_000
    reward: RewardConfig = field(default_factory=RewardConfig)
    sampling: str = "failure"
    max_error_m: float = 0.5

    @property
    def privileged(self) -> bool:
        """Whether its environment must show the reference."""
        needs_teacher = isinstance(self.learning, DaggerConfig)
        return needs_teacher or "privileged" in self.policy.actor_blocks + self.policy.critic_blocks


@dataclass(frozen=True)
class Preset:
    """A whole training.

    Attributes:
        minutes: default time budget; None for none.
        num_envs: simulations in the batch.
        body_preset: see ``questsim.body``.
        stages: by name, in order: ``teacher``, ``student``, ``finetune``, or ``ppo`` alone.
        validation_clips: how many training clips make up the fixed evaluation set.
        expect: what to expect of it when, for the line at its start.
    """

    minutes: float | None
    num_envs: int
    stages: dict[str, StageConfig]
    body_preset: str = "default"
    validation_clips: int = 48
    expect: str = ""


TEACHER = PolicySpec(
    actor_blocks=TRACKER_BLOCKS,
    critic_blocks=TRACKER_BLOCKS,
    activation="elu",
    reference_head=True,
    balance="reference",
)
STUDENT = PolicySpec(
    actor_blocks=SPARSE_BLOCKS,
    critic_blocks=(),
    hidden=(512, 400, 300),
    activation="elu",
    balance="feet",
)
SHOWN_ESTIMATES = replace(TEACHER, critic_blocks=())
"""A student that follows what kinematic systems make of the devices; as large as a teacher."""
# The critic is thrown away after training, so it may see what the actor must guess.
FINETUNED = PolicySpec(
    actor_blocks=SPARSE_BLOCKS,
    critic_blocks=(*SPARSE_BLOCKS, "privileged"),
    hidden=STUDENT.hidden,
    activation="elu",
    balance="feet",
)

TRACKING_REWARD = RewardConfig(
    joint_angles=0.2,
    joint_velocities=0.1,
    link_positions=0.3,
    link_velocities=0.1,
    contact=0.0,
    link_orientations=0.3,
    k_link_positions=60.0,
)
"""A teacher's reward: what is off is told at once, long before the fall that it leads to.

Places weigh more than published, and links may not turn or lean. The contact term is left out: to
a beginner it is mostly the noise of its own exploration."""

CPU = Preset(
    minutes=45.0,
    num_envs=256,
    expect=(
        "people on the spot are followed from the start, walking, turning and running after about "
        "4 M steps of the teacher (13 minutes on two idle cores); see docs/training.md"
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
        # Outside of the default budget: `--stage finetune` adds it to a finished student.
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
            policy=PolicySpec(
                actor_blocks=TRACKER_BLOCKS,
                critic_blocks=TRACKER_BLOCKS,
                hidden=(128, 128),
                activation="elu",
                reference_head=True,
                balance="reference",
            ),
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
            policy=PolicySpec(
                critic_blocks=(), hidden=(128, 128), activation="elu", balance="feet"
            ),
            learning=DaggerConfig(minibatch=512, capacity=60_000, mix_steps=20_000),
            steps=50_000,
            evaluate_every=25_000,
        ),
    },
)
"""Whether everything works, in two minutes: it learns little."""


def shown_estimates(name: str, stage: StageConfig) -> StageConfig:
    """A stage of that name for a tracker that sees estimates in place of what the user did.

    Its networks are a teacher's, and so is its reward, which is of what the user did.
    """
    if name == "finetune":
        return replace(stage, policy=TEACHER, reward=TRACKING_REWARD)
    return replace(stage, policy=SHOWN_ESTIMATES)


PRESETS: dict[str, Preset] = {"cpu": CPU, "paper": PAPER, "smoke": SMOKE}
