"""What the two kinds of .glb, morph targets and rig, have in common: node, colours, texture, material."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from warpdef import __version__
from warpdef.export.animation import ROUGHNESS, Animation, linear_colors
from warpdef.export.gltf_buffer import VERTICES, Buffer
from warpdef.texture import Texture

_LINEAR, _MIPMAPPED, _REPEAT = 9729, 9987, 10497


def start_document() -> dict[str, Any]:
    """The head of a document."""
    return {"asset": {"version": "2.0", "generator": f"warpdef {__version__}"}, "scene": 0}


def place_node(animation: Animation, center: np.ndarray | None = None, scale: float = 1.0) -> dict[str, Any]:
    """The transform from the data's coordinates to glTF's: y up, metres, and the way to data far from its origin.

    Args:
        center: point of the data (from the animation's origin) that is 0 in the file's numbers, shape (3,).
        scale: length of one of the file's numbers in the data's unit.
    """
    node: dict[str, Any] = {}
    if animation.up == "z":
        node["rotation"] = [-math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]
    if animation.metres_per_unit * scale != 1.0:
        node["scale"] = [animation.metres_per_unit * scale] * 3
    origin = animation.origin if center is None else animation.origin + center
    if origin.any():
        # glTF scales and turns first.
        x, y, z = (animation.metres_per_unit * origin).tolist()
        node["translation"] = [x, z, -y] if animation.up == "z" else [x, y, z]
    return node


def add_look(animation: Animation, buffer: Buffer) -> dict[str, int]:
    """Vertex attributes of what the mesh looks like: texture coordinates and colours."""
    attributes = {}
    if animation.uv is not None:
        # glTF counts v downwards from the image's top.
        upper_left = (animation.uv * [1.0, -1.0] + [0.0, 1.0]).astype(np.float32)
        attributes["TEXCOORD_0"] = buffer.add(upper_left, target=VERTICES)
    if animation.colors is not None:
        # Shown, they would darken the image: where there is one they are kept under a name of their own.
        name = "COLOR_0" if animation.texture is None else "_COLOR_0"
        attributes[name] = add_colors(animation.colors, buffer)
    return attributes


def add_colors(colors: np.ndarray, buffer: Buffer) -> int:
    """Append sRGB colours (V, 3) or (V, 4) uint8 as linear light, and return the index of their accessor."""
    light = np.ones((len(colors), 4))
    light[:, : colors.shape[1]] = linear_colors(colors)
    # 16 bits hold every 8-bit sRGB value apart, and four components keep rows aligned.
    return buffer.add(np.rint(light * 65535).astype(np.uint16), target=VERTICES, normalized=True)


def add_material(animation: Animation, buffer: Buffer, document: dict[str, Any]) -> None:
    """Put the one material into a document, with the image of a texture."""
    color = [*animation.base_color, 1.0]
    surface: dict[str, Any] = {"baseColorFactor": color, "metallicFactor": 0.0, "roughnessFactor": ROUGHNESS}
    if animation.texture is not None:
        surface["baseColorTexture"] = {"index": 0}
        media = Texture.KINDS[animation.texture.kind]
        document["images"] = [{"bufferView": buffer.add_bytes(animation.texture.data), "mimeType": media}]
        document["samplers"] = [{"magFilter": _LINEAR, "minFilter": _MIPMAPPED, "wrapS": _REPEAT, "wrapT": _REPEAT}]
        document["textures"] = [{"source": 0, "sampler": 0}]
    document["materials"] = [{"name": "surface", "pbrMetallicRoughness": surface, "doubleSided": True}]
