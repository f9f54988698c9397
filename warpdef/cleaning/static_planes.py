"""A scene instead of an object: a floor, wall or table that stands still in all frames, found and cut.

Only planes, and only such as cannot be the object's own resting part. A plane is cut if

1. it holds at least ``SHARE`` of the points of (nearly) every frame, in the same place: of its cells that are ever
   occupied most are occupied in most frames;
2. all else lies on one side of it: a floor, a wall, a table top bounds what is seen;
3. it is wider than what is left: it covers ``WIDER`` times the area that the rest has when seen along its normal, and
   goes on beyond it to at least three of four sides, as no face of a box does;
4. enough is left in every frame.

With a plane goes what stands beside it: furniture, which would also make what is left as wide as the walls (see
``furniture``). It is set aside before 2 and 3 are asked, and cut if a plane is.

Planes are looked for by random triples of points of one frame, the best of ``TRIALS``, then fitted to the points near
it; what lies within four standard deviations of their heights belongs to it. Then the next, up to ``PLANES``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from warpdef.cleaning.furniture import furniture_masks
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
LEAST_TOLD = 0.005  # of all points, below which furniture is no more than specks of the planes
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


@dataclass(frozen=True)
class Surroundings:
    """What stands still: planes, and which points of each frame are furniture, T of shape (N_t,)."""

    planes: list[Plane]
    furniture: list[np.ndarray]

    def masks(self, clouds: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Which points of the clouds it takes."""
        return [_any_holds(self.planes, cloud) | beside for cloud, beside in zip(clouds, self.furniture, strict=True)]


