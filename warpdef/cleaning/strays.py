"""Points that belong to no surface: found before anything else looks at a cloud.

Scanners leave stray points all around. They would blow up the cube that the sequence is normalised into, pull the
template and spoil its keyframe. Two tests, both relative to the local spacing, so that sparse and uneven clouds keep
all they have:

1. Link every point to its neighbours within a few local spacings. A surface hangs together; strays far from it are cut
   off, alone or in clusters that are neither dense nor flat.
2. Where the first test found strays, others float close above the surface: points whose height over the plane of their
   neighbours is several spacings and much more than the roughness there.

A cloud in which the first test finds next to nothing keeps every point, and so does one in which most of what is cut
off continues the plane of its neighbours: a sparse part of the surface. Beside a scene that was cut these are rather
pixels between body and background, a curve along the outline, or the rims of what was cut: few of them are dropped.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpdef.cloud import SPACING_NEIGHBOURS
from warpdef.geometry.nearby import Fellows
from warpdef.geometry.triangles import component_labels
from warpdef.sequence import MIN_POINTS, PointSequence, name_frames

if TYPE_CHECKING:
    import warp as wp

# Longest link, in local spacings; how many times its neighbours' spacing that of a point counts at most, so that strays
# form no bridges; and how many times over that is asked.
CAREFUL = (2.0, 1.2, 8)  # a surface loses nothing by it, be it uneven by 10 to 1
STRICT = (1.8, 1.1, 12)  # where there are many strays for certain
GRAPH_NEIGHBOURS = 16
LEAST_CLUSTER = 0.005  # share of the points below which a cut-off cluster is not an object
DENSE = 1.5  # a cut-off cluster is an object if its spacing is below this times the main one's ...
FLAT, SPARSE = 0.3, 6.0  # ... or below the latter, and its neighbourhoods are this flat; those of strays have 0.5
IN_PLANE_FLAT, IN_PLANE_HEIGHT = 0.2, 0.3  # a cut-off point in the plane of flat neighbours is surface, not stray
FALSE_ALARM = 0.4  # share of such among the cut-off points, above which these are a sparse part of the surface ...
CERTAIN = 0.7  # ... but up to here only if it is so in most frames: one scanner made them all
SCENE_STRAYS = 0.1  # share of the points, up to which what is cut off beside a scene is no surface
STRICT_FROM = 0.05  # share of strays by the careful rule from which the strict one is asked
LEAST_STRAYS = 0.002  # share of the points; up to that, nothing is dropped
HEIGHT = 0.75  # of a floating point, in local spacings
HEIGHT_OVER_ROUGHNESS = 6.0
ROUNDS = 3  # strays spoil the planes of their neighbours: the worst go first
LEAST_POINTS = 50  # clouds below that are left alone


def inlier_mask(points: np.ndarray, device: wp.Device | None = None) -> np.ndarray:
    """Which points lie on a surface, shape (N,) bool; all of them in a clean cloud.

    Made for up to 30 % strays, uniform over a box around the body.

    Args:
        points: shape (N, 3), any units. device: where neighbours are looked for; None: on the host, without Warp.
    """
    mask, flat = _suspected(points, device)
    return mask if flat <= FALSE_ALARM else np.ones_like(mask)


def _suspected(points: np.ndarray, device: wp.Device | None, scene: bool = False) -> tuple[np.ndarray, float]:
    """The mask if what is cut off are strays, and the share of it that speaks for a sparse part of the surface; that
    is NaN if nothing is cut off, and 0 beside a scene if it is little."""
    points = np.asarray(points, dtype=np.float64)
    every = np.ones(len(points), dtype=bool), np.nan
    if len(points) < LEAST_POINTS:
        return every
    most = max(LEAST_STRAYS * len(points), 1)
    near = Fellows(points, SPACING_NEIGHBOURS + 1, device=device)
    distance, index = near.distance, near.index
    # More links join clusters and part none: what half of them hold together, all of them do.
    labels = _clusters(distance[:, 1:], index[:, 1:], distance[:, SPACING_NEIGHBOURS], CAREFUL)
    if len(points) - np.bincount(labels).max() <= most:
        return every
    near = Fellows(points, GRAPH_NEIGHBOURS + 1, device=device)
    distance, index = near.distance[:, 1:], near.index[:, 1:]
    spacing = distance[:, SPACING_NEIGHBOURS - 1]
    inlier = _hangs_together(points, distance, index, spacing, CAREFUL)
    if (~inlier).sum() <= most:
        return every
    flat = float(_in_plane(points[~inlier], points[index[~inlier]], spacing[~inlier]).mean())
    if scene and (~inlier).mean() <= SCENE_STRAYS:
        flat = 0.0
    if flat > CERTAIN:
        return every[0], flat
    if (~inlier).mean() > STRICT_FROM:
        inlier &= _hangs_together(points, distance, index, spacing, STRICT)
    for _ in range(ROUNDS):
        floating = _floats(points[inlier])
        if not floating.any():
            break
        inlier[np.flatnonzero(inlier)[floating]] = False
    return inlier, flat


def _hangs_together(
    points: np.ndarray, distance: np.ndarray, index: np.ndarray, spacing: np.ndarray, rule: tuple[float, float, int]
) -> np.ndarray:
    """Points of the main cluster and of other objects, shape (N,) bool."""
    labels = _clusters(distance, index, spacing, rule)
    size = np.bincount(labels)
    main = int(size.argmax())
    usual = float(np.median(spacing[labels == main]))
    keep = np.zeros(len(size), dtype=bool)
    keep[main] = True
    for cluster in np.flatnonzero(size >= max(LEAST_CLUSTER * len(points), 10)):
        inside = labels == cluster
        sparser = float(np.median(spacing[inside])) / max(usual, 1e-300)
        keep[cluster] |= sparser < DENSE or (sparser < SPARSE and _thickness(points[index[inside]]) < FLAT)
    return keep[labels]


def _clusters(
    distance: np.ndarray, index: np.ndarray, spacing: np.ndarray, rule: tuple[float, float, int]
) -> np.ndarray:
    """Which cluster each point is linked to, shape (N,), by its neighbours (N, K), the nearest first."""
    link, growth, rounds = rule
    calm = spacing
    for _ in range(rounds):
        before, calm = calm, np.minimum(spacing, growth * calm[index[:, :SPACING_NEIGHBOURS]].min(axis=1))
        if (calm == before).all():
            break
    linked = distance <= link * np.minimum(calm[:, None], calm[index])
    rows = np.repeat(np.arange(len(index)), linked.sum(axis=1))
    return component_labels(rows, index[linked], len(index))


def _in_plane(points: np.ndarray, near: np.ndarray, spacing: np.ndarray) -> np.ndarray:
    """Which points (M, 3) continue the flat neighbourhood (M, K, 3) around them, shape (M,) bool."""
    centre = near.mean(axis=1)
    away = near - centre[:, None]
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", away, away))
    height = np.abs(np.einsum("ni,ni->n", points - centre, axes[:, :, 0]))
    return (spread[:, 0] < IN_PLANE_FLAT * spread[:, 1]) & (height < IN_PLANE_HEIGHT * spacing)


def _thickness(near: np.ndarray) -> float:
    """Median over neighbourhoods (M, K, 3) of the smallest over the middle variance: 0 flat, 1 a ball."""
    near = near - near.mean(axis=1, keepdims=True)
    spread = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", near, near))
    return float(np.median(spread[:, 0] / np.maximum(spread[:, 1], 1e-300)))


def _floats(points: np.ndarray) -> np.ndarray:
    """Points high above the plane of their neighbours, for the roughness and spacing there; shape (N,) bool."""
    from scipy.spatial import cKDTree

    count = min(12, len(points) - 1)
    distance, index = cKDTree(points).query(points, k=count + 1)
    spacing = distance[:, min(SPACING_NEIGHBOURS, count)]
    near = points[index[:, 1:]]
    centre = np.median(near, axis=1)
    high = HEIGHT * np.median(spacing[index[:, 1:]], axis=1)
    # None is higher than far: most need no plane.
    far = np.flatnonzero(np.linalg.norm(points - centre, axis=1) > (1.0 - 1e-9) * high)
    near, centre = near[far], centre[far]
    away = near - near.mean(axis=1, keepdims=True)
    normal = np.linalg.eigh(np.einsum("nki,nkj->nij", away, away))[1][:, :, 0]
    heights = np.einsum("nki,ni->nk", near - centre[:, None], normal)
    roughness = 1.48 * np.median(np.abs(heights), axis=1)
    height = np.abs(np.einsum("ni,ni->n", points[far] - centre, normal))
    floats = np.zeros(len(points), dtype=bool)
    floats[far] = (height > high[far]) & (height > HEIGHT_OVER_ROUGHNESS * roughness)
    return floats


def drop_strays(sequence: PointSequence, device: wp.Device | None = None, scene: bool = False) -> PointSequence:
    """The sequence without points that belong to no surface; a note says how many, and in which frames.

    ``scene``: what is left of one. Frames that would be left with fewer than ``MIN_POINTS`` points stay whole.
    """
    masks, flat = zip(*(_suspected(points, device, scene) for points in sequence.points), strict=True)
    shares = [share for share in flat if not np.isnan(share)]
    most = CERTAIN if shares and float(np.median(shares)) <= FALSE_ALARM else FALSE_ALARM
    masks = [
        mask if share <= most and mask.sum() >= MIN_POINTS else np.ones_like(mask)
        for mask, share in zip(masks, flat, strict=True)
    ]
    found = [(number, mask) for number, mask in zip(sequence.numbers, masks, strict=True) if not mask.all()]
    if not found:
        return sequence
    strays = sum(int((~mask).sum()) for _, mask in found)
    share = strays / sum(len(mask) for _, mask in found)
    which = name_frames([number for number, _ in found])
    note = f"{which}: {strays} stray points ({share:.1%}) on no surface left out; --no-drop-strays keeps them"
    return sequence.keep(masks, note)
