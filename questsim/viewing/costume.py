"""Visual shapes of the avatar: convex shapes for each link of the physics model.

Only rendering uses these shapes. They are scaled with the joints of the spec, so they fit every
height. The soles are those of the physics model, so that a foot in the air is visibly in the air.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

from questsim.body import DEFAULT_HEIGHT_M, scaled_spec
from questsim.body_proportions import Proportions

Rgba = tuple[float, float, float, float]
Blobs = list[tuple[float, ...]]  # x y z and one radius, or x y z and three; metres, 1.75 m body


@dataclass(frozen=True)
class Look:
    """Colours of a figure, as red, green, blue and opacity in 0 to 1."""

    shirt: Rgba
    trousers: Rgba
    skin: Rgba
    hair: Rgba
    shoe: Rgba
    sole: Rgba
    device: Rgba = (0.93, 0.94, 0.95, 1.0)
    visor: Rgba = (0.10, 0.11, 0.13, 1.0)

    def faded(self, opacity: float) -> Look:
        """The same colours, see-through."""
        return Look(*((*rgba[:3], opacity) for rgba in vars(self).values()))


AVATAR = Look(
    shirt=(0.95, 0.47, 0.27, 1.0),
    trousers=(0.27, 0.31, 0.40, 1.0),
    skin=(0.92, 0.73, 0.60, 1.0),
    hair=(0.20, 0.15, 0.13, 1.0),
    shoe=(0.30, 0.32, 0.36, 1.0),
    sole=(0.95, 0.95, 0.93, 1.0),
)
"""The simulated avatar: warm."""

REFERENCE = Look(
    shirt=(0.30, 0.52, 0.84, 1.0),
    trousers=(0.36, 0.47, 0.66, 1.0),
    skin=(0.62, 0.73, 0.88, 1.0),
    hair=(0.30, 0.42, 0.62, 1.0),
    shoe=(0.36, 0.47, 0.66, 1.0),
    sole=(0.80, 0.87, 0.95, 1.0),
)
"""The recorded person: blue all over."""


def figure_spec(
    height_m: float, look: Look, devices: bool = True, proportions: Proportions | None = None
) -> mujoco.MjSpec:
    """A figure for rendering: the physics body's links and joints with the visual shapes.

    Args:
        height_m: stature, 1.2 to 2.2 m.
        look: the colours.
        devices: whether the figure wears the headset and holds the controllers.
        proportions: of the body.

    Raises:
        InputError: height out of range.
    """
    spec = scaled_spec(height_m, proportions=proportions)
    for unseen in (*spec.sensors, *spec.actuators, *spec.excludes, *spec.lights):
        spec.delete(unseen)
    for name, rgba in vars(look).items():
        spec.add_material(name=name, rgba=rgba, specular=0.15, shininess=0.2)
    ratio = height_m / DEFAULT_HEIGHT_M
    for link, material, blobs in list(_worn(spec, ratio, devices)):
        _dress(spec, link, material, _scaled(blobs, ratio))
    for geom in list(spec.geoms):
        if not geom.name.startswith("costume"):
            spec.delete(geom)
    return spec


@dataclass(frozen=True)
class Piece:
    """A mesh of the costume, in its link's frame, of the 1.75 m body.

    Attributes:
        link: name of its link.
        material: a field of ``Look``.
        vertices, normals: ``(m, 3)`` metres, unit vectors.
        faces: ``(f, 3)`` indices of vertices.
    """

    link: str
    material: str
    vertices: np.ndarray
    normals: np.ndarray
    faces: np.ndarray


def costume_pieces(devices: bool = True, proportions: Proportions | None = None) -> list[Piece]:
    """The whole costume of the 1.75 m body as meshes, for viewers other than MuJoCo's."""
    spec = scaled_spec(proportions=proportions)
    return [
        Piece(link, material, *convex_hull(_scaled(blobs, 1.0)))
        for link, material, blobs in _worn(spec, 1.0, devices)
    ]


def _worn(spec: mujoco.MjSpec, ratio: float, devices: bool) -> Iterator[tuple[str, str, Blobs]]:
    yield from _parts(spec, ratio)
    if devices:
        yield from _device_parts(spec, ratio)


