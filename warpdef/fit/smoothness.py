"""Smooth in time: every vertex moves evenly within the patch of surface around it (``kernels.patches``).

The clouds of a sequence are noisy each in its own way, and a mesh that lands on every one of them flickers. Smoothing a
vertex's way through space bends limbs off their course, for these accelerate; smoothing its place in the moving frame
of its neighbourhood does not. The neighbourhood's course is smoothed only where that changes it as little as chance
does. After the moves that the clouds ask for are made, a second solve with the same matrix draws every vertex to its
smooth place as far as the clouds let it: neighbourhoods stay free to move, which the same pull inside the first solve
would have slowed. The noisier the clouds, the more this leaves of rigid patches alone, and the more their course is
smoothed wherever it goes.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from warpdef.fit.problem import Problem
from warpdef.geometry.edges import edge_graph
from warpdef.geometry.sampling import spread_evenly
from warpdef.geometry.triangles import component_labels
from warpdef.kernels.patches import fit_patches, local_places, smooth_rhs

_PATCH = 32  # vertices a patch
_PER_VERTEX = 4  # patches a vertex, at most
_SPREAD = 6  # edges over which a patch fades into those around it
_SIDE = 3  # frames on either side that a place is smoothed over
_REACH = _SIDE + 0.5  # usual steps in time up to which they are: a parabola does not reach over long gaps
_OWN_LEFT_OUT = 0.5  # share of a vertex's own smooth motion that is given up at noise 1
_COURSE = 0.5  # share in which the patches' own motion is smoothed at noise 1: limbs accelerate, and that must stay
_CHANCE = 0.08  # of an edge: so far patches of clean clouds are off an even course by chance; 0 at noise 1
_FIRMER = 3.0  # times as firmly again are vertices held where their course is even
_ALONE = 4.0  # weight where there is no time to be smooth in, before it is stiffened
_STIFFENING = 25.0  # factor on the weight at noise 1
_ORDER = 2  # a parabola through them: what accelerates evenly stays


class Smoothness:
    """Patches of the template, their motion, and the places of the vertices in them.

    Args:
        moving: the rest shape, (V,) vec3; vertices of all frames, (T, V) vec3; their rotations, (T, V) mat33.
        noise: see ``pairing.noise_of``. scratch: two arrays (T, V) vec3, for the time of a round.

    weight: of a smooth place against one plane. Where ``refine.time`` is 0, and with three frames or fewer, which any
    parabola passes through, patches only stiffen noisy clouds; without noise they are false.
    """

    def __init__(
        self, problem: Problem, moving: tuple[wp.array, wp.array, wp.array], noise: float, scratch: tuple[wp.array, ...]
    ) -> None:
        p, (self._rest, self._vertices, self._rotation) = problem, moving
        self._count, frames = p.vertex_count, p.frame_count
        ordered = p.config.refine.time > 0 and frames > _ORDER + 1
        self.weight = p.config.refine.time if ordered else _ALONE * float(noise > 0)
        if not self:
            return
        # Of noisy clouds what a vertex does on its own is mostly noise, and so is part of what its neighbourhood does.
        share = min(noise, 1.0)
        chance = _CHANCE * p.edge_length * (1.0 - share) if ordered else 0.0
        self._shares = 1.0 - _OWN_LEFT_OUT * share, _COURSE * share, chance, _FIRMER
        self.weight *= _STIFFENING**noise
        index, weight = patches_of(p.template, p.edges.numpy())
        row, member, strength = _members(index, weight)
        first, filter = time_filter(p.times) if ordered else (np.arange(frames), np.ones((frames, 1)))
        device, self._patches = p.device, len(row) - 1
        self._patch = wp.array(index, dtype=wp.int32, device=device), wp.array(weight, dtype=wp.float32, device=device)
        self._members = p.integers(row), p.integers(member), p.numbers(strength)
        self._filter = p.integers(first), wp.array(filter, dtype=wp.float32, device=device)
        poses = frames, self._patches
        self._poses = wp.zeros(poses, dtype=wp.mat33, device=device), wp.zeros(poses, dtype=wp.vec3, device=device)
        self._carried, self._local = scratch

    def __bool__(self) -> bool:
        return self.weight > 0

    # Tasks.

    def place(self, first: int, last: int) -> None:
        """Fit the patches of frames ``first .. last``, and find the places of the vertices in them."""
        frames, (patches, mesh) = last - first, (self._patches, self._count)
        moving = self._rest, self._vertices, self._rotation
        fit_patches(first * patches, frames * patches, *self._members, *moving, *self._poses)
        local_places(first * mesh, frames * mesh, *self._patch, *moving, *self._poses, self._carried, self._local)

    def hold(self, first: int, last: int, matrix_out: wp.array, rhs_out: wp.array) -> None:
        """Draw the vertices of frames ``first .. last`` to their smooth places; the matrix is added to."""
        begin, count = first * self._count, (last - first) * self._count
        places = self._rotation, self._carried, self._local
        smooth_rhs(begin, count, self.weight, *self._shares, *self._filter, *places, matrix_out, rhs_out)


def time_filter(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A parabola by least squares through the frames around each, and its value there (Savitzky and Golay 1964).

    Args:
        times: of the frames, shape (T,), ascending, in any unit.

    Returns:
        The first of the frames of each, (T,), and their weights (T, W), sum 1: frame t is smoothed over the frames
        ``first[t] .. first[t] + W``, up to three on either side, fewer and on one side at the ends, and fewer where
        frames are missing: what is farther away in time than three frames usually are is left out.
    """
    count = len(times)
    width = min(2 * _SIDE + 1, count)
    reach = _REACH * float(np.median(np.diff(times))) if count > 1 else 0.0
    first = np.clip(np.arange(count) - _SIDE, 0, count - width)
    weights = np.zeros((count, width))
    for t in range(count):
        used = np.arange(max(t - _SIDE, 0), min(t + _SIDE + 1, count))
        used = used[np.abs(times[used] - times[t]) <= reach]
        powers = np.vander(times[used] - times[t], min(_ORDER, len(used) - 1) + 1, increasing=True)
        weights[t, used - first[t]] = np.linalg.pinv(powers.astype(float))[0]
    return first, weights


