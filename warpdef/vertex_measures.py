"""Measures at the vertices of a moving mesh: a number at every vertex and frame, for pictures and files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from warpdef.geometry.edges import spread_over_edges
from warpdef.geometry.triangles import unique_edges
from warpdef.mesh import MeshSequence, TriMesh

LIMIT_FRAMES = 9
"""Frames looked at for the ends of the colour bar: distances to a surface cost too much to take all."""


@dataclass(frozen=True)
class Measure:
    """A number at every vertex.

    label:     for the colour bar; ``{}`` is the unit of a length
    diverging: 0 is in the bar's middle
    needs:     what has to be known for it besides the mesh
    """

    label: str
    diverging: bool = False
    needs: str = ""


MEASURES = {
    "error": Measure("distance to surface, {}", needs="the clouds or a truth to measure against"),
    "stretch": Measure("edge stretch, l / l_key - 1", diverging=True),
    "displacement": Measure("displacement, {}"),
    "confidence": Measure("confidence, 0 to 1", needs="a result that knows its confidence"),
}


def edge_stretch(vertices: np.ndarray, at_keyframe: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Mean over a vertex's edges of l / l_key - 1, l an edge's length here and l_key in the keyframe; shape (V,).

    Edges of length 0 in the keyframe are left out; a vertex without others has 0.
    """
    now, then = (
        np.linalg.norm(np.subtract(x[edges[:, 0]], x[edges[:, 1]], dtype=np.float64), axis=1)
        for x in (vertices, at_keyframe)
    )
    long = then > 0.0
    change = now[long] / then[long] - 1.0
    ends = edges[long].T.reshape(-1)
    total = np.bincount(ends, np.tile(change, 2), minlength=len(vertices))
    return total / np.maximum(np.bincount(ends, minlength=len(vertices)), 1)


def spread_over_vertices(
    values: np.ndarray, faces_hit: np.ndarray, weights: np.ndarray, faces: np.ndarray, count: int, rings: int = 4
) -> np.ndarray:
    """Numbers known at places on a surface as a mean at each vertex.

    A place counts at the three vertices of its face by its barycentric weights; a vertex that none reached takes
    the mean of its neighbours, up to ``rings`` edges away, and is NaN beyond.

    Args:
        values: shape (N,).
        faces_hit: face of each place, shape (N,).
        weights: barycentric coordinates, shape (N, 3).
        faces: shape (F, 3).
        count: number V of vertices.

    Returns:
        Shape (V,).
    """
    corners = faces[faces_hit].reshape(-1)
    weight = np.bincount(corners, weights.reshape(-1), minlength=count)
    total = np.bincount(corners, (weights * values[:, None]).reshape(-1), minlength=count)
    known = weight > 1e-9
    mean = np.where(known, total / np.where(known, weight, 1.0), 0.0)
    spread, known = spread_over_edges(mean[:, None], known, unique_edges(faces), rings)
    return np.where(known, spread[:, 0], np.nan)


@dataclass
class VertexMeasures:
    """The measures of one moving mesh, each frame computed when first asked for.

    meshes:   the mesh that is measured         T frames; where their triangles change, the error alone is known
    keyframe: frame that lengths and places are compared with
    clouds:   the input, where known            T arrays (N_t, 3)
    truth:    the true surfaces, where known    T meshes
    confidence: of each vertex, where known     (T, V) uint8, 255 for 1
    """

    meshes: MeshSequence | Sequence[TriMesh]
    keyframe: int = 0
    clouds: Sequence[np.ndarray] | None = None
    truth: MeshSequence | Sequence[TriMesh] | None = None
    confidence: np.ndarray | None = None
    _values: dict[tuple[str, int], np.ndarray] = field(default_factory=dict)
    _points: dict[int, np.ndarray] = field(default_factory=dict)
    _edges: np.ndarray | None = None

    @property
    def measures(self) -> list[str]:
        """The keys of ``MEASURES`` that can be computed from what is known."""
        error, moving = self.clouds is not None or self.truth is not None, isinstance(self.meshes, MeshSequence)
        known = {"error": error, "confidence": self.confidence is not None, "stretch": moving, "displacement": moving}
        return [name for name in MEASURES if known[name]]

    def values(self, name: str, frame: int) -> np.ndarray:
        """One number a vertex, shape (V,) float64, NaN where unknown.

        ``error``: with the truth, each vertex's exact distance to the true surface; else the exact distances of the
        input's points to this mesh, each counted where it is nearest. The other names are explained in ``MEASURES``.
        """
        if (name, frame) not in self._values:
            self._values[name, frame] = self._compute(name, frame)
        return self._values[name, frame]

    def point_errors(self, frame: int) -> np.ndarray:
        """Exact distance of each point of the input cloud to the mesh, shape (N_t,)."""
        if frame not in self._points:
            self._cloud_error(frame)
        return self._points[frame]

    def limits(self, name: str) -> tuple[float, float]:
        """Ends of the colour bar: the 99th percentile over some frames, and 0 or its negative; confidence: 0 and 1."""
        if name == "confidence":
            return 0.0, 1.0
        frames = np.unique(
            np.linspace(0, len(self.meshes) - 1, min(LIMIT_FRAMES, len(self.meshes))).round().astype(int)
        )
        sizes = np.concatenate([np.abs(self.values(name, int(t))) for t in frames])
        sizes = sizes[np.isfinite(sizes)]
        high = float(np.percentile(sizes, 99)) if len(sizes) else 0.0
        high = high if high > 0.0 else 1.0
        return (-high if MEASURES[name].diverging else 0.0), high

    def forget(self, meshes: MeshSequence) -> None:
        """Take new vertices; nothing computed before is kept."""
        self.meshes, self.confidence = meshes, None
        self._values.clear()
        self._points.clear()
        self._edges = None

    def _compute(self, name: str, frame: int) -> np.ndarray:
        if name == "error":
            return self._error(frame)
        vertices, at_keyframe = self.meshes[frame].vertices, self.meshes[self.keyframe].vertices
        if name == "confidence":
            assert self.confidence is not None
            return self.confidence[frame] / 255.0
        if name == "displacement":
            return np.linalg.norm(np.subtract(vertices, at_keyframe, dtype=np.float64), axis=1)
        if self._edges is None:
            self._edges = unique_edges(self.meshes[frame].faces)
        return edge_stretch(vertices, at_keyframe, self._edges)

    def _error(self, frame: int) -> np.ndarray:
        if self.truth is not None:
            from warpdef.geometry.closest import closest_on_surface

            vertices = self.meshes[frame].vertices
            return closest_on_surface(vertices, self.truth[frame].vertices, self.truth[frame].faces)[0]
        return self._cloud_error(frame)

    def _cloud_error(self, frame: int) -> np.ndarray:
        from warpdef.geometry.closest import closest_on_surface

        assert self.clouds is not None
        vertices, faces = self.meshes[frame].vertices, self.meshes[frame].faces
        distance, face, weights = closest_on_surface(self.clouds[frame], vertices, faces)
        self._points[frame] = distance
        return spread_over_vertices(distance, face, weights, faces, len(vertices))
