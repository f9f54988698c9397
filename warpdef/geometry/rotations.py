"""The rotation nearest to a matrix."""

from __future__ import annotations

import numpy as np


def nearest_rotation(spread: np.ndarray) -> np.ndarray:
    """The rotations R that maximise trace(R^T S) of matrices S, shape (..., 3, 3): never reflections.

    What S says least of is turned over where the nearest orthogonal matrix would be one (Kabsch 1976).
    """
    u, _, vt = np.linalg.svd(spread)
    u[..., 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    return u @ vt
