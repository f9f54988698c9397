"""Float64 NumPy twins of the patches and of fairing, written from the formulas. Imports NumPy only.

T frames, V vertices, M patches: x (T, V, 3), rest y (V, 3), R (T, V, 3, 3), weights of vertices in patches w (V, M).
"""

from __future__ import annotations

import numpy as np
from reference_refine import nearest_rotation


def fit_patches(x: np.ndarray, y: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations Q (T, M, 3, 3) and shifts s (T, M, 3) that minimise sum_i w_in |x_i - Q_n y_i - s_n|^2."""
    turn = np.zeros((len(x), w.shape[1], 3, 3))
    shift = np.zeros((len(x), w.shape[1], 3))
    for t in range(len(x)):
        for n in range(w.shape[1]):
            share = w[:, n] / w[:, n].sum()
            at, origin = share @ x[t], share @ y
            turn[t, n] = nearest_rotation((share[:, None] * (x[t] - at)).T @ (y - origin))
            shift[t, n] = at - turn[t, n] @ origin
    return turn, shift


def places(x: np.ndarray, y: np.ndarray, w: np.ndarray, rotation: np.ndarray, turn: np.ndarray, shift: np.ndarray):
    """p (T, V, 3), where patches carry the vertices, and r (T, V, 3), these in the vertices' own frames."""
    each = np.einsum("tnab,vb->tvna", turn, y) + shift[:, None]
    carried = np.einsum("vn,tvna->tva", w, each)
    return carried, np.einsum("tvba,tvb->tva", rotation, x - carried)


def smooth_places(
    carried: np.ndarray,
    local: np.ndarray,
    rotation: np.ndarray,
    f: np.ndarray,
    shares: tuple[float, float, float, float],
) -> tuple[np.ndarray, np.ndarray]:
    """e (T, V, 3), and g over h (T, V, 1), with the filter as a matrix (T, T); shares o, c, k and f."""
    turned = np.einsum("tvab,tvb->tva", rotation, np.einsum("tu,uva->tva", f, local))
    (own, course, chance, firmer), off = shares, np.einsum("tu,uva->tva", f, carried) - carried
    even = chance**2 / (chance**2 + (off**2).sum(axis=-1, keepdims=True))
    return carried + (course + (1 - course) * even) * off + own * turned, 1 + firmer * even


def towards_mean(y: np.ndarray, edges: np.ndarray, factor: float, still: np.ndarray) -> np.ndarray:
    """Every vertex that is not still moved by ``factor`` of the way to the mean of its neighbours (V, 3)."""
    total, count = np.zeros_like(y), np.zeros(len(y))
    for a, b in ((0, 1), (1, 0)):
        np.add.at(total, edges[:, a], y[edges[:, b]])
        np.add.at(count, edges[:, a], 1)
    free = ~still & (count > 0)
    out = y.copy()
    out[free] += factor * (total[free] / count[free, None] - y[free])
    return out
