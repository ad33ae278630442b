"""What a new policy takes over from an earlier one, decided by the weights that both hold."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from agents.policy.balance import OUTPUTS, Balance
from agents.policy.checkpoint import (
    CARD_FILE,
    CRITIC,
    SAME_PRESET,
    find_policy,
    find_teacher,
    has_critic,
    load_critic,
    load_policy,
)
from agents.policy.networks import TorqueHead, TorquePolicy
from agents.training.fewer_devices import with_devices
from agents.training.options import TrainArgs
from agents.training.presets import PPOConfig, Preset
from questsim.errors import InputError

_HEAD = "head."
_GAINS = ("log_kp", "log_kd", "log_limit")
"""Gains of ``Balance``, relative to its least values."""


def with_networks_of_start(preset: Preset, args: TrainArgs, names: Sequence[str]) -> Preset:
    """The preset, with hidden layers and balance of the policies that its stages start from.

    ``--set stages.STAGE.policy.hidden=...`` and ``...policy.balance=...`` give a stage others.
    Wider layers are filled up, terms that only the new balance has are added. A stage that starts
    from a policy without balance, or with another kind of head, keeps the preset's.

    Args:
        preset: with the values of ``--set``.
        args: options of the training.
        names: of the stages to train.

    Raises:
        InputError: there is no such policy, its files are damaged, or it lacks a device.
    """
    stages = dict(preset.stages)
    for name in names:
        folder = _start_of(name, args)
        if folder is None:
            continue
        agent = load_policy(folder)
        # A teacher may have learnt beside other devices; a resumed stage is compared with its run.
        if name != "teacher" and folder != _last(name, args):
            with_devices(agent, args.sensors, args.future_frames)
        start, policy = agent.policy.spec, stages[name].policy
        if not _is_set(args, f"stages.{name}.policy.hidden"):
            policy = replace(policy, hidden=start.hidden)
        same = start.balance != "none" and start.reference_head == policy.reference_head
        if same and not _is_set(args, f"stages.{name}.policy.balance"):
            policy = replace(policy, balance=start.balance)
        stages[name] = replace(stages[name], policy=policy)
    return replace(preset, stages=stages)


def _is_set(args: TrainArgs, name: str) -> bool:
    return any(text.startswith(f"{name}=") for text in args.set)


def _last(name: str, args: TrainArgs) -> Path:
    """Where a stage keeps the checkpoint with which it resumes."""
    return args.out / name / "last"


def _start_of(name: str, args: TrainArgs) -> Path | None:
    """The checkpoint from which a stage begins, or which it resumes; None for a new policy."""
    last = _last(name, args)
    if args.resume and (last / CARD_FILE).exists():
        return last
    if name == "teacher":
        return None if args.start is None else find_teacher(args.start)
    if name == "finetune":
        student = args.start or args.out / "student"
        return find_policy(student) if args.start or student.is_dir() else None
    if name == "student" and args.stage == "student" and args.start is not None:
        return find_policy(args.start)
    return None


def copy_actor(source: TorquePolicy, target: TorquePolicy, where: Path | str) -> None:
    """Copy the actor, its normaliser, the noise and the head of ``source``, but no critic.

    The normaliser keeps its statistics in the training (``RunningNorm.hold``).

    Terms that only the target's head has keep their start values; so do gains that have another
    meaning there, see ``copy_head``. The actor's outputs for such terms begin at zero. Layers may
    be wider in the target: its actor has the same outputs at first, see ``_grow``.

    Args:
        source, target: policies.
        where: origin of the source, for messages.

    Raises:
        InputError: their networks differ in more than outputs and wider layers.
    """
    state = {
        name: value
        for name, value in source.state_dict().items()
        if not name.startswith((CRITIC, _HEAD))
    }
    _widen(state, source, target)
    _grow(state, target)
    try:
        missing, unexpected = target.load_state_dict(state, strict=False)
        fits = not unexpected and all(name.startswith((CRITIC, _HEAD)) for name in missing)
    except RuntimeError:  # the shapes differ
        fits = False
    if not fits or (source.head is None) != (target.head is None):
        raise InputError("its networks do not fit this preset's", where, SAME_PRESET)
    copy_head(source, target)
    target.actor.norm.hold()


def copy_head(source: TorquePolicy, target: TorquePolicy) -> None:
    """Copy the weights of the head that mean the same in both policies.

    These are the springs' gains; the gains of the centre of mass if both heads have the same least
    values, which the gains are relative to; and the laws of stepping and foot placement that both
    have.
    """
    if source.head is None or target.head is None:
        return
    target.head.load_state_dict(_common(source.head, target.head), strict=False)


def _common(source: TorqueHead, target: TorqueHead) -> dict[str, Tensor]:
    theirs, ours = source.state_dict(), target.state_dict()
    gains = {f"balance.{name}" for name in _GAINS}
    if not _same_least(source.balance, target.balance):
        theirs = {name: value for name, value in theirs.items() if name not in gains}
    return {name: value for name, value in theirs.items() if name in ours}


def _same_least(one: Balance | None, other: Balance | None) -> bool:
    """Whether gains of both are relative to the same least values."""
    if one is None or other is None:
        return False
    return (
        torch.equal(one.least_kp, other.least_kp)
        and torch.equal(one.least_kd, other.least_kd)
        and one.least_limit == other.least_limit
    )


def _widen(state: dict[str, Tensor], source: TorquePolicy, target: TorquePolicy) -> None:
    """Extend the actor by the outputs that only the target's balance has, with zeros."""
    more = OUTPUTS.get(target.spec.balance, 0) - OUTPUTS.get(source.spec.balance, 0)
    if more <= 0:
        return
    last = f"actor.layers.{len(source.actor.layers) - 1}."
    for name in (last + "weight", last + "bias"):
        rows = state[name].new_zeros(more, *state[name].shape[1:])
        state[name] = torch.cat([state[name], rows])


