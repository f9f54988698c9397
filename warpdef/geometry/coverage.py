"""What a cloud shows: how much surface, and how many objects. One notion of each, for all that ask.

A frame is complete if the area that it shows is at least a given share of the fullest frame's. An object is a cluster
of points linked to their neighbours, unless these are several spacings away.
"""

from __future__ import annotations

import numpy as np

from warpdef.geometry.triangles import component_labels

AREA_NEIGHBOURS = 16
INNER_QUANTILE = 0.35  # of the areas around a point: a border point's own one is up to twice too large
LINK_NEIGHBOURS = 32
LINK_REACH = 3.0  # in sqrt(area of a point), twice the widest gap that a random cloud shows now and then
OBJECT_SHARE = 0.02  # least share of the points that is an object
COMPLETE_SURFACE = 0.7
"""Share of a known surface that a complete frame shows as well; thin limbs and few points cost whole bodies 0.24."""
JUDGED = 100
"""Points from which a cloud's area says something; a smaller one counts as complete."""


def area_of_discs(distance: np.ndarray) -> float:
    """Area of the surface that points lie on: of the discs to their 16th neighbours, in their unit squared.

    Args:
        distance: of all points to their nearest neighbours, themselves first, (N, k).
    """
    # As many points stand for the disc to the last neighbour as lie inside it.
    return float(np.pi * (distance[:, -1] ** 2).sum() / max(distance.shape[1] - 1, 1))


def shares_of_fullest(area: np.ndarray, sizes: np.ndarray, surface: float = np.inf) -> np.ndarray:
    """Of each frame's area (T,), what share it is of the largest one; 1 for clouds too small to be judged.

    Args:
        sizes: points of each frame, (T,). surface: area of the whole surface, where that is known: noise adds to a
            cloud's area, and what exceeds the surface's says nothing.
    """
    share = area / min(area.max(), surface)
    return np.where(sizes < JUDGED, np.maximum(share, 1.0), share)


def complete_frames(area: np.ndarray, sizes: np.ndarray, least: float, surface: float | None = None) -> np.ndarray:
    """Which frames show all of the surface, (T,) bool: at least the share ``least`` of the fullest one.

    Args:
        area, sizes: of each frame, (T,). surface: see ``shares_of_fullest``; of it ``COMPLETE_SURFACE`` is asked for.
    """
    whole = surface or np.inf
    enough = shares_of_fullest(area, sizes, whole) >= least
    return enough if surface is None else enough & ((area >= COMPLETE_SURFACE * whole) | (sizes < JUDGED))


def point_areas(points: np.ndarray) -> np.ndarray:
    """Area that each point stands for, shape (N,): of the disc to its 16th neighbour, made robust at borders."""
    return _point_areas(*_neighbours(points, AREA_NEIGHBOURS))


def _point_areas(distance: np.ndarray, index: np.ndarray) -> np.ndarray:
    """The same from the nearest neighbours of all points, themselves first, both (N, 17) or more."""
    count = min(AREA_NEIGHBOURS, distance.shape[1] - 1)
    area = np.pi * distance[:, count] ** 2 / count
    return np.maximum(np.quantile(area[index[:, : count + 1]], INNER_QUANTILE, axis=1), 1e-300)


def objects_of(points: np.ndarray, near: tuple[np.ndarray, np.ndarray] | None = None) -> np.ndarray:
    """Which object each point belongs to, shape (N,): 0 for the one with most points, and so on; -1 for none.

    Objects are connected clusters with at least ``OBJECT_SHARE`` of the points. There is always one.

    Args:
        points: shape (N, 3), free of outliers. near: distances and numbers of the 16 neighbours of all of them,
            themselves first, both (N, 17), where these are known.
    """
    labels = _linked(*near or _neighbours(points, AREA_NEIGHBOURS))
    # More links join clusters and part none: what the nearest ones hold together, all do.
    if labels.max() > 0:
        labels = _linked(*_neighbours(points, LINK_NEIGHBOURS))
    size = np.bincount(labels)
    order = np.argsort(-size, kind="stable")
    objects = max(int((size >= OBJECT_SHARE * len(points)).sum()), 1)
    number = np.full(len(size), -1)
    number[order[:objects]] = np.arange(objects)
    return number[labels]


def _linked(distance: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Cluster of each point, linked to those of its neighbours that are not several spacings away, shape (N,)."""
    reach = LINK_REACH * np.sqrt(_point_areas(distance, index))
    # The sparser of the two decides: density may change along a surface.
    linked = distance <= np.maximum(reach[:, None], reach[index])
    rows = np.repeat(np.arange(len(index)), linked.sum(axis=1))
    return component_labels(rows, index[linked], len(index))


def _neighbours(points: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Distances and numbers of that many neighbours of all points, themselves first, both (N, count + 1)."""
    from scipy.spatial import cKDTree

    return cKDTree(points).query(points, k=min(count, len(points) - 1) + 1)


def object_count(points: np.ndarray) -> int:
    """Number of objects in points (N, 3), at least 1."""
    return int(objects_of(points).max()) + 1 if len(points) > 1 else 1


def area_and_objects(points: np.ndarray) -> tuple[float, int]:
    """``area_of_discs`` and ``object_count`` of points (N, 3), whose neighbours are looked for once."""
    if len(points) <= 1:
        return 0.0, 1
    near = _neighbours(points, AREA_NEIGHBOURS)
    return area_of_discs(near[0][:, :AREA_NEIGHBOURS]), int(objects_of(points, near).max()) + 1
