"""A part beside what moves that stands still in all frames and is no plane: a chair, a corner of a room. It is told.

It is not cut: a foot that stands while the leg above it is not seen, or the second of two objects, looks the same.
Parts are clusters of the points of all frames together, so that a part of what moves hangs together with its own ways.
A part stands still if nearly all of its points have a point at their place in all frames but one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from warpdef.geometry.coverage import objects_of
from warpdef.sequence import PointSequence

SAMPLE_FRAMES, SAMPLE_POINTS = 8, 1500
PLACE = 3.0  # spacings within which a point of another frame is at the same place: a sampled surface has such gaps
STILL, MOVING = 0.9, 0.8  # share of a part's points: from, and below
LEAST = 0.03  # of all points


def find_static_parts(clouds: list[np.ndarray]) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Low and high corner and share of the points of each part that stands still beside one that moves.

    Args:
        clouds: T of shape (N_t, 3), any units.
    """
    from scipy.spatial import cKDTree

    frames = np.unique(np.linspace(0, len(clouds) - 1, SAMPLE_FRAMES).round().astype(int))
    if len(frames) < 3:
        return []
    rng = np.random.default_rng(0)
    thin = [clouds[t][rng.permutation(len(clouds[t]))[:SAMPLE_POINTS]] for t in frames]
    if min(map(len, thin)) < SAMPLE_POINTS // 10:
        return []
    every = np.concatenate(thin)
    part = objects_of(every)
    if part.max() == 0:
        return []  # nothing beside what moves
    trees = [cKDTree(points) for points in thin]
    spacing = [np.median(tree.query(points, k=2)[0][:, 1]) for tree, points in zip(trees, thin, strict=True)]
    reach = PLACE * float(np.max(spacing))
    met = [np.mean([tree.query(points)[0] <= reach for tree in trees], axis=0) for points in thin]
    still = np.concatenate(met) >= (len(frames) - 1) / len(frames)
    shares = {k: float(still[part == k].mean()) for k in range(part.max() + 1) if (part == k).mean() >= LEAST}
    if not any(share < MOVING for share in shares.values()):
        return []
    found = [every[part == k] for k, share in shares.items() if share >= STILL]
    return [(points.min(axis=0), points.max(axis=0), len(points) / len(every)) for points in found]


def tell_static_parts(sequence: PointSequence) -> PointSequence:
    """The sequence with a note for each part that stands still beside what moves."""
    notes = []
    for low, high, share in find_static_parts(list(sequence.points)):
        box = ",".join(f"{a:.4g}:{b:.4g}" for a, b in zip(low, high, strict=True))
        notes.append(
            f"a part with {share:.0%} of the points, in {box}, stands still in all frames, apart from what moves; it "
            "is kept: if it is no part of the object, leave it out with --crop"
        )
    return replace(sequence, notes=(*sequence.notes, *notes)) if notes else sequence
