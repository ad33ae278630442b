"""The live follower: time from a frame of devices to a pose, and ten minutes of a bad stream.

    python -m benchmarks.live                  # latency, and ten minutes at 90 Hz
    python -m benchmarks.live --minutes 1 --agent questsim-now --assist 0
    python -m benchmarks.live --motions bandai-namco-2:test --clips 36 --assist 0
    python -m benchmarks.live --motions bandai-namco-2:test --clips 36 --assist 0 --rest 1
    python -m benchmarks.live --motions synthetic:random:100 --users 12 --assist 0
    python -m benchmarks.live --motions synthetic:walk+turn-left --statures 7 --assist 0

The frames come from a synthetic user at 90 Hz. 1 % are lost. Each arrives up to 20 ms late, so many
arrive out of order and are dropped. Targets: half of the steps within 5 ms, 99 % within 20 ms, no
restart, no growth of memory. The times do not include the future window of the agent. Next to the
times of the clock stand those of the processor, which other programs do not lengthen.

With ``--motions`` it measures instead the cost of a calibrated start. It compares the success on
clips between three starts: in the state of the clip's first frame, as in most evaluations; standing
at its place, as in evaluations of standing starts; and from a user who stands still for calibration
and then goes over to the clip within two seconds, with the body unknown. Target: at most 3 points
less than the first. Clips that begin at rest are also counted alone, and with ``--rest 1`` chosen
alone: from standing, most others cannot be followed at all. It also measures how far apart the
links of the first and the last avatar are in the same frames, after the first second: whether the
live avatar moves as the evaluated one.

With ``--users`` several synthetic users of 1.5 to 1.95 m stand still for calibration and then
perform six of these clips each, one after the other. Their controllers are held askew, by 1 cm and
0.15 rad. It prints how many clips were followed without a fall. Only clips that can be performed
from rest are used (``questsim motions chain``).

With ``--statures`` users of so many statures from 1.5 to 1.9 m stand still and perform each of
these clips alone, with devices in their place and without losses.
"""

from __future__ import annotations

import argparse
import math
import resource
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from agents.evaluation.assisted import AssistUse
from agents.evaluation.follow import choose_clips
from agents.evaluation.rollout import env_config, roll_out
from agents.follower import Follower
from agents.headset.command import ASSIST_N
from agents.loading import load_agent
from agents.resolve import LIVE_POLICY
from benchmarks.common import arguments, report
from envs.starts import WHOLLY
from questsim.avatar_pose import AvatarPose
from questsim.cli import guarded
from questsim.devices import DeviceFrame
from questsim.errors import InputError
from questsim.metrics import MAX_LINK_ERROR_M, Rollout
from questsim.motion.clip import FPS, Clip
from questsim.motion.spec import load_motions
from questsim.motion.synthesis.synthetic import synthetic_clips
from questsim.motion.varying.chain import can_be_chained
from questsim.stream_metrics import stream_scores, track_of
from questsim.synthetic_user import EXAMPLE_CLIPS, STILL_S, SyntheticUser, stream

RATE_HZ, LOSS, JITTER_S = 90.0, 0.01, 0.02
COUNTS = {"minutes": 10, "clips": 60, "rest": 0, "users": 0, "statures": 0}
"""Options that are whole numbers, with their defaults."""
RANGES = {"minutes": (1, 1440), "clips": (1, 100_000), "rest": (0, 1)}
"""Least and greatest values; of the other options 0 and any number."""
USERS_CLIPS = 6
"""Clips that each of several users performs."""
REST_M_S = 0.3
"""A clip whose pelvis is slower in its first frame begins at rest."""


