"""Which frame the template is built on (sec. Keyframe Selection; completeness and objects go beyond the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from warpdef.config import KeyframeConfig
from warpdef.errors import InputError
from warpdef.template.clusters import OBJECT_SHARE

POINTS_A_CELL = 8.0  # of the coarse grid on which frames are compared
SPREAD = 0.12  # of the frames: how far apart in time further keyframes should be


@dataclass(frozen=True)
class KeyframeCandidate:
    """A frame that may carry the template.

    frame:           index from 0
    occupied_voxels: cells of the grid over [-1, 1]^3 that hold a point
    weight:          Gaussian of the distance to the temporal middle, 0 to 1
    score:           occupied_voxels * weight
    coverage:        occupied cells of a coarse grid, relative to the frame with most; it shows missing surface, which
                     fine voxels do not once they hold no more than a point each
    full:            whether the coverage reaches ``coverage_min``
    objects:         pieces of the cloud that no occupied cell of the coarse grid joins
    why:             one sentence for the report
    """

    frame: int
    occupied_voxels: int
    weight: float
    score: float
    coverage: float
    full: bool
    objects: int
    why: str


def rank_keyframes(clouds: Sequence[np.ndarray], config: KeyframeConfig) -> list[KeyframeCandidate]:
    """Candidates, best first: all frames for ``auto``, one for ``first``, ``middle`` or an index.

    The score is |G(P_t)| exp(-gamma (t - T/2)^2), T the last frame's index, so that the weight is 1 in the true middle.
    Equal scores go to the frame nearer the middle, then to the earlier one. Frames that show less than ``coverage_min``
    of what the fullest frame shows come after all others; among the full ones, those in which most objects lie apart
    come first, as objects that touch would become one.

    Args:
        clouds: one array a frame, each (N_t, 3), cube units, free of outliers.
        config: the choice, the grid, gamma and the least coverage.

    Raises:
        InputError: an index that is not a frame of the sequence, or one without points.
    """
    frame_count = len(clouds)
    middle = (frame_count - 1) / 2
    named = {"first": 0, "middle": int(middle)}
    if config.choice == "auto":
        frames = [t for t in range(frame_count) if len(clouds[t])]
    else:
        frame = named[config.choice] if config.choice in named else int(config.choice)
        if frame >= frame_count:
            raise InputError(
                f"--keyframe: expected auto, first, middle or a frame in 0..{frame_count - 1}, got {frame}; "
                f"the sequence has {frame_count} frames, counted from 0"
            )
        if not len(clouds[frame]):
            raise InputError(f"--keyframe: frame {frame} has no usable points; choose another frame")
        frames = [frame]

    coverage, objects = compare_frames([clouds[frame] for frame in frames])
    scored = []
    for frame, seen, apart in zip(frames, coverage, objects, strict=True):
        occupied = occupied_voxels(clouds[frame], config.voxels)
        weight = float(np.exp(-config.gamma * (frame - middle) ** 2))
        full = bool(seen >= config.coverage_min)
        score = occupied * weight
        scored.append(KeyframeCandidate(frame, occupied, weight, score, float(seen), full, int(apart), ""))
    scored.sort(key=lambda c: (not c.full, -c.objects, -c.score, abs(c.frame - middle), c.frame))
    full = [c for c in scored if c.full]
    ranked = []
    for rank, candidate in enumerate(scored):
        why = _why(config.choice, rank, len(scored), candidate.occupied_voxels, candidate.weight)
        if config.choice == "auto" and candidate.full and candidate.objects > min(c.objects for c in full):
            why += f"; {candidate.objects} objects lie apart there, which touch in other frames"
        if config.choice == "auto" and rank == 0 and len(full) < len(frames):
            why += f"; {len(frames) - len(full)} frames show less than {config.coverage_min:.0%} of the surface"
        ranked.append(replace(candidate, why=why))
    return ranked


def spread_out(ranked: list[KeyframeCandidate], count: int) -> list[KeyframeCandidate]:
    """At most ``count`` of the candidates: the first, then such as are no neighbours in time of those before.

    What spoils one frame (a limb that touches the body, a surface out of sight) spoils its neighbours too. The score
    counts by 1 - exp(-(d / spread)^2), d the frames to the nearest one chosen; coverage and objects still go first.

    Args:
        ranked: by ``rank_keyframes``.
        count: at least 1.
    """
    spread = SPREAD * len(ranked)
    chosen, rest = ranked[:1], list(ranked[1:])
    while rest and len(chosen) < count:
        near = [min(abs(c.frame - other.frame) for other in chosen) for c in rest]
        worth = [
            (not c.full, -c.objects, -c.score * (1.0 - np.exp(-((d / spread) ** 2))))
            for c, d in zip(rest, near, strict=True)
        ]
        chosen.append(rest.pop(worth.index(min(worth))))
    return chosen


def compare_frames(clouds: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Coverage, relative to the frame with most, and number of objects; both of shape (T,).

    Both on one grid for all frames, whose cells hold ``POINTS_A_CELL`` points in the frame of median density.
    """
    cells = 128
    counts = [_cells(cloud, cells)[1] for cloud in clouds]
    while cells > 4 and np.median([n.mean() for n in counts]) < POINTS_A_CELL:
        cells = cells * 3 // 4
        counts = [_cells(cloud, cells)[1] for cloud in clouds]
    coverage = np.array([len(n) for n in counts], dtype=np.float64)
    return coverage / coverage.max(), np.array([_objects(cloud, cells) for cloud in clouds])


def _objects(points: np.ndarray, cells: int) -> int:
    """Pieces with at least ``OBJECT_SHARE`` of the points, joined by cells that share at least a corner."""
    from scipy.ndimage import label

    where, count = _cells(points, cells)
    grid = np.zeros((cells,) * 3, dtype=np.int64)
    grid[where[:, 0], where[:, 1], where[:, 2]] = count
    # Without an array to write to, it returns both; SciPy says so in words only.
    labels, pieces = cast("tuple[np.ndarray, int]", label(grid > 0, np.ones((3, 3, 3))))
    size = np.bincount(labels.ravel(), grid.ravel(), minlength=pieces + 1)[1:]
    return max(int((size >= OBJECT_SHARE * len(points)).sum()), 1)


def _cells(points: np.ndarray, cells: int) -> tuple[np.ndarray, np.ndarray]:
    """Occupied cells of a ``cells``^3 grid over [-1, 1]^3, shape (M, 3), and how many points each holds, shape (M,)."""
    cell = np.clip(np.floor((np.asarray(points) + 1.0) * (cells / 2.0)).astype(np.int64), 0, cells - 1)
    x, y, z = cell.T
    key, count = np.unique((x * cells + y) * cells + z, return_counts=True)
    return np.stack([key // cells**2, key // cells % cells, key % cells], axis=1), count


def occupied_voxels(points: np.ndarray, voxels: int) -> int:
    """Number of cells of a ``voxels``^3 grid over [-1, 1]^3 that hold at least one of the points (N, 3)."""
    return len(_cells(points, voxels)[1])


def _why(choice: str, rank: int, count: int, occupied: int, weight: float) -> str:
    if choice in ("first", "middle"):
        return f"the {choice} frame, as asked"
    if choice != "auto":
        return "the frame asked for"
    place = "best" if rank == 0 else f"number {rank + 1}"
    return f"{place} of {count} frames by coverage: {occupied} occupied voxels times {weight:.3f} for its place in time"
