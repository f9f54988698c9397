"""The evaluation protocol: how well a moving mesh matches a known sequence.

Protocol of *Preconditioned Deformation Grids* (sec. Evaluation): every frame is normalised into the unit box, 100,000
samples uniform by area on both surfaces. In the unit box the true frame's bounding box has its low corner at 0 and its
longest side is 1; the reconstruction goes through the same map.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from warpdef.errors import InputError
from warpdef.files import same_triangles
from warpdef.geometry.closest import closest_on_surface
from warpdef.geometry.sampling import sample_surface
from warpdef.geometry.triangles import unique_edges
from warpdef.mesh import MeshSequence, TriMesh
from warpdef.quality.temporal import acceleration, flicker

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

METRICS = (
    "chamfer_l2",
    "normal_consistency",
    "f_score_0.5",
    "f_score_1",
    "point_to_surface",
    "edge_distortion",
    "chamfer_floor",
    "tracking",
    "flicker",
    "flicker_truth",
    "acceleration",
    "acceleration_truth",
)
"""Keys of one frame's results, in order."""

_TRUTH, _RESULT, _TRUTH_AGAIN = range(3)


class MovingMesh(Protocol):
    """What can be evaluated: vertices (T, V, 3), faces (F, 3), and the index ``keyframe`` if it has one."""

    @property
    def vertices(self) -> np.ndarray: ...

    @property
    def faces(self) -> np.ndarray: ...


@dataclass(frozen=True)
class UnitBox:
    """The map of one true frame's bounding box into [0, 1]^3: ``unit = (x - low) / side``.

    low:  low corner, input units    (3,)
    side: longest side, input units
    """

    low: np.ndarray
    side: float

    @classmethod
    def of(cls, vertices: np.ndarray) -> UnitBox:
        """The box of one frame's vertices (V, 3).

        Raises:
            InputError: all vertices coincide.
        """
        vertices = np.asarray(vertices, dtype=np.float64)
        low = vertices.min(axis=0)
        side = float((vertices.max(axis=0) - low).max())
        if not side > 0.0:
            raise InputError("the true mesh: expected an extent above 0, got all vertices in one place")
        return cls(low, side)

    def map(self, x: np.ndarray) -> np.ndarray:
        """Input units to the unit box, float64."""
        return (np.asarray(x, dtype=np.float64) - self.low) / self.side


def edge_distortion(vertices: np.ndarray, at_keyframe: np.ndarray, edges: np.ndarray) -> float:
    """Mean over edges of |l - l_key| / l_key, l an edge's length in this frame and l_key in the keyframe.

    Edges of length 0 in the keyframe are left out. A surface that truly stretches has a distortion above 0 as well.
    """
    now, then = (np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1) for x in (vertices, at_keyframe))
    long = then > 0.0
    return float(np.mean(np.abs(now[long] - then[long]) / then[long])) if long.any() else 0.0


def f_score(to_truth: np.ndarray, to_result: np.ndarray, threshold: float) -> float:
    """Harmonic mean of precision (share of result samples nearer to the truth than ``threshold``) and recall."""
    precision, recall = float(np.mean(to_truth < threshold)), float(np.mean(to_result < threshold))
    return 2.0 * precision * recall / (precision + recall) if precision + recall > 0.0 else 0.0


