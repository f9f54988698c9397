"""Vector fields on points, smeared on a grid: their curl-free part, and the indicator of the body that they bound.

A closed surface S with outward normals n has an indicator chi (1 inside, 0 outside) with grad chi = -n delta_S. So the
area-weighted normals, smeared on a grid, must be (nearly) free of curl, and chi is 1/2 on every point.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np

SMOOTH_CELLS = 0.85  # Gaussian on the grid, standard deviation in cells
CELLS_MAX = 6_000_000  # beyond, the cell grows: 0.4 GB
REGULARISATION = 5.0  # of the start, relative to the mean diagonal: high enough for noise of one spacing
REGULARISATION_NOISY = 15.0  # and of clouds with wide noise, which no normals explain: with less, round ones turn over
START_ITERATIONS = 20
START_ITERATIONS_NOISY = 3  # what more of them explain is noise
START_TOLERANCE = 1e-2  # only signs are taken from the start

AROUND = 0.25  # of a body on every side, in extents: the periodic images must stay away
AROUND_NOISY = 0.15


class CurlFreeField:
    """Vectors on points, smeared on a periodic grid and freed of curl; and the potentials that go with them."""

    def __init__(self, points: np.ndarray, cell: float, around: float = AROUND) -> None:
        import scipy.fft

        fft: Any = scipy.fft  # its functions are handed on to others, which hides their types
        self._fft = fft
        low = points.min(axis=0)
        extent = points.max(axis=0) - low
        pad = max(around * float(extent.max()), 6.0 * cell)
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


def least_norm_start(field: CurlFreeField, area: np.ndarray, noisy: bool = False) -> np.ndarray:
    """The shortest normals (N, 3) with chi = 1/2 on every point, regularised: A W A^T + r I by conjugate gradients."""
    regularisation, iterations = REGULARISATION, START_ITERATIONS
    if noisy:
        regularisation, iterations = REGULARISATION_NOISY, START_ITERATIONS_NOISY

    def apply(charges: np.ndarray) -> np.ndarray:
        return field.indicator(area[:, None] * field.indicator_adjoint(charges))

    # Mean diagonal by a random probe of signs.
    probe = np.random.default_rng(0).choice([-1.0, 1.0], len(area))
    damping = regularisation * abs(_dot(probe, apply(probe))) / len(area)
    charges = np.zeros(len(area))
    residual = np.full(len(area), 0.5)
    direction, start_sq = residual.copy(), _dot(residual, residual)
    residual_sq = start_sq
    for _ in range(iterations):
        image = apply(direction) + damping * direction
        step = residual_sq / _dot(direction, image)
        charges += step * direction
        residual -= step * image
        previous, residual_sq = residual_sq, _dot(residual, residual)
        if residual_sq <= START_TOLERANCE**2 * start_sq:
            break
        direction = residual + residual_sq / previous * direction
    return area[:, None] * field.indicator_adjoint(charges)


def _dot(a: np.ndarray, b: np.ndarray) -> float:
    # BLAS would add in an order that depends on its number of threads.
    return float(np.sum(a * b))
