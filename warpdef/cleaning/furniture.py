"""What stands still in a room beside its planes: furniture, walls seen aslant. It is told from a body that rests.

With the planes' points away, space is cut into cells of a few point spacings.

1. A cell stands still if most frames have points there and the heights of these along the cell's own normal differ
   between frames no more than within them, by the F ratio. Through the others something moves.
2. Of a body that stands for a while and leaves, cells look still, too: where the points come or go from one frame to
   the next, what moves is close by. What is only hidden for a while has nothing near it.
3. Cells that stand still and hang together are one part. It is the body's (a standing foot, a trunk) if something large
   that moves touches it in half of the frames, else furniture. What is seen now and then at the rims of furniture, or
   small and apart from all, goes with it.

Where nothing large moves there is no furniture: a body that stands still loses nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warpdef.cloud import SPACING_NEIGHBOURS
from warpdef.geometry.triangles import component_labels

LEAST_FRAMES = 5  # below that no part is told from what moves slowly
SIDE = 4.0  # of a cell, in spacings: some sixteen points on a surface
LEAST = 3  # points of a frame in a cell that count as seen there
OFTEN, RARE = 0.5, 0.25  # of the frames in which a cell or one beside it is seen; and in which it is itself
QUIETEST = 1e-3  # noise of heights, in spacings: what is made by a computer has none
STEADY = 4.0  # F ratio below which heights do not move
WATCHED = 2  # cells within which what moves is close by
LEAVES = 0.5  # of the comings and goings of a cell's points
LARGE, SMALL = 0.1, 0.005  # of the largest part that moves, by points
MOVING_POINTS = 100  # of a frame on average; below that nothing large moves
TOUCHED, TOUCHING = 0.5, 0.01  # of the frames in which a cell is seen, and of a part's cells
FRAME_POINTS = 20000  # of a frame by which cells are judged
LARGEST_KEY = 2**60
SAMPLE = 3000  # points by which a spacing is measured
OFFSETS = np.stack(np.meshgrid(*[(-1, 0, 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
SIX = np.flatnonzero(np.abs(OFFSETS).sum(axis=1) <= 1)


@dataclass(frozen=True)
class Places:
    """Cubes of space that hold points of any frame.

    side, low, size, step, keys: the cell of a place is floor((place - low) / side), below size, found by its product
    with step; (3,) each and (M,). near: each cell's neighbours and itself, by OFFSETS, (M, 27), -1 for none. seen:
    whether a frame has points there, (T, M). weight: points there of the frames that have, (M,).
    """

    side: float
    low: np.ndarray
    size: np.ndarray
    step: np.ndarray
    keys: np.ndarray
    near: np.ndarray
    seen: np.ndarray
    weight: np.ndarray

    def find(self, points: np.ndarray) -> np.ndarray:
        """The cell of each of the points (N, 3), shape (N,); -1 where no cell is."""
        place = np.floor((points - self.low) / self.side)
        inside = np.all((place >= 0) & (place < self.size), axis=1)
        key = np.where(inside[:, None], place, 0).astype(np.int64) @ self.step
        at = np.minimum(np.searchsorted(self.keys, key), len(self.keys) - 1)
        return np.where(inside & (self.keys[at] == key), at, -1)

    def beside(self, marked: np.ndarray, offsets: slice | np.ndarray = slice(None)) -> np.ndarray:
        """Cells that are marked or next to marked ones, (..., M)."""
        wide = np.zeros_like(marked)
        for near in self.near[:, offsets].T:
            wide |= (near >= 0) & marked[..., near]
        return wide

    def parts(self, marked: np.ndarray) -> np.ndarray:
        """Which part of hanging-together marked cells each is of, (M,), -1 where it is not marked."""
        rows, offsets = np.nonzero((self.near >= 0) & marked[:, None])
        beside = self.near[rows, offsets]
        both = marked[beside]
        part = component_labels(rows[both], beside[both], len(marked))
        return np.where(marked, part, -1)


def furniture_masks(clouds: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Which points are furniture, or specks that go with it; T of shape (N_t,) bool.

    Args:
        clouds: what planes leave of T frames, each (N_t, 3), any units, near the origin.
    """
    marked = [np.zeros(len(points), dtype=bool) for points in clouds]
    rng = np.random.default_rng(0)
    some = [points if len(points) <= FRAME_POINTS else rng.choice(points, FRAME_POINTS, False) for points in clouds]
    middle = max(some, key=len, default=np.empty((0, 3)))
    if len(some) < LEAST_FRAMES or len(middle) <= SPACING_NEIGHBOURS:
        return marked
    spacing = _spacing(middle)
    cells = _cells(some, SIDE * spacing)
    if cells is None:
        return marked
    furniture = _furniture(cells, _steadiness(some, cells, QUIETEST * spacing))
    return [furniture[(cell := cells.find(points))] & (cell >= 0) for points in clouds]


