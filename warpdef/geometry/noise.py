"""How far the points of a cloud lie off their surface, told by the cloud alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_JUDGED = 200  # points whose neighbourhoods tell the noise
_FLAT = ((16, 0.5), (48, 0.75), (144, np.inf))
"""Neighbours asked for the noise, and thickness over width up to which they are believed: noise wider than a
neighbourhood makes it a ball (0.8), and the next larger one is asked."""


def noise_level(points: np.ndarray, tree: cKDTree, rng: np.random.Generator) -> float:
    """Standard deviation of the points (N, 3) across their surface, the points' units; ``tree`` is a k-d tree of them.

    What a surface bends within a neighbourhood counts as noise, so that it is never far below a third of the spacing.
    """
    asked = points if len(points) <= _JUDGED else points[rng.choice(len(points), _JUDGED, replace=False)]
    thickness = np.zeros(1)
    for count, flat in _FLAT:
        near = points[tree.query(asked, k=min(count, len(points)))[1]]
        near = near - near.mean(axis=1, keepdims=True)
        spread = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", near, near) / near.shape[1])
        thickness, width = np.sqrt(np.maximum(spread[:, :2], 0.0)).T
        if np.median(thickness) <= flat * np.median(width):
            break
    return float(np.median(thickness))
