"""How a closed template spans what its cloud does not show: a sole, the base of a thing on a table, an underside.

Screened Poisson goes on from the rim of an opening as it arrives there, and where that is steep, as over a shoe's side
or a hoof's, it makes a balloon about as high as half the opening is wide. The smallest surface in its place is right
for what is flat and cuts off what is round; half-way between the two leaves a quarter of the squared error in either
case. Where the points of the rim turn in already they tell what follows, and Poisson's surface is kept.

NumPy and SciPy only.
"""

from __future__ import annotations

import numpy as np

from warpdef.geometry import triangles
from warpdef.template.support import Support

FLATTER = 0.5  # of the way to the smallest surface, beside a steep rim
STEEP, TURNED_IN = 0.2, 0.5
"""Cosine between a rim's normal and the direction in which the opening looks: 0 at the end of a cylinder, 1/2 on a ball
60 degrees from its pole. Up to the first the rim says nothing of what is beyond it, from the second on all."""
RIM_POINTS = 8  # of the cloud, whose normals speak for a place of the rim


def closed_flatter(vertices: np.ndarray, faces: np.ndarray, opening: np.ndarray, support: Support) -> np.ndarray:
    """The vertices (V, 3), with those in openings nearer to the smallest surface, the more the steeper the rim.

    Args:
        vertices, faces: a closed surface (V, 3), (F, 3) whose faces have the side of the support's normals.
        opening: number of the opening that a vertex lies in, -1 in none, shape (V,).
    """
    inside = opening >= 0
    if not inside.any() or inside.all():
        return vertices
    a, b = triangles.unique_edges(faces).T
    crossing = inside[a] != inside[b]
    ends = np.where(inside[a], [b, a], [a, b])[:, crossing]
    rim, first = np.unique(ends[0], return_index=True)
    facing = support.normals_near(vertices[rim], RIM_POINTS)
    axis = _axes(vertices, faces, opening)[opening[ends[1][first]]]
    cosine = np.einsum("ri,ri->r", facing, axis)
    weight = np.zeros(len(vertices))
    weight[rim] = FLATTER * np.clip((TURNED_IN - cosine) / (TURNED_IN - STEEP), 0.0, 1.0)
    if not weight.any():
        return vertices
    # What the rim says of the way to go is carried inwards as its places are.
    spanned = spanned_smallest(np.column_stack([vertices, weight]), faces, inside)
    smallest, weight = spanned[:, :3], np.where(inside, spanned[:, 3], 0.0)[:, None]
    return (1.0 - weight) * vertices + weight * smallest


def spanned_smallest(values: np.ndarray, faces: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Values of vertices (V, K), those that are ``free`` (V,) now the mean of their neighbours'.

    Of places, (V, 3), that is the surface whose squared edges are least. What hangs together with nothing held stays.
    """
    from scipy.sparse import coo_matrix, diags
    from scipy.sparse.linalg import splu

    a, b = triangles.unique_edges(faces).T
    total = len(values)
    part = triangles.component_labels(a, b, total)
    free = free & np.isin(part, part[~free])
    if not free.any():
        return values
    free, held = np.flatnonzero(free), np.flatnonzero(~free)
    ends = np.concatenate([a, b]), np.concatenate([b, a])
    beside = coo_matrix((np.ones(2 * len(a)), ends), shape=(total, total)).tocsr()
    laplacian = (diags(np.asarray(beside.sum(axis=1)).ravel()) - beside).tocsr()[free]
    spanned = values.copy()
    spanned[free] = splu(laplacian[:, free].tocsc()).solve(-(laplacian[:, held] @ values[held]))
    return spanned


def _axes(vertices: np.ndarray, faces: np.ndarray, opening: np.ndarray) -> np.ndarray:
    """The direction in which each opening looks, unit, (openings, 3): its area as a vector, given by the rim alone."""
    corners = vertices[faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    owner = opening[faces].max(axis=1)
    axes = np.zeros((int(opening.max()) + 1, 3))
    np.add.at(axes, owner[owner >= 0], area[owner >= 0])
    return axes / np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), 1e-300)