def nearest(tree: cKDTree, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``tree.query(places, workers=-1)``, whose threads are waited for: SciPy's own are left behind where a signal ends
    the wait, ask a tree that is gone, and crash the process."""
    cores = os.cpu_count() or 1  # as SciPy counts them
    with ThreadPoolExecutor(cores) as pool:
        found = list(pool.map(tree.query, np.array_split(places, cores)))
    distances, numbers = zip(*found, strict=True)
    return np.concatenate(distances), np.concatenate(numbers)


def compare_surfaces(
    result: TriMesh, truth: TriMesh, samples: int = 100_000, seed: int | Sequence[int] = 0
) -> dict[str, float]:
    """The measures of one frame that need surfaces only; both meshes already in the unit box.

    Returns:
        ``chamfer_l2``: half the sum of both mean squared nearest distances between samples;
        ``normal_consistency``: mean absolute cosine between a sample's face normal and that of its nearest sample, mean
        of both directions;
        ``f_score_0.5`` and ``f_score_1``: F-scores at distances 0.005 and 0.01;
        ``point_to_surface``: mean exact distance of all samples to the other surface, mean of both directions;
        ``chamfer_floor``: the same Chamfer distance between the truth and a second sampling of itself.

    Raises:
        InputError: a surface without area, or ``samples`` below 1.
        MissingPackageError: gpytoolbox cannot be imported.
    """
    from scipy.spatial import cKDTree

    def draw(mesh: TriMesh, stream: int) -> tuple[np.ndarray, np.ndarray]:
        rng = np.random.default_rng([*np.atleast_1d(seed), stream])
        return sample_surface(mesh.vertices, mesh.faces, samples, rng)[:2]

    true_points, true_normals = draw(truth, _TRUTH)
    points, normals = draw(result, _RESULT)
    again, _ = draw(truth, _TRUTH_AGAIN)
    true_tree = cKDTree(true_points)
    to_truth, true_match = nearest(true_tree, points)
    to_result, match = nearest(cKDTree(points), true_points)
    forth, _ = nearest(true_tree, again)
    back, _ = nearest(cKDTree(again), true_points)
    cosines = (
        np.abs(np.einsum("ni,ni->n", a, b)).mean()
        for a, b in ((normals, true_normals[true_match]), (true_normals, normals[match]))
    )
    gap = closest_on_surface(points, truth.vertices, truth.faces)[0].mean()
    true_gap = closest_on_surface(true_points, result.vertices, result.faces)[0].mean()
    return {
        "chamfer_l2": float(0.5 * (np.mean(to_truth**2) + np.mean(to_result**2))),
        "normal_consistency": float(0.5 * sum(cosines)),
        "f_score_0.5": f_score(to_truth, to_result, 0.005),
        "f_score_1": f_score(to_truth, to_result, 0.01),
        "point_to_surface": float(0.5 * (gap + true_gap)),
        "chamfer_floor": float(0.5 * (np.mean(forth**2) + np.mean(back**2))),
    }


def evaluate(
    result: MovingMesh,
    truth: MeshSequence | Sequence[TriMesh],
    samples: int = 100_000,
    seed: int = 0,
    keyframe: int | None = None,
    progress: Callable[[int, int], Any] | None = None,
) -> dict[str, Any]:
    """Compare a moving mesh with the truth, frame by frame.

    Beside the measures of ``compare_surfaces`` (lengths in the unit box, so fractions of the true frame's longest side)
    there are ``edge_distortion`` (see there) and ``tracking``: the template's vertices are put on the closest places of
    the true surface at the keyframe, these places move with the truth, and the mean distance from them to the
    reconstruction's vertices is taken. It needs a truth with the same triangles in all frames. The keyframe counts in
    the means. ``flicker`` (degrees) and ``acceleration`` are ``quality.temporal``'s, of the result and, where its
    triangles stay the same, of the truth; the first and the last frame have none.

    Args:
        result: vertices (T, V, 3) and faces (F, 3) in the truth's units.
        truth: T frames, those that the result was made from.
        samples: samples on each surface.
        seed: of the samples; frame t draws from generators seeded with (seed, t, surface).
        keyframe: index of the frame that the template was built on; None takes ``result.keyframe`` if there.
        progress: called with (frames done, frames in all).

    Returns:
        ``{"mean": {...}, "frames": [{"frame": 0, ...}, ...]}`` with the keys ``METRICS``, in plain units. ``tracking``
        is None where the truth's triangles change; it and ``edge_distortion`` are None where no keyframe is known.

    Raises:
        InputError: another number of frames than the truth, a keyframe out of range, fewer than 1 sample, a negative
            seed, or a surface without area.
        MissingPackageError: gpytoolbox cannot be imported.
    """
    moving = MeshSequence(result.vertices, result.faces)
    count = len(moving)
    if count != len(truth):
        raise InputError(
            f"evaluation: the result has {count} frames, the truth {len(truth)}; "
            "pick the true frames that the result was made from with --frames start:stop:step"
        )
    if samples < 1:
        raise InputError(f"--samples: expected at least 1, got {samples}")
    if seed < 0:
        raise InputError(f"--seed: expected 0 or more, got {seed}")
    keyframe = getattr(result, "keyframe", None) if keyframe is None else keyframe
    if keyframe is not None and not 0 <= keyframe < count:
        raise InputError(f"evaluation: keyframe: expected an index in 0..{count - 1}, got {keyframe}")

    edges = unique_edges(moving.faces)
    tracked, steady = None, isinstance(truth, MeshSequence) or same_triangles(truth) is not None
    calm = _calmness(moving.vertices, moving.faces, "")
    if steady:
        true_vertices = truth.vertices if isinstance(truth, MeshSequence) else [m.vertices for m in truth]
        calm |= _calmness(true_vertices, truth[0].faces, "_truth")
    if keyframe is not None and steady:
        at_keyframe = truth[keyframe]
        template = moving[keyframe].vertices
        _, face, barycentric = closest_on_surface(template, at_keyframe.vertices, at_keyframe.faces)
        tracked = at_keyframe.faces[face], barycentric

    frames = []
    for frame in range(count):
        true_mesh, mesh = truth[frame], moving[frame]
        try:
            box = UnitBox.of(true_mesh.vertices)
            unit_truth = TriMesh(box.map(true_mesh.vertices), true_mesh.faces)
            unit = TriMesh(box.map(mesh.vertices), mesh.faces)
            of_surfaces = compare_surfaces(unit, unit_truth, samples, (seed, frame))
        except InputError as error:
            raise InputError(f"frame {frame}: {error}") from None
        values: dict[str, Any] = {**dict.fromkeys(METRICS), **of_surfaces}
        for key, of_frames in calm.items():
            scale = box.side if key.startswith("acceleration") else 1.0
            values[key] = None if np.isnan(of_frames[frame]) else float(of_frames[frame] / scale)
        if keyframe is not None:
            values["edge_distortion"] = edge_distortion(mesh.vertices, moving[keyframe].vertices, edges)
        if tracked is not None:
            corners, barycentric = tracked
            gone = np.einsum("nk,nki->ni", barycentric, unit_truth.vertices[corners])
            values["tracking"] = float(np.linalg.norm(unit.vertices - gone, axis=1).mean())
        frames.append({"frame": frame, **{key: values[key] for key in METRICS}})
        if progress is not None:
            progress(frame + 1, count)
    return {"mean": {key: _mean(frames, key) for key in METRICS}, "frames": frames}


def _calmness(vertices: np.ndarray | Sequence[np.ndarray], faces: np.ndarray, suffix: str) -> dict[str, np.ndarray]:
    return {"flicker" + suffix: flicker(vertices, faces), "acceleration" + suffix: acceleration(vertices)}


def _mean(frames: Sequence[dict[str, Any]], key: str) -> float | None:
    """Over the frames that have the measure; None where none has."""
    known = [frame[key] for frame in frames if frame[key] is not None]
    return float(np.mean(known)) if known else None
