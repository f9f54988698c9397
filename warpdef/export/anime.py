"""The ``.anime`` files of DeformingThings4D (Li et al. 2021): little-endian, without a frame rate or colours.

int32 T, int32 V, int32 F; positions of the first frame, V x 3 float32; triangles, F x 3 int32; then for every
further frame the offsets from the first, V x 3 float32
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from warpdef.errors import InputError
from warpdef.export.animation import Animation


def write_anime(animation: Animation, path: Path) -> None:
    """Write the animation to ``path``.

    Raises:
        InputError: the mesh lies so far from the origin that the format's float32 would lose its shape.
    """
    if animation.is_far:
        where = ", ".join(f"{x:g}" for x in animation.origin)
        raise InputError(
            f"{path.name}: expected a mesh near the origin, as .anime holds float32 alone, got one around ({where}); "
            "export to .npz or .ply, which then hold float64, or shift the input"
        )
    animation = animation.joined
    vertices = animation.vertices
    with open(path, "wb") as stream:
        stream.write(struct.pack("<iii", len(vertices), vertices.shape[1], len(animation.faces)))
        stream.write(vertices[0].astype("<f4").tobytes())
        stream.write(animation.faces.astype("<i4").tobytes())
        for positions in vertices[1:]:
            stream.write(np.subtract(positions, vertices[0], dtype=np.float32).astype("<f4").tobytes())
