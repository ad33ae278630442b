"""The clips that a training learns from, their estimates, and the clips that choose checkpoints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from agents.evaluation.follow import choose_clips
from agents.training.hold_out import without_styles
from agents.training.options import TrainArgs
from agents.training.start_estimates import SPARE_FRAMES, estimated_clip_name, load_estimates
from questsim.errors import InputError
from questsim.motion.clip import Clip

Pairs = dict[str, tuple[Clip, Clip]]
"""A true clip and the one that the policy observes instead, by name."""


def load_clips(args: TrainArgs) -> list[Clip]:
    """The clips of ``--motions``, at the data's own statures and, on request, proportions."""
    from questsim.motion.spec import check_own_proportions, load_motions

    if args.own_proportions and args.proportions:
        what = "does not go with --own-proportions"
        raise InputError(what, "--proportions", "give one of them")
    if args.own_proportions and args.body is not None:
        what = "does not go with a body of your own: the body keeps its own proportions"
        raise InputError(what, "--own-proportions", "leave it out")
    if args.own_proportions:
        check_own_proportions(args.motions)
    return load_motions(
        args.motions,
        mirrored=args.mirrored,
        seed=args.seed,
        own_proportions=args.own_proportions,
    )


def estimate_pairs(args: TrainArgs, clips: Sequence[Clip]) -> Pairs | None:
    """Pairs of true and observed clips, by name: one per estimate, and the truth itself once.

    Raises:
        InputError: the stage does not use estimates, or they are not of these clips.
    """
    from questsim.motion.retarget import to_clip
    from questsim.motion.retarget_back import to_motion

    if args.estimates is None:
        return None
    if args.stage not in ("student", "finetune"):
        fix = "add --stage student or finetune"
        raise InputError(f"does not go with --stage {args.stage}", "--estimates", fix)
    others = {
        "--vary": args.vary,
        "--mirrored": args.mirrored,
        # The policy observes the estimated bodies, and no devices.
        "--sensors": args.sensors != TrainArgs.sensors,
        "--future-frames": args.future_frames != TrainArgs.future_frames,
    }
    for option, given in others.items():
        if given:
            raise InputError(f"does not go with {option}", "--estimates", f"leave out {option}")
    known = {clip.name: clip for clip in clips}
    pairs: Pairs = {}
    for estimate in load_estimates(args.estimates, args.seed):
        user = estimated_clip_name(estimate, known, args.estimates)
        if known[user].height_m != estimate.height_m:
            # Estimates are made from recordings, whose stature is measured on their bones.
            known[user] = to_clip(to_motion(known[user]))
        name, again = estimate.name, 2
        while name in pairs:  # the same system with other devices
            name, again = f"{estimate.name} {again}", again + 1
        pairs[name] = _paired(replace(known[user], name=name), estimate, args.estimates)
        pairs[user] = known[user], known[user]  # train on accurate estimates too
    return pairs


def _paired(truth: Clip, estimate: Clip, where: str) -> tuple[Clip, Clip]:
    """Both, up to the last frame of the shorter one.

    Raises:
        InputError: their lengths differ by more than another frame rate can explain.
    """
    frames = min(len(truth), len(estimate))
    if max(len(truth), len(estimate)) > frames + SPARE_FRAMES:
        raise InputError(
            f"{estimate.name!r} is not an estimate of this motion: {len(estimate)} frames for "
            f"{len(truth)}",
            where,
            "make it again by questsim estimate",
        )
    return truth.first(frames), estimate.first(frames)


def split_validation(
    clips: Sequence[Clip], hold_out: str, count: int
) -> tuple[list[Clip], list[Clip]]:
    """Clips to learn from, and the fixed set on which checkpoints are compared.

    Args:
        clips: all clips.
        hold_out: styles used only for evaluation; without any, the fixed set is a subset of the
            training clips.
        count: size of the fixed set.

    Raises:
        InputError: no such style, or no training clips are left.
    """
    learnt, held = without_styles(clips, hold_out)
    return learnt, choose_clips(held or learnt, count)


def validation_clips(args: TrainArgs, count: int) -> list[Clip]:
    """The clips of ``--validation``, at most ``count``.

    Raises:
        InputError: another option excludes it.
    """
    from questsim.motion.spec import load_motions

    assert args.validation is not None
    for option, given in (("--hold-out", args.hold_out), ("--estimates", args.estimates)):
        if given:
            raise InputError(f"does not go with {option}", "--validation", "leave one out")
    clips = load_motions(args.validation, seed=args.seed, own_proportions=args.own_proportions)
    return choose_clips(clips, count)
