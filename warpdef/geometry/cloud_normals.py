"""Normals of a raw point cloud: their lines from local planes, their side from a winding-number field.

A closed surface S with outward normals n has an indicator chi (1 inside, 0 outside) with grad chi = -n delta_S. So the
area-weighted normals, smeared on a grid, must be (nearly) free of curl, and chi is 1/2 on every point. Both facts fix
the side of all normals at once, where a walk from neighbour to neighbour turns over at the first thin limb:

1. Start: the shortest vector field on the points whose chi is 1/2 on all of them, a linear least-norm problem
   (Lin et al. 2022, *Surface Reconstruction from Point Clouds without Normals by Parametrizing the Gauss Formula*),
   here regularised, solved by a few conjugate gradients, and with FFTs on a periodic grid in place of pair sums.
2. Sharpen: replace each normal by the direction of the curl-free part of all of them
   (Lin et al. 2024, *Fast and Globally Consistent Normal Orientation based on the Winding Number Normal Consistency*).
3. Detail: fit the local plane to the neighbours of the same side only, keep its normal where the plane is clear,
   and the field's where it is not (noise).
4. Where neighbours then still deny each other's side, as on a flat open sheet, walk from neighbour to neighbour.

NumPy and SciPy only, but for planes asked of a device; double precision outside the grids; the same input gives the
same bytes.
"""

from __future__ import annotations

import numpy as np

from warpdef.geometry.cloud_planes import Neighbourhood, agreement_of, fit_planes, turned_to, unit_vectors
from warpdef.geometry.curl_free import AROUND, AROUND_NOISY, CurlFreeField, least_norm_start
from warpdef.geometry.sampling import spread_evenly
from warpdef.geometry.triangles import component_labels

CELL_SPACINGS = 1.0  # grid cell, in mean point spacings
CELL_NOISE = 1.0  # and of clouds with wide noise, in noise
SPARSE, CELL_SPARSE = 2_000, 0.5
"""Of clouds of at most so many points, whose limbs are as thin as their points stand apart, the cell is that of a
spacing: 600 points of a person, a horse and two walkers have 1 to 5 % on the wrong side for 4 to 12 %, 1,000 have 0.3
to 2 for 2 to 9; 2,500 gain no more, for five times the time."""
CLEAR_PLANES = 0.8  # median clarity of a cloud's planes: 0.95 clean, 0.7 with noise of half a percent; above, ...
START_SPACINGS = 1.5  # ... signs can be taken from a grid as coarse as this, with a third of the cells; in noise ...
START_EXTENTS = 0.02  # ... too, up to this share of the body, whose limbs it has to tell apart
SHARPEN_ITERATIONS = 5
DISCORD_DOUBTED = 0.006  # of neighbours' sides, above which the field's answer is held against a walk's ...
DISCORD_GAIN = 0.1  # ... which has to have less than this share of it; a closed body's stays below, noise of 1 % too
OFF_SURFACE = 2.5  # spacings from a point, along its normal and against it, at which given normals are tried ...
FREE = 1.5  # ... unless another point is nearer than this
HALF_INSIDE = 0.25  # how far from 0 and 1 an indicator is neither
UNTRUE = 0.005  # share of places that are neither, up to which given normals are confirmed: right ones of whole bodies
# have 0 to 0.01, and a patch of 0.6 % turned over adds more than this
CONFIRMED_ITERATIONS = 2  # then find what is smaller
SIDED = 20_000
"""Points that tell the sides of a cloud's normals: a body's front and back are further apart than they are."""
CLEARLY_OPPOSED = -0.3  # cosine to the estimate below which a given normal is doubted
SMALL_PATCH = 0.02  # share of the points up to which a doubted patch needs ...
CLEAR_BREAK = -0.5  # ... a mean agreement with the normals around it below this, to be turned over


