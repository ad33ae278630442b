"""The scene of the page: the avatar, its user, the floor and the forces."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import groupby

import numpy as np
import trimesh
import viser
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from questsim.body import DEFAULT_HEIGHT_M
from questsim.heightfield import HeightField
from questsim.objects import ObjectShape
from questsim.skeleton import LINKS
from questsim.viewing.costume import AVATAR, REFERENCE, Piece, costume_pieces
from questsim.viewing.live import Scenery, Snapshot, force_arrows
from questsim.viewing.render import metre_tile

SKY = (226, 232, 240)
_OBJECT_COLOURS = [[240, 236, 224], [226, 170, 60]]
_FLAT_HALF_SIZE_M = 40.0
_GHOST_OPACITY = 0.18
_ARROW_HEAD_M = 0.06
_FORCE_COLOUR, _PUSH_COLOUR = (30, 160, 90), (200, 40, 40)
_FOLLOW_S = 0.35
"""Time constant of the camera's following."""


class PageScene:
    """Everything in the picture; ``show`` updates it to a snapshot.

    The world moves and the camera stays, so each viewer can turn their own view freely.

    Args:
        server: server of the page.

    Attributes:
        follow, ghost, devices, forces: visible parts, as chosen on the panel.
    """

    def __init__(self, server: viser.ViserServer) -> None:
        self._server, self._scene = server, server.scene
        self.follow, self.ghost, self.devices, self.forces = True, True, True, True
        self._scenery: Scenery | None = None
        self._centre = np.zeros(3)
        self._time_s = 0.0
        _light(server)
        self._world = self._scene.add_frame("/world", show_axes=False)
        self._avatar = [self._link(f"/world/avatar/{link}", link) for link in LINKS]
        self._person = [self._ghost_link(f"/world/user/{link}", link) for link in LINKS]
        # Browsers do not draw what is out of sight, and compute the place of batched markers only
        # once. So these stay near a frame that moves with the avatar.
        self._near = self._scene.add_frame("/world/near", show_axes=False)
        self._axes = self._scene.add_batched_axes(
            "/world/near/devices",
            np.tile([1.0, 0.0, 0.0, 0.0], (1, 1)),
            np.zeros((1, 3)),
            axes_length=0.16,
            axes_radius=0.007,
        )
        self._arrows = self._scene.add_arrows(
            "/world/near/forces",
            np.tile([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]], (3, 1, 1)),
            np.array([_FORCE_COLOUR, _FORCE_COLOUR, _PUSH_COLOUR], np.uint8),
            shaft_radius=0.012,
            head_radius=0.03,
            head_length=_ARROW_HEAD_M,
        )
        self._ground: viser.SceneNodeHandle | None = None
        self._object: viser.SceneNodeHandle | None = None

    def _link(self, name: str, link: str) -> viser.SceneNodeHandle:
        return self._scene.add_mesh_trimesh(name, _clothed(link))

    def _ghost_link(self, name: str, link: str) -> viser.SceneNodeHandle:
        mesh = _merged(_pieces(False)[link])
        return self._scene.add_mesh_simple(
            name,
            mesh.vertices,
            mesh.faces,
            color=np.array(REFERENCE.shirt[:3]),
            opacity=_GHOST_OPACITY,
            cast_shadow=False,
            receive_shadow=False,
        )

    def show(self, snapshot: Snapshot) -> None:
        """Update the picture to a snapshot."""
        with self._server.atomic():
            if snapshot.scenery != self._scenery:
                self._set(snapshot.scenery)
            for nodes, position, quat in (
                (self._avatar, snapshot.position, snapshot.quat),
                (self._person, snapshot.reference_position, snapshot.reference_quat),
            ):
                if nodes is self._person and not self.ghost:
                    continue
                for node, where, turn in zip(nodes, position, quat, strict=True):
                    node.position, node.wxyz = where, turn
            for node in self._person:
                if node.visible != self.ghost:
                    node.visible = self.ghost
            root = snapshot.position[0]
            self._near.position = root
            if self.devices:
                around = snapshot.device_position - root
                self._axes.batched_positions = around.astype(np.float32)
                self._axes.batched_wxyzs = snapshot.device_quat.astype(np.float32)
            if self.forces:
                self._arrows.points = (_arrow_points(snapshot) - root).astype(np.float32)
            for node, visible in ((self._axes, self.devices), (self._arrows, self.forces)):
                if node.visible != visible:
                    node.visible = visible
            if self._object is not None and snapshot.object_pose is not None:
                self._object.position, self._object.wxyz = snapshot.object_pose
            self._move_world(snapshot)

    def _set(self, scenery: Scenery) -> None:
        """Replace the scenery."""
        before, self._scenery = self._scenery, scenery
        for nodes, height_m in ((self._avatar, scenery.height_m), (self._person, scenery.user_m)):
            for node in nodes:
                scale = height_m / DEFAULT_HEIGHT_M
                node.scale = scale  # pyright: ignore[reportAttributeAccessIssue]
        if self._ground is None or before is None or before.ground is not scenery.ground:
            self._ground = self._scene.add_mesh_trimesh(
                "/world/ground", ground_mesh(scenery.ground), cast_shadow=False
            )
        if self._object is not None:
            self._object.remove()
            self._object = None
        if scenery.parts:
            self._object = self._scene.add_mesh_trimesh("/world/object", object_mesh(scenery.parts))
        self._centre = np.full(3, np.nan)

    def _move_world(self, snapshot: Snapshot) -> None:
        """Move the world smoothly so that the avatar stays in the middle."""
        aim = snapshot.position[0] - [0.0, 0.0, 0.53 * snapshot.scenery.height_m]
        elapsed = abs(snapshot.step / 36.0 - self._time_s)
        self._time_s = snapshot.step / 36.0
        if np.isnan(self._centre).any() or np.linalg.norm(aim - self._centre) > 2.0:
            self._centre = aim  # a clip has begun somewhere else: no glide across the world
        elif self.follow:
            share = 1.0 - np.exp(-elapsed / np.array([_FOLLOW_S, _FOLLOW_S, 3.0 * _FOLLOW_S]))
            self._centre = self._centre + share * (aim - self._centre)
        self._world.position = -self._centre


