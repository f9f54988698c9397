"""How alike the poses of two clouds are, without correspondences: their distance fields on a coarse lattice.

    d(a, b) = mean_x | f_a(x) - f_b(x) |,   f_t(x) the distance of a lattice place x to the nearest point of cloud t

Of the same pose sampled anew the fields hardly differ, where distances from cloud to cloud are the spacing of the
points; and a field is found once a cloud, not once a pair. Where a cloud lacks a part that the other has, its field is
too large there, and never too small; of what both show

    d'(a, b) = 2 min( mean_x max(f_a - f_b, 0), mean_x max(f_b - f_a, 0) ),

which is 0 for a cloud and any part of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

CELLS = 8
"""Of the lattice, along the longest side of the box around all clouds."""
_ASKED = 2000  # points of a cloud that are asked
_JUDGED = 8  # clouds whose halves tell the noise


def pose_fields(clouds: Sequence[np.ndarray]) -> tuple[np.ndarray, float]:
    """Distance fields of T clouds (N_t, 3), over the longest side of the box around all of them.

    Returns:
        The fields, shape (T, K), and what their mean difference is between the halves of one cloud, about 1.4 times
        what it is between two clouds of one pose: the median over some of them.
    """
    from scipy.spatial import cKDTree

    thin = [cloud[:: max(len(cloud) // _ASKED, 1)] for cloud in clouds]
    low, high = (f([f(c, axis=0) for c in thin], axis=0) for f in (np.min, np.max))
    side = max(float((high - low).max()), 1e-30)
    cell = side / CELLS
    counts = np.maximum(np.ceil((high - low) / cell), 1).astype(int)
    axes = [a + cell * (np.arange(n) + 0.5) for a, n in zip(low, counts, strict=True)]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)

    def field(cloud: np.ndarray) -> np.ndarray:
        return cKDTree(cloud).query(places)[0] / side

    halves = [np.abs(field(c[::2]) - field(c[1::2])).mean() for c in thin[:: max(len(thin) // _JUDGED, 1)]]
    return np.array([field(cloud) for cloud in thin]), float(np.median(halves))


def differences(fields: np.ndarray) -> np.ndarray:
    """d of all pairs of clouds, shape (T, T), by their fields (T, K)."""
    return np.array([np.abs(fields - field).mean(axis=1) for field in fields])


def shared_differences(fields: np.ndarray) -> np.ndarray:
    """d' of all pairs of clouds, as ``differences``: how alike they are in what both show."""
    over = np.array([np.maximum(fields - field, 0.0).mean(axis=1) for field in fields])
    return 2.0 * np.minimum(over, over.T)
