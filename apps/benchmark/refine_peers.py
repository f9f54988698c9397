"""Other libraries' ways to what the vertex stage's kernels compute."""

from __future__ import annotations

import numpy as np

from warpdef.apps.benchmark.peers import add_rows
from warpdef.geometry.triangles import vertex_normals
from warpdef.kernels.graphs import Graph


def vertex_normals_numpy(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area-weighted unit normals, (T, V, 3)."""
    return np.stack([vertex_normals(x, faces) for x in vertices])


def planes_numpy(
    x: np.ndarray, m: np.ndarray, q: np.ndarray, n: np.ndarray, reach: np.ndarray, agreement: float
) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of pairs of vertices x, normals m, with points q, normals n: (P, 3, 3) and (P, 3)."""
    d = x - q
    a = np.where((n * m).sum(axis=1, keepdims=True) > agreement, n + m, 0.0)
    a /= np.maximum(np.linalg.norm(a, axis=1, keepdims=True), 1e-30)
    w = np.exp(-(d**2).sum(axis=1) / reach**2)
    wa = w[:, None] * a
    return wa[:, :, None] * a[:, None, :], -(a * d).sum(axis=1, keepdims=True) * wa


def rotations_numpy(x: np.ndarray, y: np.ndarray, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """Best rotations of the edges from i to j of shape y to those of x (T, V, 3), by singular values; (T, V, 3, 3)."""
    edge, found = y[i] - y[j], []
    for frame in x:
        s = ((frame[i] - frame[j])[:, :, None] * edge[:, None, :]).reshape(-1, 9)
        u, _, v = np.linalg.svd(add_rows(i, s, len(frame)).reshape(-1, 3, 3))
        u[:, :, 2] *= np.linalg.det(u @ v)[:, None]
        found.append(u @ v)
    return np.stack(found)


def block_cg_scipy(
    blocks: np.ndarray, graph: Graph, alpha: float, beta: float, rhs: np.ndarray, tolerance: float
) -> np.ndarray:
    """(A + beta I + alpha L) d = rhs frame by frame; blocks (T, V, 3, 3), rhs (T, V, 3)."""
    from scipy.sparse import bsr_array, csr_array, diags_array, kron
    from scipy.sparse.linalg import LinearOperator, cg

    count, degree = len(graph.node), np.diff(graph.row)
    around = csr_array((np.ones(len(graph.column)), graph.column, graph.row), shape=(count, count))
    shared = kron(diags_array(beta + alpha * degree) - alpha * around, np.eye(3), format="csr")
    found = []
    for block, b in zip(blocks.astype(float), rhs.astype(float), strict=True):
        own = bsr_array((block, np.arange(count), np.arange(count + 1)), shape=shared.shape)
        matrix = (shared + own.tocsr()).tocsr()
        inverse = np.linalg.inv(block + (beta + alpha * degree)[:, None, None] * np.eye(3))

        def precondition(r: np.ndarray, inverse: np.ndarray = inverse) -> np.ndarray:
            return (inverse @ r.reshape(-1, 3, 1)).ravel()

        operator = LinearOperator(matrix.shape, precondition)
        found.append(cg(matrix, b.ravel(), rtol=tolerance, M=operator)[0].reshape(-1, 3))
    return np.stack(found)
