"""``info`` of the environments: data of a step besides observation and reward."""

from __future__ import annotations

from typing import Any

import numpy as np

from envs.core import BatchSim


def info_arrays(sim: BatchSim, fresh: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """The info that ``QuestEnv`` documents, for all simulations, as new arrays ``(n, ...)``.

    Args:
        sim: after a step or a reset.
        fresh: ``(n,)`` bool, simulations that have just begun an episode: their reward terms,
            error and fall in ``sim`` still belong to the previous episode.
    """
    clip = sim.clip
    infos: dict[str, np.ndarray] = {
        **{term: sim.reward_terms[:, i].copy() for i, term in enumerate(sim.reward_names)},
        "error_m": sim.error.copy(),
        "fell": sim.fell.copy(),
    }
    if fresh is not None:
        for values in infos.values():
            values[fresh] = 0
    return infos | {
        "clip": clip.copy(),
        "frame": sim.frame - sim.reference.start[clip],
        "floor_m": sim.floor.copy(),
        "push_n": sim.pusher.force.copy(),
        "foot_force_n": sim.contact_force.copy(),
        "object_pose": sim.objects.pose.copy(),
        "object_force_n": sim.objects.force.copy(),
    }


def info_of(sim: BatchSim, fresh: bool) -> dict[str, Any]:
    """The info of a batch of one: numbers and arrays without the batch axis."""
    arrays = info_arrays(sim, np.ones(1, bool) if fresh else None)
    return {
        name: values[0] if values.ndim > 1 else values.tolist()[0]
        for name, values in arrays.items()
    }


def masked(infos: dict[str, Any], mask: np.ndarray) -> dict[str, Any]:
    """Infos in the form of gymnasium's vector environments: ``_name`` is the mask of ``name``."""
    return infos | {f"_{name}": mask.copy() for name in infos}
