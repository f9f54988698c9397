"""Separate objects in one cloud: points linked to their neighbours, unless these are several spacings away."""

from __future__ import annotations

import numpy as np

from warpdef.geometry.triangles import component_labels
from warpdef.template.support import point_areas

LINK_NEIGHBOURS = 32
LINK_REACH = 3.0  # in sqrt(area of a point), twice the widest gap that a random cloud shows now and then
OBJECT_SHARE = 0.02  # least share of the points that is an object


def point_clusters(points: np.ndarray) -> np.ndarray:
    """Which object each point belongs to, shape (N,): 0 for the one with most points, and so on; -1 for none.

    Objects are connected clusters with at least ``OBJECT_SHARE`` of the points. There is always one.

    Args:
        points: shape (N, 3), free of outliers.
    """
    from scipy.spatial import cKDTree

    count = min(LINK_NEIGHBOURS, len(points) - 1)
    distance, index = cKDTree(points).query(points, k=count + 1)
    reach = LINK_REACH * np.sqrt(point_areas(points))
    # The sparser of the two decides: density may change along a surface.
    linked = distance <= np.maximum(reach[:, None], reach[index])
    rows = np.repeat(np.arange(len(points)), linked.sum(axis=1))
    labels = component_labels(rows, index[linked], len(points))
    size = np.bincount(labels)
    order = np.argsort(-size, kind="stable")
    objects = max(int((size >= OBJECT_SHARE * len(points)).sum()), 1)
    number = np.full(len(size), -1)
    number[order[:objects]] = np.arange(objects)
    return number[labels]
