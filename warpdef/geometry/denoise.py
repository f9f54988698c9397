"""Clouds whose noise is wider than their spacing: what surface their points scatter around, and its normals.

A plane through a fixed number of neighbours is pure noise once these lie within the noise, and so is every distance
that is counted in spacings: the denser such a cloud, the worse it is read. So lengths are the noise's here:

1. Thin the cloud until its points stand about as far apart as the noise is wide, each the mean of the points around it,
   and tell the side of the surface there (``cloud_normals``).
2. Move points onto the surface that all points around them say (moving least squares, Alexa et al. 2003): a parabola
   over the plane across the normal, fitted with Gaussian weights to the points whose normals lie on the same side.

NumPy and SciPy only; the same input gives the same bytes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdef.geometry.cloud_normals import estimate_normals
from warpdef.geometry.cloud_planes import unit_vectors
from warpdef.geometry.noise import noise_level

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

NOISY = 0.8
"""Noise over spacing from which a cloud counts as noisy."""
_POINTS_LEAST = 2000  # of fewer, limbs as thin as the spacing look like noise
_SPACED = 5000  # points that tell the spacing
POINTS = 5000  # of what a cloud is made to: more say no more of a surface as smooth as the noise leaves it
_ASKED = 200  # points that tell the density
_BALL = 2.5  # radius in which they count points, in noise
_HELD = 30.0  # points held there by clouds as dense as they are noisy, whose sides are told well
_MEAN_OF = 4  # points of the cloud a thinned one is the mean of, times the thinning
_WIDTH, _WIDTH_FALL, _WIDTHS = 2.4, 0.2, (1.0, 3.0)  # of the Gaussian, in noise, at that density; denser, narrower
_REACHED = 2.0  # widths up to which points are asked for
_ASKED_MAX = 300  # of them, at most
_PROJECTIONS = 2
_STEP_MAX = 1.5  # widths
_SPREAD_NEIGHBOURS = 12  # thinned points whose normals a point takes
_RIDGE = 1e-6
_CHUNK = 1024  # places at a time, for memory


@dataclass(frozen=True)
class Scattered:
    """A cloud as it was measured: points (N, 3), and their standard deviation across the surface, their units."""

    points: np.ndarray
    deviation: float


def noise_if_wide(points: np.ndarray) -> float:
    """Standard deviation of the points (N, 3) across their surface where that is wider than they stand, else 0."""
    from scipy.spatial import cKDTree

    if len(points) < _POINTS_LEAST:
        return 0.0
    tree = cKDTree(points)
    spacing = float(tree.query(points[:: -(-len(points) // _SPACED)], k=2)[0][:, 1].mean())
    noise = noise_level(points, tree, np.random.default_rng(0))
    return noise if noise > NOISY * spacing else 0.0


def denoised(
    points: np.ndarray, noise: float, neighbours: int = 16, trusted: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Points on the surface that a noisy cloud scatters around, and their outward unit normals.

    Args:
        points: shape (N, 3), any units. noise: their standard deviation across the surface, above 0.
        neighbours: as in ``estimate_normals``, of the thinned cloud.
        trusted: normals of the points, (N, 3), unit length, whose side is taken as it is; None: it is told anew.

    Returns:
        At most ``POINTS``, or half as many as the noise leaves apart, (M, 3) float64, and normals (M, 3).
    """
    from scipy.spatial import cKDTree

    points = np.asarray(points, dtype=np.float64)
    tree, rng = cKDTree(points), np.random.default_rng(0)
    order = rng.permutation(len(points))
    held = float(np.mean(tree.query_ball_point(points[order[:_ASKED]], _BALL * noise, return_length=True)))
    density = held / _HELD
    thinned = int(np.clip(len(points) / density, min(1000, len(points)), len(points)))
    if trusted is None:
        normals = _sides(points, tree, order[:thinned], noise, neighbours)
    else:
        normals = _spread_over(points, points, np.asarray(trusted, dtype=np.float64), noise)
    chosen = np.sort(order[: max(thinned // 2, POINTS)])
    width = noise * float(np.clip(_WIDTH * density**-_WIDTH_FALL, *_WIDTHS))
    return _project(points, normals, tree, chosen, width)


def _sides(points: np.ndarray, tree: cKDTree, thinned: np.ndarray, noise: float, neighbours: int) -> np.ndarray:
    """Outward normals of all points, smooth over the noise."""
    count = max(4, _MEAN_OF * len(points) // len(thinned))
    means = points[tree.query(points[thinned], k=min(count, len(points)))[1]].mean(axis=1)
    return _spread_over(points, means, estimate_normals(means, neighbours, noise), noise)


def _spread_over(points: np.ndarray, places: np.ndarray, sides: np.ndarray, noise: float) -> np.ndarray:
    """Unit normals of points (N, 3): means of the ``sides`` (M, 3) at places (M, 3) around them."""
    from scipy.spatial import cKDTree

    distance, index = cKDTree(places).query(points, k=min(_SPREAD_NEIGHBOURS, len(places)))
    weight = np.exp(-0.5 * (distance / noise) ** 2) + 1e-12
    return unit_vectors(np.einsum("nk,nki->ni", weight, sides[index]))


def _project(
    points: np.ndarray, normals: np.ndarray, tree: cKDTree, chosen: np.ndarray, width: float
) -> tuple[np.ndarray, np.ndarray]:
    """Those of the points, moved onto the surface that all say, and its normals there."""
    places, sides = points[chosen], normals[chosen]
    reached = tree.query_ball_point(places[:: max(1, len(places) // _ASKED)], _REACHED * width, return_length=True)
    count = int(np.clip(1.2 * np.mean(reached), 12, min(_ASKED_MAX, len(points))))
    for begin in range(0, len(places), _CHUNK):
        part = slice(begin, begin + _CHUNK)
        x, n = places[part], sides[part]
        near = tree.query(x, k=count)[1]
        for _ in range(_PROJECTIONS):
            x, n = _onto_parabola(x, n, points, normals, near, width)
        places[part], sides[part] = x, n
    return places, sides


def _onto_parabola(
    x: np.ndarray, n: np.ndarray, points: np.ndarray, normals: np.ndarray, index: np.ndarray, width: float
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Places (M, 3) and normals (M, 3) once on the parabolas through their neighbours (M, K)."""
    helper = np.where(np.abs(n[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = unit_vectors(np.cross(n, helper))
    axes = np.stack([first, np.cross(n, first), n], axis=1)
    local = (points[index] - x[:, None]) @ axes.transpose(0, 2, 1) / width
    facing = np.maximum(np.einsum("ni,nki->nk", n, normals[index]), 0.0)
    weight = np.exp(-0.5 * (local**2).sum(axis=2)) * facing
    u, v, height = local[:, :, 0], local[:, :, 1], local[:, :, 2]
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=2)
    weighed = weight[:, :, None] * terms
    matrix = weighed.transpose(0, 2, 1) @ terms
    matrix += (_RIDGE * matrix[:, :1, :1] + 1e-300) * np.eye(terms.shape[2])
    found = np.linalg.solve(matrix, weighed.transpose(0, 2, 1) @ height[:, :, None])[:, :, 0]
    move = width * np.clip(found[:, :1], -_STEP_MAX, _STEP_MAX)
    return x + move * n, unit_vectors(n - found[:, 1:2] * axes[:, 0] - found[:, 2:3] * axes[:, 1])
