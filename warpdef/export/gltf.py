"""A moving mesh as binary glTF 2.0 (.glb): one morph target a frame, played by an animation of their weights.

The first frame is the base mesh; frame t is the base plus target t - 1 at weight 1. Positions are the data's own; the
node carries the turn from z up to glTF's y up, the scale to glTF's metres and, for data far from its origin, the way
there.
"""

from __future__ import annotations

import json
import math
import struct
from pathlib import Path
from typing import Any

import numpy as np

from warpdef import __version__
from warpdef.errors import InputError
from warpdef.export.animation import ROUGHNESS, Animation, linear_colors
from warpdef.texture import Texture

_FLOAT, _UINT, _USHORT = 5126, 5125, 5123
_VERTICES, _INDICES = 34962, 34963
_LINEAR, _MIPMAPPED, _REPEAT = 9729, 9987, 10497
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


def write_glb(animation: Animation, path: Path) -> None:
    """Write the animation to ``path``.

    Raises:
        InputError: more than the 4 GiB that the format can hold.
    """
    buffer = _Buffer()
    vertices, faces = animation.vertices, animation.faces
    first_normals = animation.normals_of(0)
    attributes = {
        "POSITION": buffer.add(vertices[0], bounds=True, target=_VERTICES),
        "NORMAL": buffer.add(first_normals, target=_VERTICES),
    }
    if animation.uv is not None:
        # glTF counts v downwards from the image's top.
        upper_left = (animation.uv * [1.0, -1.0] + [0.0, 1.0]).astype(np.float32)
        attributes["TEXCOORD_0"] = buffer.add(upper_left, target=_VERTICES)
    if animation.colors is not None:
        light = np.ones((vertices.shape[1], 4))
        light[:, : animation.colors.shape[1]] = linear_colors(animation.colors)
        # 16 bits hold every 8-bit sRGB value apart, and four components keep rows aligned.
        # Shown, they would darken the image: where there is one they are kept under a name of their own.
        name = "COLOR_0" if animation.texture is None else "_COLOR_0"
        attributes[name] = buffer.add(np.rint(light * 65535).astype(np.uint16), target=_VERTICES, normalized=True)
    primitive: dict[str, Any] = {
        "attributes": attributes,
        "indices": buffer.add(faces.reshape(-1).astype(np.uint32), target=_INDICES),
        "material": 0,
    }
    mesh: dict[str, Any] = {"primitives": [primitive]}
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": f"warpdef {__version__}"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [_node(animation)],
        "meshes": [mesh],
        "materials": [_material(animation)],
    }
    if len(animation) > 1:
        targets = [
            (vertices[t] - vertices[0], animation.normals_of(t) - first_normals) for t in range(1, len(vertices))
        ]
        primitive["targets"] = [
            {
                "POSITION": buffer.add(offset, bounds=True, target=_VERTICES),
                "NORMAL": buffer.add(turn, target=_VERTICES),
            }
            for offset, turn in targets
        ]
        mesh["weights"] = [0.0] * len(targets)
        mesh["extras"] = {"targetNames": list(animation.names[1:])}
        weights = np.eye(len(animation), dtype=np.float32)[:, 1:]
        sampler = {
            "input": buffer.add(animation.times, bounds=True),
            "output": buffer.add(np.ascontiguousarray(weights).reshape(-1)),
            "interpolation": "LINEAR",
        }
        channel = {"sampler": 0, "target": {"node": 0, "path": "weights"}}
        document["animations"] = [{"name": "motion", "samplers": [sampler], "channels": [channel]}]
    if animation.texture is not None:
        media = Texture.KINDS[animation.texture.kind]
        document["images"] = [{"bufferView": buffer.add_bytes(animation.texture.data), "mimeType": media}]
        document["samplers"] = [{"magFilter": _LINEAR, "minFilter": _MIPMAPPED, "wrapS": _REPEAT, "wrapT": _REPEAT}]
        document["textures"] = [{"source": 0, "sampler": 0}]
    document["accessors"], document["bufferViews"] = buffer.accessors, buffer.views
    document["buffers"] = [{"byteLength": buffer.size}]
    _write(path, document, buffer)


def _node(animation: Animation) -> dict[str, Any]:
    node: dict[str, Any] = {"mesh": 0, "name": "warpdef"}
    if animation.up == "z":
        node["rotation"] = [-math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]
    if animation.metres_per_unit != 1.0:
        node["scale"] = [animation.metres_per_unit] * 3
    if animation.is_far:
        # glTF scales and turns first.
        x, y, z = (animation.metres_per_unit * animation.origin).tolist()
        node["translation"] = [x, z, -y] if animation.up == "z" else [x, y, z]
    return node


def _material(animation: Animation) -> dict[str, Any]:
    color = [*animation.base_color, 1.0]
    surface: dict[str, Any] = {"baseColorFactor": color, "metallicFactor": 0.0, "roughnessFactor": ROUGHNESS}
    if animation.texture is not None:
        surface["baseColorTexture"] = {"index": 0}
    return {"name": "surface", "pbrMetallicRoughness": surface, "doubleSided": True}


class _Buffer:
    """Arrays one after the other, each aligned to 4 bytes, with the accessors that describe them."""

    def __init__(self) -> None:
        self.accessors: list[dict[str, Any]] = []
        self.views: list[dict[str, Any]] = []
        self.chunks: list[bytes] = []
        self.size = 0

    def add(
        self, array: np.ndarray, *, bounds: bool = False, target: int | None = None, normalized: bool = False
    ) -> int:
        """Append an array (N,) or (N, 2..4) and return the index of its accessor."""
        component = {"f": _FLOAT, "I": _UINT, "H": _USHORT}[array.dtype.char]
        view = self.add_bytes(np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<")).tobytes())
        if target is not None:
            self.views[view]["target"] = target
        columns = array.shape[1] if array.ndim == 2 else 1
        accessor = {
            "bufferView": view,
            "componentType": component,
            "count": len(array),
            "type": _KINDS[columns],
        }
        if normalized:
            accessor["normalized"] = True
        if bounds:
            table = array.reshape(len(array), columns)
            accessor["min"], accessor["max"] = table.min(axis=0).tolist(), table.max(axis=0).tolist()
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def add_bytes(self, data: bytes) -> int:
        """Append what is no array and return the index of its view."""
        self.views.append({"buffer": 0, "byteOffset": self.size, "byteLength": len(data)})
        data += bytes(-len(data) % 4)
        self.chunks.append(data)
        self.size += len(data)
        return len(self.views) - 1


def _write(path: Path, document: dict[str, Any], buffer: _Buffer) -> None:
    text = json.dumps(document, separators=(",", ":")).encode("utf-8")
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + buffer.size
    if total >= 2**32:
        raise InputError(
            f"{path.name}: expected less than the 4 GiB that a .glb can hold, got {total / 2**30:.1f} GiB; "
            "export fewer frames with --frames, or to .usdc"
        )
    with open(path, "wb") as stream:
        stream.write(struct.pack("<4sII", b"glTF", 2, total))
        stream.write(struct.pack("<I4s", len(text), b"JSON") + text)
        stream.write(struct.pack("<I4s", buffer.size, b"BIN\0"))
        stream.writelines(buffer.chunks)
