"""Numbers of the web page as text: differences, which are small, byte by byte, deflated, in base64.

Of what moves the difference to the frame before is taken, and of that the difference to a neighbour of lower index:
both move nearly alike. Differences wrap around, so that nothing is lost. ``viewer/script_data.py`` is the way back.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence

import numpy as np

STEPS = 65535
"""Steps of a position along each axis of the bounding box."""


def position_steps(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Positions (..., 3) as whole steps of a box, uint16 of that shape."""
    size = np.where(high > low, high - low, 1.0)
    return np.rint((points - low) / size * STEPS).clip(0, STEPS).astype(np.uint16)


def lower_neighbours(faces: np.ndarray, count: int) -> np.ndarray:
    """Of each vertex the neighbour of the largest lower index, or the vertex before; of the first -1. Shape (V,).

    Args:
        faces: shape (F, 3). count: number V of vertices.
    """
    found = np.full(count, -1, dtype=np.int64)
    for k in range(3):
        one, other = faces[:, k], faces[:, (k + 1) % 3]
        apart = one != other
        np.maximum.at(found, np.maximum(one, other)[apart], np.minimum(one, other)[apart])
    return np.where(found < 0, np.arange(count) - 1, found)


def pack_moving(values: np.ndarray, parents: np.ndarray) -> str:
    """Numbers (T, V, C), uint8 or uint16, that change little from frame to frame and from a vertex to its parent.

    Args:
        parents: an index below its own for every vertex; -1 for the first. Shape (V,).
    """
    change = np.diff(values, axis=0, prepend=np.zeros_like(values[:1]))
    change[:, 1:] -= change[:, parents[1:]]
    return deflated(np.ascontiguousarray(_folded(change).transpose(0, 2, 1)))


def pack_indices(faces: np.ndarray) -> str:
    """Indices (F, 3) as differences from each to the next."""
    corners = faces.reshape(-1).astype(np.uint32)
    return deflated(_folded(np.diff(corners, prepend=np.zeros(1, dtype=np.uint32))))


def pack_clouds(clouds: Sequence[np.ndarray]) -> str:
    """Clouds (N_t, 3) uint16 one after the other, each along a curve that passes near points together (Morton's)."""
    steps = np.concatenate([cloud[np.argsort(_morton(cloud), kind="stable")] for cloud in clouds])
    return pack_moving(steps[None], np.arange(len(steps)) - 1)


def deflated(array: np.ndarray) -> str:
    """An array of unsigned numbers: all lowest bytes, then all next ones; the array's own order, little end first."""
    planes = array.astype(array.dtype.newbyteorder("<")).reshape(-1, 1).view(np.uint8).T
    return base64.b64encode(zlib.compress(np.ascontiguousarray(planes).tobytes(), 6)).decode("ascii")


def _folded(change: np.ndarray) -> np.ndarray:
    """Differences that wrapped around, small where they are small of either sign: 0, -1, 1, -2 become 0, 1, 2, 3."""
    signed = change.view(change.dtype.str.replace("u", "i"))
    return ((signed << 1) ^ (signed >> (8 * change.itemsize - 1))).view(change.dtype)


def _morton(steps: np.ndarray) -> np.ndarray:
    code = np.zeros(len(steps), dtype=np.uint64)
    for bit in range(15, -1, -1):
        for axis in range(3):
            code = (code << np.uint64(1)) | ((steps[:, axis] >> bit) & 1).astype(np.uint64)
    return code
