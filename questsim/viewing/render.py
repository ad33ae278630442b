"""Off-screen pictures of one or several figures on a floor with a metre grid."""

from __future__ import annotations

import atexit
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from weakref import ref

import mujoco
import numpy as np

from questsim import rotations as rot
from questsim.bodies import BodyMap
from questsim.body_proportions import Proportions
from questsim.heightfield import HeightField
from questsim.objects import ObjectShape
from questsim.sensors import device_poses
from questsim.viewing.camera import FOVY_DEG, Camera
from questsim.viewing.costume import AVATAR, Look, figure_spec
from questsim.viewing.gl import use_gl

_HORIZON = (0.90, 0.92, 0.945)
_ZENITH = (0.70, 0.77, 0.86)
_SUN_DISTANCE_M = 4.0
_OBJECT = (0.89, 0.67, 0.24, 1.0)
_EXTENT_M = 3.0


@dataclass(frozen=True)
class _Light:
    """A directional light; ``toward`` is where it shines: right, away from the camera, up."""

    name: str
    toward: tuple[float, float, float]
    diffuse: float
    shadow: bool


_LIGHTS = (
    _Light("sun", (0.45, 0.40, -1.0), 0.45, True),
    _Light("sky", (-0.7, 0.2, -0.6), 0.12, False),
)
_MARKER_SIZES = {
    "headset": (0.03, 0.085, 0.045),
    "left_controller": (0.045, 0.025, 0.025),
    "right_controller": (0.045, 0.025, 0.025),
}


@dataclass(frozen=True)
class DrawnAvatar:
    """A figure in the picture.

    Attributes:
        height_m: stature in metres.
        look: colours.
        devices: whether headset and controllers are worn.
        body: a body of the user's own, in the colours of its MJCF, or with another look than the
            avatar's in that of its shirt; None for our avatar.
        proportions: of our avatar.
    """

    height_m: float = 1.75
    look: Look = AVATAR
    devices: bool = True
    body: BodyMap | None = None
    proportions: Proportions | None = None


@dataclass(frozen=True)
class Marker:
    """A marker of a device or an object: a box or an ellipsoid.

    Attributes:
        position: ``(3,)`` metres.
        matrix: ``(3, 3)`` orientation.
        size: ``(3,)`` half the edges, or the radii, metres.
        round: whether it is an ellipsoid instead.
    """

    position: np.ndarray
    matrix: np.ndarray
    size: tuple[float, float, float]
    rgba: tuple[float, float, float, float] = (0.10, 0.62, 0.95, 1.0)
    round: bool = False


@dataclass(frozen=True)
class Arrow:
    """An arrow, such as a force.

    Attributes:
        start, end: ``(3,)`` metres.
        radius: of its shaft in metres.
    """

    start: np.ndarray
    end: np.ndarray
    radius: float = 0.014
    rgba: tuple[float, float, float, float] = (0.12, 0.63, 0.35, 1.0)


def object_markers(
    parts: Sequence[ObjectShape], position: np.ndarray, quat: np.ndarray
) -> list[Marker | Arrow]:
    """An object made of ``parts`` that is at ``position`` ``(3,)``, turned by ``quat`` ``(4,)``."""
    turn = rot.quat_to_matrix(quat)
    markers: list[Marker | Arrow] = []
    for part in parts:
        ball = part.shape == "ball"
        x, y, z = part.size * 3 if ball else part.size
        middle = position + turn @ np.array(part.place)
        markers.append(Marker(middle, turn, (x, y, z), _OBJECT, ball))
    return markers


def device_markers(position: np.ndarray, quat: np.ndarray, height_m: float) -> list[Marker | Arrow]:
    """Markers of headset and controllers on links at ``(16, 3)``, turned by ``(16, 4)``."""
    places, turns = device_poses(position, quat, list(_MARKER_SIZES), height_m)
    return [
        Marker(place, rot.quat_to_matrix(turn), size)
        for place, turn, size in zip(places, turns, _MARKER_SIZES.values(), strict=True)
    ]


