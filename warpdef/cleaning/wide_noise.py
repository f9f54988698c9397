"""Noise wider than the points stand apart: the fit begins with the surfaces that such clouds scatter around."""

from __future__ import annotations

import numpy as np

from warpdef.cloud import FramePoints
from warpdef.geometry.denoise import Scattered, denoised, noise_if_wide
from warpdef.sequence import PointSequence, Similarity


def without_wide_noise(
    sequence: PointSequence, into: Similarity, neighbours: int, trusted: bool = False
) -> tuple[list[Scattered] | None, PointSequence]:
    """Noisy clouds as they were measured, in the cube, and the same sequence without noise, with normals.

    Of a sequence whose clouds mostly have little noise: None, and the sequence as it is.

    Args:
        sequence: input units. into: the cube. neighbours: see ``estimate_normals``. trusted: whether given
            normals keep their sides.
    """
    clouds = [into.to_cube(p) for p in sequence.points]
    noise = np.array([noise_if_wide(p) for p in clouds])
    if not np.median(noise) > 0:
        return None, sequence
    scattered = [Scattered(p, float(max(n, np.median(noise)))) for p, n in zip(clouds, noise, strict=True)]
    sides = sequence.normals if trusted else [None] * len(scattered)
    found = [denoised(s.points, s.deviation, neighbours, n) for s, n in zip(scattered, sides, strict=True)]
    return scattered, sequence.with_clouds([FramePoints(into.from_cube(p), n) for p, n in found])


def noise_facts(
    scattered: list[Scattered], measured: PointSequence, calm: PointSequence, into: Similarity, trusted: bool
) -> dict[str, float | int | str]:
    """What is told of noisy clouds: ``deviation`` of their points across the surface, input units, and as a ``share``
    of the extent; ``points`` a frame that the fit begins with; whose side ``normals`` have: estimated, or kept."""
    deviation = float(np.median([s.deviation for s in scattered])) / into.scale
    extent = float(
        np.ptp(np.concatenate([np.stack([p.min(axis=0), p.max(axis=0)]) for p in measured.points]), axis=0).max()
    )
    kept = trusted and all(n is not None for n in measured.normals)
    return {
        "deviation": deviation,
        "share": deviation / extent,
        "points": int(np.median([len(p) for p in calm.points])),
        "normals": "kept" if kept else "estimated",
        "normals_given": sum(n is not None for n in measured.normals),
    }


def noise_note(facts: dict[str, float | int | str]) -> str:
    """The same in one line."""
    line = (
        f"the clouds are noisy: points lie {facts['deviation']:.3g} ({facts['share']:.1%} of the extent) off their "
        f"surface, more than they stand apart; the fit begins with {facts['points']} points a frame, moved onto it"
    )
    if not facts["normals_given"]:
        return line
    if facts["normals"] == "kept":
        return f"{line}; given normals keep their sides"
    return f"{line}, and with their normals in place of those given (--trust-normals keeps the sides of these)"
