"""Meshes of any size for the bench: a given one made finer by splitting edges, or coarser by merging vertices.

Only the count and the spread of vertices and edges matter here; a coarser mesh need not be a manifold.
"""

from __future__ import annotations

import numpy as np

CLOSE_ENOUGH = 0.05


def resize_mesh(vertices: np.ndarray, faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """A mesh of about ``count`` vertices; the given one where it is within ``CLOSE_ENOUGH`` of that.

    Args:
        vertices: shape (V, 3). faces: shape (F, 3).

    Returns:
        Vertices and faces: exactly ``count`` vertices when finer, within 3 % when coarser.
    """
    if abs(len(vertices) - count) <= CLOSE_ENOUGH * count:
        return vertices, faces
    if len(vertices) > count:
        return merge_vertices(vertices, faces, count)
    while len(vertices) < count:
        vertices, faces = split_long_edges(vertices, faces, count - len(vertices))
    return vertices, faces


def merge_vertices(vertices: np.ndarray, faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """About ``count`` vertices: those of one cell of a grid become their mean; faces that collapse go."""
    low, high = 1e-6, 1.0  # cell over extent; bisected on the number of occupied cells
    extent = float(np.ptp(vertices, axis=0).max())
    for _ in range(40):
        cell = np.sqrt(low * high)
        _, owner = np.unique(np.floor(vertices / (cell * extent)), axis=0, return_inverse=True)
        owner = owner.ravel()
        found = owner.max() + 1
        if abs(found - count) <= 0.01 * count:
            break
        low, high = (cell, high) if found > count else (low, cell)
    size = np.bincount(owner).astype(float)
    merged = np.stack([np.bincount(owner, weights=vertices[:, c]) / size for c in range(3)], axis=1)
    faces = owner[faces]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    faces = np.unique(faces[whole], axis=0)
    used, compact = np.unique(faces, return_inverse=True)
    return merged[used], compact.reshape(faces.shape)


def split_long_edges(vertices: np.ndarray, faces: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Split up to ``most`` edges in the middle, longest first, each being the longest of every face it borders."""
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2)  # side c of a face runs from corner c to the next
    edges, edge = np.unique(np.sort(sides.reshape(-1, 2), axis=1), axis=0, return_inverse=True)
    edge = edge.reshape(faces.shape)
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    # Ranks instead of lengths: no two are equal, so every face has one longest edge and some edge is always chosen.
    rank = np.empty(len(edges), dtype=np.int64)
    rank[np.argsort(length, kind="stable")] = np.arange(len(edges))
    side = rank[edge].argmax(axis=1)
    longest = edge[np.arange(len(faces)), side]
    chosen = np.flatnonzero(np.bincount(longest, minlength=len(edges)) == np.bincount(edge.ravel()))
    chosen = chosen[np.argsort(rank[chosen])][-most:]
    middle = np.full(len(edges), -1)
    middle[chosen] = len(vertices) + np.arange(len(chosen))
    cut = np.flatnonzero(middle[longest] >= 0)
    a, b, c = (faces[cut, (side[cut] + k) % 3] for k in range(3))
    m = middle[longest[cut]]
    rest = np.delete(faces, cut, axis=0)
    halves = [np.stack([a, m, c], axis=1), np.stack([m, b, c], axis=1)]
    centres = vertices[edges[chosen]].mean(axis=1)
    return np.concatenate([vertices, centres]), np.concatenate([rest, *halves])
