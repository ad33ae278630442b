"""Surroundings of the avatars of a batch: ground, pushes, objects, and device errors."""

from __future__ import annotations

from typing import Any

import numpy as np
from mujoco import batch as mujoco_batch

from envs.avatar import avatar_of
from envs.config import EnvConfig
from envs.device_faults import DeviceFaults, SignalFaults
from envs.episode_random import EpisodeRandom, Seeds
from envs.footed_clip import footed_clip, joined
from envs.object_places import Objects
from envs.placement import Placement
from envs.pushes import Pusher
from envs.reference import Reference
from envs.starts import Beginnings
from questsim.motion.clip import Clip


class Surroundings:
    """Everything that differs between episodes, except body and clip.

    Args:
        config: options of the task.
        reference: the clips.
        ratio: ``(n,)`` height of each simulation's body over 1.75 m.
        batch: of models with the config's objects.
        seed: random seed.

    Attributes:
        placement: where each clip is played on the terrain; its ``field`` is the ground.
        pusher: forces on the avatars.
        objects: poses of the objects, and the avatar's force on each.
        signals: latency and dropout of each device.
        faults: noise and mounting errors of the devices, and recentring.
        starts: initial states of episodes.
    """

    def __init__(
        self,
        config: EnvConfig,
        reference: Reference,
        ratio: np.ndarray,
        batch: mujoco_batch.Batch,
        seed: int,
    ) -> None:
        names, fixed, bind = reference.names, config.fixed_start, batch.bind
        self._reference, self._ratio = reference, ratio
        self._body, avatar = config.body, avatar_of(config.body)
        self.placement = Placement(reference, config.terrain, ratio, seed, fixed)
        self.pusher = Pusher(
            config.pushes,
            EpisodeRandom(names, len(ratio), seed, 2, fixed),
            bind("xfrc_applied"),
            avatar,
        )
        self.objects = Objects(
            config.objects,
            EpisodeRandom(names, len(ratio), seed, 3, fixed),
            bind("qpos"),
            bind("qvel"),
            bind("sensordata"),
            avatar.base_m,
        )
        devices = reference.dev_position.shape[1]
        self.signals = SignalFaults(config.randomisation, len(ratio), devices, seed)
        self.faults = DeviceFaults(
            config.randomisation,
            EpisodeRandom(names, len(ratio), seed, 5, fixed),
            len(ratio),
            devices,
            seed,
        )
        self._offset = config.frame_offsets[-1]
        self.starts = Beginnings(
            config.starts,
            EpisodeRandom(names, len(ratio), seed, 4, fixed),
            avatar,
            avatar.base_m * ratio,
        )

    def begin(self, ids: np.ndarray, rows: np.ndarray, clips: np.ndarray) -> None:
        """Begin episodes ``ids`` at ``rows`` of ``clips``; their places are already drawn."""
        self.pusher.begin(ids, clips)
        self.objects.place(ids, rows, clips, self._reference, self.placement, self._ratio)
        self.signals.begin(ids, rows + self._offset - self.signals.late[ids])
        self.faults.begin(ids, clips)

    def placed_clip(self, i: int, clip: Clip, first: int) -> Clip:
        """The clip that simulation ``i`` plays, at its place, feet adapted to the ground there.

        Args:
            i: the simulation.
            clip: on the body of its user.
            first: frame of the clip in which the episode began.
        """
        field, faults = self.placement.field, self.faults
        body = self._body
        placed = footed_clip(clip, self.placement.place[i], field, body)
        if not faults.jumped[i]:
            return placed
        # The frame of the jump still belongs to the old place.
        after = int(first + faults.jump[i]) + 1
        return joined(footed_clip(clip, faults.before[i], field, body), placed, after)

    def _parts(self) -> dict[str, Any]:
        return {
            "placement": self.placement,
            "pusher": self.pusher,
            "objects": self.objects,
            "signals": self.signals,
            "faults": self.faults,
            "starts": self.starts,
        }

    def seed(self, seeds: Seeds) -> None:
        """Seed the random streams of places, pushes, objects, starts and devices."""
        for part in self._parts().values():
            part.seed(seeds)

    def get_state(self) -> dict[str, Any]:
        """State that determines later episodes."""
        return {name: part.get_state() for name, part in self._parts().items()}

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore the result of ``get_state``."""
        for name, part in self._parts().items():
            part.set_state(state[name])
