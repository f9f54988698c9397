"""The estimated motion applied to other geometry (beyond the paper).

A run's motion is two things: grids, which move any point of space, and a vertex stage, which moved every vertex of the
mesh on from there. With x_t the result's vertices, g_t the grids' chain from keyframe k to frame t and w the weights of
``attach``, a point p goes to

    y_t = sum_i w_i x_t,i + near R_t (p - r_k) + (1 - near) Q_t (g_t(p) - r_t)
    r_t = on g_t(foot) + sum_i w'_i g_t(x_k,i)

R_t turns as the mesh around p does, Q_t as the vertex stage did from where the grids had put the mesh: means, by w, of
rotations fitted to the vertices' edges. A point of the surface is its own foot, so it lands on x_t whatever the grids
say. What stands close to the surface goes with it rigidly; what is far goes with the grids, which know no nearest place
and so tear nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from warpdef.errors import InputError
from warpdef.motion.attach import attach
from warpdef.motion.between import between, check_times, steps_of, turns_between
from warpdef.motion.grid_motion import GridMotion
from warpdef.motion.rotations import blend, local_rotations, turn, unwind

# Shares of the template's largest side within which a point goes rigidly with the surface, and beyond which with the
# grids. Shells 1, 3 and 6 % off the crane, rigid by definition: error 0.40, 0.53 and 1.5 % of the extent; by the grids
# alone 0.67, 1.15 and 2.1 %.
_RIGID, _FREE = 0.02, 0.10
_AT_ONCE = 50_000  # points: bounds the memory


@dataclass(frozen=True)
class Deformed:
    """Points moved along, and what they hold on to.

    points:   places in all frames, input units                          (T, N, 3) float64
    distance: from the mesh at the keyframe, input units                 (N,)
    weights:  of the mesh's vertices on the points                       sparse (N, V)
    turns:    rotations of the mesh's vertices since the keyframe        (T, V, 4) quaternions
    vertices: of the mesh                                                (T, V, 3)
    faces:    of the mesh                                                (F, 3)
    """

    points: np.ndarray
    distance: np.ndarray
    weights: Any
    turns: np.ndarray
    vertices: np.ndarray
    faces: np.ndarray

    def at(self, times: np.ndarray) -> np.ndarray:
        """The points at any times, counted in frames from 0, shape (n, N, 3); see ``between``.

        Raises:
            InputError: a time outside the frames.
        """
        times = check_times(times, len(self.points))
        if (times % 1.0 == 0.0).all():
            return self.points[times.astype(int)]
        steps = steps_of(self.vertices, self.faces)
        return between(self.points, np.stack([blend(self.weights, step) for step in steps]), times)

    def turned(self, normals: np.ndarray, times: np.ndarray | None = None) -> np.ndarray:
        """Normals of the keyframe, shape (N, 3), in all frames or at the times given, shape (n, N, 3) float32.

        Raises:
            InputError: a time outside the frames.
        """
        turns = turns_between(self.turns, np.arange(len(self.turns)) if times is None else times)
        return np.stack([turn(blend(self.weights, turned), normals) for turned in turns]).astype(np.float32)


def deform(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray, motion: GridMotion) -> Deformed:
    """Move points of the keyframe by the motion of a result.

    Args:
        points: shape (N, 3), input units, where they are at the keyframe.
        vertices: the result, shape (T, V, 3), input units. faces: shape (F, 3). motion: its grids.

    Raises:
        InputError: points of another shape, not finite, or a motion of other frames than the result's.
        MissingPackageError: gpytoolbox cannot be imported.
    """
    from scipy import sparse

    points = _checked(points)
    if len(motion) != len(vertices):
        raise InputError(f"the motion: expected {len(vertices)} frames as the result has, got {len(motion)}")
    vertices = np.asarray(vertices, dtype=np.float64)
    rest = vertices[motion.keyframe]
    guided = motion.carry(rest)
    added = local_rotations(guided, vertices, faces)
    whole = unwind(local_rotations(rest, vertices, faces), motion.keyframe)
    side = (rest.max(axis=0) - rest.min(axis=0)).max()

    placed = np.empty((len(vertices), len(points), 3))
    weights = []
    distance = np.empty(len(points))
    for begin in range(0, len(points), _AT_ONCE):
        part = slice(begin, begin + _AT_ONCE)
        held = attach(points[part], rest, faces)
        carried, foot = motion.carry(points[part]), motion.carry(held.foot)
        fade = np.clip((held.distance / side - _RIGID) / (_FREE - _RIGID), 0.0, 1.0)[:, None]
        near = 1.0 - fade * fade * (3.0 - 2.0 * fade)
        reference = [held.on[:, None] * foot[t] + held.spread @ guided[t] for t in range(len(vertices))]
        off = points[part] - reference[motion.keyframe]
        for t, mesh in enumerate(vertices):
            rigid = turn(blend(held.weights, whole[t]), off)
            free = turn(blend(held.weights, added[t]), carried[t] - reference[t])
            placed[t, part] = held.weights @ mesh + near * rigid + (1.0 - near) * free
        distance[part] = held.distance
        weights.append(held.weights)
    return Deformed(placed, distance, sparse.vstack(weights, format="csr"), whole, vertices, faces)


def _checked(points: np.ndarray) -> np.ndarray:
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise InputError(f"the points to deform: expected shape (N, 3) with at least one point, got {points.shape}")
    if not np.isfinite(points).all():
        bad = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise InputError(f"the points to deform: expected finite numbers, got NaN or infinity in point {bad}")
    return points
