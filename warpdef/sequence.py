"""A sequence of point clouds, checked and cleaned, and the one similarity that takes it into the cube."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from warpdef.errors import InputError

MIN_FRAMES = 2
MIN_POINTS = 10


@dataclass(frozen=True)
class PointSequence:
    """Raw point clouds without correspondences, one a frame.

    points:  positions, input units           T arrays, each (N_t, 3) float64
    normals: unit normals, None where unknown T entries, each (N_t, 3) float64 or None
    names:   what a frame is called in errors T strings: a file name or "frame 7"
    merged:  duplicate points merged          T integers

    Build one with ``PointSequence.from_arrays``, which checks every frame.
    """

    points: tuple[np.ndarray, ...]
    normals: tuple[np.ndarray | None, ...]
    names: tuple[str, ...]
    merged: tuple[int, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.points)

    @classmethod
    def from_arrays(
        cls,
        points: np.ndarray | Sequence[np.ndarray],
        normals: np.ndarray | Sequence[np.ndarray | None] | None = None,
        names: Sequence[str] | None = None,
    ) -> PointSequence:
        """Check every frame, merge duplicate points, make normals unit length.

        Args:
            points: shape (T, N, 3), or a list of T arrays of shape (N_t, 3). Input units.
            normals: as ``points``, any length above zero; None, or None for single frames, where unknown.
            names: T names used in error messages; "frame i" if not given.

        Raises:
            InputError: fewer than 2 frames, fewer than 10 points in a frame, a wrong shape, NaN or
                infinity, all points equal, or normals of another length than the points.
        """
        frame_count = len(points)
        names = tuple(names) if names is not None else tuple(f"frame {i}" for i in range(frame_count))
        if frame_count < MIN_FRAMES:
            raise InputError(
                f"the sequence: expected at least {MIN_FRAMES} frames, got {frame_count}; "
                "give a folder of numbered clouds or an npz with points (T, N, 3)"
            )
        if normals is None:
            normals = [None] * frame_count
        if len(normals) != frame_count:
            raise InputError(
                f"normals: expected {frame_count} frames as in points, got {len(normals)}; give them for all, or none"
            )
        kept, kept_normals, merged = [], [], []
        for frame_points, frame_normals, name in zip(points, normals, names, strict=True):
            p = _check_points(frame_points, name)
            n = _check_normals(frame_normals, len(p), name)
            p, n, dropped = _merge_duplicates(p, n)
            if len(p) == 1:
                raise InputError(
                    f"{name}: all points are equal; expected a surface, got a single position; drop this frame"
                )
            if len(p) < MIN_POINTS:
                raise InputError(
                    f"{name}: expected at least {MIN_POINTS} different points, got {len(p)}; drop this frame"
                )
            kept.append(p)
            kept_normals.append(n)
            merged.append(dropped)
        return cls(tuple(kept), tuple(kept_normals), names, tuple(merged))

    def select(self, frames: slice) -> PointSequence:
        """The frames of a slice, in order.

        Raises:
            InputError: fewer than 2 frames are left.
        """
        chosen = self.points[frames]
        if len(chosen) < MIN_FRAMES:
            raise InputError(
                f"--frames: expected at least {MIN_FRAMES} of {len(self)} frames, got {len(chosen)}; widen the range"
            )
        return PointSequence(chosen, self.normals[frames], self.names[frames], self.merged[frames])

    def subsample(self, count: int, seed: int) -> PointSequence:
        """At most ``count`` points a frame, drawn without replacement; order kept; repeatable by ``seed``.

        Raises:
            InputError: ``count`` is below 10.
        """
        if count < MIN_POINTS:
            raise InputError(f"--points: expected at least {MIN_POINTS}, got {count}")
        points, normals = [], []
        for frame, (p, n) in enumerate(zip(self.points, self.normals, strict=True)):
            if len(p) > count:
                chosen = np.sort(np.random.default_rng([seed, frame]).choice(len(p), count, replace=False))
                p, n = p[chosen], None if n is None else n[chosen]
            points.append(p)
            normals.append(n)
        return PointSequence(tuple(points), tuple(normals), self.names, self.merged)


def _check_points(points: np.ndarray, name: str) -> np.ndarray:
    try:
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
    bad = ~np.isfinite(points).all(axis=1)
    if bad.any():
        raise InputError(
            f"{name}: points: expected finite coordinates, got NaN or infinity in {int(bad.sum())} of {len(points)} "
            f"(first: point {int(bad.argmax())}); remove them"
        )
    return points


def _check_normals(normals: np.ndarray | None, count: int, name: str) -> np.ndarray | None:
    if normals is None:
        return None
    normals = np.asarray(normals, dtype=np.float64)
    if normals.shape != (count, 3):
        raise InputError(
            f"{name}: normals: expected shape ({count}, 3) as the points have, got {normals.shape}; "
            "give one normal a point, or none"
        )
    if not np.isfinite(normals).all():
        raise InputError(f"{name}: normals: expected finite numbers, got NaN or infinity; leave the normals out")
    length = np.linalg.norm(normals, axis=1)
    if (length == 0).any():
        # A zero normal says nothing; estimating the whole frame is safer than mixing.
        return None
    return normals / length[:, None]


def _merge_duplicates(points: np.ndarray, normals: np.ndarray | None) -> tuple[np.ndarray, np.ndarray | None, int]:
    _, first = np.unique(points, axis=0, return_index=True)
    if len(first) == len(points):
        return points, normals, 0
    first.sort()
    return points[first], None if normals is None else normals[first], len(points) - len(first)


@dataclass(frozen=True)
class Similarity:
    """The one map of a whole sequence into the cube: ``unit = (x - centre) * scale``.

    centre: input units, shape (3,) float64
    scale:  cube units per input unit
    """

    centre: np.ndarray
    scale: float

    @classmethod
    def into_cube(cls, clouds: Sequence[np.ndarray], fill: float) -> Similarity:
        """Joint bounding box of all frames to the centre of [-1, 1]^3, its largest side to 2 * ``fill``."""
        low = np.min([c.min(axis=0) for c in clouds], axis=0)
        high = np.max([c.max(axis=0) for c in clouds], axis=0)
        return cls((low + high) / 2.0, float(2.0 * fill / (high - low).max()))

    def to_cube(self, x: np.ndarray) -> np.ndarray:
        """Input units to cube units, float64."""
        return (np.asarray(x, dtype=np.float64) - self.centre) * self.scale

    def from_cube(self, x: np.ndarray) -> np.ndarray:
        """Cube units back to input units, float64."""
        return np.asarray(x, dtype=np.float64) / self.scale + self.centre
