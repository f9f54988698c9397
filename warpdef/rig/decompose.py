"""Fitting a rig: bones are added where the error is largest, with rounds of alternating least squares in between."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpdef.errors import InputError
from warpdef.rig.bones import fit_rigid, skin, update_bones, update_rest
from warpdef.rig.weights import bone_errors, solve_weights

BONES_MAX, BONES_ASKED_MAX = 64, 256
"""Most bones that are chosen, and most that may be asked for."""
MEAN_ERROR = 0.002
"""Mean distance, over the extent, at which no more bones are added where their number is not given."""

_VERTICES, _FRAMES = 3000, 48  # as many at most serve to find the bones; all take part in what follows
_ROUNDS_BETWEEN, _ROUNDS_LAST, _ROUNDS_ALL = 3, 8, 4


@dataclass(frozen=True)
class Rig:
    """A moving mesh as linear blend skinning: x_ti = sum_k w_ik (R_tb y_i + s_tb), b = joints[i, k].

    rest:       y, the shape that the bones move, input units      (V, 3) float64
    joints:     bones that each vertex follows                     (V, K) int64, K at most 4
    weights:    how much, the largest first, rows of sum 1         (V, K) float64
    bones:      R and s side by side, of every frame               (T, B, 3, 4) float64
    mean_error: distance to the mesh given, mean over frames and vertices, input units
    max_error:  the largest one
    extent:     longest side of the rest shape's bounding box, input units
    """

    rest: np.ndarray
    joints: np.ndarray
    weights: np.ndarray
    bones: np.ndarray
    mean_error: float
    max_error: float
    extent: float

    @property
    def bone_count(self) -> int:
        """Number B of bones."""
        return self.bones.shape[1]

    def vertices(self) -> np.ndarray:
        """Where the rig takes the mesh, shape (T, V, 3) float64."""
        return skin(self.rest, self.joints, self.weights, self.bones)


def fit_rig(vertices: np.ndarray, bone_count: int | None = None, rest: int = 0) -> Rig:
    """Explain the motion of a mesh by rigid bones and linear blend skinning.

    Args:
        vertices: shape (T, V, 3), any unit.
        bone_count: number of bones; None: as many as bring the mean error to ``MEAN_ERROR``, at most ``BONES_MAX``.
        rest: frame whose shape the rest shape starts from and stays near.

    Raises:
        InputError: fewer than one bone, or more than ``BONES_ASKED_MAX`` or than every third vertex could have.
    """
    moved = np.asarray(vertices, dtype=np.float64)
    most = max(1, min(BONES_ASKED_MAX, moved.shape[1] // 3))
    if bone_count is not None and not 1 <= bone_count <= most:
        raise InputError(f"--bones: expected 1 to {most} for {moved.shape[1]} vertices, or auto, got {bone_count}")
    center = moved[rest].mean(axis=0)
    moved = moved - center  # the smaller the numbers, the less is lost where sums of squares cancel
    extent = float(np.ptp(moved[rest], axis=0).max()) or 1.0
    # Some vertices in some frames find the bones, then in all frames their motions, then all vertices their weights.
    some = np.sort(np.random.default_rng(0).permutation(moved.shape[1])[:_VERTICES])
    frames = np.unique(np.linspace(0, len(moved) - 1, min(_FRAMES, len(moved))).round().astype(int))
    sample, start = moved[:, some], moved[rest]
    limits = (bone_count, min(BONES_MAX, most), MEAN_ERROR * extent)
    shape, bones = _grow(start[some], sample[frames], *limits)
    if len(frames) < len(moved):
        bones = _in_all_frames(shape, sample, sample[frames], bones)
    shape, bones, _ = _alternate(start[some], shape, sample, bones, _ROUNDS_LAST)
    shape = start + _nearest_offsets(moved[frames], some, shape - start[some])
    for _ in range(_ROUNDS_ALL):
        joints, weights = solve_weights(shape, moved, bones)
        shape = update_rest(start, moved, joints, weights, bones)
    joints, weights = solve_weights(shape, moved, bones)
    distance = np.linalg.norm(skin(shape, joints, weights, bones) - moved, axis=2)
    used, joints = np.unique(np.where(weights > 0.0, joints, joints[:, :1]), return_inverse=True)
    bones = bones[:, used]
    # Back to where the data's origin is: R (y - c) + s + c.
    bones[..., 3] += center - bones[..., :3] @ center
    errors = float(distance.mean()), float(distance.max())
    return Rig(shape + center, joints.reshape(weights.shape), weights, bones, *errors, extent)


def _grow(
    start: np.ndarray, moved: np.ndarray, bone_count: int | None, most: int, goal: float
) -> tuple[np.ndarray, np.ndarray]:
    """Rest shape (N, 3) and bones (T, B, 3, 4) of vertices that are at ``start`` (N, 3) and go to ``moved`` (T, N, 3).

    Args:
        bone_count: how many. None: until the mean distance is at most ``goal``, or there are ``most``.
    """
    shape, bones = start, fit_rigid(start, moved, np.ones(len(start)))[:, None]
    limit = most if bone_count is None else bone_count
    while True:
        shape, bones, distance = _alternate(start, shape, moved, bones, _ROUNDS_BETWEEN)
        number = bones.shape[1]
        if number >= limit or (bone_count is None and distance.mean() <= goal):
            return shape, bones
        bones = _add_bones(shape, moved, bones, distance, min(limit - number, max(1, number // 3)))


def _in_all_frames(shape: np.ndarray, moved: np.ndarray, some: np.ndarray, bones: np.ndarray) -> np.ndarray:
    """Bones (T, B, 3, 4) for ``moved`` (T, N, 3), from those found in ``some`` of its frames: each where its vertices
    are, which is a start."""
    joints, weights = solve_weights(shape, some, bones)
    found = np.empty((len(moved), bones.shape[1], 3, 4))
    for b in range(bones.shape[1]):
        who, which = np.nonzero(joints == b)
        share = weights[who, which] ** 2
        found[:, b] = (
            fit_rigid(shape[who], moved[:, who], share)
            if share.sum() > 0.0
            else fit_rigid(shape, moved, np.ones(len(shape)))
        )
    return found


def _nearest_offsets(moved: np.ndarray, some: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Offsets of all vertices from those of ``some``: its own, or the mean, by inverse distance, of the three nearest
    over a few frames; (V, 3)."""
    from scipy.spatial import cKDTree

    few = np.linspace(0, len(moved) - 1, min(4, len(moved))).round().astype(int)
    ways = moved[few].transpose(1, 0, 2).reshape(moved.shape[1], -1)
    distance, nearest = cKDTree(ways[some]).query(ways, k=[*range(1, min(3, len(some)) + 1)])
    share = 1.0 / np.maximum(distance, 1e-12)
    return np.einsum("vk,vki->vi", share / share.sum(axis=1, keepdims=True), offsets[nearest])