def main() -> None:
    """Measure and print."""
    args = arguments(
        __doc__ or "", {"agent": LIVE_POLICY, "motions": ""}, assist=round(ASSIST_N), **COUNTS
    )
    check_options(args)
    torch.set_num_threads(1)
    agent, assist_n = args.agent, float(args.assist)
    if not args.motions:
        report(measure(agent, float(args.minutes), assist_n), args.json)
        return
    loaded = load_motions(args.motions)
    if args.users:
        report(several_users(agent, loaded, args.users, assist_n), args.json)
    elif args.statures:
        report(all_statures(agent, loaded, args.statures, assist_n), args.json)
    else:
        begun = [clip for clip in loaded if not args.rest or at_rest(clip)]
        if not begun:
            what = f"none of {len(loaded)} clips begins at rest"
            raise InputError(what, "--motions", "name others, or leave --rest out")
        clips = choose_clips(begun, args.clips)
        report(starts(agent, clips, assist_n), args.json)


def check_options(args: argparse.Namespace) -> None:
    """Check that each option given has an effect.

    Raises:
        InputError: one has none, or a value is out of its range.
    """
    if (args.users or args.statures) and not args.motions:
        raise InputError("need clips", "--users, --statures", "name them with --motions")
    only = "users" if args.users else "statures" if args.statures else ""
    read = {only} if only else {"clips", "rest"} if args.motions else {"minutes"}
    beside = f"beside --{only}" if only else "beside --motions" if args.motions else "alone"
    for name, default in COUNTS.items():
        value = getattr(args, name)
        least, most = RANGES.get(name, (0, math.inf))
        if not least <= value <= most:
            raise InputError(f"is {value}, not {_range(least, most)}", f"--{name}", "change it")
        if value != default and name not in read:
            raise InputError(f"has no effect {beside}", f"--{name}", "leave it out")


def _range(least: float, most: float) -> str:
    return f"{least:g} or more" if most == math.inf else f"{least:g} to {most:g}"


def bad_stream(minutes: float) -> list[DeviceFrame]:
    """Frames of a user in the order of their arrival."""
    clips = {clip.name.removeprefix("synthetic-"): clip for clip in synthetic_clips()}
    rounds = int(np.ceil(minutes / 2.0))
    done = [clips[name] for name in EXAMPLE_CLIPS] * rounds
    frames, _ = stream(SyntheticUser(1.75), done, RATE_HZ, loss=LOSS)
    frames = [frame for frame in frames if frame.time_s < 60.0 * minutes]
    late = np.random.default_rng(0).uniform(0.0, JITTER_S, len(frames))
    order = np.argsort([frame.time_s + wait for frame, wait in zip(frames, late, strict=True)])
    return [frames[i] for i in order]


def measure(agent: str, minutes: float, assist_n: float) -> dict[str, float]:
    """Times of steps in ms, falls and other restarts, and growth of memory in the second half.

    Args:
        agent: the policy that follows.
        minutes: length of the stream.
        assist_n: bound of the assist.
    """
    frames = bad_stream(minutes)
    follower = Follower(agent, assist_n=assist_n)
    follower.calibrate([f for f in sorted(frames, key=lambda f: f.time_s) if f.time_s < STILL_S])
    for frame in frames[:200]:  # compiles, and warms caches
        follower.step(frame)
    follower.reset()
    # Made in advance: lists would grow with the stream, and be taken for the follower's memory.
    times, busy = np.full((2, len(frames)), np.nan)
    events, half = [], 0
    for number, frame in enumerate(frames):
        began, worked = time.perf_counter(), time.thread_time()
        pose = follower.step(frame)
        busy[number] = time.thread_time() - worked
        times[number] = time.perf_counter() - began
        events += [event for event in pose.events if "set up again" in event]
        if number == len(frames) // 2:
            half = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    whole = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    p50, p99 = np.percentile(times, [50, 99])
    own_p50, own_p99 = np.percentile(busy, [50, 99])
    falls = sum("fell" in event for event in events)
    return {
        "frames": len(frames),
        "p50_ms": 1e3 * float(p50),
        "p50_goal_ms": 5.0,
        "p99_ms": 1e3 * float(p99),
        "p99_goal_ms": 20.0,
        "processor_p50_ms": 1e3 * float(own_p50),
        "processor_p99_ms": 1e3 * float(own_p99),
        "times_real_time": frames[-1].time_s / float(times.sum()),
        "falls": falls,
        "other_restarts": len(events) - falls,
        "memory_growth_in_second_half_kb": whole - half,
    }


