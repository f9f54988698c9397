"""Coordinates that were rounded before they came: steps so coarse that the surface has stairs. It is told, not mended.

Map coordinates written as float32 (half a metre apart at 5,000,000) or float16, decimals cut off, voxels. An axis is
looked at by the differences of its sorted values: on a lattice nearly all are multiples of the smallest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from warpdef.sequence import PointSequence

FRAMES_SEEN, POINTS_SEEN = 3, 5000
COARSE = 0.5  # of the spacing of points
LEAST_VALUES = 4  # a box has two on an axis
ON_LATTICE, OFF = 0.95, 0.01  # share of the differences that are multiples, and how nearly, in steps


def find_steps(clouds: Sequence[np.ndarray]) -> tuple[np.ndarray, float]:
    """Step of each axis, shape (3,), 0 where it is fine enough, and the spacing of the points; units as the clouds'.

    Args:
        clouds: T of shape (N_t, 3).
    """
    from scipy.spatial import cKDTree

    found, spacings = [], []
    for t in np.unique(np.linspace(0, len(clouds) - 1, FRAMES_SEEN).round().astype(int)):
        points = clouds[t] - clouds[t].min(axis=0)
        some = points[:: max(len(points) // POINTS_SEEN, 1)]
        spacings.append(float(np.median(cKDTree(points).query(some, k=2)[0][:, 1])))
        found.append([_step(points[:, axis]) for axis in range(3)])
    steps, spacing = np.min(found, axis=0), float(np.median(spacings))
    return np.where(steps > COARSE * spacing, steps, 0.0), spacing


def _step(values: np.ndarray) -> float:
    """The distance of which those between values (N,) are multiples; 0 for values on no lattice."""
    apart = np.diff(np.unique(values))
    apart = apart[apart > 1e-9 * max(float(values.max()), 1e-300)]  # decimals are not exact
    if len(apart) < LEAST_VALUES - 1:
        return 0.0
    times = apart / apart.min()
    return float(apart.min()) if (np.abs(times - np.rint(times)) < OFF).mean() >= ON_LATTICE else 0.0


def tell_coarse_steps(sequence: PointSequence) -> PointSequence:
    """The sequence with a note where its coordinates come in coarse steps."""
    steps, spacing = find_steps(sequence.points)
    axes = [f"{axis} in steps of {step:.3g}" for axis, step in zip("xyz", steps, strict=True) if step]
    if not axes:
        return sequence
    note = (
        f"coordinates were rounded before they came, {', '.join(axes)}, where points are {spacing:.3g} apart: no "
        "surface is finer; where they are large numbers in float32 or float16, take the origin off in float64 first"
    )
    return replace(sequence, notes=(*sequence.notes, note))
