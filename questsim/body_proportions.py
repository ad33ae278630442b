"""Proportions of a person's body: where its joints are, apart from its stature."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import mujoco
import numpy as np

from questsim.assets import mjcf_path
from questsim.errors import InputError
from questsim.skeleton import LINKS

PARTS: tuple[str, ...] = ("arms", "legs", "trunk", "shoulders", "hips")
"""The measures that sum proportions up, each a multiple of the default body's."""
LEAST_PART, MOST_PART = 0.6, 1.6

_SIDES = ("left", "right")
_STRETCHED = {
    "spine": "chest",
    **{
        f"{side}_{link}": f"{side}_{end}"
        for side in _SIDES
        for link, end in (
            ("thigh", "shin"),
            ("shin", "foot"),
            ("upper_arm", "forearm"),
            ("forearm", "hand"),
        )
    },
}
"""Links that stretch along z, and the link at their end."""


@dataclass(frozen=True)
class Proportions:
    """Places of a body's joints, of the person scaled to 1.75 m.

    Attributes:
        places: 16 triples in the order of ``skeleton.LINKS``: each link's origin in its parent's
            frame in metres; the pelvis has zeros.
    """

    places: tuple[tuple[float, float, float], ...] = field(
        default_factory=lambda: _nested(default_places())
    )

    def __post_init__(self) -> None:
        places = np.asarray(self.places, float)
        if places.shape != (len(LINKS), 3) or not np.isfinite(places).all():
            raise InputError(f"places are not {len(LINKS)} triples of metres", "Proportions")
        object.__setattr__(self, "places", _nested(places))
        for name, value in self.parts().items():
            if not LEAST_PART <= value <= MOST_PART:
                raise InputError(
                    f"{name} are {value:.3g} times the default body's, "
                    f"not {LEAST_PART} to {MOST_PART}",
                    "Proportions",
                )

    @staticmethod
    def of_parts(
        *,
        arms: float = 1.0,
        legs: float = 1.0,
        trunk: float = 1.0,
        shoulders: float = 1.0,
        hips: float = 1.0,
    ) -> Proportions:
        """The default body with lengths multiplied.

        Args:
            arms: upper arms and forearms.
            legs: thighs and shins.
            trunk: heights from the hips to the neck and the shoulders.
            shoulders, hips: distances between the left and the right joint.

        Raises:
            InputError: a number outside 0.6 to 1.6.
        """
        places = default_places()
        for side in _SIDES:
            for link in ("forearm", "hand"):
                places[LINKS.index(f"{side}_{link}")] *= arms
            for link in ("shin", "foot"):
                places[LINKS.index(f"{side}_{link}")] *= legs
            places[LINKS.index(f"{side}_upper_arm")] *= [1.0, shoulders, trunk]
            places[LINKS.index(f"{side}_thigh"), 1] *= hips
        for link in ("spine", "chest", "head"):
            places[LINKS.index(link)] *= trunk
        return Proportions(_nested(places))

    def array(self) -> np.ndarray:
        """``(16, 3)`` a copy of ``places``."""
        return np.array(self.places)

    def parts(self) -> dict[str, float]:
        """Each of ``PARTS`` as a multiple of the default body's."""
        here, there = _lengths(self.array()), _lengths(default_places())
        return {name: float(here[name] / there[name]) for name in PARTS}

    def stretch(self) -> np.ndarray:
        """``(16, 3)`` by how much each link is longer along its axes than the default body's."""
        here, there = self.array(), default_places()
        out = np.ones((len(LINKS), 3))
        for link, end in _STRETCHED.items():
            row = LINKS.index(end)
            out[LINKS.index(link), 2] = np.linalg.norm(here[row]) / np.linalg.norm(there[row])
        parts = self.parts()
        spine, arm = LINKS.index("spine"), LINKS.index("left_upper_arm")
        out[LINKS.index("pelvis")] = [1.0, parts["hips"], here[spine, 2] / there[spine, 2]]
        out[LINKS.index("chest")] = [1.0, parts["shoulders"], here[arm, 2] / there[arm, 2]]
        return np.clip(out, 0.4, 2.5)