def at_rest(clip: Clip) -> bool:
    """Whether a clip begins with a pelvis that moves by less than ``REST_M_S``."""
    return bool(np.linalg.norm(clip.qvel[0, :2]) < REST_M_S)


def starts(agent: str, clips: Sequence[Clip], assist_n: float) -> dict[str, float]:
    """Success in percent of scored and of calibrated starts.

    Figures of clips begun at rest, and of avatars in the same frames, stand there if there are any.

    Args:
        agent: the policy that follows.
        clips: clips to follow.
        assist_n: bound of the assist after both starts.
    """
    loaded = load_agent(agent)

    def scored_from(start: str, these: Sequence[Clip]) -> list[Rollout]:
        assist = AssistUse(assist_n) if assist_n else None
        config = replace(env_config(loaded), starts=WHOLLY[start])
        return roll_out(loaded, these, config, assist=assist)

    scored = np.array([r.completed for r in scored_from("reference", clips)])
    standing = np.array([r.completed for r in scored_from("standing", clips)])
    live = [followed(agent, clip, assist_n) for clip in clips]
    calibrated = np.array([each.completed for each in live])
    # The same frames: a user's stream has a clip without its slow first and last half second.
    same = zip(live, scored_from("reference", [each.clip for each in live]), strict=True)
    apart = [
        np.linalg.norm(positions - rollout.link_position[number], axis=-1).mean()
        for each, rollout in same
        if each.completed and rollout.completed
        for number, positions in each.links.items()
        if FPS <= number < len(rollout.link_position)
    ]
    rest = np.array([at_rest(clip) for clip in clips])
    at_rest_percent = {
        f"at_rest_{start}_percent": 100.0 * float(done[rest].mean())
        for start, done in (
            ("scored_start", scored),
            ("scored_standing_start", standing),
            ("calibrated_start", calibrated),
        )
        if rest.any()
    }
    return {
        "clips": len(clips),
        "assist_n": assist_n,
        "scored_start_percent": 100.0 * float(scored.mean()),
        "scored_standing_start_percent": 100.0 * float(standing.mean()),
        "calibrated_start_percent": 100.0 * float(calibrated.mean()),
        "clips_begun_at_rest": int(rest.sum()),
        **at_rest_percent,
        "points_lost": 100.0 * float(scored.mean() - calibrated.mean()),
        "points_goal": 3.0,
        "fell_before_full_speed_percent": 100.0 * float(np.mean([e.fell_early for e in live])),
        "lost_in_both": int((~scored & ~calibrated).sum()),
    } | ({"avatars_apart_cm": 100.0 * float(np.mean(apart))} if apart else {})


@dataclass(frozen=True)
class LiveResult:
    """A clip that a calibrated avatar has followed.

    Attributes:
        clip: the part that the user performs at full speed.
        completed: whether the avatar did not fall and stayed within 0.5 m.
        fell_early: whether it fell before, while the user went over from standing to the clip.
        links: positions ``(16, 3)`` of the avatar's links by the number of the clip's frame.
    """

    clip: Clip
    completed: bool
    fell_early: bool
    links: dict[int, np.ndarray]


def followed(agent: str, clip: Clip, assist_n: float) -> LiveResult:
    """Follow a clip with a calibrated avatar."""
    user = SyntheticUser(clip.height_m, noise_m=0.001)
    frames, (span,) = stream(user, [clip], 72.0)
    follower, links = Follower(agent, assist_n=assist_n), dict[int, np.ndarray]()
    early = False
    follower.calibrate([frame for frame in frames if frame.time_s < STILL_S])
    for frame in frames:
        pose = follower.step(frame)
        number = round((pose.time_s - span.start_s) * FPS)
        fell = has_fallen(pose)
        early |= fell and number < 0
        if not 0 <= number < len(span.clip):
            continue
        apart = np.linalg.norm(pose.link_position - span.clip.link_position[number], axis=-1)
        if apart.mean() > MAX_LINK_ERROR_M or fell:
            return LiveResult(span.clip, False, early, links)
        links[number] = pose.link_position
    return LiveResult(span.clip, True, early, links)


