"""Meshes of the frames that have no points: filled in between their neighbours once the others are fitted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def fill_gaps(
    vertices: np.ndarray, numbers: Sequence[int], frame_count: int, faces: np.ndarray | None = None
) -> np.ndarray:
    """The moving mesh with a mesh for every frame of the input.

    A gap between fitted frames is interpolated at the share of the time that has passed: with faces, vertices turn as
    they go (``motion.between``), else they go straight. Before the first and after the last fitted frame all is held.

    Args:
        vertices: of the fitted frames, shape (T, V, 3).
        numbers: their frame numbers, ascending, shape (T,).
        frame_count: frames of the input.
        faces: triangles, shape (F, 3); None: points that belong to no mesh.

    Returns:
        Shape (frame_count, V, 3); the fitted frames unchanged to the bit.
    """
    fitted = np.asarray(numbers)
    if len(fitted) == frame_count:
        return vertices
    filled = np.empty((frame_count, *vertices.shape[1:]), dtype=vertices.dtype)
    filled[fitted] = vertices
    filled[: fitted[0]], filled[fitted[-1] + 1 :] = vertices[0], vertices[-1]
    for t in np.flatnonzero(np.diff(fitted) > 1):
        start, end = fitted[t], fitted[t + 1]
        shares = np.arange(1, end - start) / (end - start)
        filled[start + 1 : end] = _between(vertices[t : t + 2], shares, faces)
    return filled


def _between(pair: np.ndarray, shares: np.ndarray, faces: np.ndarray | None) -> np.ndarray:
    """Two frames (2, V, 3) to those at the shares (n,) of the way, (n, V, 3)."""
    if faces is None:
        shares = shares[:, None, None]
        return (1.0 - shares) * pair[0] + shares * pair[1]
    from warpdef.motion.between import mesh_between

    return mesh_between(pair, faces, shares)
