"""A moving mesh as binary glTF 2.0 (.glb): one morph target a frame, played by an animation of their weights.

The first frame is the base mesh; frame t is the base plus target t - 1 at weight 1. By default numbers are quantised
(KHR_mesh_quantization): positions as 16-bit multiples of one step, of which every frame is the nearest, so that no
error adds up; normals as bytes, or as 16 bits in frames that turn some of them nearly about. The node carries the way
back to the data's own numbers. Colours of a measure or of every frame change by targets, too; programs that know none
of colours, Blender among them, show those of the first frame.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from warpdef.export.animation import Animation, linear_colors
from warpdef.export.gltf_buffer import VERTICES, Buffer
from warpdef.export.gltf_parts import add_colors, add_look, add_material, place_node, start_document

TARGETS_MANY = 100
"""Frames beyond which a rig serves better: programs hold every target at once, and some stop at 256."""

_STEPS = np.iinfo(np.int16).max
_ANGLE = np.radians(2.0)  # of a normal, at most, between what is meant and what the bytes say
_LENGTH = 0.995  # of base normals; see normal_offsets. Within what the Khronos validator calls unit


def write_glb(animation: Animation, path: Path, precise: bool = False, meshopt: bool = False) -> None:
    """Write the animation to ``path``.

    Args:
        precise: float32 throughout, in place of quantised numbers.
        meshopt: pack the arrays, for programs that know EXT_meshopt_compression.

    Raises:
        MissingPackageError: meshopt is asked for and not installed.
        InputError: more than the 4 GiB that the format can hold.
    """
    buffer, document = Buffer(meshopt), start_document()
    center, scale, positions = None, 1.0, _float_positions(animation)
    if not precise:
        center, step = quantisation(animation.vertices)
        scale, positions = step * _STEPS, _short_positions(animation, center, step)
    count = animation.vertices.shape[1]
    base, base_normals = next(positions), _base_normals(animation, precise)
    attributes = {
        "POSITION": buffer.add(base, bounds=True, target=VERTICES, normalized=not precise),
        "NORMAL": buffer.add(base_normals, target=VERTICES, normalized=not precise),
        **add_look(animation, buffer),
    }
    colors = animation.moving_colors
    if colors is not None:
        attributes["COLOR_0"] = add_colors(colors[0], buffer)
    primitive: dict[str, Any] = {
        "attributes": attributes,
        "indices": buffer.add_triangles(animation.faces, count),
        "material": 0,
    }
    mesh: dict[str, Any] = {"primitives": [primitive]}
    document["scenes"] = [{"nodes": [0]}]
    document["nodes"] = [{"mesh": 0, "name": "warpdef"} | place_node(animation, center, scale)]
    document["meshes"] = [mesh]
    if len(animation) > 1:
        primitive["targets"] = []
        for frame, offset in enumerate(positions, 1):
            turn = animation.normals_of(frame)
            turn = turn - base_normals if precise else normal_offsets(base_normals, turn)
            target = {
                "POSITION": buffer.add(offset, bounds=True, target=VERTICES, normalized=not precise),
                "NORMAL": buffer.add(turn, target=VERTICES, normalized=not precise),
            }
            if colors is not None:
                change = np.zeros((count, 4), dtype=np.float32)
                change[:, :3] = linear_colors(colors[frame]) - linear_colors(colors[0])
                if not precise:
                    change = np.rint(change * _STEPS).astype(np.int16)
                target["COLOR_0"] = buffer.add(change, target=VERTICES, normalized=not precise)
            primitive["targets"].append(target)
        mesh["weights"] = [0.0] * len(primitive["targets"])
        mesh["extras"] = {"targetNames": list(animation.names[1:])}
        document["animations"] = [_play(animation, buffer)]
    if not precise:
        document["extensionsUsed"] = document["extensionsRequired"] = ["KHR_mesh_quantization"]
    add_material(animation, buffer, document)
    buffer.write(path, document)


def quantisation(vertices: np.ndarray) -> tuple[np.ndarray, float]:
    """The point that quantised positions count from, (3,) float64, and their step, both in the mesh's units.

    The step is the smallest that both the first frame and the offsets from it hold in 16 bits; vertices are within half
    of it, along each axis.

    Args:
        vertices: shape (T, V, 3).
    """
    low, high = vertices[0].min(axis=0).astype(np.float64), vertices[0].max(axis=0).astype(np.float64)
    center = (low + high) / 2.0
    reach = float((high - low).max()) / 2.0
    reach = max([reach, *(float(np.abs(frame - vertices[0]).max()) for frame in vertices[1:])])
    # One step is kept free: base and offset are whole numbers, so that an offset may be rounded up by one.
    return center, (reach or 1.0) / (_STEPS - 1)


def normal_offsets(base: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """What to add to quantised normals to point along others, as bytes where those do so within two degrees.

    An offset's parts must lie in -1 .. 1. Where that is too short, the sum points the right way but is shorter than 1:
    programs normalise it. Base normals are a hair shorter than 1, so that something is left even of one that turns
    about along an axis.

    Args:
        base: shape (V, 3) int16, in 32767ths. normals: unit, shape (V, 3).

    Returns:
        Shape (V, 3), int8 in 127ths or int16 in 32767ths.
    """
    start, goal = base / float(_STEPS), np.asarray(normals, dtype=np.float64)
    # The largest s <= 1 with |s n - b| <= 1 in every part.
    room = np.where(goal > 0.0, 1.0 + start, 1.0 - start) / np.maximum(np.abs(goal), 1e-9)
    offset = np.minimum(room.min(axis=1, keepdims=True), 1.0) * goal - start
    small = np.rint(offset * 127.0)
    said = start + small / 127.0
    cosine = np.einsum("vi,vi->v", said, goal) / np.maximum(np.linalg.norm(said, axis=1), 1e-12)
    if (cosine >= np.cos(_ANGLE)).all():
        return small.astype(np.int8)
    return np.rint(offset * _STEPS).astype(np.int16)


def _float_positions(animation: Animation) -> Any:
    yield animation.vertices[0]
    for frame in animation.vertices[1:]:
        yield frame - animation.vertices[0]


def _short_positions(animation: Animation, center: np.ndarray, step: float) -> Any:
    base = np.rint((animation.vertices[0] - center) / step).astype(np.int32)
    yield base.astype(np.int16)
    for frame in animation.vertices[1:]:
        yield (np.rint((frame - center) / step).astype(np.int32) - base).astype(np.int16)


def _base_normals(animation: Animation, precise: bool) -> np.ndarray:
    normals = animation.normals_of(0)
    return normals if precise else np.rint(normals * (_LENGTH * _STEPS)).astype(np.int16)


def _play(animation: Animation, buffer: Buffer) -> dict[str, Any]:
    """An animation that shows one frame after the other, and blends two neighbours in between."""
    weights = np.eye(len(animation), dtype=np.float32)[:, 1:]
    sampler = {
        "input": buffer.add(animation.times, bounds=True),
        "output": buffer.add(np.ascontiguousarray(weights).reshape(-1)),
        "interpolation": "LINEAR",
    }
    channel = {"sampler": 0, "target": {"node": 0, "path": "weights"}}
    return {"name": "motion", "samplers": [sampler], "channels": [channel]}