def estimate_normals(points: np.ndarray, neighbours: int = 16, noise: float = 0.0) -> np.ndarray:
    """Outward unit normals of a cloud that samples a closed surface, shape (N, 3) float64.

    Where the body is thinner, or a gap narrower, than about one point spacing, no method can tell the sides apart.
    On an open surface one side is chosen, the same all over. Of more than ``SIDED`` points so many, evenly spread, find
    the sides, and each point has that of the nearest of them.

    Args:
        points: shape (N, 3), any units.
        neighbours: points a local plane is fitted to; at most N are used.
        noise: of the points across the surface, their units, where it is wider than their spacing: no finer than that
            is the grid, and no local plane says more than the field does.
    """
    if len(points) > SIDED:
        few = spread_evenly(points, SIDED)
        sides = _of_nearest(points, few, estimate_normals(points[few], neighbours, noise))
        return sides if noise else _detail(Neighbourhood.of(points, neighbours), sides)
    near = Neighbourhood.of(points, neighbours)
    clarity = fit_planes(near.points, near.index, np.ones(near.index.shape))[1]
    cell, around = max(CELL_SPACINGS * near.spacing, CELL_NOISE * noise), AROUND_NOISY if noise else AROUND
    at_first = field = CurlFreeField(near.points, cell, around)
    coarse = START_SPACINGS * cell
    if not noise and len(points) <= SPARSE:
        field = CurlFreeField(near.points, CELL_SPARSE * near.spacing)
    elif coarse < START_EXTENTS * np.ptp(near.points, axis=0).max() if noise else np.median(clarity) > CLEAR_PLANES:
        at_first = CurlFreeField(near.points, coarse, around)
    return _estimated(near, field, at_first, planes=not noise)