def _parts(spec: mujoco.MjSpec, ratio: float) -> Iterator[tuple[str, str, Blobs]]:
    """Every shape as (link, material, blobs of the 1.75 m body)."""
    eyes = spec.site("headset").pos[2] / ratio
    neck = spec.body("head").pos[2] / ratio
    _, shoulder_y, shoulder_z = spec.body("left_upper_arm").pos / ratio
    yield "pelvis", "trousers", _both(
        (0, 0.068, -0.03, 0.092, 0.088, 0.075), (-0.01, 0.055, 0.03, 0.098, 0.085, 0.06),
        (0, 0.055, 0.10, 0.084, 0.068, 0.04),
    )  # fmt: skip
    yield "spine", "shirt", _both(
        (0, 0.065, -0.055, 0.094, 0.078, 0.03), (0, 0.052, 0.05, 0.086, 0.072, 0.06),
        (0.0, 0.05, 0.14, 0.09, 0.085, 0.06),
    )  # fmt: skip
    yield "chest", "shirt", _both(
        (0.0, 0.045, 0.03, 0.092, 0.088, 0.08), (0.012, 0.05, 0.12, 0.098, 0.1, 0.1),
        (-0.012, shoulder_y - 0.065, shoulder_z - 0.025, 0.062, 0.055, 0.05),
        (-0.008, 0.025, neck - 0.005, 0.056, 0.056, 0.025),
    )  # fmt: skip
    yield "head", "skin", [(-0.005, 0, -0.02, 0.055), (0.012, 0, eyes - 0.08, 0.05)]
    yield "head", "skin", [
        (0.018, 0, eyes + 0.016, 0.096, 0.076, 0.09), (0.045, 0, eyes - 0.072, 0.055, 0.048, 0.045),
    ]  # fmt: skip
    yield "head", "hair", [
        (0.002, 0, eyes + 0.027, 0.098, 0.081, 0.0855), (-0.03, 0, eyes - 0.04, 0.06, 0.07, 0.05),
    ]  # fmt: skip
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for link, material, blobs in _side_parts(side, spec, ratio):
            yield link, material, [(x, sign * y, z, *radii) for x, y, z, *radii in blobs]
        yield f"{side}_foot", "sole", _soles(spec.body(f"{side}_foot"), ratio)


def _side_parts(side: str, spec: mujoco.MjSpec, ratio: float) -> Iterator[tuple[str, str, Blobs]]:
    """One leg and one arm, drawn for the left."""
    knee, ankle, elbow, wrist = (
        spec.body(f"{side}_{link}").pos[2] / ratio for link in ("shin", "foot", "forearm", "hand")
    )
    thigh, upper_arm, forearm = f"{side}_thigh", f"{side}_upper_arm", f"{side}_forearm"
    yield (
        thigh,
        "trousers",
        [(0, 0.002, -0.02, 0.083), (0.008, 0, -0.15, 0.077), (0, 0, knee, 0.056)],
    )
    yield (
        f"{side}_shin",
        "trousers",
        [(0, 0, 0, 0.0555), (-0.012, 0, -0.11, 0.057), (-0.004, 0, ankle + 0.05, 0.044)],
    )
    yield f"{side}_foot", "shoe", [
        (-0.012, 0, 0.01, 0.041), (-0.028, 0, -0.03, 0.034), (0.05, 0, -0.025, 0.036),
        (0.14, 0.002, -0.042, 0.045, 0.04, 0.02),
    ]  # fmt: skip
    yield upper_arm, "shirt", [(0, -0.004, 0.0, 0.053), (0, 0, -0.06, 0.053), (0, 0, -0.17, 0.048)]
    yield upper_arm, "skin", [(0, 0, -0.13, 0.042), (0, 0, elbow, 0.036)]
    yield (
        forearm,
        "skin",
        [(0, 0, 0, 0.037), (0.004, 0, -0.07, 0.039), (0, 0, wrist, 0.027, 0.023, 0.025)],
    )
    hand = f"{side}_hand"
    yield hand, "skin", [(0, 0, -0.005, 0.026, 0.021, 0.02), (0.002, 0, -0.085, 0.042, 0.017, 0.02)]
    yield (
        hand,
        "skin",
        [(0.0, -0.004, -0.09, 0.038, 0.014, 0.015), (0, -0.022, -0.155, 0.028, 0.011, 0.015)],
    )
    yield hand, "skin", [(0.025, -0.005, -0.03, 0.014), (0.052, -0.016, -0.085, 0.011)]