def drawn_proportions(spread: float, count: int, seed: int) -> list[Proportions]:
    """Proportions of ``count`` people: the logarithm of each part is normal, and apart.

    Args:
        spread: standard deviation of the logarithms; values beyond 2.5 of it are clipped.
        count: number of people.
        seed: same seed, same people; the first do not depend on ``count``.
    """
    rng = np.random.default_rng([seed, 0x50524F50])
    drawn = np.clip(rng.standard_normal((count, len(PARTS))), -2.5, 2.5)
    multiples = np.clip(np.exp(spread * drawn), LEAST_PART, MOST_PART)
    rows = [dict(zip(PARTS, row, strict=True)) for row in multiples.tolist()]
    return [Proportions.of_parts(**row) for row in rows]


def default_places() -> np.ndarray:
    """``(16, 3)`` origins of the default body's links in their parents, in metres."""
    return _default_places().copy()


@lru_cache(maxsize=1)
def _default_model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(mjcf_path("humanoid.xml")))


@lru_cache(maxsize=1)
def _default_places() -> np.ndarray:
    places = _default_model().body_pos[1:].copy()
    places[0] = 0.0
    return places


def _nested(places: np.ndarray) -> tuple[tuple[float, float, float], ...]:
    rows = np.round(np.asarray(places, float), 6).tolist()
    return tuple((row[0], row[1], row[2]) for row in rows)


def _lengths(places: np.ndarray) -> dict[str, float]:
    """Metres of each of ``PARTS``, means of both sides."""

    def row(name: str) -> np.ndarray:
        return places[LINKS.index(name)]

    def both(*links: str) -> float:
        return sum(
            float(np.linalg.norm(row(f"{side}_{link}"))) for side in _SIDES for link in links
        )

    up = row("spine")[2] + row("chest")[2]
    return {
        "arms": both("forearm", "hand"),
        "legs": both("shin", "foot"),
        "trunk": float(up + (row("left_upper_arm")[2] + row("right_upper_arm")[2]) / 2.0),
        "shoulders": float(row("left_upper_arm")[1] - row("right_upper_arm")[1]),
        "hips": float(row("left_thigh")[1] - row("right_thigh")[1]),
    }


def deform(spec: mujoco.MjSpec, proportions: Proportions) -> None:
    """Move the joints of the default body's spec, and stretch its shapes, masses and inertias.

    A stretched link keeps its density: mass and second moments are those of the solid under the
    linear map. Inertias must be explicit.
    """
    here, there = _lengths(proportions.array()), _lengths(default_places())
    longer_m = (here["legs"] - there["legs"]) / 2.0
    for name, place, stretch in zip(LINKS, proportions.array(), proportions.stretch(), strict=True):
        body = spec.body(name)
        body.pos = place
        if name == "pelvis":
            body.pos = [0.0, 0.0, _default_model().body(name).pos[2] + longer_m]
        if (stretch != 1.0).any():
            for geom in body.geoms:
                _stretch_geom(geom, stretch)
            _stretch_inertia(body, stretch)


def _stretch_geom(geom: mujoco.MjsGeom, stretch: np.ndarray) -> None:
    if not np.isnan(geom.fromto[0]):
        geom.fromto = geom.fromto * np.tile(stretch, 2)
        return
    geom.pos = geom.pos * stretch
    if geom.type in (mujoco.mjtGeom.mjGEOM_ELLIPSOID, mujoco.mjtGeom.mjGEOM_BOX):
        geom.size = geom.size * stretch


def _stretch_inertia(body: mujoco.MjsBody, stretch: np.ndarray) -> None:
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, body.iquat)
    axes = turn.reshape(3, 3)
    inertia = axes @ np.diag(body.inertia) @ axes.T
    moments = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    volume = float(np.prod(stretch))
    moments = volume * moments * np.outer(stretch, stretch)
    inertia = np.trace(moments) * np.eye(3) - moments
    values, vectors = np.linalg.eigh(inertia)
    if np.linalg.det(vectors) < 0.0:
        vectors[:, 0] *= -1.0
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(vectors).ravel())
    body.mass = body.mass * volume
    body.ipos = body.ipos * stretch
    body.iquat, body.inertia = quat, values
