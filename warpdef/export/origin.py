"""Where to put an origin so that float32 holds a shape that lies far from the data's own."""

from __future__ import annotations

import math

import numpy as np

from warpdef.mesh import float32_where_exact


def choose_origin(vertices: np.ndarray) -> np.ndarray:
    """A point from which positions keep their shape in float32; 0 where they keep it as they are.

    Coordinates of 1,000,000 are 0.06 apart in float32. The point is the middle of all frames, rounded to the leading
    digit of their extent, so that it is short to write down and adding it loses nothing.

    Args:
        vertices: shape (T, V, 3), any unit.

    Returns:
        Shape (3,) float64.
    """
    if float32_where_exact(vertices).dtype == np.float32:
        return np.zeros(3)
    low, high = (bound.astype(np.float64) for bound in (vertices.min(axis=(0, 1)), vertices.max(axis=(0, 1))))
    extent = float((high - low).max())
    if not extent > 0.0:
        return low
    unit = 10.0 ** math.floor(math.log10(extent))
    return np.round((low / 2.0 + high / 2.0) / unit) * unit
