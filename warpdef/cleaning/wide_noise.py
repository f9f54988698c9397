"""Noise wider than the points stand apart: the fit begins with the surfaces that such clouds scatter around."""

from __future__ import annotations

import numpy as np

from warpdef.cloud import FramePoints
from warpdef.geometry.denoise import Scattered, denoised, noise_if_wide
from warpdef.sequence import PointSequence, Similarity


def without_wide_noise(
    sequence: PointSequence, into: Similarity, neighbours: int
) -> tuple[list[Scattered] | None, PointSequence]:
    """Noisy clouds as they were measured, in the cube, and the same sequence without noise, with normals.

    Of a sequence whose clouds mostly have little noise: None, and the sequence as it is.

    Args:
        sequence: input units. into: the cube. neighbours: see ``estimate_normals``.
    """
    clouds = [into.to_cube(p) for p in sequence.points]
    noise = np.array([noise_if_wide(p) for p in clouds])
    if not np.median(noise) > 0:
        return None, sequence
    scattered = [Scattered(p, float(max(n, np.median(noise)))) for p, n in zip(clouds, noise, strict=True)]
    found = [denoised(s.points, s.deviation, neighbours) for s in scattered]
    return scattered, sequence.with_clouds([FramePoints(into.from_cube(p), n) for p, n in found])
