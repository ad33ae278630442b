"""Teachers asked instead of the general one: for kinds of motion, or clips they follow better."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from agents.agent import Needs
from agents.evaluation.follow import evaluation_sim, follow, from_first_frames
from agents.policy.checkpoint import find_policy, find_teacher, load_policy, needs_of
from agents.policy.policy_agent import PolicyAgent
from agents.resolve import from_anywhere, policy_folder
from envs import QuestVecEnv
from envs.config import EnvConfig
from questsim.errors import InputError
from questsim.motion.clip import Clip, source_kind
from questsim.sensors import sensor_set

if TYPE_CHECKING:
    from agents.training.cluster import ActorPool
    from agents.training.options import TrainArgs

OPTION = "--specialists"
BATCH = 256
"""Clips that are followed at a time to find the best teacher of each."""


@dataclass(frozen=True)
class Specialist:
    """A teacher, and patterns of the kinds of motion for which it is asked.

    Without patterns it is asked for the clips that it follows better than the others do.
    """

    where: Path
    kinds: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.where}:{'+'.join(self.kinds)}" if self.kinds else str(self.where)


def read_specialist(text: str) -> Specialist:
    """Read ``FOLDER:KIND+KIND`` or ``FOLDER``; kinds may be patterns such as ``side-*``.

    A shipped name may stand for the folder.

    Raises:
        InputError: it is not of this form.
    """
    where, colon, kinds = text.rpartition(":") if ":" in text else (text, "", "")
    patterns = tuple(kind.strip() for kind in kinds.split("+")) if colon else ()
    if not where or not all(patterns):
        fix = "write FOLDER, or FOLDER:KIND+KIND, e.g. runs/steps:side-*"
        raise InputError(f"is {text!r}", OPTION, fix)
    return Specialist(from_anywhere(Path(where)) or Path(where), patterns)


def load_teacher(where: Path, env: QuestVecEnv | ActorPool, option: str) -> PolicyAgent:
    """A teacher that acts in ``env``: it observes the reference, or devices of the user.

    Args:
        where: a run, stage or policy folder.
        env: the training environment.
        option: the command's option, for messages.

    Raises:
        InputError: there is no such policy, or it does not fit ``env``.
    """
    agent = load_policy(find_teacher(where))
    needs, config = agent.needs, env.config
    devices, found = (needs.sensors, needs.future_frames), (config.sensors, config.future_frames)
    if not needs.privileged and devices != found:
        less = set(sensor_set(found[0])) - set(sensor_set(devices[0])) or devices[1] < found[1]
        if less:
            what = f"observes {devices[0]} with {devices[1]} future frames, the student "
            fix = "give a teacher that observes at least what its student does"
            raise InputError(f"{what}{found[0]} with {found[1]}", f"{option} {where}", fix)
        if devices != config.teacher_devices:
            raise InputError(
                f"observes {devices[0]} with {devices[1]} future frames, neither the student's "
                "devices nor those of the first teacher",
                f"{option} {where}",
                "give teachers of the same devices",
            )
        agent = _OfOtherDevices(agent.policy, needs, agent.name, agent.card)
    agent.bind(env)
    return agent


class _OfOtherDevices(PolicyAgent):
    """A teacher that observes other devices, or more future frames, than its student."""

    def blocks(self, layout: dict[str, slice]) -> dict[str, slice]:
        return {**layout, "o_user": layout["o_teacher"]}

    def devices(self, config: EnvConfig) -> tuple[str, int]:
        assert config.teacher_devices is not None
        return config.teacher_devices


def check_teachers(args: TrainArgs, names: Sequence[str]) -> None:
    """Check that the policies a stage builds on exist, before the motions are loaded.

    They are a student's teachers, and the student of fine-tuning.

    Args:
        args: options of the training.
        names: of the stages to train.

    Raises:
        InputError: there is no such policy.
    """
    if names == ["finetune"] and args.start is None:
        find_policy(args.out / "student")
    if names == ["student"]:
        needs_of_teachers(args)
    elif "student" in names:  # its general teacher is trained before
        for text in args.specialists:
            needs_of(find_teacher(read_specialist(text).where))


def needs_of_teachers(args: TrainArgs) -> list[Needs]:
    """What a student's teachers observe.

    Raises:
        InputError: there is no such teacher.
    """
    folders = [read_specialist(text).where for text in args.specialists]
    if args.teacher is not None:
        folders.insert(0, args.teacher)
    elif policy_folder(args.out / "teacher") is None:
        fix = "give --teacher, or train one there with --stage teacher"
        raise InputError("has no teacher of its own", f"--stage student in {args.out}", fix)
    needs = [needs_of(find_teacher(folder)) for folder in folders]
    # Without --teacher it is the run's own.
    return needs if args.teacher is not None else [*needs, Needs(privileged=True)]


def _fits(kind: str, pattern: str) -> bool:
    """Whether a pattern is for clips of a kind, or for those that they vary."""
    return fnmatchcase(kind, pattern) or fnmatchcase(source_kind(kind), pattern)


def check_kinds(patterns: Sequence[Sequence[str]], clips: Sequence[Clip]) -> None:
    """Check that each pattern fits a kind of the clips.

    Args:
        patterns: those of each specialist.
        clips: to learn from, without variations that a training adds.

    Raises:
        InputError: one fits none.
    """
    _check_patterns(patterns, [clip.kind for clip in clips])


def _check_patterns(patterns: Sequence[Sequence[str]], kinds: Iterable[str]) -> None:
    known = sorted(set(kinds))
    for pattern in chain.from_iterable(patterns):
        if not any(_fits(kind, pattern) for kind in known):
            names = ", ".join(kind for kind in known if kind) or "none"
            raise InputError(f"no clip is of a kind {pattern!r}", OPTION, f"there is {names}")


class Teachers:
    """Labels each avatar's state by the teacher of its clip.

    Args:
        general: the teacher of all clips without a specialist.
        specialists: agents with the patterns of their kinds, which also fit variations of these;
            the first that fits a kind counts. Of the agents without patterns and the general
            teacher, each clip has the one with the highest mean reward over the clip.
        env: the training environment; its clips may change.
        threads: physics threads of the comparison.

    Raises:
        InputError: a pattern fits no kind of the clips.
    """

    def __init__(
        self,
        general: PolicyAgent,
        specialists: Sequence[tuple[PolicyAgent, tuple[str, ...]]],
        env: QuestVecEnv,
        threads: int = 1,
    ) -> None:
        self._agents = [general, *(agent for agent, _ in specialists)]
        self._kinds = [kinds for _, kinds in specialists]
        self._env, self._threads = env, threads
        self._reference = env.sim.reference
        _check_patterns(self._kinds, self._reference.kinds)
        self._teacher_of_clip = self._assign()

    def clips_of_each(self) -> list[int]:
        """Number of clips of the general teacher and of each specialist."""
        return np.bincount(self._teacher_of_clip, minlength=len(self._agents)).tolist()

    def _assign(self) -> np.ndarray:
        teacher = self._best_of_each_clip()
        for clip, kind in enumerate(self._reference.kinds):
            fits = [any(_fits(kind, p) for p in kinds) for kinds in self._kinds]
            if kind and True in fits:
                teacher[clip] = fits.index(True) + 1
        return teacher

    def _best_of_each_clip(self) -> np.ndarray:
        """Numbers ``(C,)`` of the best agents among the general one and those without kinds."""
        able = [0, *(i + 1 for i, kinds in enumerate(self._kinds) if not kinds)]
        best = np.zeros(len(self._reference.kinds), np.int64)
        if len(able) == 1:
            return best
        clips = self._env.clips
        # On level ground and undisturbed, since every agent would meet other disturbances.
        config = replace(
            from_first_frames(self._env.sim.config),
            starts=None, pushes=None, randomisation=None, terrain=None, objects=(),
        )  # fmt: skip
        # Clips of about the same length, so that few avatars wait for the longest one.
        order = np.argsort([len(clip) for clip in clips], kind="stable")
        for rows in np.split(order, range(BATCH, len(order), BATCH)):
            part = [clips[row] for row in rows]
            sim = evaluation_sim(part, config, self._threads)
            scores = []
            for number in able:
                self._agents[number].bind(sim)
                followed = follow(self._agents[number], sim, part)
                scores.append(followed.total_reward / followed.length)
            sim.close()
            best[rows] = np.array(able)[np.argmax(scores, axis=0)]
        for agent in self._agents:
            agent.bind(self._env)
        return best

    def action_mean(self, observations: Tensor) -> Tensor:
        """Actions ``(n, 33)`` of each avatar's teacher for its observation ``(n, D)``."""
        if self._env.sim.reference is not self._reference:
            self._reference = self._env.sim.reference
            self._teacher_of_clip = self._assign()
        chosen = torch.from_numpy(self._teacher_of_clip[self._env.sim.clip])
        hinges = self._agents[0].policy.log_std.numel()
        labels = observations.new_empty(len(observations), hinges)
        for number, agent in enumerate(self._agents):
            rows = torch.nonzero(chosen == number)[:, 0]
            if len(rows):
                labels[rows] = agent.policy.action_mean(observations[rows])
        return labels
