"""A scene instead of an object: a floor, wall or table that stands still in all frames, found and cut.

Only planes, and only such as cannot be the object's own resting part. A plane is cut if

1. it holds at least ``SHARE`` of the points of (nearly) every frame, in the same place: of its cells that are ever
   occupied most are occupied in most frames;
2. all else lies on one side of it: a floor, a wall, a table top bounds what is seen;
3. it is wider than what is left: it covers ``WIDER`` times the area that the rest has when seen along its normal, and
   goes on beyond it to at least three of four sides, as no face of a box does;
4. enough is left in every frame.

Planes are looked for by random triples of points of one frame, the best of ``TRIALS``, then fitted to the points near
it; what lies within four standard deviations of their heights belongs to it. Then the next, up to ``PLANES``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from warpdef.sequence import MIN_POINTS, PointSequence, name_frames

SHARE = 0.1
MOST_FRAMES = 0.9
CELLS = 24  # of a plane, along its longer side
CELL_KEPT = 0.6  # of the frames in which a cell must be occupied to stand still
STILL = 0.5  # of the cells
ONE_SIDE = 0.97  # of the rest
WIDER = 1.5
BEYOND = 0.03  # of the plane's longer side
LEFT = 0.02  # of a frame's points
LEFT_POINTS = 100
TRIALS = 1000
PLANES = 4
SAMPLE = 6000  # points in which planes are looked for
ROUGH, FINEST, COARSEST = 0.01, 0.001, 0.02  # tolerance while searching and its bounds, in sizes of the scene


@dataclass(frozen=True)
class Plane:
    """normal . x = offset; what lies within ``tolerance`` of it is cut."""

    normal: np.ndarray
    offset: float
    tolerance: float

    def holds(self, points: np.ndarray) -> np.ndarray:
        """Which of the points (N, 3) belong to it."""
        return np.abs(points @ self.normal - self.offset) <= self.tolerance


def find_static_planes(clouds: Sequence[np.ndarray]) -> list[Plane]:
    """Planes that stand still in all clouds, (N_t, 3) each, the largest first; empty for an object alone."""
    step = max(sum(map(len, clouds)) // SAMPLE, 1)
    thin = [np.asarray(cloud, dtype=np.float64)[::step] for cloud in clouds]
    centre = np.median(np.concatenate(thin), axis=0)
    thin = [cloud - centre for cloud in thin]  # near the origin, for the digits of far places
    planes: list[Plane] = []
    left = thin
    while len(planes) < PLANES and (plane := _best_plane(left, SHARE * sum(map(len, thin)))) is not None:
        planes.append(plane)
        left = [cloud[~plane.holds(cloud)] for cloud in left]
    # Each is held against what none of them takes; one that is no static plane gives its points back.
    while planes:
        rest = [cloud[~_any_holds(planes, cloud)] for cloud in thin]
        wrong = [plane for plane in planes if not _is_static(plane, thin, rest)]
        if not wrong:
            break
        # The smallest first: a card on a table may hold as many points as the table.
        least = min(reversed(wrong), key=lambda plane: _area(plane, thin))
        planes = [plane for plane in planes if plane is not least]
    return [replace(plane, offset=plane.offset + float(plane.normal @ centre)) for plane in planes]


def _any_holds(planes: Sequence[Plane], points: np.ndarray) -> np.ndarray:
    return np.any([plane.holds(points) for plane in planes], axis=0) if planes else np.zeros(len(points), dtype=bool)


def _area(plane: Plane, clouds: Sequence[np.ndarray]) -> float:
    """Of the box, in the plane, of the points that it holds."""
    held = np.concatenate([cloud[plane.holds(cloud)] for cloud in clouds])
    return float(np.prod(np.ptp(held @ np.linalg.svd(plane.normal[None])[2][1:].T, axis=0))) if len(held) else 0.0


def _best_plane(clouds: Sequence[np.ndarray], least: float) -> Plane | None:
    rng = np.random.default_rng(0)
    every = np.concatenate(clouds)
    usable = [cloud for cloud in clouds if len(cloud) >= MIN_POINTS]
    if len(usable) < len(clouds) * MOST_FRAMES or len(usable) < 2:
        return None
    size = float(np.ptp(np.percentile(every, [1, 99], axis=0), axis=0).max())
    best, found = 0, None
    for trial in range(TRIALS):
        cloud = usable[trial % len(usable)]
        a, b, c = cloud[rng.choice(len(cloud), 3, replace=False)]
        normal = _cross(b - a, c - a)
        length = np.sqrt(normal @ normal)
        if not length > 1e-12 * size**2:
            continue
        normal = normal / length
        count = int((np.abs(every @ normal - normal @ a) <= ROUGH * size).sum())
        if count > best:
            best, found = count, (normal, float(normal @ a))
    if found is None or best < least:
        return None
    return _fitted(every, *found, size)


def _cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Of two vectors (3,): NumPy's takes twenty times as long for one."""
    (a, b, c), (x, y, z) = u.tolist(), v.tolist()
    return np.array([b * z - c * y, c * x - a * z, a * y - b * x])


