"""Cut a triangle mesh along the contour of a function on its vertices, without slivers. NumPy and SciPy only."""

from __future__ import annotations

import numpy as np

from warpdef.geometry import triangles

SNAP = 0.35  # a vertex nearer to the contour than this share of an edge is moved onto it


def cut_at_zero(vertices: np.ndarray, faces: np.ndarray, level: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The part of a mesh where ``level`` is above 0, its new border on the contour.

    Vertices close to the contour move onto it along an edge (as in isosurface stuffing, Labelle and Shewchuk 2007);
    the edges that still cross it are split there. What is left is an edge-manifold mesh if the input is one; a vertex
    where two parts merely touch becomes two.

    Args:
        vertices: shape (V, 3). faces: shape (F, 3). level: shape (V,), linear on edges.

    Returns:
        vertices and faces, compacted; none where nothing is above 0.
    """
    vertices, zero = _snap(vertices, faces, level)
    sign = np.where(zero, 0, np.where(level > 0, 1, -1))
    corner = sign[faces]
    # A face all on the contour belongs to the side that it came from.
    inside = (corner >= 0).all(axis=1) & ((corner > 0).any(axis=1) | (level[faces].mean(axis=1) > 0))
    crossed = (corner > 0).any(axis=1) & (corner < 0).any(axis=1)
    pieces, created = _split(vertices, faces[crossed], sign, level)
    all_faces = np.concatenate([faces[inside], pieces]) if len(pieces) else faces[inside]
    if len(all_faces) == 0:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32)
    return triangles.compact(*triangles.separate_touching(np.concatenate([vertices, created]), all_faces))


def _snap(vertices: np.ndarray, faces: np.ndarray, level: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices with those near the contour moved onto it, and which ones were, shape (V,) bool."""
    edges = triangles.unique_edges(faces)
    edges = edges[(level[edges[:, 0]] > 0) != (level[edges[:, 1]] > 0)]
    a = np.concatenate([edges[:, 0], edges[:, 1]])
    b = np.concatenate([edges[:, 1], edges[:, 0]])
    share = level[a] / (level[a] - level[b])
    near = share < SNAP
    a, b, share = a[near], b[near], share[near]
    move = share[:, None] * (vertices[b] - vertices[a])
    order = np.lexsort((np.einsum("ni,ni->n", move, move), a))
    first = order[np.unique(a[order], return_index=True)[1]]
    vertices = vertices.copy()
    vertices[a[first]] += move[first]
    zero = level == 0.0
    zero[a[first]] = True
    return vertices, zero


def _split(
    vertices: np.ndarray, faces: np.ndarray, sign: np.ndarray, level: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The inner pieces of crossed faces, and the vertices made on their edges, numbered after the others."""
    # Turn every face so that its first corner is the only one of its sign.
    corner = sign[faces]
    alone = np.where((corner > 0).sum(axis=1) == 1, 1, -1)
    turn = (corner == alone[:, None]).argmax(axis=1)
    faces = faces[np.arange(len(faces))[:, None], (turn[:, None] + np.arange(3)) % 3]
    corner = sign[faces]
    a, b, c = faces.T
    cut_ab, cut_ca = corner[:, 0] * corner[:, 1] < 0, corner[:, 0] * corner[:, 2] < 0
    wanted = np.sort(np.concatenate([np.stack([a, b], 1)[cut_ab], np.stack([a, c], 1)[cut_ca]]), axis=1)
    edges, of = np.unique(wanted, axis=0, return_inverse=True)
    share = (level[edges[:, 0]] / (level[edges[:, 0]] - level[edges[:, 1]]))[:, None]
    created = (1.0 - share) * vertices[edges[:, 0]] + share * vertices[edges[:, 1]]
    of = of.ravel() + len(vertices)
    on_ab, on_ca = b.copy(), c.copy()
    on_ab[cut_ab], on_ca[cut_ca] = of[: cut_ab.sum()], of[cut_ab.sum() :]

    tip = corner[:, 0] > 0  # the first corner alone is inside
    pieces = [np.stack([a, on_ab, on_ca], 1)[tip]]
    for which, quad in (
        (~tip & cut_ab & cut_ca, np.stack([on_ab, b, c, on_ca], 1)),
        # One of the other two is on the contour: a triangle is left.
        (~tip & cut_ab & ~cut_ca, np.stack([on_ab, b, c, c], 1)),
        (~tip & ~cut_ab & cut_ca, np.stack([b, c, on_ca, on_ca], 1)),
    ):
        p, q, r, s = quad[which].T
        pieces += [np.stack([p, q, r], 1), np.stack([p, r, s], 1)[r != s]]
    return np.concatenate(pieces).astype(faces.dtype), created