def _grow(state: dict[str, Tensor], target: TorquePolicy) -> None:
    """Fill up layers that are wider in ``target`` so that its actor's outputs stay the same.

    New units keep the random weights that ``target`` gave their inputs; the units that were there
    before, and the outputs, do not use them yet: these weights are zero (as for the new layers of
    Net2Net, Chen et al. 2016, the function is kept; its copies of units are not needed, since the
    random inputs already make new units differ).
    """
    begin = target.state_dict()
    names = [name for name in state if name.startswith("actor.layers.")]
    if any(name not in begin or begin[name].dim() != state[name].dim() for name in names):
        return
    for name in names:
        old, new = state[name], begin[name].clone()
        outputs = len(old)
        if outputs > len(new) or old.shape[-1] > new.shape[-1] or old.shape == new.shape:
            continue
        if old.dim() == 1:
            new[:outputs] = old
        else:
            inputs = old.shape[1]
            new[:outputs, :inputs], new[:outputs, inputs:] = old, 0.0
        state[name] = new


def take_critic(
    folder: Path, policy: TorquePolicy, learning: PPOConfig, say: Callable[[str], None]
) -> None:
    """Load the critic that was saved with a policy, if there is one.

    Without one (students and published policies have none), the new critic stays and learns alone
    for ``critic_warmup_steps``.

    Args:
        folder: checkpoint of the earlier policy.
        policy: the new one.
        learning: settings of its training.
        say: is called with a line for the user.

    Raises:
        InputError: the critic does not fit; or there is none, and the training has no warm-up.
    """
    if has_critic(folder):
        load_critic(folder, policy)
        assert policy.critic is not None
        policy.critic.norm.hold()
        return
    if learning.critic_warmup_steps == 0:
        fix = "set stages.teacher.learning.critic_warmup_steps, so that a new critic learns first"
        raise InputError("has no critic", folder, fix)
    steps = f"{learning.critic_warmup_steps:,}"
    say(f"{folder} has no critic: a new one learns alone for {steps} steps")