def _close(renderer: ref[mujoco.Renderer]) -> None:
    left = renderer()
    if left is not None:
        left.close()


class SceneRenderer:
    """Renders figures in given poses; a context manager that frees the OpenGL context.

    Args:
        figures: the figures in the picture.
        width, height: size of the picture in pixels.
        ground: the ground; None for a plane.
        reach_m: radius of the shadows around the middle of the picture.

    Raises:
        NoGLError: there is no OpenGL library to render with.
    """

    def __init__(
        self,
        figures: Sequence[DrawnAvatar],
        width: int = 640,
        height: int = 480,
        ground: HeightField | None = None,
        reach_m: float = _EXTENT_M,
    ) -> None:
        use_gl()
        self.width, self.height = width, height
        self._model = scene_spec(figures, width, height, ground).compile()
        self._model.vis.map.shadowclip = reach_m / _EXTENT_M
        # The same shadows to the metre.
        self._model.vis.quality.shadowsize *= 1 if reach_m <= _EXTENT_M else 2
        self._data = mujoco.MjData(self._model)
        self._renderer = mujoco.Renderer(
            self._model, height, width, max_geom=max(500, 70 * len(figures))
        )
        self._camera = mujoco.MjvCamera()
        # At exit MuJoCo ends OpenGL before it frees renderers that were not closed: that fails.
        self._at_exit = partial(_close, ref(self._renderer))
        atexit.register(self._at_exit)

    def __enter__(self) -> SceneRenderer:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Free the OpenGL context."""
        atexit.unregister(self._at_exit)
        self._renderer.close()

    def render(
        self,
        poses: Sequence[np.ndarray],
        camera: Camera,
        markers: Sequence[Marker | Arrow] = (),
    ) -> np.ndarray:
        """A picture ``(height, width, 3)`` uint8 of each figure in its pose ``(40,)``."""
        self._data.qpos[:] = np.concatenate(poses)
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        view = self._camera
        view.lookat[:] = camera.lookat
        view.distance, view.azimuth = camera.distance, camera.azimuth_deg
        view.elevation = camera.elevation_deg
        self._model.vis.global_.fovy = camera.fovy_deg
        self._renderer.update_scene(self._data, view)
        scene = self._renderer.scene
        scene.flags[mujoco.mjtRndFlag.mjRND_HAZE] = True
        _aim_lights(scene, camera)
        for marker in markers:
            if isinstance(marker, Arrow):
                _add_arrow(scene, marker)
            else:
                _add_box(scene, marker)
        return self._renderer.render()


def _aim_lights(scene: mujoco.MjvScene, camera: Camera) -> None:
    """Turn the lights with the view: whichever way people walk, they are lit alike."""
    right, _, forward = camera.axes()
    forward = forward * [1.0, 1.0, 0.0] / np.linalg.norm(forward[:2])
    for light in scene.lights[: scene.nlight]:
        if light.headlight:
            continue
        across, along, up = _LIGHTS[light.id].toward
        light.dir = across * right + along * forward + np.array([0.0, 0.0, up])
        light.dir /= np.linalg.norm(light.dir)
        light.pos = camera.lookat * [1.0, 1.0, 0.0] - _SUN_DISTANCE_M * np.array(light.dir)


def scene_spec(
    figures: Sequence[DrawnAvatar], width: int, height: int, ground: HeightField | None = None
) -> mujoco.MjSpec:
    """Floor, sky, light and the figures, named ``0/...``, ``1/...`` in the order given."""
    spec = mujoco.MjSpec()
    spec.stat.extent, spec.stat.center = _EXTENT_M, np.array([0.0, 0.0, 0.9])
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = width, height
    visual.global_.fovy = FOVY_DEG
    visual.quality.shadowsize, visual.quality.offsamples = 2048, 4
    visual.map.znear, visual.map.zfar, visual.map.shadowclip = 0.05, 30.0, 1.0
    visual.map.haze = 0.4
    visual.rgba.haze[:] = (*_HORIZON, 1.0)
    visual.headlight.ambient[:] = 0.42
    visual.headlight.diffuse[:] = 0.22
    visual.headlight.specular[:] = 0.0
    for light in _LIGHTS:
        _add_light(spec, light)
    _add_sky_and_floor(spec)
    if ground is not None:
        ground.replace_floor(spec)
    for i, figure in enumerate(figures):
        if figure.body is not None:
            person = figure.body.looks(figure.height_m)
            if figure.look is not AVATAR:
                _paint(person, figure.look.shirt)
        else:
            person = figure_spec(figure.height_m, figure.look, figure.devices, figure.proportions)
        # MuJoCo warns on stderr of every option in which a guest differs from its host.
        spec.option.timestep, spec.option.integrator = (
            person.option.timestep,
            person.option.integrator,
        )
        spec.memory = person.memory
        spec.attach(person, prefix=f"{i}/", frame=spec.worldbody.add_frame())
    return spec


def _paint(spec: mujoco.MjSpec, rgba: tuple[float, float, float, float]) -> None:
    """Give every shape of a body one colour."""
    for geom in spec.geoms:
        geom.material, geom.rgba = "", rgba


def _add_light(spec: mujoco.MjSpec, light: _Light) -> None:
    spec.worldbody.add_light(
        name=light.name,
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[0.0, 0.0, _SUN_DISTANCE_M],
        dir=[0.0, 0.0, -1.0],
        diffuse=[light.diffuse] * 3,
        ambient=[0.0] * 3,
        specular=[0.25 if light.shadow else 0.0] * 3,
        castshadow=light.shadow,
    )


def _add_sky_and_floor(spec: mujoco.MjSpec) -> None:
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=_HORIZON,
        rgb2=_ZENITH,
        width=256,
        height=256,
    )
    tile = metre_tile()
    texture = spec.add_texture(
        name="grid",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        width=tile.shape[1],
        height=tile.shape[0],
        nchannel=3,
    )
    texture.data = tile.tobytes()
    material = spec.add_material(
        name="grid", texuniform=True, texrepeat=[0.5, 0.5], specular=0.0, shininess=0.0
    )
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "grid"
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 1],
        material="grid",
        contype=0,
        conaffinity=0,
    )


def metre_tile(pixels: int = 1024) -> np.ndarray:
    """Two by two metres of floor ``(pixels, pixels, 3)`` uint8: checks, metre and 25 cm lines."""
    x = (np.arange(pixels) + 0.5) * 2.0 / pixels
    check = (np.floor(x)[:, None] + np.floor(x)[None]) % 2
    tone = 205.0 + 14.0 * check

    def lines(every: float, half_width: float) -> np.ndarray:
        near = np.abs(x - np.round(x / every) * every) < half_width
        return near[:, None] | near[None]

    tone[lines(0.25, 0.003)] -= 12.0
    tone[lines(1.0, 0.010)] = 150.0
    return np.stack([tone * 0.97, tone * 0.985, tone], axis=-1).clip(0, 255).astype(np.uint8)


def _add_box(scene: mujoco.MjvScene, marker: Marker) -> None:
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(
        geom,
        mujoco.mjtGeom.mjGEOM_ELLIPSOID if marker.round else mujoco.mjtGeom.mjGEOM_BOX,
        np.array(marker.size, float),
        marker.position,
        marker.matrix.ravel(),
        np.array(marker.rgba, np.float32),
    )
    scene.ngeom += 1


def _add_arrow(scene: mujoco.MjvScene, arrow: Arrow) -> None:
    geom = scene.geoms[scene.ngeom]
    nothing = np.zeros(3)
    kind = mujoco.mjtGeom.mjGEOM_ARROW
    mujoco.mjv_initGeom(
        geom, kind, nothing, nothing, np.eye(3).ravel(), np.array(arrow.rgba, np.float32)
    )
    # MuJoCo draws an arrow at half the given length.
    mujoco.mjv_connector(geom, kind, arrow.radius, arrow.start, 2.0 * arrow.end - arrow.start)
    scene.ngeom += 1
