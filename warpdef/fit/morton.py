"""Order by Morton code: neighbours in space become neighbours in memory."""

from __future__ import annotations

import numpy as np

_BITS = 10


def morton_order(points: np.ndarray) -> np.ndarray:
    """Indices that sort ``points``, shape (N, 3) in cube units, along the Morton curve; ties keep their order."""
    cell = np.clip((points + 1.0) * (0.5 * 2**_BITS), 0, 2**_BITS - 1).astype(np.int64)
    code = np.zeros(len(points), dtype=np.int64)
    for bit in range(_BITS):
        for axis in range(3):
            code |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")
