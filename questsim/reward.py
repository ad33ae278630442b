"""QuestSim's reward: four imitation kernels and a contact term.

r = w . [r(q), r(qdot), r(x), r(xdot), r_f] with r(s) = exp(-k_s * error), QuestSim section 3.
The published error is a sum of squares; as k = 40 only makes sense for a mean (0.1 rad a joint,
summed over 33, would already give exp(-13)), errors here are means over joints or links.
Each term is a pure function over a batch; the environments' compiled kernel computes the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

TERMS: tuple[str, ...] = (
    "joint_angles",
    "joint_velocities",
    "link_positions",
    "link_velocities",
    "contact",
    "link_orientations",
)
"""The reward's terms, in the order of every array of terms and of the weights."""


@dataclass(frozen=True)
class RewardConfig:
    """Weights ``w`` and kernel widths ``k`` of the terms.

    The weights and the kernels of angles, positions and contact are QuestSim's. Its velocity
    kernels, 0.3 and 2, see nothing but good tracking: joints that are off by 3 rad/s already earn
    exp(-2.7). The defaults are softer, so that a beginner too is told what is better. The
    orientations of the links, in the world, are no term of QuestSim's and have no weight by
    default: they tell a teacher that it turns or leans before its links are far off.
    """

    joint_angles: float = 0.4
    joint_velocities: float = 0.1
    link_positions: float = 0.2
    link_velocities: float = 0.1
    contact: float = 0.2
    link_orientations: float = 0.0
    k_joint_angles: float = 40.0
    k_joint_velocities: float = 0.03
    k_link_positions: float = 6.0
    k_link_velocities: float = 0.5
    k_contact: float = 0.01
    k_link_orientations: float = 10.0

    @property
    def weights(self) -> np.ndarray:
        """``(6,)`` in the order of ``TERMS``."""
        return np.array([getattr(self, term) for term in TERMS])

    @property
    def kernels(self) -> np.ndarray:
        """``(6,)`` in the order of ``TERMS``."""
        return np.array([getattr(self, f"k_{term}") for term in TERMS])


PAPER_REWARD = RewardConfig(k_joint_velocities=0.3, k_link_velocities=2.0)
"""The published kernels, on means over joints and links."""


def tracking(simulated: np.ndarray, reference: np.ndarray, k: float) -> np.ndarray:
    """exp(-k * mean square difference) ``(n,)`` of joint values ``(n, 33)``.

    For r(q) in rad and r(qdot) in rad/s; QuestSim section 3.
    """
    return np.exp(-k * np.mean((simulated - reference) ** 2, axis=-1))


def link_tracking(simulated: np.ndarray, reference: np.ndarray, k: float) -> np.ndarray:
    """exp(-k * mean over links of the squared distance) ``(n,)`` of vectors ``(n, 16, 3)``.

    For r(x) in m and r(xdot) in m/s; QuestSim section 3.
    """
    squared = np.sum((simulated - reference) ** 2, axis=-1)
    return np.exp(-k * np.mean(squared, axis=-1))


def turn_tracking(simulated: np.ndarray, reference: np.ndarray, k: float) -> np.ndarray:
    """exp(-k * mean over links of the squared angle) ``(n,)`` of quaternions ``(n, 16, 4)``.

    The angle in rad is that of the one rotation between the two, as in DeepMimic's pose reward
    (Peng et al. 2018, eq. 6), here in the world.
    """
    dot = np.abs(np.sum(simulated * reference, axis=-1))
    angle = 2.0 * np.arccos(np.minimum(dot, 1.0))
    return np.exp(-k * np.mean(angle**2, axis=-1))


def unloading(previous: np.ndarray, force: np.ndarray, k: float) -> np.ndarray:
    """exp(-k * sum over feet of max(0, f_prev - f)) ``(n,)`` of vertical forces ``(n, 2)`` in N.

    Penalises feet that leave the floor abruptly; QuestSim section 3.
    """
    return np.exp(-k * np.sum(np.maximum(0.0, previous - force), axis=-1))
