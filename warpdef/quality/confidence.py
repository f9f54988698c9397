"""How far each vertex of each frame can be trusted: whether the frame shows it, how well it fits, how it is stretched.

    c = fit * stretch * (seen + (1 - seen) * shown / 2)

seen:    1 up to 2 lengths from the nearest point, 0 from ``FAR`` on or on a side that no point lies on
shown:   mean of seen over the frames: a vertex that other frames show has its shape from them, and only its place is
         guessed here
fit:     1 up to a mean residual of 1 length among the points nearest to it, 0 from ``FAR`` on
stretch: 1 while its edges are within a factor of 1.25 of the shape, 0 from 2 on; their mean
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warpdef.quality.coverage import FAR, Coverage

_SEEN, _FIT = 2.0, 1.0  # lengths up to which nothing is doubted
_STRETCH = np.log(1.25), np.log(2.0)


def vertex_confidence(
    coverages: Sequence[Coverage | None],
    stretches: Sequence[np.ndarray],
    edges: np.ndarray,
    faces: np.ndarray,
    count: int,
) -> np.ndarray:
    """The formula above for every frame, shape (T, V) uint8, 255 for 1.

    Args:
        coverages: T of them, None for a frame without points.
        stretches: T arrays (E,), |log l / l_shape| of the edges.
        edges: shape (E, 2). faces: shape (F, 3). count: number V of vertices.
    """
    seen = np.zeros((len(coverages), count), dtype=np.float32)
    rest = np.empty_like(seen)
    ends = edges.T.ravel()
    used = np.maximum(np.bincount(ends, minlength=count), 1)
    for t, (coverage, stretch) in enumerate(zip(coverages, stretches, strict=True)):
        rest[t] = _falling(np.bincount(ends, np.tile(stretch, 2), minlength=count) / used, *_STRETCH)
        if coverage is None:
            continue
        seen[t] = np.where(coverage.seen, _falling(coverage.away, _SEEN, FAR), 0.0)
        # A point counts at the corners of its face; a vertex without points has no misfit.
        corners, misfit = faces[coverage.face].ravel(), coverage.residual / coverage.length
        weight = np.bincount(corners, coverage.weights.ravel(), minlength=count)
        total = np.bincount(corners, (coverage.weights * misfit[:, None]).ravel(), minlength=count)
        rest[t] *= _falling(total / np.maximum(weight, 1e-9), _FIT, FAR)
    shown = seen.mean(axis=0)
    return np.round(255.0 * rest * (seen + 0.5 * (1.0 - seen) * shown)).astype(np.uint8)


def _falling(x: np.ndarray, full: float, none: float) -> np.ndarray:
    """1 up to ``full``, 0 from ``none`` on, straight between."""
    return np.clip((none - x) / (none - full), 0.0, 1.0)
