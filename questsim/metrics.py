"""Metrics of an evaluation: recorded rollouts, and the figures computed from them.

``metrics_terms`` contains the formulas; this module applies them to rollouts and averages. A mean
is over pooled frames: every frame of every clip of a group counts once, so long clips weigh more.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from questsim import metrics_terms as terms
from questsim.bodies import OwnBody
from questsim.body import DEFAULT_HEIGHT_M, build_body
from questsim.errors import InputError
from questsim.motion.clip import Clip
from questsim.motion.kinematics import sole_points
from questsim.objects import ObjectTrack
from questsim.skeleton import FEET, FOOT_LINKS, NUM_LINKS
from questsim.statistics import interval

SCHEMA, SCHEMA_VERSION = "questsim-metrics", 1

MAX_LINK_ERROR_M = 0.5
"""Beyond this mean link error the avatar counts as lost.

Source: Luo et al., "Perpetual Humanoid Control", ICCV 2023; QuestSim ends episodes alike.
"""

CONTACT_FORCE_N = 10.0
"""A foot is in contact with the floor above this vertical force.

Source: the cut-off for force plates in Leitch et al., Gait & Posture 33(1), 2011.
"""

CONTACT_CLEARANCE_M = 0.005
"""Without forces, a foot this near to the floor is in contact (PhysDiff's tolerance)."""

METRICS: tuple[str, ...] = (
    "mpjpe_cm",
    "mpjpe_root_aligned_cm",
    "mpjre_deg",
    "root_cm",
    "root_deg",
    "sip_deg",
    "jitter_km_s3",
    "reference_jitter_km_s3",
    "mpjve_cm_s",
    "mhpe_cm",
    "mhre_deg",
    "foot_skate_cm_s",
    "reference_foot_skate_cm_s",
    "penetration_cm",
)
"""Metrics of ``samples``, in the order of reports; each name ends with the unit."""


@dataclass(frozen=True)
class Rollout:
    """One clip as the avatar performed it, from the clip's first frame on.

    ``F`` frames were simulated; frame ``f`` is compared with frame ``f`` of the clip, and frame 0
    is the initial state. A rollout ends before its first frame that is not finite.

    Attributes:
        name: the clip's name.
        kind, style: of the clip; empty if unknown.
        height_m: stature in metres of the avatar.
        fps: frames a second.
        reference: the clip, for this height; at least ``F`` frames.
        link_position: ``(F, 16, 3)`` link origins in the world in metres.
        link_quat: ``(F, 16, 4)`` link orientations, quaternions wxyz.
        joint_angles: ``(F, 33)`` hinge angles in rad; another body has its own hinges, and
            ``link_position`` and ``link_quat`` are where our links are on it.
        foot_clearance: ``(F, 2)`` height in metres of the lowest point of each foot.
        contact_force: ``(F, 2)`` vertical force in N of the floor on each foot, or None for a
            pose shown without physics.
        fell: whether the simulation was ended: lost by 0.5 m, or no longer finite.
        seconds_simulated: simulated time.
        seconds_wall: wall-clock time; in a batch, this rollout's share. 0 if unknown.
        objects: the objects of the scene, with ``F`` poses each.
        body: a body of the user's own that performed it; None for our avatar.
        root: ``(F, 7)`` poses of that body's root link, which need not carry our pelvis.

    Raises:
        InputError: shapes do not agree, a number is not finite or a quaternion not of unit length.
    """

    name: str
    kind: str
    style: str
    height_m: float
    fps: float
    reference: Clip
    link_position: np.ndarray
    link_quat: np.ndarray
    joint_angles: np.ndarray
    foot_clearance: np.ndarray
    contact_force: np.ndarray | None
    fell: bool
    seconds_simulated: float = 0.0
    seconds_wall: float = 0.0
    objects: tuple[ObjectTrack, ...] = ()
    body: OwnBody | None = None
    root: np.ndarray | None = None

    def __post_init__(self) -> None:
        frames = len(self.link_position)
        if not 1 <= frames <= len(self.reference):
            raise InputError(
                f"{frames} simulated frames for {len(self.reference)} of the clip", self.name
            )
        shapes = {
            "link_position": (NUM_LINKS, 3),
            "link_quat": (NUM_LINKS, 4),
            "joint_angles": (self.reference.qpos.shape[1] - 7,),
            "foot_clearance": (len(FEET),),
            "contact_force": (len(FEET),),
        }
        for field, shape in shapes.items():
            array = getattr(self, field)
            if array is not None:
                _check(array, (frames, *shape), field, self.name)
        for field in ("link_position", "link_quat"):
            array = getattr(self.reference, field)[:frames]
            _check(array, (frames, *shapes[field]), f"reference {field}", self.name)
        for i, obj in enumerate(self.objects):
            _check(obj.position, (frames, 3), f"object {i} position", self.name)
            _check(obj.quat, (frames, 4), f"object {i} quat", self.name)
        if not (np.isfinite(self.fps) and self.fps > 0):
            raise InputError(f"frame rate is {self.fps}, not above zero", self.name)

    def __len__(self) -> int:
        return len(self.link_position)

    @property
    def qpos(self) -> np.ndarray:
        """The avatar's poses ``(F, 40)``: the pelvis is the root, then the joint angles.

        Of a body of the user's own, ``(F, 7 + D)``: its root link and its hinges.
        """
        if self.root is not None:
            return np.concatenate([self.root, self.joint_angles], axis=-1)
        root = [self.link_position[:, 0], self.link_quat[:, 0]]
        return np.concatenate([*root, self.joint_angles], axis=-1)

    @cached_property
    def link_error_m(self) -> np.ndarray:
        """Mean link error in metres ``(F,)``."""
        reference = self.reference.link_position[: len(self)]
        return terms.link_error_m(self.link_position, reference)

    @property
    def scored_frames(self) -> int:
        """Number of scored frames: those before the mean link error first exceeds 0.5 m."""
        lost = self.link_error_m > MAX_LINK_ERROR_M
        return int(lost.argmax()) if lost.any() else len(self)

    @property
    def completed(self) -> bool:
        """Whether it did not fall and stayed within 0.5 m."""
        return not self.fell and self.scored_frames == len(self)

    @property
    def contact(self) -> np.ndarray:
        """Whether each foot is in contact ``(F, 2)``, by its force or else its clearance."""
        if self.contact_force is None:
            return self.foot_clearance < CONTACT_CLEARANCE_M
        return self.contact_force > CONTACT_FORCE_N


def _check(array: np.ndarray, shape: tuple[int, ...], field: str, where: str) -> None:
    """Reject errors that a mean would hide: wrong shape, NaN, invalid quaternions."""
    if array.shape != shape:
        raise InputError(f"{field} has shape {array.shape}, not {shape}", where)
    finite = np.isfinite(array)
    if not finite.all():
        frame = np.argwhere(~finite)[0][0]
        raise InputError(f"{field} is not finite at frame {frame}", where)
    if field.endswith("quat"):
        off = np.abs(np.linalg.norm(array, axis=-1) - 1.0) > 1e-3
        if off.any():
            frame = np.argwhere(off)[0][0]
            raise InputError(f"{field} is not of unit length at frame {frame}", where)


def samples(rollout: Rollout) -> dict[str, np.ndarray]:
    """Every sample of every metric of one rollout: name to ``(N,)``, as in ``METRICS``.

    ``N`` differs: one per frame, one less for velocities, three less for jerk, and for skating one
    per foot and pair of frames in contact. Frames count until the fall.
    """
    frames = rollout.scored_frames
    position, quat = rollout.link_position[:frames], rollout.link_quat[:frames]
    reference, fps = rollout.reference, rollout.fps
    want, want_quat = reference.link_position[:frames], reference.link_quat[:frames]
    device_cm, device_deg = terms.device_errors(position, quat, want, want_quat, rollout.height_m)
    feet, soles = list(FOOT_LINKS), sole_spheres(rollout.height_m)

    def skate(at: np.ndarray, turned: np.ndarray, contact: np.ndarray) -> np.ndarray:
        return terms.foot_skate_cm_s(at[:, feet], turned[:, feet], contact[:frames], soles, fps)

    return {
        "mpjpe_cm": terms.mpjpe_cm(position, want),
        "mpjpe_root_aligned_cm": terms.mpjpe_root_aligned_cm(position, want),
        "mpjre_deg": terms.mpjre_deg(quat, want_quat),
        "root_cm": terms.root_cm(position, want),
        "root_deg": terms.root_deg(quat, want_quat),
        "sip_deg": terms.sip_deg(quat, want_quat),
        "jitter_km_s3": terms.jitter_km_s3(position, fps),
        "reference_jitter_km_s3": terms.jitter_km_s3(want, fps),
        "mpjve_cm_s": terms.mpjve_cm_s(position, want, fps),
        "mhpe_cm": device_cm,
        "mhre_deg": device_deg,
        "foot_skate_cm_s": skate(position, quat, rollout.contact),
        "reference_foot_skate_cm_s": skate(want, want_quat, reference.contacts),
        "penetration_cm": terms.penetration_cm(rollout.foot_clearance[:frames]),
    }


def summarise(rollouts: Sequence[Rollout]) -> dict[str, float | int | None]:
    """Figures of one group of rollouts; None where there is nothing to average.

    Keys: ``clips``, ``frames`` (scored), ``success`` (fraction of clips that neither fell nor left
    0.5 m mean link error; Luo et al., ICCV 2023), those of ``samples``, ``real_time_factor``
    (seconds simulated a second of wall clock, the clips of a batch together).
    """
    return _figures([(rollout, samples(rollout)) for rollout in rollouts])


def evaluate(
    rollouts: Sequence[Rollout], context: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """The content of metrics.json: figures over all clips, by kind and by style.

    Each group has two columns: ``all``, every clip until its fall, and ``completed``, only clips
    that were followed to their last frame. With many falls ``completed`` is too optimistic, because
    the hard clips are missing from it. ``intervals`` has the 95 % bootstrap interval over clips of
    each figure of both columns, or None for fewer than 11 clips; a group has those of ``all``.

    Args:
        rollouts: one a clip.
        context: what to record beside the figures: agent, motions, config, versions, hashes.

    Raises:
        InputError: no rollouts.
    """
    if not rollouts:
        raise InputError("no clips were evaluated", fix="check the motions")
    scored = [(rollout, samples(rollout)) for rollout in rollouts]
    return {
        "schema": SCHEMA,
        "version": SCHEMA_VERSION,
        "context": dict(context or {}),
        **_columns(scored),
        "intervals": _columns(scored, _intervals),
        "by_kind": _by(scored, lambda rollout: rollout.kind),
        "by_style": _by(scored, lambda rollout: rollout.style),
    }


_Scored = list[tuple[Rollout, dict[str, np.ndarray]]]


def _by(scored: _Scored, label: Callable[[Rollout], str]) -> dict[str, Any]:
    names = sorted({label(rollout) or "unknown" for rollout, _ in scored})
    groups = {
        name: [item for item in scored if (label(item[0]) or "unknown") == name] for name in names
    }
    return {
        name: {**_columns(group), "intervals": {"all": _intervals(group)}}
        for name, group in groups.items()
    }


def _columns(
    scored: _Scored, figures: Callable[[_Scored], dict[str, Any]] | None = None
) -> dict[str, Any]:
    completed = [item for item in scored if item[0].completed]
    figures = figures or _figures
    return {"all": figures(scored), "completed": figures(completed)}


def _intervals(scored: _Scored) -> dict[str, list[float] | None]:
    """95 % bootstrap intervals over clips of the figures of ``_figures``."""

    def ends(values: list[np.ndarray]) -> list[float] | None:
        known = [v for v in values if len(v)]
        found = interval([v.mean() for v in known], [len(v) for v in known])
        return None if found is None else list(found)

    success = [np.array([float(rollout.completed)]) for rollout, _ in scored]
    return {
        "success": ends(success),
        **{name: ends([s[name] for _, s in scored]) for name in METRICS},
    }


def _figures(scored: _Scored) -> dict[str, float | int | None]:
    wall = sum(rollout.seconds_wall for rollout, _ in scored)
    simulated = sum(rollout.seconds_simulated for rollout, _ in scored)
    return {
        "clips": len(scored),
        "frames": sum(rollout.scored_frames for rollout, _ in scored),
        "success": _mean(np.array([rollout.completed for rollout, _ in scored], float)),
        **{name: _mean(np.concatenate([s[name] for _, s in scored] or [[]])) for name in METRICS},
        "real_time_factor": simulated / wall if wall > 0 else None,
    }


def _mean(values: np.ndarray) -> float | None:
    return float(values.mean()) if len(values) else None


@lru_cache(maxsize=64)
def sole_spheres(height_m: float) -> tuple[np.ndarray, float]:
    """Sole spheres of the feet: centres ``(2, 4, 3)`` in the feet's frames, and radius, in m."""
    ratio = height_m / DEFAULT_HEIGHT_M
    radius = float(build_body().model.geom("left_heel_ball_outer").size[0])
    return (sole_points() + np.array([0.0, 0.0, radius])) * ratio, radius * ratio