def _furniture(cells: Places, steadiness: np.ndarray) -> np.ndarray:
    """Which cells are furniture or go with it, (M,) bool; of their steadiness (M,)."""
    there = cells.beside(cells.seen, SIX)  # at the rim of a surface a cell is seen by chance; the next one tells
    still = (there.mean(axis=0) >= OFTEN) & (steadiness < STEADY)
    still &= ~_left(cells, there, cells.seen & ~still)

    # What moves, and its parts of some size.
    moves = ~still & cells.seen.any(axis=0)
    part, weight = cells.parts(moves), cells.weight
    size = np.bincount(part[moves], weight[moves], minlength=len(still))
    if size.max(initial=0.0) < MOVING_POINTS * len(cells.seen):
        return np.zeros_like(still)
    large = moves & (size[part] >= LARGE * size.max())

    times = cells.seen.sum(axis=0)
    touched = (cells.beside(cells.seen & large) & cells.seen).sum(axis=0) >= TOUCHED * times
    touched &= times >= RARE * len(cells.seen)
    rests = cells.parts(still)
    count = np.bincount(rests[still], minlength=len(still))
    touching = np.bincount(rests[still & touched], minlength=len(still))
    body = large | (still & (touching[rests] > TOUCHING * count[rests]))
    furniture = still & ~body
    # Where something is seen beside it only now and then, a body may have come near.
    furniture &= (times >= RARE * len(cells.seen)) | ~cells.beside(large)
    if not furniture.any():
        return furniture
    # Specks: what is small or hardly ever dense enough to be seen, and what moves a little beside furniture.
    rest = ~body & ~furniture
    part = cells.parts(rest)
    size = np.bincount(part[rest], weight[rest], minlength=len(still))
    beside = np.zeros(len(still), dtype=bool)
    beside[part[rest & cells.beside(furniture)]] = True
    tiny = size < SMALL * weight[large].sum()
    return furniture | (rest & (beside | tiny)[part] & ~cells.beside(body))


def _left(cells: Places, there: np.ndarray, moving: np.ndarray) -> np.ndarray:
    """Cells whose points come or go, (T, M), with something that moves, (T, M), close by; (M,) bool."""
    close = moving
    for _ in range(WATCHED):
        close = cells.beside(close)
    goes, comes = there[:-1] & ~there[1:], ~there[:-1] & there[1:]
    met = (goes & close[1:]).sum(axis=0) + (comes & close[:-1]).sum(axis=0)
    return met >= np.maximum(LEAVES * (goes.sum(axis=0) + comes.sum(axis=0)), 1)


def _spacing(points: np.ndarray) -> float:
    """Median distance to the eighth neighbour, as the side of one of a grid of squares; points (N, 3)."""
    from scipy.spatial import cKDTree

    some = points[:: max(len(points) // SAMPLE, 1)]
    far = cKDTree(points).query(some, k=SPACING_NEIGHBOURS + 1)[0][:, -1]
    return max(float(np.median(far)) / np.sqrt(SPACING_NEIGHBOURS / np.pi), 1e-12 * float(np.ptp(points)))


def _cells(clouds: Sequence[np.ndarray], side: float) -> Places | None:
    """Cells of all points; None if they lie so far apart that cells cannot be numbered."""
    low = np.min([points.min(axis=0) for points in clouds if len(points)], axis=0) - 1.5 * side
    high = np.max([points.max(axis=0) for points in clouds if len(points)], axis=0)
    size = np.floor((high - low) / side) + 2
    if not np.prod(size) < LARGEST_KEY:
        return None
    size = size.astype(np.int64)
    step = np.array([size[1] * size[2], size[2], 1])
    keyed = [np.floor((points - low) / side).astype(np.int64) @ step for points in clouds]
    keys = np.unique(np.concatenate(keyed))
    count = np.stack([np.bincount(np.searchsorted(keys, key), minlength=len(keys)) for key in keyed])
    seen = count >= LEAST
    asked = keys[:, None] + OFFSETS @ step
    found = np.minimum(np.searchsorted(keys, asked), len(keys) - 1)
    near = np.where(keys[found] == asked, found, -1)
    return Places(side, low, size, step, keys, near, seen, (count * seen).sum(axis=0))


def _steadiness(clouds: Sequence[np.ndarray], cells: Places, least: float) -> np.ndarray:
    """F ratio of each cell, (M,): variance of heights between frames over that within, at least least^2."""
    frames, count = cells.seen.shape
    points = np.concatenate(list(clouds))
    cell, frame = cells.find(points), np.repeat(np.arange(frames), [len(cloud) for cloud in clouds])
    total = np.bincount(cell, minlength=count)
    middle = np.stack([np.bincount(cell, points[:, a], count) for a in range(3)], axis=1) / total[:, None]
    away = points - middle[cell]
    spread = np.empty((count, 3, 3))
    for a in range(3):
        for b in range(3):
            spread[:, a, b] = np.bincount(cell, away[:, a] * away[:, b], count)
    height = np.einsum("ni,ni->n", away, np.linalg.eigh(spread)[1][:, :, 0][cell])
    both = cell * frames + frame
    held = np.bincount(both, minlength=count * frames)
    mean = np.bincount(both, height, count * frames) / np.maximum(held, 1)
    times = (held.reshape(count, frames) > 0).sum(axis=1)
    within = np.bincount(cell, (height - mean[both]) ** 2, count) / np.maximum(total - times, 1)
    between = (held * mean**2).reshape(count, frames).sum(axis=1) / np.maximum(times - 1, 1)
    return between / np.maximum(within, least**2)
