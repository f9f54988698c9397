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

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from warpdef.geometry.nearby import Fellows
from warpdef.geometry.sampling import spread_evenly
from warpdef.geometry.triangles import component_labels

if TYPE_CHECKING:
    import warp as wp

CELL_SPACINGS = 1.0  # grid cell, in mean point spacings
CELL_NOISE = 1.0  # and of clouds with wide noise, in noise
SMOOTH_CELLS = 0.85  # Gaussian on the grid, standard deviation in cells
CELLS_MAX = 6_000_000  # beyond, the cell grows: 0.4 GB
CLEAR_PLANES = 0.8  # median clarity of a cloud's planes: 0.95 clean, 0.7 with noise of half a percent; above, ...
START_SPACINGS = 1.5  # ... signs can be taken from a grid as coarse as this, with a third of the cells
REGULARISATION = 5.0  # of the start, relative to the mean diagonal: high enough for noise of one spacing
REGULARISATION_NOISY = 15.0  # and of clouds with wide noise, which no normals explain: with less, round ones turn over
START_ITERATIONS = 20
START_TOLERANCE = 1e-2  # only signs are taken from the start
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


def pca_normals(points: np.ndarray, neighbours: int = 16, device: wp.Device | None = None) -> np.ndarray:
    """Unit normals of the planes through each point's neighbours, shape (N, 3) float64; their sign means nothing.

    Args:
        points: shape (N, 3), any units.
        neighbours: points a plane is fitted to, the point itself among them; at most N are used.
        device: where they are looked for; None: on the host, without Warp.
    """
    return Fellows(points, max(neighbours, 4), device=device).planes()[0]


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
        return sides if noise else _detail(_Neighbourhood.of(points, neighbours), sides)
    near = _Neighbourhood.of(points, neighbours)
    clarity = _fit_planes(near.points, near.index, np.ones(near.index.shape))[1]
    clear = not noise and float(np.median(clarity)) > CLEAR_PLANES
    field = _CurlFreeField(near.points, max(CELL_SPACINGS * near.spacing, CELL_NOISE * noise))
    at_first = _CurlFreeField(near.points, START_SPACINGS * near.spacing) if clear else field
    return _estimated(near, field, at_first, planes=not noise)


