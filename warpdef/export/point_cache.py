"""Point caches for animators: .pc2 and .mdd, each with the base mesh beside it: ``walk_pc2.obj`` for ``walk.pc2``.

A cache holds positions only; the program that plays it puts them on a mesh of the same vertex order. In Blender: import
the .obj with its vertex order kept, add a Mesh Cache modifier, and choose the cache. Far from the origin, where float32
would lose the shape, both count from a point near the mesh: the .obj names it in a comment ``# origin x y z``, and the
object's location is to be set there.

    .pc2  little-endian: "POINTCACHE2\\0", int32 version 1, int32 V, float32 first frame, float32 frames a sample,
          int32 T; then T times V positions, float32
    .mdd  big-endian: int32 T, int32 V; T times in seconds, float32; then T times V positions, float32
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from warpdef.export.animation import Animation
from warpdef.export.mesh_folders import obj_text


def write_pc2(animation: Animation, path: Path) -> None:
    """Write ``path`` and its base mesh, the first frame."""
    vertices = animation.joined.vertices
    count = vertices.shape[1]
    with open(path, "wb") as stream:
        stream.write(struct.pack("<12siiffi", b"POINTCACHE2\0", 1, count, 0.0, 1.0, len(animation)))
        stream.write(np.ascontiguousarray(vertices, dtype="<f4").tobytes())
    _write_base(animation, path)


def write_mdd(animation: Animation, path: Path) -> None:
    """Write ``path`` and its base mesh, the first frame."""
    vertices = animation.joined.vertices
    with open(path, "wb") as stream:
        stream.write(struct.pack(">ii", len(animation), vertices.shape[1]))
        stream.write(animation.times.astype(">f4").tobytes())
        stream.write(vertices.astype(">f4").tobytes())
    _write_base(animation, path)


def _write_base(animation: Animation, path: Path) -> None:
    path.with_name(f"{path.stem}_{path.suffix[1:]}.obj").write_bytes(obj_text(animation, 0, local=True))
