"""One cloud: checked, cleaned, and thinned; what its points carry goes with them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from warpdef.errors import InputError

MIN_POINTS = 10
LARGEST_COORDINATE = 1e30
"""Coordinates beyond it are no measurement, and squared they would leave float32."""
MARK_SHARE, MARK_LEAST = 0.01, 10
"""A position that so many points of a frame share, and no other position does, stands for nothing seen (0 0 0)."""
SPACING_NEIGHBOURS = 8
"""Neighbours whose farthest tells a local spacing: sqrt(8 a / pi) on a surface with area a a point."""


class FramePoints(NamedTuple):
    """What one frame holds: positions, input units, and what its points carry, None where that is unknown.

    points: (N, 3). normals: (N, 3). colors: sRGB, (N, 3), uint8 once they are checked; before also fractions of 1.
    """

    points: np.ndarray
    normals: np.ndarray | None = None
    colors: np.ndarray | None = None

    def keep(self, chosen: np.ndarray) -> FramePoints:
        """Those points, by a mask (N,) or by indices (M,), with all that they carry."""
        return FramePoints(*(None if array is None else array[chosen] for array in self))  # type: ignore[arg-type]


def check_cloud(cloud: FramePoints, name: str) -> tuple[FramePoints, int, int, bool]:
    """One frame, clean: duplicates merged, points that are no numbers left out, normals of unit length.

    Args:
        cloud: as read; colours may have a fourth column, which is left out. name: of the frame, for errors.

    Returns:
        Points and normals, float64, and colours, uint8; duplicates merged; points left out, marks of nothing seen among
        them; whether normals were given but are not usable.

    Raises:
        InputError: a wrong shape, fewer than 10 different points, or all points equal.
    """
    p, n = _as_points(cloud.points, name), _as_normals(cloud.normals, cloud.points, name)
    c = _as_colors(cloud.colors, cloud.points, name)
    # "not <=" holds for NaN too.
    bad = np.zeros(len(p), dtype=bool)
    for axis in range(3):
        bad |= ~(np.abs(p[:, axis]) <= LARGEST_COORDINATE)
    dropped = int(bad.sum())
    if dropped:
        if len(p) - dropped < MIN_POINTS:
            raise InputError(
                f"{name}: points: expected finite coordinates below {LARGEST_COORDINATE:g}, got NaN or infinity or "
                f"larger in {dropped} of {len(p)} (first: point {int(bad.argmax())}); scan it again"
            )
        p, n, c = FramePoints(p, n, c).keep(~bad)
    unit = None if n is None else _unit(n)
    whole, mark = _merge_duplicates(FramePoints(p, unit, c))
    merged, p = len(p) - len(whole.points), whole.points
    if mark and len(p) > MIN_POINTS:
        # An organised cloud of a sensor has a point a pixel, also where it measured nothing.
        whole = whole.keep(~(p == mark[0]).all(axis=1))
        merged, dropped, p = merged - mark[1] + 1, dropped + mark[1], whole.points
    if len(p) == 1:
        raise InputError(f"{name}: all points are equal; expected a surface, got a single position; drop this frame")
    if len(p) < MIN_POINTS:
        raise InputError(f"{name}: expected at least {MIN_POINTS} different points, got {len(p)}; drop this frame")
    return whole, merged, dropped, n is not None and unit is None


def _as_points(points: np.ndarray, name: str) -> np.ndarray:
    try:
        # A damaged file may hold signalling NaNs, of which NumPy would warn.
        with np.errstate(invalid="ignore", over="ignore"):
            points = np.asarray(points, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name}: points: expected numbers of shape (N, 3), got something else") from None
    if points.ndim != 2 or points.shape[1] != 3:
        hint = "; drop the columns after the third" if points.ndim == 2 and points.shape[1] > 3 else ""
        raise InputError(f"{name}: points: expected shape (N, 3), got {points.shape}{hint}")
    if len(points) < MIN_POINTS:
        raise InputError(
            f"{name}: expected at least {MIN_POINTS} points, got {len(points)}; drop this frame or scan it again"
        )
    return points


def _as_normals(normals: np.ndarray | None, points: np.ndarray, name: str) -> np.ndarray | None:
    if normals is None:
        return None
    try:
        with np.errstate(invalid="ignore", over="ignore"):
            normals = np.asarray(normals, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name}: normals: expected numbers of shape (N, 3), got something else") from None
    if normals.shape != (len(points), 3):
        raise InputError(
            f"{name}: normals: expected shape ({len(points)}, 3) as the points have, got {normals.shape}; "
            "give one normal a point, or none"
        )
    return normals


def _as_colors(colors: np.ndarray | None, points: np.ndarray, name: str) -> np.ndarray | None:
    if colors is None:
        return None
    colors = np.asarray(colors)
    if colors.shape not in ((len(points), 3), (len(points), 4)) or colors.dtype.kind not in "uif":
        raise InputError(
            f"{name}: colours: expected shape ({len(points)}, 3) as the points have, got {colors.shape} "
            f"{colors.dtype}; give one colour a point, or none"
        )
    colors = colors[:, :3]
    return np.ascontiguousarray(colors if colors.dtype == np.uint8 else byte_colors(colors, colors.dtype.kind != "f"))


def _unit(normals: np.ndarray) -> np.ndarray | None:
    """Unit normals; None if one of them says nothing: estimating the whole frame is safer than mixing."""
    largest = np.abs(normals).max(axis=1)
    if not ((largest > 0) & (largest < np.inf)).all():
        return None
    # Divided twice, so that neither huge nor tiny ones leave the range of their squares.
    scaled = normals / largest[:, None]
    return scaled / np.linalg.norm(scaled, axis=1)[:, None]


def _merge_duplicates(cloud: FramePoints) -> tuple[FramePoints, tuple[np.ndarray, int] | None]:
    """The cloud with each position once, and the position (3,) that stands for nothing seen, with its count."""
    points = cloud.points
    # Sorting a hash of each point is far quicker than sorting points. Stable: the first in the file comes first.
    hashes = _hashes(points)
    order = np.argsort(hashes, kind="stable")
    hashes = hashes[order]
    pairs = np.flatnonzero(hashes[1:] == hashes[:-1])
    if not _equal(points, order, pairs).all():
        order = np.lexsort(points.T)
        pairs = np.arange(len(points) - 1)
        pairs = pairs[_equal(points, order, pairs)]
    if not len(pairs):
        return cloud, None
    kept = np.ones(len(points), dtype=bool)
    kept[order[pairs + 1]] = False
    return cloud.keep(kept), _mark_of(points, order, pairs)


def _mark_of(points: np.ndarray, order: np.ndarray, pairs: np.ndarray) -> tuple[np.ndarray, int] | None:
    """The one position that is repeated as no other is, by the places ``pairs`` of an order whose next is the same."""
    starts = np.flatnonzero(np.diff(pairs, prepend=-2) > 1)
    counts = np.diff(starts, append=len(pairs)) + 1
    most, second = int(counts.argmax()), int(np.sort(counts)[-2]) if len(counts) > 1 else 1
    if counts[most] < max(MARK_LEAST * second, MARK_SHARE * len(points)):
        return None
    return points[order[pairs[starts[most]]]], int(counts[most])


def _equal(points: np.ndarray, order: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Whether the point at each of these places in the order equals the next one."""
    here, there = order[places], order[places + 1]
    same = points[here, 0] == points[there, 0]
    for axis in (1, 2):
        same &= points[here, axis] == points[there, axis]
    return same