def _of_nearest(points: np.ndarray, few: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """For each point (N, 3) the normal of the nearest of those whose indices ``few`` holds, (N, 3)."""
    from scipy.spatial import cKDTree

    return normals[cKDTree(points[few]).query(points)[1]]


def _estimated(
    near: _Neighbourhood, field: _CurlFreeField, at_first: _CurlFreeField, planes: bool = True
) -> np.ndarray:
    """The same, from the grid on which it starts; without local planes it is the field's word."""
    start = _least_norm_start(at_first, near.area, REGULARISATION if planes else REGULARISATION_NOISY)
    side = _sharpened(near, field, unit_vectors(start), SHARPEN_ITERATIONS)
    normals = _detail(near, side) if planes else side
    if _discord(near, normals) > DISCORD_DOUBTED:
        # A flat open sheet has no inside, and the field cuts it into patches: there, a walk does better.
        walked = _walk(near, side)
        walked = _detail(near, walked) if planes else walked
        if _discord(near, walked) < DISCORD_GAIN * _discord(near, normals):
            return walked
    return normals


def _sharpened(near: _Neighbourhood, field: _CurlFreeField, side: np.ndarray, iterations: int) -> np.ndarray:
    """``side`` (N, 3), replaced some times by the direction of its curl-free part."""
    for _ in range(iterations):
        side = unit_vectors(field.project(near.area[:, None] * side))
    return side


def _confirmed(near: _Neighbourhood, field: _CurlFreeField, normals: np.ndarray) -> bool:
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


def _detail(near: _Neighbourhood, side: np.ndarray) -> np.ndarray:
    """Local planes through the neighbours of the same side, where they are clear; ``side`` where they are not."""
    same_side = np.maximum(np.einsum("ni,nki->nk", side, side[near.index]), 0.0)
    normals, clarity = _fit_planes(near.points, near.index, same_side)
    normals = turned_to(normals, side)
    clarity = (clarity**2)[:, None]
    return unit_vectors(clarity * normals + (1.0 - clarity) * side)


def _discord(near: _Neighbourhood, normals: np.ndarray) -> float:
    """How much neighbouring normals deny each other's side, 0 to 1."""
    agreement, flatness = _agreement(near.points, normals, *near.edges())
    return float((flatness * np.maximum(-agreement, 0.0)).sum() / max(flatness.sum(), 1e-300))


def _walk(near: _Neighbourhood, side: np.ndarray) -> np.ndarray:
    """Local planes' normals, each given the side of its neighbour along a minimum spanning tree (Hoppe et al. 1992).

    What the side of the whole is, most of ``side`` decide, for every piece by itself.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

    normals, _ = _fit_planes(near.points, near.index, np.ones(near.index.shape))
    i, j = near.edges()
    agreement, flatness = _agreement(near.points, normals, i, j)
    count = len(normals)
    cost = 1.0 + 1e-6 - flatness * np.abs(agreement)  # an edge of cost 0 would be none
    tree = minimum_spanning_tree(coo_matrix((cost, (i, j)), shape=(count, count)).tocsr())
    tree = tree + tree.T
    pieces, piece = connected_components(tree, directed=False)
    sign = np.ones(count)
    for root in np.unique(piece, return_index=True)[1]:
        order, before = breadth_first_order(tree, root, directed=False)
        order = order[1:]
        agreement, _ = _agreement(near.points, normals, order, before[order])
        for point, previous, same in zip(order, before[order], agreement >= 0, strict=True):
            sign[point] = sign[previous] if same else -sign[previous]
    votes = np.bincount(piece, sign * (normals * side).sum(axis=1), minlength=pieces)
    return normals * (sign * np.where(votes[piece] < 0, -1.0, 1.0))[:, None]


def turned_to(normals: np.ndarray, side: np.ndarray) -> np.ndarray:
    """``normals``, each turned over where it opposes the one of ``side``; both (N, 3)."""
    return np.where((normals * side).sum(axis=1, keepdims=True) < 0, -normals, normals)


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
    near = _Neighbourhood.of(points[few], neighbours)
    field = _CurlFreeField(near.points, CELL_SPACINGS * near.spacing)
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
            near = _Neighbourhood.of(points, neighbours)
        i, j = near.edges()
        agreement, flatness = _agreement(near.points, sign[:, None] * given, i, j)
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


@dataclass(frozen=True)
class _Neighbourhood:
    """points (N, 3) float64; index: neighbours, the point itself first (N, K); area: relative area a point stands for
    (N,); spacing: mean distance to the nearest six."""

    points: np.ndarray
    index: np.ndarray
    area: np.ndarray
    spacing: float

    @classmethod
    def of(cls, points: np.ndarray, neighbours: int) -> _Neighbourhood:
        from scipy.spatial import cKDTree

        points = np.ascontiguousarray(points, dtype=np.float64)
        distance, index = cKDTree(points).query(points, k=min(max(neighbours, 4), len(points)))
        area = distance[:, -1] ** 2
        return cls(points, index, area / max(area.mean(), 1e-300), float(distance[:, 1:7].mean()))

    def edges(self) -> tuple[np.ndarray, np.ndarray]:
        """Undirected neighbour pairs, each once: two arrays of E indices."""
        count = len(self.index)
        i, j = np.repeat(np.arange(count), self.index.shape[1]), self.index.ravel()
        first, second = np.divmod(np.unique((np.minimum(i, j) * count + np.maximum(i, j))[i != j]), count)
        return first, second


def unit_vectors(x: np.ndarray) -> np.ndarray:
    """Vectors (N, 3) of length 1; zero where they are zero."""
    return x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-300)


def _dot(a: np.ndarray, b: np.ndarray) -> float:
    # BLAS would add in an order that depends on its number of threads.
    return float(np.sum(a * b))


def _fit_planes(points: np.ndarray, index: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normals (N, 3) of weighted planes through ``points[index]``, and how clear each plane is: 1 flat, 0 a ball."""
    total = np.maximum(weight.sum(axis=1), 1e-300)
    near = points[index]
    near = near - (np.einsum("nk,nki->ni", weight, near) / total[:, None])[:, None]
    spread, axes = np.linalg.eigh(np.einsum("nk,nki,nkj->nij", weight, near, near))
    return axes[:, :, 0], 1.0 - np.clip(spread[:, 0], 0, None) / np.maximum(spread[:, 1], 1e-300)


def _agreement(points: np.ndarray, normals: np.ndarray, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How well the sides of pairs of normals agree, -1 to 1, and how far to trust that, 0 to 1; both of shape (E,).

    The first is n_i . n_j with n_j mirrored across the step from i to j: right across sharp edges and thin walls too.
    The second is high where the step runs along the surface.
    """
    step = unit_vectors(points[j] - points[i])
    n_i, n_j = normals[i], normals[j]
    rise_i, rise_j = (n_i * step).sum(axis=1), (n_j * step).sum(axis=1)
    flatness = (1.0 - np.minimum(np.maximum(np.abs(rise_i), np.abs(rise_j)), 1.0)) ** 2
    return (n_i * n_j).sum(axis=1) - 2.0 * rise_i * rise_j, flatness


class _CurlFreeField:
    """Vectors on points, smeared on a periodic grid and freed of curl; and the potentials that go with them."""

    def __init__(self, points: np.ndarray, cell: float) -> None:
        import scipy.fft

        fft: Any = scipy.fft  # its functions are handed on to others, which hides their types
        self._fft = fft
        low = points.min(axis=0)
        extent = points.max(axis=0) - low
        # The periodic images must stay away: a quarter of the body on every side.
        pad = max(0.25 * float(extent.max()), 6.0 * cell)
        cell = max(cell, float((np.prod(extent + 2 * pad) / CELLS_MAX) ** (1 / 3)))
        self.shape = tuple(fft.next_fast_len(int(np.ceil(side / cell)) + 2, real=True) for side in extent + 2 * pad)
        self._size = int(np.prod(self.shape))
        self._low, self._cell = low - pad, cell
        self._points = self._corners(points)
        kx, ky = (2 * np.pi * fft.fftfreq(n).astype(np.float32) for n in self.shape[:2])
        kz = 2 * np.pi * fft.rfftfreq(self.shape[2]).astype(np.float32)
        self._k = (kx[:, None, None], ky[None, :, None], kz[None, None, :])
        k_sq = sum(k * k for k in self._k)
        # Gaussian over -Laplacian; the mean (k = 0) has no gradient.
        self._filter = np.exp(-0.5 * SMOOTH_CELLS**2 * k_sq) / np.maximum(k_sq, 1e-12)
        self._filter[0, 0, 0] = 0.0

    def _corners(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nodes around places (N, 3) that are padding or less away from the points, and their weights, (N, 8) each."""
        place = (places - self._low) / self._cell
        corner = np.floor(place).astype(np.int64)
        part = (place - corner).astype(np.float32)
        offset = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
        weight = np.prod(np.where(offset == 1, part[:, None], 1.0 - part[:, None]), axis=2)
        index = np.ravel_multi_index(tuple((corner[:, None] + offset).transpose(2, 0, 1)), self.shape)
        return np.asarray(index), weight

    def _spread(self, values: np.ndarray) -> np.ndarray:
        index, weight = self._points
        grid = np.bincount(index.ravel(), (weight * values[:, None]).ravel(), minlength=self._size)
        return grid.astype(np.float32).reshape(self.shape)

    def _gather(self, spectrum: np.ndarray, places: np.ndarray | None = None) -> tuple[np.ndarray, float]:
        """On the points, or at other places; and at a far corner."""
        grid = self._fft.irfftn(spectrum, s=self.shape).ravel()
        index, weight = self._points if places is None else self._corners(places)
        return (grid[index] * weight).sum(axis=1).astype(np.float64), float(grid[0])

    def _divergence(self, vectors: np.ndarray) -> np.ndarray:
        parts = (k * self._fft.rfftn(self._spread(v)) for k, v in zip(self._k, vectors.T, strict=True))
        return cast(np.ndarray, sum(parts))  # there are three: it is not the bare 0

    def project(self, vectors: np.ndarray) -> np.ndarray:
        """The curl-free part of vectors (N, 3) on the points, smoothed, at the points (N, 3)."""
        potential = self._divergence(vectors) * self._filter
        return np.stack([self._gather(potential * k)[0] for k in self._k], axis=1)

    def indicator(self, normals: np.ndarray, places: np.ndarray | None = None) -> np.ndarray:
        """chi of area-weighted outward normals (N, 3), 0 at a far corner: at the points, or at places near them."""
        there, far = self._gather(1j * self._divergence(normals) * self._filter, places)
        return there - far

    def indicator_adjoint(self, charges: np.ndarray) -> np.ndarray:
        """Transpose of ``indicator``: (N,) to (N, 3)."""
        grid = self._spread(charges)
        grid[0, 0, 0] -= charges.sum()
        potential = -1j * self._fft.rfftn(grid) * self._filter
        return np.stack([self._gather(potential * k)[0] for k in self._k], axis=1)


def _least_norm_start(field: _CurlFreeField, area: np.ndarray, regularisation: float = REGULARISATION) -> np.ndarray:
    """The shortest normals (N, 3) with chi = 1/2 on every point, regularised: A W A^T + r I by conjugate gradients."""

    def apply(charges: np.ndarray) -> np.ndarray:
        return field.indicator(area[:, None] * field.indicator_adjoint(charges))

    # Mean diagonal by a random probe of signs.
    probe = np.random.default_rng(0).choice([-1.0, 1.0], len(area))
    damping = regularisation * abs(_dot(probe, apply(probe))) / len(area)
    charges = np.zeros(len(area))
    residual = np.full(len(area), 0.5)
    direction, start_sq = residual.copy(), _dot(residual, residual)
    residual_sq = start_sq
    for _ in range(START_ITERATIONS):
        image = apply(direction) + damping * direction
        step = residual_sq / _dot(direction, image)
        charges += step * direction
        residual -= step * image
        previous, residual_sq = residual_sq, _dot(residual, residual)
        if residual_sq <= START_TOLERANCE**2 * start_sq:
            break
        direction = residual + residual_sq / previous * direction
    return area[:, None] * field.indicator_adjoint(charges)