def _alternate(
    start: np.ndarray, shape: np.ndarray, moved: np.ndarray, bones: np.ndarray, rounds: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rounds over weights, bones and rest shape; returns shape, bones and the distances that are left, (T, N)."""
    for _ in range(rounds):
        joints, weights = solve_weights(shape, moved, bones)
        bones = update_bones(shape, moved, joints, weights, bones)
        shape = update_rest(start, moved, joints, weights, bones)
    return shape, bones, np.linalg.norm(skin(shape, joints, weights, bones) - moved, axis=2)


def _add_bones(shape: np.ndarray, moved: np.ndarray, bones: np.ndarray, distance: np.ndarray, more: int) -> np.ndarray:
    """New bones, each fitted to a patch of vertices around one whose error is large, away from the others' patches."""
    error = (distance**2).sum(axis=0)
    size = max(4, len(shape) // (2 * (bones.shape[1] + more)))
    for _ in range(more):
        worst = int(error.argmax())
        # Vertices that stay near it in all frames: of the same limb, not of one that touches it.
        apart = ((moved - moved[:, worst, None]) ** 2).sum(axis=2).max(axis=0)
        patch = np.argpartition(apart, size - 1)[:size]
        new = fit_rigid(shape[patch], moved[:, patch], np.ones(len(patch)))
        bones = np.concatenate([bones, new[:, None]], axis=1)
        error = np.minimum(error, bone_errors(shape, moved, bones[:, -1:])[:, 0])
        error[patch] = 0.0
    return bones
