"""Rotations of a moving mesh, vertex by vertex, as unit quaternions (x, y, z, w)."""

from __future__ import annotations

import numpy as np

from warpdef.geometry.rotations import nearest_rotation
from warpdef.geometry.triangles import unique_edges

_TIE = 1e-9  # weight of the identity, which decides what a flat or straight neighbourhood leaves open


def local_rotations(rest: np.ndarray, moved: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The rotation of every vertex that best turns the edges around it (Sorkine and Alexa 2007, ARAP, sec. 2.1).

        R_i = argmax trace(R^T sum_ij (x_i - x_j)(y_i - y_j)^T)   over the edges of i and of its neighbours

    Args:
        rest: y, shape (V, 3), or (B, V, 3) with a mesh of its own for every one moved. moved: x, shape (B, V, 3).
        faces: shape (F, 3). A vertex without faces does not turn.

    Returns:
        Quaternions, shape (B, V, 4) float64, w never negative.
    """
    from scipy import sparse
    from scipy.spatial.transform import Rotation

    count = moved.shape[1]
    edges = unique_edges(faces).astype(np.int64)
    number = len(edges)
    ends, of_edge = edges.T.ravel(), np.tile(np.arange(number), 2)
    gather = sparse.csr_array((np.ones(2 * number), (ends, of_edge)), shape=(count, number))
    around = sparse.csr_array((np.ones(2 * number), (ends, edges[:, ::-1].T.ravel())), shape=(count, count))
    around += sparse.eye_array(count, format="csr")
    turns = np.empty((len(moved), count, 4))
    for b, after in enumerate(np.asarray(moved, dtype=np.float64)):
        before = np.asarray(rest if rest.ndim == 2 else rest[b], dtype=np.float64)
        x, y = after[edges[:, 0]] - after[edges[:, 1]], before[edges[:, 0]] - before[edges[:, 1]]
        spread = around @ (gather @ (x[:, :, None] * y[:, None, :]).reshape(number, 9))
        spread = spread.reshape(count, 3, 3)
        size = np.abs(spread).max(axis=(1, 2), keepdims=True)
        spread = spread / np.where(size > 0.0, size, 1.0) + _TIE * np.eye(3)
        turns[b] = Rotation.from_matrix(nearest_rotation(spread)).as_quat(canonical=True)
    return turns


def smoothed(turns: np.ndarray, faces: np.ndarray, spread: float) -> np.ndarray:
    """Rotations averaged over the surface, (I + spread^2 L)^-1 with the uniform Laplacian L of the mesh; unit length.

    Args:
        turns: shape (B, V, 4), near their neighbours as quaternions too. faces: shape (F, 3).
        spread: how far an average reaches, in edges.
    """
    from scipy import sparse
    from scipy.sparse.linalg import splu

    edges, count = unique_edges(faces).astype(np.int64), turns.shape[1]
    ends = np.concatenate([edges, edges[:, ::-1]])
    joined = sparse.csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    degree = np.bincount(ends[:, 0], minlength=count)
    solver = splu((sparse.diags_array(1.0 + spread**2 * degree) - spread**2 * joined).tocsc())
    mean = np.stack([solver.solve(turn) for turn in turns])
    return mean / np.maximum(np.linalg.norm(mean, axis=2, keepdims=True), 1e-12)


def blend(weights, turns: np.ndarray) -> np.ndarray:
    """Weighted means of rotations that lie near each other, as quaternions too.

    Args:
        weights: a sparse matrix (N, V), rows of sum 1. turns: shape (V, 4).

    Returns:
        Quaternions, shape (N, 4); those of a row that cancels are the identity.
    """
    mean = weights @ turns
    length = np.linalg.norm(mean, axis=1, keepdims=True)
    return np.where(length > 1e-12, mean / np.where(length > 1e-12, length, 1.0), [0.0, 0.0, 0.0, 1.0])


def turn(turns: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors (N, 3) turned by quaternions (N, 4): v + w c + q x c with c = 2 q x v."""
    axis, w = turns[..., :3], turns[..., 3:]
    c = 2.0 * np.cross(axis, vectors)
    return vectors + w * c + np.cross(axis, c)


def multiply(second: np.ndarray, first: np.ndarray) -> np.ndarray:
    """The rotation ``first``, then ``second``; shapes (..., 4)."""
    a, b = second[..., :3], first[..., :3]
    axis = second[..., 3:] * b + first[..., 3:] * a + np.cross(a, b)
    w = second[..., 3] * first[..., 3] - (a * b).sum(axis=-1)
    return np.concatenate([axis, w[..., None]], axis=-1)


def inverse(turns: np.ndarray) -> np.ndarray:
    """The rotations back."""
    return turns * [-1.0, -1.0, -1.0, 1.0]


def about(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rotations by angles (N,) about unit vectors (N, 3)."""
    return np.concatenate([axis * np.sin(angle / 2.0)[:, None], np.cos(angle / 2.0)[:, None]], axis=-1)


def unwind(turns: np.ndarray, start: int) -> np.ndarray:
    """Of the two quaternions of every rotation the one nearer to its neighbour towards frame ``start``; (T, V, 4).

    Vertices that turned the same way then lie together, beyond half a turn as well, and can be averaged.
    """
    turns = turns.copy()
    for frames in (range(start + 1, len(turns)), range(start - 1, -1, -1)):
        for t in frames:
            before = turns[t - 1 if t > start else t + 1]
            turns[t] *= np.where((turns[t] * before).sum(axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    return turns
