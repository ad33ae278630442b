"""Random variations of clips: data augmentation of recorded motion.

A variation splits a clip into parts (``varying.figure``), changes them by a random recipe and
rebuilds the motion with leg inverse kinematics and balance. Motions that people could not do are
rejected (``varying.feasible``). The clip's ``source`` records the recipe.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from questsim.body import DEFAULT_HEIGHT_M
from questsim.errors import InputError
from questsim.licences import of_parts
from questsim.motion.clip import FPS, Clip, source_kind
from questsim.motion.kinematics import clip_from_qpos
from questsim.motion.synthesis.posture import drift
from questsim.motion.synthesis.synthetic import SEATED
from questsim.motion.varying import feasible, stances, upper
from questsim.motion.varying.figure import (
    Figure,
    check_bodies,
    default_poses,
    figure_of,
    in_other_time,
    misfit,
    solve,
)
from questsim.motion.varying.upper import LEG_M, Timing

SHORTEST_S, LONGEST_S = 1.0, 10.0
"""Shortest clip in seconds that can be varied, and the longest part of one that is used."""
ATTEMPTS = 60
"""Maximum number of recipes tried for one variation."""
SPEEDS = (0.75, 1.3)
CHANCES = {
    "reversed": 0.25, "upper": 0.2, "reach": 0.35, "bow": 0.2, "crouch": 0.2, "stance": 0.25,
    "lean": 0.35, "drift": 0.6,
}  # fmt: skip
"""Probability of each ingredient in a recipe."""
GREATEST = {
    "reversed": 0.9, "upper": 0.8, "reach": 0.5, "bow": np.deg2rad(50.0), "crouch": 0.25,
    "stance": 0.15, "lean": np.deg2rad(10.0), "drift": 0.5,
}  # fmt: skip
"""Amounts that change a motion about equally, by eye; the largest ratio names the kind."""


@dataclass
class Recipe:
    """The parameters of a variation.

    Attributes:
        speed: factor on the playback speed.
        amounts: ingredient to its amount, in its own unit (see ``draw``); others are not used.
    """

    speed: float
    amounts: dict[str, float] = field(default_factory=dict)

    @property
    def dominant(self) -> str | None:
        """The ingredient that changes the motion most, if any."""
        if not self.amounts:
            return None
        return max(self.amounts, key=lambda name: abs(self.amounts[name]) / GREATEST[name])

    def __str__(self) -> str:
        parts = [f"{name} {amount:.2f}" for name, amount in self.amounts.items()]
        return ", ".join([f"speed {self.speed:.2f}", *parts])


@dataclass
class Tally:
    """Number of recipes tried, and of recipes rejected for each reason."""

    tried: int = 0
    rejected: dict[str, int] = field(default_factory=lambda: defaultdict(int))

    def __str__(self) -> str:
        count = sum(self.rejected.values())
        reasons = ", ".join(
            f"{n} {why}" for why, n in sorted(self.rejected.items(), key=lambda pair: -pair[1])
        )
        share = 100.0 * count / max(self.tried, 1)
        return f"{count} of {self.tried} recipes rejected ({share:.0f} %): {reasons or 'none'}"


def vary(
    clips: Sequence[Clip], count: int, seed: int = 0, *, tally: Tally | None = None
) -> list[Clip]:
    """Random variations of clips.

    Each kind of clip is drawn equally often, variations as their source's. The kind of a variation
    joins its clip's kind and its largest ingredient, e.g. ``"walk+crouch"``. It carries the
    licences of all clips that it uses.

    Args:
        clips: the clips to vary. Clips shorter than 1 s or with a chair are left out.
        count: how many variations.
        seed: same clips and seed, same bits; the first variations do not depend on ``count``.
        tally: counts the tried and rejected recipes.

    Returns:
        ``count`` clips.

    Raises:
        InputError: no clip is left, no variation is feasible, or ``seed`` is negative.
    """
    return list(variations(clips, range(count), seed, tally=tally))


def variations(
    clips: Sequence[Clip],
    numbers: Sequence[int],
    seed: int = 0,
    *,
    tally: Tally | None = None,
) -> Iterator[Clip]:
    """The variations of these numbers, one after the other; see ``vary``."""
    check_bodies(clips, "variations")
    pool = _pool(clips, seed)
    tally = Tally() if tally is None else tally
    for number in numbers:
        yield pool.variation(number, tally)


def long_enough(clips: Sequence[Clip]) -> list[Clip]:
    """The clips that can be varied: at least 1 s long and without a chair.

    Raises:
        InputError: there is none.
    """
    usable = [clip for clip in clips if clip.kind not in SEATED]
    if not usable:
        raise InputError("no clips to vary", fix="name motions that need no chair")
    longest = max(usable, key=lambda clip: clip.duration)
    if longest.duration < SHORTEST_S - 1e-9:
        raise InputError(
            f"lasts {longest.duration:.2f} s; variations need {SHORTEST_S:g} s", longest.name
        )
    return [clip for clip in usable if clip.duration >= SHORTEST_S - 1e-9]


def _pool(clips: Sequence[Clip], seed: int) -> _Pool:
    if seed < 0:
        raise InputError(f"seed {seed} is below zero")
    return _Pool(long_enough(clips), seed)


class _Pool:
    """Clips by kind, and the force and moment that the floor cannot supply to each."""

    def __init__(self, clips: Sequence[Clip], seed: int) -> None:
        self._clips = clips
        self._seed = seed
        kinds: dict[str, list[int]] = defaultdict(list)
        for number, clip in enumerate(clips):
            kinds[source_kind(clip.kind)].append(number)
        self._kinds = [kinds[kind] for kind in sorted(kinds)]
        self._lacking: dict[int, tuple[float, float]] = {}

    def variation(self, number: int, tally: Tally) -> Clip:
        rng = np.random.default_rng([self._seed, number])
        for _ in range(ATTEMPTS):
            base = self._draw(rng)
            donor = self._clips[self._draw(rng)]
            result = make(self._clips[base], donor, rng)
            tally.tried += 1
            reason = result if isinstance(result, str) else self._carried(base, result)
            if reason is None:
                assert isinstance(result, Clip)
                return replace(result, name=f"{result.name}-vary-{self._seed}-{number}")
            tally.rejected[reason] += 1
        raise InputError(
            f"no variation of {ATTEMPTS} recipes is physically possible for a person",
            fix="give more or other motions",
        )

    def _draw(self, rng: np.random.Generator) -> int:
        kind = self._kinds[int(rng.integers(len(self._kinds)))]
        return kind[int(rng.integers(len(kind)))]

    def _carried(self, base: int, clip: Clip) -> str | None:
        if base not in self._lacking:
            self._lacking[base] = feasible.lacking(self._clips[base])
        return (
            "not carried by the floor" if feasible.unsupported(clip, self._lacking[base]) else None
        )


def make(base: Clip, donor: Clip, rng: np.random.Generator) -> Clip | str:
    """One variation, or the reason why it is infeasible (dynamics are not checked here).

    Args:
        base: the clip.
        donor: another clip whose upper body may be used.
        rng: of the recipe.
    """
    first, last = _part(base, rng)
    recipe = draw(base, rng)
    backwards = "reversed" in recipe.amounts
    figure = figure_of(in_other_time(default_poses(base, first, last), recipe.speed, backwards))
    _mix(figure, donor, recipe, rng)
    qpos = solve(figure)
    qpos[:, :2] -= qpos[0, :2]
    qpos[:, :3] *= base.height_m / DEFAULT_HEIGHT_M
    mixed = donor if "upper" in recipe.amounts else base
    dominant = recipe.dominant
    clip = clip_from_qpos(
        base.name,
        qpos,
        base.height_m,
        source=_source(base, mixed, recipe),
        source_sha256=base.source_sha256,
        licence=of_parts((base.licence, mixed.licence)),
        kind=f"{base.kind}+{dominant}" if dominant else base.kind,
        style=base.style,
        weight=base.weight,
    )
    if feasible.feet_missed(figure.contacts, misfit(figure, clip)):
        return "out of the legs' reach"
    if backwards and feasible.too_fast_backwards(clip):
        return "runs backwards"
    if (hinge := feasible.fast_joint(clip)) is not None:
        return f"fast {hinge.split('_')[-2]}"
    return "in the floor" if feasible.in_the_floor(clip) else clip


def _part(clip: Clip, rng: np.random.Generator) -> tuple[int, int]:
    """First frame and end of the part of a clip that is varied."""
    longest = int(LONGEST_S * FPS)
    first = int(rng.integers(max(len(clip) - longest, 0) + 1))
    return first, min(first + longest, len(clip))


def _source(base: Clip, donor: Clip, recipe: Recipe) -> str:
    mixed = f" and {donor.name}" if "upper" in recipe.amounts else ""
    origin = f" ({base.source})" if base.source else ""
    return f"variation of {base.name}{mixed}{origin}: {recipe}"


def draw(clip: Clip, rng: np.random.Generator) -> Recipe:
    """A random recipe for a clip; ingredients that do not fit are not drawn.

    Amounts: of ``reversed``, ``upper`` and ``reach`` how much of the motion they change, 0 to 1;
    of ``bow`` and ``lean`` radians; of ``crouch`` leg lengths; of ``stance`` metres by which the
    feet are farther apart; of ``drift`` m/s (a turn of 1 rad/s counts as 0.5).
    """
    stepping = bool(clip.contacts.all(axis=1).mean() < 0.97)
    speed = float(np.linalg.norm(clip.qvel[:, :2], axis=-1).mean())
    possible = dict(CHANCES)
    if not stepping:
        del possible["drift"]
    if feasible.too_fast_backwards(clip):
        del possible["reversed"]
    wanted = {name for name, chance in possible.items() if rng.random() < chance}
    # At least one ingredient.
    wanted.add(str(rng.choice(list(possible)))) if not wanted else None
    # People bend less deeply while walking than while standing.
    ease = float(np.clip(1.0 - 0.5 * speed, 0.3, 1.0))
    amounts = {
        "reversed": 1.0 if stepping else 0.3,
        "upper": 1.0,
        "reach": float(rng.uniform(0.4, 1.0)),
        "bow": float(np.deg2rad(rng.uniform(10.0, 85.0)) * ease),
        "crouch": float(rng.uniform(0.05, 0.45) * ease),
        "stance": float(rng.uniform(-0.08, 0.35) * ease),
        "lean": float(np.deg2rad(rng.uniform(2.0, 10.0))),
        "drift": float(rng.uniform(0.05, 0.5)),
    }
    chosen = {name: amount for name, amount in amounts.items() if name in wanted}
    return Recipe(float(rng.uniform(*SPEEDS)), chosen)


def _mix(figure: Figure, donor: Clip, recipe: Recipe, rng: np.random.Generator) -> None:
    """Apply a recipe to a figure; its open parameters are drawn at random."""
    amounts, time = recipe.amounts, figure.time
    if "drift" in amounts:
        stances.drift_path(figure, _drift(amounts["drift"], rng))
    if "stance" in amounts:
        ahead, toe_out = rng.normal(0.0, 0.06), rng.normal(0.0, np.deg2rad(6.0))
        stances.place_feet(figure, amounts["stance"], ahead, toe_out)
    if "upper" in amounts:
        poses = in_other_time(default_poses(donor), recipe.speed, False)
        upper.take_upper(figure, poses, int(rng.integers(len(poses))))
    if "reach" in amounts:
        _reach(figure, amounts["reach"], rng)
    if "crouch" in amounts:
        depth = amounts["crouch"] * LEG_M * upper.shares(_moments(figure, rng, 0.6, 1.4), time)
        upper.crouch(figure, depth, rng.uniform(0.3, 1.6) * amounts["crouch"] / 0.45)
    if "bow" in amounts:
        pitch = amounts["bow"] * upper.shares(_moments(figure, rng, 0.8, 1.8), time)
        hips, up, hang = rng.uniform(0.45, 0.75), rng.uniform(-0.1, 0.5), rng.uniform(0.0, 1.0)
        upper.bow(figure, pitch, hips, up, hang)
    if "lean" in amounts:
        _lean(figure, amounts["lean"], rng)
    # Straight knees snap when the pelvis is moved: bend them a little.
    figure.root[:, 2] -= 0.01


def _drift(size: float, rng: np.random.Generator) -> stances.Drift:
    sideways, forwards, turning = rng.normal(0.0, 1.0, 3)
    scale = size / max(float(np.linalg.norm([sideways, forwards, turning])), 1e-6)
    return stances.Drift(scale * sideways, scale * forwards, 2.0 * scale * turning)


def _reach(figure: Figure, weight: float, rng: np.random.Generator) -> None:
    one = bool(rng.random() < 0.5)
    hands = (one, not one) if rng.random() < 0.4 else (True, True)
    share = upper.shares(_moments(figure, rng, 0.7, 1.2), figure.time)
    upper.reach_about(figure, rng, hands, share)
    trunk, gaze = np.deg2rad([rng.uniform(0.0, 35.0), rng.uniform(0.0, 60.0)]) * weight
    upper.look_and_twist(figure, rng, trunk, gaze, share)


def _lean(figure: Figure, size: float, rng: np.random.Generator) -> None:
    way = rng.uniform(-np.pi, np.pi)
    even = np.ones(len(figure))
    upper.tilt(figure, size * np.cos(way) * even, 0.5 * size * np.sin(way) * even)
    sway = [rng.uniform(0.0, 0.03) * drift(figure.time, rng, 0.1, 0.5) for _ in range(2)]
    stances.move_pressure(figure, np.column_stack(sway))


def _moments(
    figure: Figure, rng: np.random.Generator, least_s: float, most_s: float
) -> tuple[Timing, ...]:
    """When an ingredient acts in a clip: a few times, once, or (empty) all the time."""
    if rng.random() < 0.25:
        return ()
    moments, at = [], rng.uniform(-0.5, 0.6)
    while at < upper.seconds(figure) - least_s and len(moments) < 4:
        ease, hold = rng.uniform(least_s, most_s), rng.exponential(0.8)
        moments.append(Timing(at, ease, hold))
        at += 2.0 * ease + hold + rng.exponential(0.5)
    return tuple(moments)
