"""The ``.anime`` files of DeformingThings4D (Li et al. 2021): little-endian, without a frame rate or colours.

int32 T, int32 V, int32 F; positions of the first frame, V x 3 float32; triangles, F x 3 int32; then for every
further frame the offsets from the first, V x 3 float32
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from warpdef.export.animation import Animation


def write_anime(animation: Animation, path: Path) -> None:
    """Write the animation to ``path``."""
    vertices = animation.vertices
    with open(path, "wb") as stream:
        stream.write(struct.pack("<iii", len(vertices), vertices.shape[1], len(animation.faces)))
        stream.write(vertices[0].astype("<f4").tobytes())
        stream.write(animation.faces.astype("<i4").tobytes())
        for positions in vertices[1:]:
            stream.write(np.subtract(positions, vertices[0], dtype=np.float32).astype("<f4").tobytes())
