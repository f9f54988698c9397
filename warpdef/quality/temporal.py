"""How calm a moving mesh is in time: second differences over three frames that follow each other."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from warpdef.geometry.triangles import vertex_normals


def flicker(vertices: np.ndarray | Sequence[np.ndarray], faces: np.ndarray) -> np.ndarray:
    """Mean over the vertices of |n(t - 1) - 2 n(t) + n(t + 1)|, n a vertex's unit normal, as an angle in degrees.

    Args:
        vertices: shape (T, V, 3), or T arrays (V, 3). faces: shape (F, 3).

    Returns:
        Shape (T,); NaN in the first and the last frame.
    """
    return np.degrees(_second_differences(len(vertices), lambda t: vertex_normals(vertices[t].astype(float), faces)))


def acceleration(vertices: np.ndarray | Sequence[np.ndarray]) -> np.ndarray:
    """Mean over the vertices of |x(t - 1) - 2 x(t) + x(t + 1)|, units of ``vertices`` a frame squared.

    Args:
        vertices: shape (T, V, 3), or T arrays (V, 3).

    Returns:
        Shape (T,); NaN in the first and the last frame.
    """
    return _second_differences(len(vertices), lambda t: np.asarray(vertices[t], dtype=np.float64))


def _second_differences(count: int, at: Callable[[int], np.ndarray]) -> np.ndarray:
    """Mean length of the second differences of ``at(t)``, (V, 3) each, of which three are held at a time."""
    found = np.full(count, np.nan)
    if count < 3:
        return found
    before, here = at(0), at(1)
    for t in range(1, count - 1):
        after = at(t + 1)
        found[t] = np.linalg.norm(before - 2.0 * here + after, axis=1).mean()
        before, here = here, after
    return found