def _hashes(points: np.ndarray) -> np.ndarray:
    """A number for each point, equal for equal points, shape (N,) uint64."""
    # Large odd factors; 0.0 is added so that -0.0 and 0.0 have the same bits.
    mixed = np.zeros(len(points), dtype=np.uint64)
    for axis, factor in enumerate((0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9)):
        mixed ^= mixed >> np.uint64(29)
        mixed += (points[:, axis] + 0.0).view(np.uint64)
        mixed *= np.uint64(factor)
    return mixed


def byte_colors(values: np.ndarray, whole: bool = False) -> np.ndarray:
    """Colours as bytes: ``whole`` ones as they are, others fractions of 1 unless one goes beyond; shape kept.

    Whole numbers beyond 255 are of 16 bits.
    """
    with np.errstate(invalid="ignore"):
        values = np.nan_to_num(values.astype(np.float64))
        largest = float(values.max(initial=0.0))
        scale = 1.0 if whole or largest > 1.0 else 255.0
        scale = 1.0 / 257.0 if whole and largest > 255.0 else scale
        return np.clip(np.rint(values * scale), 0, 255).astype(np.uint8)


def draw_points(cloud: FramePoints, count: int, seed: int, number: int) -> FramePoints:
    """At most ``count`` of the points, without replacement, order kept; by seed and frame number."""
    if len(cloud.points) <= count:
        return cloud
    return cloud.keep(np.sort(np.random.default_rng([seed, number]).choice(len(cloud.points), count, replace=False)))