def several_users(
    agent: str, motions: Sequence[Clip], users: int, assist_n: float
) -> dict[str, float]:
    """Clips followed without a fall, falls a minute, and the error at headset and hands.

    Args:
        agent: the policy that follows.
        motions: clips that the users choose from.
        users: number of users, each with other clips.
        assist_n: bound of the assist.

    Raises:
        InputError: fewer than ``USERS_CLIPS`` clips can be performed from rest.
    """
    pool = chainable(motions, USERS_CLIPS)
    falls, seconds, errors, whole = 0, 0.0, [], []
    for seed in range(users):
        rng = np.random.default_rng(seed)
        clips = [pool[i] for i in rng.choice(len(pool), USERS_CLIPS, replace=False)]
        mounts = {
            f"{side}_controller": (tuple(rng.normal(0.0, 0.01, 3)), tuple(rng.normal(0.0, 0.15, 3)))
            for side in ("left", "right")
        }
        height = float(rng.uniform(1.5, 1.95))
        frames, spans = stream(
            SyntheticUser(height, mounts=mounts, seed=seed), clips, 60.0, 0.004, LOSS
        )
        follower = Follower(agent, assist_n=assist_n)
        calibration = follower.calibrate([f for f in frames if f.time_s < STILL_S])
        after = [frame for frame in frames if frame.time_s >= STILL_S]
        poses = [follower.step(frame) for frame in after]
        fell = [pose.time_s for pose in poses if has_fallen(pose)]
        ends = [span.end_s + 1.0 for span in spans]
        whole += [
            not any(begin <= time < end for time in fell)
            for begin, end in zip([0.0, *ends], ends, strict=False)
        ]
        known = [calibration.apply(frame) for frame in after]
        scores = stream_scores(track_of(known, poses, calibration.floor_m))
        falls, seconds = falls + len(fell), seconds + float(scores["seconds"] or 0.0)
        errors.append(scores["mhpe_cm"])
    return {
        "users": users,
        "clips": len(whole),
        "assist_n": assist_n,
        "followed_without_a_fall_percent": 100.0 * float(np.mean(whole)),
        "falls_a_minute": 60.0 * falls / seconds,
        "mhpe_cm": float(np.mean(errors)),
    }


def chainable(motions: Sequence[Clip], least: int) -> list[Clip]:
    """The clips that can be performed from rest.

    Raises:
        InputError: fewer than ``least``.
    """
    pool = [clip for clip in motions if can_be_chained(clip)]
    if len(pool) < least:
        what = f"{len(pool)} of {len(motions)} clips can be performed from rest"
        raise InputError(what, "--motions", f"name at least {least}")
    return pool


def has_fallen(pose: AvatarPose) -> bool:
    """Whether the avatar fell and was set up again at this pose."""
    return any("fell" in event for event in pose.events)


def all_statures(
    agent: str, motions: Sequence[Clip], statures: int, assist_n: float
) -> dict[str, float]:
    """Falls before the end of each clip, each with users of several statures.

    Args:
        agent: the policy that follows.
        motions: clips to perform.
        statures: number of statures from 1.5 to 1.9 m.
        assist_n: bound of the assist.

    Raises:
        InputError: no clip can be performed from rest.
    """
    falls = []
    for clip in chainable(motions, 1):
        for height in np.linspace(1.5, 1.9, statures):
            frames, (span,) = stream(SyntheticUser(float(height)), [clip], 72.0)
            follower = Follower(agent, assist_n=assist_n)
            follower.calibrate([frame for frame in frames if frame.time_s < STILL_S])
            poses = [follower.step(f) for f in frames if STILL_S - 1.0 <= f.time_s <= span.end_s]
            falls.append(sum(map(has_fallen, poses)))
    return {
        "streams": len(falls),
        "assist_n": assist_n,
        "streams_with_a_fall": int(np.count_nonzero(falls)),
        "falls": int(np.sum(falls)),
    }


if __name__ == "__main__":
    sys.exit(guarded(main))
