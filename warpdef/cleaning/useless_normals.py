"""Normals given that say nothing: pointing anywhere, or all the same on a body that is not flat. They are left out.

Normals that are wrong would cost more than none, which are estimated. A frame's are held against two things: those of
neighbours, which are alike on any surface, however noisy its points are, and the plane of the points nearby. Only where
they agree with neither are they useless. Which way they point does not count: sides are sorted out later.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from warpdef.cloud import SPACING_NEIGHBOURS
from warpdef.geometry.cloud_planes import fit_planes
from warpdef.sequence import PointSequence, name_frames

SEEN, LEAST = 500, 100  # points of a frame that are looked at, and that it must have
AGREES = 0.56  # mean of |cos| between directions; 0.5 by chance
SAME = 0.999  # |cos| to the mean of all normals, of all of them
FLAT = 0.1  # extent along that mean, over the largest


def are_useless(points: np.ndarray, normals: np.ndarray) -> bool:
    """Whether unit normals (N, 3) have nothing to do with their points (N, 3)."""
    from scipy.spatial import cKDTree

    if len(points) < LEAST:
        return False
    mean = np.linalg.svd(normals.T @ normals)[0][:, 0]
    if (np.abs(normals @ mean) > SAME).all():
        return float(np.ptp(points @ mean)) > FLAT * float(np.ptp(points, axis=0).max())
    step = max(len(points) // SEEN, 1)
    index = cKDTree(points).query(points[::step], k=SPACING_NEIGHBOURS + 1)[1]
    some, beside = normals[index[:, 0]], normals[index[:, 1:]]
    if np.abs(np.einsum("ni,nki->nk", some, beside)).mean() >= AGREES:
        return False
    planes = fit_planes(points, index, np.ones(index.shape))[0]
    return float(np.abs(np.einsum("ni,ni->n", some, planes)).mean()) < AGREES


def leave_out_useless_normals(sequence: PointSequence) -> PointSequence:
    """The sequence without the normals of frames in which they are useless; a note names these."""
    pairs = zip(sequence.points, sequence.normals, strict=True)
    useless = [given is not None and are_useless(points, given) for points, given in pairs]
    if not any(useless):
        return sequence
    which = name_frames([number for number, bad in zip(sequence.numbers, useless, strict=True) if bad])
    note = f"normals given for {which} agree neither with each other nor with the points: estimated instead"
    kept = tuple(None if bad else given for given, bad in zip(sequence.normals, useless, strict=True))
    return replace(sequence, normals=kept, notes=(*sequence.notes, note))
