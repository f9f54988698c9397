"""Shares: which vertex has how much of which point, when none may have more than its own.

Nearest neighbours give two fingers the same points while a third finger's points find nobody. A transport plan does
not: points ask to be explained, and a vertex explains no more than the surface that it stands for (partial, unbalanced
optimal transport with an entropy, Chizat et al. 2018, *Scaling algorithms for unbalanced optimal transport problems*):

    min_P  sum_ij P_ij C_ij + blur^2 KL(P | 1) + reach^2 KL(P^T 1 | b)    with  P 1 <= a

a vertex may go without, as nobody sees all of a surface; a point pays for going without, so that what the mesh lacks
does not tear at it. Solved by scaling: P = diag(u) exp(-C / blur^2) diag(v).
"""

from __future__ import annotations

import numpy as np

_SCALINGS = 30
_LEAST = 1e-300


def transport_cost(
    places: np.ndarray, normals: np.ndarray, points: np.ndarray, point_normals: np.ndarray, turn: float
) -> np.ndarray:
    """|x - q|^2 + turn (1 - m . n) of m vertices and n points, (m, n); all arrays (., 3), normals unit."""
    from scipy.spatial.distance import cdist

    return cdist(places, points, "sqeuclidean") + turn * (1.0 - normals @ point_normals.T)


def partial_transport(cost: np.ndarray, capacity: float, demand: float, blur: float, reach: float) -> np.ndarray:
    """The plan P (m, n) of a cost (m, n): rows sum to ``capacity`` at most, columns to ``demand`` or less, where that
    costs more than ``reach``. ``blur`` and ``reach`` are in the unit of the cost."""
    kernel = np.exp(-cost / blur)
    power = reach / (reach + blur)
    u, v = np.ones(cost.shape[0]), np.ones(cost.shape[1])
    for _ in range(_SCALINGS):
        v = (demand / np.maximum(u @ kernel, _LEAST)) ** power
        u = np.minimum(1.0, capacity / np.maximum(kernel @ v, _LEAST))
    return u[:, None] * kernel * v