def _light(server: viser.ViserServer) -> None:
    """Sun, sky and haze, and from where a viewer first looks."""
    scene = server.scene
    scene.set_background_image(np.full((2, 2, 3), SKY, np.uint8), format="png")
    scene.configure_fog(8.0, 22.0, color=SKY)
    scene.configure_environment_map(None)
    scene.configure_default_lights(enabled=False)
    scene.add_light_ambient("/lights/ambient", intensity=0.9)
    scene.add_light_hemisphere(
        "/lights/sky", sky_color=(255, 255, 255), ground_color=(190, 185, 180), intensity=0.9
    )
    scene.add_light_directional(
        "/lights/sun",
        color=(255, 246, 230),
        intensity=2.2,
        cast_shadow=True,
        position=(2.5, -3.0, 5.0),
    )
    server.initial_camera.position = (2.5, 2.2, 1.55)
    server.initial_camera.look_at = (0.0, 0.0, 0.85)
    server.initial_camera.fov = float(np.radians(40.0))


def _arrow_points(snapshot: Snapshot) -> np.ndarray:
    """Ends ``(3, 2, 3)`` of the arrows of both feet's forces and of a push."""
    points = force_arrows(snapshot)
    chest = snapshot.position[LINKS.index("chest")] + [0.0, 0.0, 0.1]
    # An arrow shorter than its head would be all head: it waits inside the chest.
    hidden = np.linalg.norm(points[:, 1] - points[:, 0], axis=-1) < _ARROW_HEAD_M
    points[hidden] = chest - [[0.0, 0.0, 0.04], [0.0, 0.0, -0.02]]
    return points


