"""Landmarks in the fit: known places of the mesh lead a frame's start, and draw it in every round.

A round draws them by ``kernels.landmarks``. But on the way outwards a frame starts from its neighbour moved by a grid,
which knows nothing of a motion within the surface: a ball that turns in itself looks at rest. Where the frame has
landmarks, that start is bent so that they fit: by one affine map or rigid motion for all of it, and what is left by
radial functions exp(-r / R), R the extent of the landmarks. It is taken if it leaves less: mean distance of the cloud
from the mesh, plus mean distance of the landmarks.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from warpdef.errors import InputError
from warpdef.files.landmarks import Landmarks
from warpdef.fit.problem import Problem
from warpdef.geometry.closest import closest_on_surface
from warpdef.geometry.rotations import nearest_rotation
from warpdef.kernels.landmarks import draw_to_landmarks
from warpdef.sequence import PointSequence, Similarity

_FAR_AT, _FAR_PLACE = 0.05, 0.5  # of the sequence's extent, from the mesh and from the frame's box, that is a mistake
_FLAT = 1e-3  # least extent of landmarks in every direction, over the largest, for an affine map
_OFF, _APART = 0.03, 0.1  # of the extent: a landmark that ends farther away, or lies so far from all points, is told
_SAMPLE = 2000  # points by which two starts are compared


class PlacedLandmarks:
    """Landmarks on the template: each on a triangle of it, with its place in one of the frames used.

    Args:
        given: as read. vertices: the template at the keyframe, (V, 3), cube units. faces: (F, 3).
        sequence: the clouds used. into: takes them into the cube. named: whether vertices may be named: the template
            is the user's own.

    frames: places of their frames among those used, ascending, (L,). corners: vertices, (L, 3). parts: barycentric
    coordinates, (L, 3). places: cube units, (L, 3). apart: from the nearest point of their frames, cube units, (L,).

    Raises:
        InputError: a vertex or frame that is not there, or a place far from the mesh or from its frame's cloud.
    """

    def __init__(
        self, given: Landmarks, vertices: np.ndarray, faces: np.ndarray, sequence: PointSequence, into: Similarity,
        named: bool, keyframe: int,
    ) -> None:  # fmt: skip
        _check(given, len(vertices), sequence, into, named)
        frame_of = {number: t for t, number in enumerate(sequence.numbers)}
        corners, parts = np.repeat(given.vertex[:, None], 3, axis=1), np.tile([1.0, 0.0, 0.0], (len(given), 1))
        at = given.vertex < 0
        if at.any():
            away, face, weights = closest_on_surface(into.to_cube(given.at[at]), vertices, faces)
            worst = int(away.argmax())
            if away[worst] > 2 * _FAR_AT:  # the cube's side is 2
                raise InputError(
                    f"{given.names[int(np.flatnonzero(at)[worst])]}: expected a place on the mesh at keyframe "
                    f"{keyframe}, got one {away[worst] / 2:.0%} of the sequence's size away; fix the keyframe it is "
                    "meant for with --keyframe"
                )
            corners[at], parts[at] = faces[face], weights
        frames = np.array([frame_of[int(number)] for number in given.frame])
        order = np.argsort(frames, kind="stable")
        self.frames, self.corners, self.parts = frames[order], corners[order], parts[order]
        self.places = into.to_cube(given.place)[order]
        self.names = [given.names[k] for k in order]
        clouds = [into.to_cube(sequence.points[t]) for t in self.frames]
        self.apart = np.array([np.linalg.norm(c - q, axis=1).min() for c, q in zip(clouds, self.places, strict=True)])

    def errors(self, vertices: np.ndarray) -> np.ndarray:
        """Distance of each from its place, (L,), in the units of the vertices (T, V, 3), which must be the cube's."""
        found = np.einsum("lc,lci->li", self.parts, vertices[self.frames[:, None], self.corners])
        return np.linalg.norm(found - self.places, axis=1)

    def as_dict(self, vertices: np.ndarray, scale: float) -> dict[str, Any]:
        """For the report: how many, and how far they end from their places, input units.

        Args:
            vertices: (T, V, 3), cube units. scale: cube units an input unit.
        """
        errors = self.errors(vertices) / scale
        return {"count": len(errors), "error_mean": float(errors.mean()), "error_max": float(errors.max())}

    def warnings(self, vertices: np.ndarray) -> list[str]:
        """Of those that end far from their places, and of places where their frame has no points."""
        told = []
        for far, most, what in (
            (self.errors(vertices), _OFF, "end {} from their places ({}): they contradict the clouds, or each other"),
            (self.apart, _APART, "lie {} from all points of their frames ({}): the mesh goes there all the same"),
        ):
            count = int((far > 2 * most).sum())
            if count:
                size = f"up to {far.max() / 2:.0%} of the sequence's size"
                told.append(f"{count} of {len(far)} landmarks " + what.format(size, self.names[int(far.argmax())]))
        return told


