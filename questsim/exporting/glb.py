"""GLB files: the avatar as sixteen rigid parts, and its motion as an animation (glTF 2.0)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pygltflib as gltf

from questsim.body import DEFAULT_HEIGHT_M
from questsim.exporting.axes import local_quats, y_up, y_up_quat
from questsim.motion.clip import FPS, Clip
from questsim.motion.kinematics import link_offsets
from questsim.skeleton import LINK_PARENTS, LINKS
from questsim.viewing.costume import AVATAR, costume_pieces

ROUGHNESS = 0.75


class _Buffer:
    """The binary part of a GLB file, and its accessors."""

    def __init__(self) -> None:
        self.file = gltf.GLTF2()
        self.file.scene = 0
        self._bytes = bytearray()

    def add(self, array: np.ndarray, kind: str, target: int | None = None) -> int:
        """Index of a new accessor for ``(n,)`` scalars or ``(n, m)`` vectors."""
        wide = array.dtype == np.float32
        data = np.ascontiguousarray(array).tobytes()
        view = gltf.BufferView(
            buffer=0, byteOffset=len(self._bytes), byteLength=len(data), target=target
        )
        self.file.bufferViews.append(view)
        self._bytes += data + b"\0" * (-len(data) % 4)
        flat = array.reshape(len(array), -1)
        self.file.accessors.append(
            gltf.Accessor(
                bufferView=len(self.file.bufferViews) - 1,
                componentType=gltf.FLOAT if wide else gltf.UNSIGNED_SHORT,
                count=len(array),
                type=kind,
                min=flat.min(axis=0).tolist(),
                max=flat.max(axis=0).tolist(),
            )
        )
        return len(self.file.accessors) - 1

    def content(self) -> bytes:
        """The whole file."""
        self.file.buffers = [gltf.Buffer(byteLength=len(self._bytes))]
        self.file.set_binary_blob(bytes(self._bytes))
        return b"".join(self.file.save_to_bytes())


def avatar_glb(height_m: float, clip: Clip | None = None, devices: bool = False) -> bytes:
    """The avatar of a stature; its nodes are named as ``skeleton.LINKS``, y up, facing +z.

    Args:
        height_m: stature in metres.
        clip: motion for the file's animation; None for the zero pose without animation.
        devices: whether it wears a headset and holds controllers.
    """
    buffer, ratio = _Buffer(), height_m / DEFAULT_HEIGHT_M
    file = buffer.file
    file.asset = gltf.Asset(version="2.0", generator="questsim")
    colours = list(vars(AVATAR).items())
    file.materials = [_material(name, rgba) for name, rgba in colours]
    material = {name: number for number, (name, _) in enumerate(colours)}
    body = None if clip is None else clip.proportions
    offsets = y_up(link_offsets(body)) * ratio
    for link, name in enumerate(LINKS):
        children = [i for i, p in enumerate(LINK_PARENTS) if p == link and i != link]
        node = gltf.Node(name=name, children=children, mesh=link)
        node.translation = offsets[link].tolist()
        file.nodes.append(node)
        file.meshes.append(gltf.Mesh(name=name))
    for piece in costume_pieces(devices, body):
        attributes = gltf.Attributes(
            POSITION=_vectors(buffer, y_up(piece.vertices) * ratio),
            NORMAL=_vectors(buffer, y_up(piece.normals)),
        )
        faces = piece.faces.astype(np.uint16).ravel()
        indices = buffer.add(faces, gltf.SCALAR, gltf.ELEMENT_ARRAY_BUFFER)
        file.meshes[LINKS.index(piece.link)].primitives.append(
            gltf.Primitive(
                attributes=attributes, indices=indices, material=material[piece.material]
            )
        )
    file.scenes = [gltf.Scene(nodes=[0])]
    if clip is not None:
        file.animations = [_animation(buffer, clip)]
    return buffer.content()


def write_glb(path: Path, clip: Clip) -> None:
    """Write the avatar of a clip with the clip as its animation."""
    path.write_bytes(avatar_glb(clip.height_m, clip))


def _vectors(buffer: _Buffer, array: np.ndarray) -> int:
    return buffer.add(array.astype(np.float32), gltf.VEC3, gltf.ARRAY_BUFFER)


def _material(name: str, rgba: tuple[float, ...]) -> gltf.Material:
    # glTF's factors are linear, ours are sRGB.
    linear = [*(round(part**2.2, 4) for part in rgba[:3]), rgba[3]]
    surface = gltf.PbrMetallicRoughness(
        baseColorFactor=linear, metallicFactor=0.0, roughnessFactor=ROUGHNESS
    )
    return gltf.Material(name=name, pbrMetallicRoughness=surface)


def _animation(buffer: _Buffer, clip: Clip) -> gltf.Animation:
    """Rotations of all links and the path of the pelvis, linear between frames."""
    animation = gltf.Animation(name=clip.name)
    times = buffer.add((np.arange(len(clip)) / FPS).astype(np.float32), gltf.SCALAR)

    def move(link: int, path: str, values: np.ndarray, kind: str) -> None:
        output = buffer.add(values.astype(np.float32), kind)
        sampler: Any = gltf.AnimationSampler(input=times, output=output)
        animation.samplers.append(sampler)
        target = gltf.AnimationChannelTarget(node=link, path=path)
        animation.channels.append(
            gltf.AnimationChannel(sampler=len(animation.samplers) - 1, target=target)
        )

    move(0, "translation", y_up(clip.link_position[:, 0]), gltf.VEC3)
    turns = y_up_quat(local_quats(clip.link_quat, LINK_PARENTS))[..., [1, 2, 3, 0]]
    for link in range(len(LINKS)):
        move(link, "rotation", turns[:, link], gltf.VEC4)
    return animation