def find_surroundings(clouds: Sequence[np.ndarray]) -> Surroundings:
    """Planes that stand still in all clouds, (N_t, 3) each, the largest first, and furniture; none of an object."""
    step = _prime_from(sum(map(len, clouds)) // SAMPLE)
    thin = [np.asarray(cloud, dtype=np.float64)[::step] for cloud in clouds]
    centre = np.median(np.concatenate(thin), axis=0)
    thin = [cloud - centre for cloud in thin]  # near the origin, for the digits of far places
    planes: list[Plane] = []
    left = thin
    while len(planes) < PLANES and (plane := _best_plane(left, SHARE * sum(map(len, thin)))) is not None:
        planes.append(plane)
        left = [cloud[~plane.holds(cloud)] for cloud in left]
    beside = [np.zeros(len(cloud), dtype=bool) for cloud in clouds]
    if not any(_still_cells(plane, thin) for plane in planes):
        return Surroundings([], beside)
    near = [np.asarray(cloud, dtype=np.float64) - centre for cloud in clouds]
    # Each is held against what none of them takes; one that is no static plane gives its points back.
    while planes:
        beside = _furniture(planes, near)
        rest = [c[~(_any_holds(planes, c) | b[::step])] for c, b in zip(thin, beside, strict=True)]
        wrong = [plane for plane in planes if not _is_static(plane, thin, rest)]
        if not wrong:
            break
        # The smallest first: a card on a table may hold as many points as the table.
        least = min(reversed(wrong), key=lambda plane: _area(plane, thin))
        planes = [plane for plane in planes if plane is not least]
    if not planes:
        beside = [np.zeros_like(mask) for mask in beside]
    return Surroundings(
        [replace(plane, offset=plane.offset + float(plane.normal @ centre)) for plane in planes], beside
    )


def _prime_from(count: int) -> int:
    """The least prime from there on, or 1: such steps meet all columns of an image, not a few of them in each row."""
    if count <= 1:
        return 1
    while any(count % k == 0 for k in range(2, int(count**0.5) + 1)):
        count += 1
    return count


def _furniture(planes: Sequence[Plane], clouds: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Which points of the clouds are furniture, with those of the planes away."""
    masks = [~_any_holds(planes, cloud) for cloud in clouds]
    found = furniture_masks([cloud[mask] for cloud, mask in zip(clouds, masks, strict=True)])
    for mask, inside in zip(masks, found, strict=True):
        mask[mask] = inside
    return masks


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


@dataclass(frozen=True)
class _Grid:
    """Cells in a plane: its axes (2, 3), corners of what it holds, (2,) each, and a cell's side."""

    axes: np.ndarray
    low: np.ndarray
    high: np.ndarray
    side: float

    def cells(self, points: np.ndarray) -> np.ndarray:
        """Cells that points (N, 3) take up, each once, (K, 2)."""
        return np.unique(np.floor((points @ self.axes.T - self.low) / self.side).astype(int), axis=0)


def _grid(plane: Plane, held: Sequence[np.ndarray]) -> _Grid:
    axes = np.linalg.svd(plane.normal[None])[2][1:]
    low, high = np.percentile(np.concatenate(held) @ axes.T, [0.5, 99.5], axis=0)
    # So many cells that one holds several of a frame's points, else frames would differ by chance.
    usual = float(np.median([len(h) for h in held]))
    return _Grid(axes, low, high, float((high - low).max()) / min(CELLS, max(int(np.sqrt(usual / 6.0)), 2)))


def _still_cells(plane: Plane, clouds: Sequence[np.ndarray]) -> int:
    """Cells of a plane that stand still; 0 if it holds too little of some frames, or moves."""
    held = [cloud[plane.holds(cloud)] for cloud in clouds]
    share = np.array([len(h) / max(len(cloud), 1) for h, cloud in zip(held, clouds, strict=True)])
    if (share >= SHARE).mean() < MOST_FRAMES:
        return 0
    grid = _grid(plane, held)
    times = np.unique(np.concatenate([grid.cells(h) for h in held]), axis=0, return_counts=True)[1]
    still = int((times >= CELL_KEPT * len(held)).sum())
    return still if still >= STILL * len(times) else 0


def _is_static(plane: Plane, clouds: Sequence[np.ndarray], rest: Sequence[np.ndarray]) -> bool:
    """Whether a plane of the clouds stands still and bounds what is left, ``rest`` by all planes."""
    left = np.array([len(r) / max(len(c), 1) for r, c in zip(rest, clouds, strict=True)])
    still = _still_cells(plane, clouds)
    if not still or (left < LEFT).any():
        return False
    beside = np.concatenate(rest)
    above = beside @ plane.normal > plane.offset
    if max(above.mean(), 1.0 - above.mean()) < ONE_SIDE:
        return False
    grid = _grid(plane, [cloud[plane.holds(cloud)] for cloud in clouds])
    inner = np.percentile(beside @ grid.axes.T, [1, 99], axis=0)
    beyond = np.concatenate([inner[0] - grid.low, grid.high - inner[1]])
    if (beyond > BEYOND * float((grid.high - grid.low).max())).sum() < 3:
        return False
    return still >= WIDER * float(np.median([len(grid.cells(r)) for r in rest if len(r)]))


def cut_static_planes(sequence: PointSequence) -> PointSequence:
    """The sequence without floor, walls and table tops, and without furniture; a note says what was cut.

    A frame of which nothing would be left stays whole.
    """
    scene = find_surroundings(sequence.points)
    kept, cut, beside = [], 0, 0
    for held, furniture in zip(scene.masks(sequence.points), scene.furniture, strict=True):
        mask = ~held
        kept.append(mask if mask.sum() >= LEFT_POINTS else np.ones(len(mask), dtype=bool))
        cut += int((~kept[-1]).sum())
        beside += int((furniture & ~kept[-1]).sum())
    if not cut:
        return sequence
    points = sum(map(len, sequence.points))
    what = "a plane that stands" if len(scene.planes) == 1 else f"{len(scene.planes)} planes that stand"
    more = f", what stands still beside (furniture, {beside / points:.0%})" if beside >= LEAST_TOLD * points else ""
    note = (
        f"{name_frames(sequence.numbers)}: {what} still in all of them (floor, wall, table){more} and "
        f"{cut / points:.0%} of the points with it cut; --no-cut-static keeps it"
    )
    return sequence.keep(kept, note)
