"""Surface inside the cloud: a wall that no scanner can have seen, because points lie around it on all sides.

Where bodies meet or part, a mesh of two pieces, or of one that was one, keeps a wall between them; a limb that is lost
may lie crumpled in the trunk. Surface that no point is near to is such if points are seen from there in all directions;
from the unseen back of a scan they are seen in half of them.
"""

from __future__ import annotations

import numpy as np

from warpdef.quality.coverage import Coverage

ENCLOSED = 0.9
"""Share of the directions in which points are seen from surface inside them."""
_DIRECTIONS = 32
_PLACES, _POINTS = 64, 1500  # looked at, of either


def inner_share(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray, coverage: Coverage) -> float:
    """Share of the surface that is far from every point and enclosed by them.

    Args:
        points: shape (N, 3). vertices: shape (V, 3). faces: shape (F, 3). coverage: of these.
    """
    weight = coverage.far_faces * coverage.areas
    if not weight.sum() > 0.0:
        return 0.0
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(faces), _PLACES, p=weight / weight.sum())
    if len(points) > _POINTS:
        points = points[rng.choice(len(points), _POINTS, replace=False)]
    seen = seen_directions(vertices[faces[chosen]].mean(axis=1), points)
    return coverage.far * float(np.mean(seen >= ENCLOSED))


def seen_directions(places: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Share of all directions in which points (N, 3) are seen from each place (M, 3), shape (M,)."""
    directions = sphere(_DIRECTIONS)
    seen = np.empty(len(places))
    for i, place in enumerate(places):
        seen[i] = len(np.unique(((points - place) @ directions.T).argmax(axis=1)))
    return seen / len(directions)


def sphere(count: int) -> np.ndarray:
    """Unit vectors spread evenly, shape (count, 3): a Fibonacci lattice."""
    height = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt(1.0 - height**2)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