def _of_nearest(points: np.ndarray, few: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """For each point (N, 3) the normal of the nearest of those whose indices ``few`` holds, (N, 3)."""
    from scipy.spatial import cKDTree

    return normals[cKDTree(points[few]).query(points)[1]]


def _estimated(near: Neighbourhood, field: CurlFreeField, at_first: CurlFreeField, planes: bool = True) -> np.ndarray:
    """The same, from the grid on which it starts; without local planes it is the field's word."""
    start = least_norm_start(at_first, near.area, noisy=not planes)
    side = _sharpened(near, field, unit_vectors(start), SHARPEN_ITERATIONS)
    normals = _detail(near, side) if planes else side
    if _discord(near, normals) > DISCORD_DOUBTED:
        # A flat open sheet has no inside, and the field cuts it into patches: there, a walk does better.
        walked = _walk(near, side)
        walked = _detail(near, walked) if planes else walked
        if _discord(near, walked) < DISCORD_GAIN * _discord(near, normals):
            return walked
    return normals


def _sharpened(near: Neighbourhood, field: CurlFreeField, side: np.ndarray, iterations: int) -> np.ndarray:
    """``side`` (N, 3), replaced some times by the direction of its curl-free part."""
    for _ in range(iterations):
        side = unit_vectors(field.project(near.area[:, None] * side))
    return side


def _confirmed(near: Neighbourhood, field: CurlFreeField, normals: np.ndarray) -> bool:
    """Whether the indicator of normals is 1 on their inner and 0 on their outer side, as it is of right ones only.

    Around a patch that is turned over it goes from one to the other where there is no surface. On a border it does so
    as well: normals of an open surface are not confirmed.
    """
    from scipy.spatial import cKDTree

    step = OFF_SURFACE * near.spacing * normals
    places = np.stack([near.points - step, near.points + step])
    free = cKDTree(near.points).query(places)[0] > FREE * near.spacing
    inner, outer = np.split(field.indicator(near.area[:, None] * normals, places[free]), [int(free[0].sum())])
    if not len(inner) or not np.median(inner) > 0.0:
        return False
    # Areas are relative, so that 1 is what most have.
    untrue = np.abs(np.concatenate([inner, outer]) / np.median(inner) - np.repeat([1, 0], [len(inner), len(outer)]))
    return float(np.mean(untrue > HALF_INSIDE)) <= UNTRUE


def _detail(near: Neighbourhood, side: np.ndarray) -> np.ndarray:
    """Local planes through the neighbours of the same side, where they are clear; ``side`` where they are not."""
    same_side = np.maximum(np.einsum("ni,nki->nk", side, side[near.index]), 0.0)
    normals, clarity = fit_planes(near.points, near.index, same_side)
    normals = turned_to(normals, side)
    clarity = (clarity**2)[:, None]
    return unit_vectors(clarity * normals + (1.0 - clarity) * side)


def _discord(near: Neighbourhood, normals: np.ndarray) -> float:
    """How much neighbouring normals deny each other's side, 0 to 1."""
    agreement, flatness = agreement_of(near.points, normals, *near.edges())
    return float((flatness * np.maximum(-agreement, 0.0)).sum() / max(flatness.sum(), 1e-300))


def _walk(near: Neighbourhood, side: np.ndarray) -> np.ndarray:
    """Local planes' normals, each given the side of its neighbour along a minimum spanning tree (Hoppe et al. 1992).

    What the side of the whole is, most of ``side`` decide, for every piece by itself.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

    normals, _ = fit_planes(near.points, near.index, np.ones(near.index.shape))
    i, j = near.edges()
    agreement, flatness = agreement_of(near.points, normals, i, j)
    count = len(normals)
    cost = 1.0 + 1e-6 - flatness * np.abs(agreement)  # an edge of cost 0 would be none
    tree = minimum_spanning_tree(coo_matrix((cost, (i, j)), shape=(count, count)).tocsr())
    tree = tree + tree.T
    pieces, piece = connected_components(tree, directed=False)
    sign = np.ones(count)
    for root in np.unique(piece, return_index=True)[1]:
        order, before = breadth_first_order(tree, root, directed=False)
        order = order[1:]
        agreement, _ = agreement_of(near.points, normals, order, before[order])
        for point, previous, same in zip(order, before[order], agreement >= 0, strict=True):
            sign[point] = sign[previous] if same else -sign[previous]
    votes = np.bincount(piece, sign * (normals * side).sum(axis=1), minlength=pieces)
    return normals * (sign * np.where(votes[piece] < 0, -1.0, 1.0))[:, None]


def repair_normals(points: np.ndarray, normals: np.ndarray, neighbours: int = 16) -> tuple[np.ndarray, int]:
    """Turn over given normals that clearly point inwards; directions are kept.

    Where the indicator of those given confirms them, only small patches are looked at, and the estimate of their side
    begins with them. Else all are turned if most oppose ``estimate_normals``. Then every connected patch that still
    opposes it is turned if it also opposes the normals around it: a patch that fits its surroundings is a place where
    the estimate is the one that errs. As it errs on small patches only (thin limbs), these need the clearer break. Of
    more than ``SIDED`` points so many make the estimate, as in ``estimate_normals``.

    Args:
        points: shape (N, 3), any units.
        normals: shape (N, 3), unit length.
        neighbours: as in ``estimate_normals``.

    Returns:
        normals, shape (N, 3) float64, and how many of them were turned over.
    """
    given = np.array(normals, dtype=np.float64)
    few = spread_evenly(points, SIDED)
    near = Neighbourhood.of(points[few], neighbours)
    field = CurlFreeField(near.points, CELL_SPACINGS * near.spacing)
    if _confirmed(near, field, given[few]):
        estimate = _sharpened(near, field, given[few], CONFIRMED_ITERATIONS)
    else:
        estimate = _estimated(near, field, field)
    if len(few) < len(points):
        estimate = _of_nearest(points, few, estimate)
    sign = np.ones(len(given))
    if ((given * estimate).sum(axis=1) < 0).mean() > 0.5:
        sign[:] = -1.0
    doubted = sign * (given * estimate).sum(axis=1) < CLEARLY_OPPOSED
    if doubted.any():
        if len(few) < len(points):
            near = Neighbourhood.of(points, neighbours)
        i, j = near.edges()
        agreement, flatness = agreement_of(near.points, sign[:, None] * given, i, j)
        inner = doubted[i] & doubted[j] & (agreement > 0)
        patch = component_labels(i[inner], j[inner], len(given))
        count = int(patch.max()) + 1
        border = doubted[i] != doubted[j]
        owner = np.where(doubted[i], patch[i], patch[j])[border]
        fit = np.bincount(owner, (flatness * agreement)[border], minlength=count)
        fit /= np.maximum(np.bincount(owner, flatness[border], minlength=count), 1e-300)
        size = np.bincount(patch[doubted], minlength=count)
        highest_fit = np.where(size <= SMALL_PATCH * len(given), CLEAR_BREAK, 0.0)
        sign[doubted & (fit <= highest_fit)[patch]] *= -1.0
    return sign[:, None] * given, int((sign < 0).sum())