def patches_of(vertices: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Overlapping patches of about 32 vertices of a mesh, which fade into each other over a few edges.

    Args:
        vertices: shape (V, 3). edges: shape (E, 2), each once.

    Returns:
        The patches of every vertex (V, W), at most four, the strongest first, and their weights, sum 1. Those that a
        vertex has too few of have weight 0. No patch reaches over a gap between components.
    """
    from scipy import sparse
    from scipy.sparse.csgraph import dijkstra

    total = len(vertices)
    walk = edge_graph(vertices, edges)
    centres = spread_evenly(vertices, max(total // _PATCH, 1))
    part = component_labels(edges[:, 0], edges[:, 1], total)
    lonely = np.flatnonzero(~np.isin(part, part[centres]))
    centres = np.union1d(centres, lonely[np.unique(part[lonely], return_index=True)[1]])
    source = dijkstra(walk, indices=centres, min_only=True, return_predecessors=True)[2]
    share = sparse.csr_matrix((np.ones(total), (np.arange(total), np.searchsorted(centres, source))))
    near = sparse.csr_matrix((np.ones(walk.nnz), walk.indices, walk.indptr), shape=walk.shape) + sparse.eye(total)
    mean = sparse.diags(1.0 / np.asarray(near.sum(axis=1)).ravel()) @ near
    for _ in range(_SPREAD):
        share = mean @ share
    return _strongest(share.tocsr(), _PER_VERTEX)


def _strongest(share, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Columns (V, W) of the largest entries of each row of a sparse matrix, and these (V, W), sum 1."""
    row = np.repeat(np.arange(share.shape[0]), np.diff(share.indptr))
    order = np.lexsort((share.indices, -share.data, row))
    rank = np.arange(len(row)) - share.indptr[row]
    kept = order[rank < most]
    index, weight = (np.zeros((share.shape[0], most), dtype=d) for d in (np.int32, np.float64))
    place = row[kept], rank[rank < most]
    index[place], weight[place] = share.indices[kept], share.data[kept]
    return index, weight / weight.sum(axis=1, keepdims=True)


def _members(index: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices of every patch in compressed rows, the strongest first, and their weights."""
    vertex, column = np.nonzero(weight > 0)
    patch, share = index[vertex, column], weight[vertex, column]
    order = np.lexsort((vertex, -share, patch))
    counts = np.bincount(patch, minlength=index.max() + 1)
    return np.concatenate([[0], np.cumsum(counts)]), vertex[order], share[order]