def _fitted(every: np.ndarray, normal: np.ndarray, offset: float, size: float) -> Plane:
    """The plane through the points near it, with its tolerance by their heights."""
    tolerance = ROUGH * size
    for _ in range(3):
        near = every[np.abs(every @ normal - offset) <= tolerance]
        middle = near.mean(axis=0)
        normal = np.linalg.svd(near - middle, full_matrices=False)[2][2]
        heights = near @ normal - normal @ middle
        offset = float(normal @ middle + np.median(heights))
        deviation = 1.48 * float(np.median(np.abs(heights - np.median(heights))))
        tolerance = float(np.clip(4.0 * deviation, FINEST * size, COARSEST * size))
    return Plane(normal, offset, tolerance)


def _is_static(plane: Plane, clouds: Sequence[np.ndarray], rest: Sequence[np.ndarray]) -> bool:
    """Whether a plane of the clouds stands still and bounds what is left, ``rest`` by all planes."""
    held = [plane.holds(cloud) for cloud in clouds]
    share = np.array([h.mean() for h in held])
    left = np.array([len(r) / max(len(c), 1) for r, c in zip(rest, clouds, strict=True)])
    if (share >= SHARE).mean() < MOST_FRAMES or (left < LEFT).any():
        return False
    above = np.concatenate(rest) @ plane.normal > plane.offset
    if max(above.mean(), 1.0 - above.mean()) < ONE_SIDE:
        return False
    # In the plane: which cells it and the rest take up.
    axes = np.linalg.svd(plane.normal[None])[2][1:]
    flat = [(cloud[h] @ axes.T, r @ axes.T) for cloud, h, r in zip(clouds, held, rest, strict=True)]
    on = np.concatenate([a for a, _ in flat])
    low, high = np.percentile(on, [0.5, 99.5], axis=0)
    beside = np.concatenate([r for _, r in flat])
    inner = np.percentile(beside, [1, 99], axis=0)
    if (np.concatenate([inner[0] - low, high - inner[1]]) > BEYOND * float((high - low).max())).sum() < 3:
        return False
    # So many cells that one holds several of a frame's points, else frames would differ by chance.
    usual = float(np.median([len(a) for a, _ in flat]))
    side = float((high - low).max()) / min(CELLS, max(int(np.sqrt(usual / 6.0)), 2))
    times: dict[tuple[int, int], int] = {}
    for a, _ in flat:
        for cell in map(tuple, np.unique(np.floor((a - low) / side).astype(int), axis=0)):
            times[cell] = times.get(cell, 0) + 1
    still = sum(count >= CELL_KEPT * len(flat) for count in times.values())
    if still < STILL * len(times):
        return False
    below = [len(np.unique(np.floor((r - low) / side).astype(int), axis=0)) for _, r in flat if len(r)]
    return still >= WIDER * float(np.median(below))


def cut_static_planes(sequence: PointSequence) -> PointSequence:
    """The sequence without floor, walls and table tops; a note says what was cut.

    A frame of which nothing would be left stays whole.
    """
    planes = find_static_planes(sequence.points)
    kept, cut = [], 0
    for points in sequence.points:
        mask = ~_any_holds(planes, points)
        kept.append(mask if mask.sum() >= LEFT_POINTS else np.ones(len(points), dtype=bool))
        cut += int((~kept[-1]).sum())
    if not cut:
        return sequence
    share = cut / sum(map(len, sequence.points))
    what = "a plane that stands" if len(planes) == 1 else f"{len(planes)} planes that stand"
    which = name_frames(sequence.numbers)
    note = (
        f"{which}: {what} still in all of them (floor, wall, table) and {share:.0%} of the points with it cut; "
        "--no-cut-static keeps it"
    )
    return sequence.keep(kept, note)