@lru_cache(maxsize=2)
def _pieces(devices: bool) -> dict[str, list[Piece]]:
    pieces = sorted(costume_pieces(devices), key=lambda piece: piece.link)
    return {link: list(group) for link, group in groupby(pieces, key=lambda piece: piece.link)}


def _merged(pieces: list[Piece]) -> trimesh.Trimesh:
    """One mesh of several pieces, with their exact normals."""
    starts = np.cumsum([0, *(len(piece.vertices) for piece in pieces)])
    return trimesh.Trimesh(
        vertices=np.concatenate([piece.vertices for piece in pieces]),
        faces=np.concatenate([p.faces + start for p, start in zip(pieces, starts, strict=False)]),
        vertex_normals=np.concatenate([piece.normals for piece in pieces]),
        process=False,
    )


def _clothed(link: str) -> trimesh.Trimesh:
    """What the avatar wears on a link, in its colours."""
    pieces = _pieces(True)[link]
    mesh = _merged(pieces)
    # A texture with one pixel for each colour: colours at vertices come without a material, and
    # browsers take such a mesh for metal.
    palette = np.array([list(vars(AVATAR).values())])
    pixel = [list(vars(AVATAR)).index(piece.material) for piece in pieces]
    u = np.repeat((np.array(pixel) + 0.5) / palette.shape[1], [len(p.vertices) for p in pieces])
    image = Image.fromarray((255 * palette[..., :3]).round().astype(np.uint8))
    mesh.visual = _textured(np.column_stack([u, np.full_like(u, 0.5)]), image, roughness=0.75)
    return mesh


def _textured(uv: np.ndarray, image: Image.Image, roughness: float = 1.0) -> TextureVisuals:
    material = PBRMaterial(baseColorTexture=image, metallicFactor=0.0, roughnessFactor=roughness)
    return TextureVisuals(uv=uv, material=material)


def ground_mesh(ground: HeightField | None) -> trimesh.Trimesh:
    """The floor with its checks of one metre; a flat one is 80 m wide."""
    if ground is None:
        ground = HeightField.of(np.zeros((2, 2)), 2.0 * _FLAT_HALF_SIZE_M)
    rows, columns = ground.height.shape
    x = ground.origin[0] + ground.cell_m * np.arange(columns)
    y = ground.origin[1] + ground.cell_m * np.arange(rows)
    xy = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    vertices = np.column_stack([xy, ground.height.ravel()])
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    # Cut as MuJoCo cuts the cells of a height field.
    lower = np.stack([corner, corner + 1, corner + columns + 1], axis=-1)
    upper = np.stack([corner, corner + columns + 1, corner + columns], axis=-1)
    # Normals are given, since GLB files without them are shaded flat.
    slope_y, slope_x = np.gradient(ground.height, y, x)
    normals = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=-1).reshape(-1, 3)
    mesh = trimesh.Trimesh(
        vertices=vertices,
        faces=np.concatenate([lower, upper]),
        vertex_normals=normals / np.linalg.norm(normals, axis=-1, keepdims=True),
        process=False,
    )
    mesh.visual = _textured(xy / 2.0, Image.fromarray(metre_tile(512)))
    return mesh


def object_mesh(parts: Sequence[ObjectShape]) -> trimesh.Trimesh:
    """An object in two colours, so that its rolling shows."""
    vertices, faces, count = [], [], 0
    for part in parts:
        if part.shape == "ball":
            shape = trimesh.creation.icosphere(subdivisions=3, radius=part.size[0])
        else:
            shape = trimesh.creation.box(extents=2.0 * np.array(part.size))
        vertices.append(shape.vertices + np.array(part.place))
        faces.append(shape.faces + count)
        count += len(shape.vertices)
    mesh = trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False)
    half = (mesh.vertices > mesh.bounds.mean(axis=0)).sum(axis=1) % 2
    image = Image.fromarray(np.array([_OBJECT_COLOURS], np.uint8))
    mesh.visual = _textured(np.column_stack([0.25 + 0.5 * half, 0.5 + 0.0 * half]), image, 0.5)
    return mesh