def _check(given: Landmarks, count: int, sequence: PointSequence, into: Similarity, named: bool) -> None:
    gaps = {gap.number: gap.why for gap in sequence.gaps}
    clouds = dict(zip(sequence.numbers, sequence.points, strict=True))
    for k, where in enumerate(given.names):
        frame, vertex = int(given.frame[k]), int(given.vertex[k])
        if vertex >= 0 and not named:
            raise InputError(
                f"{where}: vertex {vertex}: expected a place at the keyframe, as the template is yet to be built; "
                "vertices are those of a --template"
            )
        if vertex >= count:
            raise InputError(f"{where}: expected a vertex from 0 to {count - 1}, as the template has, got {vertex}")
        if frame in gaps:
            raise InputError(f"{where}: frame {frame} cannot be used, so nothing is known there: {gaps[frame]}")
        if frame not in clouds:
            raise InputError(f"{where}: expected a frame from 0 to {sequence.frame_count - 1}, got {frame}")
        cloud, place = clouds[frame], given.place[k]
        away = np.maximum(cloud.min(axis=0) - place, place - cloud.max(axis=0)).max() * into.scale / 2
        if away > _FAR_PLACE:
            raise InputError(
                f"{where}: expected a place near the cloud of frame {frame}, got one {away:.1f} times the sequence's "
                "size outside; check units and frame"
            )


class LandmarkTerm:
    """Landmarks of one problem on its device.

    Args:
        placed: on the template's own vertices. vertices: of all frames, shape (T, V) vec3.
    """

    def __init__(self, placed: PlacedLandmarks, problem: Problem, vertices: wp.array) -> None:
        p = problem
        self._vertices, self._weight, self._placed = vertices, p.config.refine.landmark_weight, placed
        self._corners = p.place[placed.corners]
        slots = placed.frames[:, None] * p.vertex_count + self._corners
        entries = np.flatnonzero(placed.parts.ravel() > 0)
        order = entries[np.argsort(slots.ravel()[entries], kind="stable")]
        slot, first = np.unique(slots.ravel()[order], return_index=True)
        self._begin = np.searchsorted(slot, np.arange(p.frame_count + 1) * p.vertex_count)
        table = lambda a, dtype: wp.array(np.ascontiguousarray(a, dtype), device=p.device)  # noqa: E731
        self._arrays = (
            p.integers(slot), p.integers(np.append(first, len(order))), p.integers(order // 3),
            p.numbers(placed.parts.ravel()[order]), table(slots, np.int32), table(placed.parts, np.float32),
            p.vectors(placed.places),
        )  # fmt: skip

    def hold(self, first: int, last: int, matrix_out: wp.array, rhs_out: wp.array) -> None:
        """Add what landmarks of frames ``first .. last`` ask for to the normal equations; shapes (T V,)."""
        begin, end = int(self._begin[first]), int(self._begin[last])
        if end > begin:
            vertices = self._vertices.flatten()
            draw_to_landmarks(begin, end - begin, self._weight, *self._arrays, vertices, matrix_out, rhs_out)

    def led(self, frame: int, vertices: np.ndarray, points: np.ndarray) -> np.ndarray | None:
        """A better start of a frame by its landmarks, shape (V, 3), or None where there is none.

        Args:
            vertices: where they would start, (V, 3). points: the frame's cloud, (N, 3).
        """
        from scipy.spatial import cKDTree

        here = self._placed.frames == frame
        if not here.any():
            return None
        parts, corners, places = self._placed.parts[here], self._corners[here], self._placed.places[here]
        sample = points[:: max(len(points) // _SAMPLE, 1)]

        def cost(x: np.ndarray) -> float:
            off = np.einsum("lc,lci->li", parts, x[corners]) - places
            return float(cKDTree(x).query(sample)[0].mean() + np.linalg.norm(off, axis=1).mean())

        bent = bent_by(np.einsum("lc,lci->li", parts, vertices[corners]), places, vertices)
        return bent if cost(bent) < cost(vertices) else None


def bent_by(source: np.ndarray, target: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (N, 3) moved so that ``source`` (L, 3) goes to ``target`` (L, 3).

    By the motion of all: an affine map through four or more that span space, else a rotation from three on, else a
    shift; and for what that leaves, radial functions exp(-r / R), R the extent of the sources, which fade with r.
    """
    middle, to = source.mean(axis=0), target.mean(axis=0)
    a, b = source - middle, target - to
    spread = np.linalg.svd(a, compute_uv=False)
    if len(a) >= 4 and spread[2] > _FLAT * spread[0]:
        linear = np.linalg.lstsq(a, b, rcond=None)[0]
    elif len(a) >= 3 and spread[1] > _FLAT * spread[0]:
        linear = nearest_rotation(a.T @ b)
    else:
        linear = np.eye(3)
    moved = (points - middle) @ linear + to
    left = target - ((source - middle) @ linear + to)
    if len(a) < 2 or np.abs(left).max() < 1e-9:
        return moved
    apart = np.linalg.norm(source[:, None] - source[None], axis=2)
    reach = float(apart.max()) or 1.0
    weights = np.linalg.lstsq(np.exp(-apart / reach), left, rcond=1e-6)[0]
    return moved + np.exp(-np.linalg.norm(points[:, None] - source[None], axis=2) / reach) @ weights