def _device_parts(spec: mujoco.MjSpec, ratio: float) -> Iterator[tuple[str, str, Blobs]]:
    """Headset and controllers, where the model's sites are."""
    x, y, z = spec.site("headset").pos / ratio
    yield "head", "device", [
        (x + dx, y + dy, z + dz, 0.016)
        for dx in (-0.045, 0.008) for dy in (-0.072, 0.072) for dz in (-0.032, 0.032)
    ]  # fmt: skip
    yield "head", "visor", [
        (x + dx, y + dy, z + dz, 0.012)
        for dx in (0.0, 0.016) for dy in (-0.064, 0.064) for dz in (-0.026, 0.026)
    ]  # fmt: skip
    yield "head", "visor", [(0.008, 0, z + 0.012, 0.107, 0.087, 0.015)]
    for side in ("left", "right"):
        x, y, z = spec.site(f"{side}_controller").pos / ratio
        yield (
            f"{side}_hand",
            "device",
            [(x - 0.03, y, z - 0.01, 0.017), (x + 0.05, y, z + 0.005, 0.022)],
        )
        yield f"{side}_hand", "visor", [(x + 0.055, y, z + 0.008, 0.014, 0.042, 0.042)]


def _both(*blobs: tuple[float, ...]) -> Blobs:
    """Blobs and their mirror images."""
    return [(x, s * y, z, *radii) for x, y, z, *radii in blobs for s in (1.0, -1.0)]


def _soles(foot: mujoco.MjsBody, ratio: float) -> Blobs:
    """The outline of the shapes that touch the floor, of the 1.75 m body."""
    blobs: Blobs = []
    for geom in foot.geoms:
        if geom.contype and not np.isnan(geom.fromto[0]):
            for end in (geom.fromto[:3], geom.fromto[3:]):
                blobs.append((*(end / ratio), geom.size[0] / ratio))
        elif geom.type == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            blobs.append((*(geom.pos / ratio), *(geom.size / ratio)))
    return blobs


def _scaled(blobs: Blobs, ratio: float) -> np.ndarray:
    """Blobs as ``(n, 6)``: centres and three radii, in metres of the scaled body."""
    return ratio * np.array([(*b, b[3], b[3]) if len(b) == 4 else b for b in blobs], float)


def _dress(spec: mujoco.MjSpec, link: str, material: str, blobs: np.ndarray) -> None:
    """Add the convex hull of ``blobs`` to a link."""
    name = f"costume{len(spec.meshes)}"
    vertices, normals, faces = convex_hull(blobs)
    spec.add_mesh(
        name=name,
        uservert=vertices.ravel(),
        usernormal=normals.ravel(),
        userface=faces.ravel(),
    )
    spec.body(link).add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        material=material,
        contype=0,
        conaffinity=0,
        group=0,
    )


def convex_hull(blobs: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The smooth convex hull of ellipsoids ``(n, 6)``: vertices, normals ``(m, 3)``, faces.

    Where the hull touches an ellipsoid they share the normal, so normals are exact and the
    surface shades smoothly however long its triangles are.
    """
    sphere = _sphere_points()
    vertices = (blobs[:, None, :3] + blobs[:, None, 3:] * sphere).reshape(-1, 3)
    normals = (sphere / blobs[:, None, 3:]).reshape(-1, 3)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    hull = ConvexHull(vertices)
    faces = hull.simplices.copy()
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    inward = np.sum(np.cross(b - a, c - a) * hull.equations[:, :3], axis=-1) < 0
    faces[inward] = faces[inward][:, ::-1]
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], normals[used], faces.reshape(-1, 3).astype(np.int32)


def _sphere_points(around: int = 28, rings: int = 13) -> np.ndarray:
    """Points ``(n, 3)`` on the unit sphere, in rings about z.

    Rings of neighbouring shapes line up, so the hull between them is of long clean quads.
    """
    polar = np.linspace(0.0, np.pi, rings + 2)[1:-1, None]
    turn = np.arange(around) * 2.0 * np.pi / around
    ring = np.stack(np.broadcast_arrays(np.cos(turn), np.sin(turn)), axis=-1)
    body = np.concatenate(
        [
            np.sin(polar)[..., None] * ring,
            np.broadcast_to(np.cos(polar)[..., None], (rings, around, 1)),
        ],
        axis=-1,
    )
    return np.concatenate([body.reshape(-1, 3), [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]])
