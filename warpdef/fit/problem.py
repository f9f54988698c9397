"""What one optimisation works on: clouds, template and transitions as device arrays, laid out once.

T frames, S = T - 1 transitions; transition s lies between frames s and s + 1 and leads away from the keyframe k: from
s to s + 1 for s >= k, from s + 1 to s for s < k. Every frame but k is the target of exactly one transition. Frames
stand behind each other in flat arrays, points along a Morton curve, so a frame is one span.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import warp as wp

from warpdef.config import Config
from warpdef.device import way_of
from warpdef.fit.measures import CloudMeasures, border_of, mean_edge_length
from warpdef.fit.morton import morton_order
from warpdef.fit.pool import Pool
from warpdef.geometry.denoise import Scattered
from warpdef.geometry.sampling import spread_evenly
from warpdef.geometry.triangles import face_areas, unique_edges
from warpdef.kernels import ways
from warpdef.kernels.graphs import Graph, kept_nodes, mesh_graph
from warpdef.kernels.levels import LevelTable
from warpdef.transitions import Transitions


@dataclass(frozen=True)
class Clouds:
    """Clouds of T frames behind each other on the device.

    points, normals: shape (N,) vec3. sizes: points in each frame, (T,). offsets: where each begins, (T + 1,).
    """

    points: wp.array
    normals: wp.array
    sizes: np.ndarray
    offsets: np.ndarray


class Problem:
    """Static data of a run on one device.

    Args:
        clouds: T arrays (N_t, 3), cube units. normals: T arrays (N_t, 3), unit length; or None.
        vertices: template at the keyframe, (V, 3), cube units. faces: (F, 3). keyframe: its frame.
        oriented: whether a frame's normals are known to point outwards; None: all are.
        eye: place of the camera, (3,), where one saw all clouds: normals are on its side beyond doubt, and no frame
            shows all. None: there is no such camera.
        times: of the frames, (T,), ascending, in any unit; None: one apart.
        scattered: noisy clouds as they were measured, of which ``clouds`` are the surfaces; None where these are.
    """

    def __init__(
        self,
        clouds: list[np.ndarray],
        normals: list[np.ndarray] | None,
        vertices: np.ndarray,
        faces: np.ndarray,
        keyframe: int,
        config: Config,
        device: wp.Device,
        oriented: Sequence[bool] | None = None,
        eye: np.ndarray | None = None,
        times: Sequence[float] | None = None,
        scattered: Sequence[Scattered] | None = None,
    ) -> None:
        self.config, self.device, self.way, self.pool = config, device, way_of(device), Pool(device)
        self.transitions = Transitions.away_from(keyframe, len(clouds))
        self.eye, self.seen = eye, eye is not None
        self.times = np.arange(len(clouds)) if times is None else np.asarray(times)
        self.levels = LevelTable.build(config.grid.coarsest, config.grid.levels)
        orders = [morton_order(c) for c in clouds]
        clouds = [c[o] for c, o in zip(clouds, orders, strict=True)]
        if normals is not None:
            normals = [n[o] for n, o in zip(normals, orders, strict=True)]
        self._lay_clouds(clouds, normals)
        self._lay_sample(clouds, normals)
        self._lay_template(vertices, faces)
        self.scattered: Clouds | None = None
        if scattered is not None:
            self._lay_scattered(scattered)
        self.oriented = np.ones(len(clouds), dtype=bool) if oriented is None else np.asarray(oriented)
        self.kept = self._keep_nodes(clouds)

    def _lay_clouds(self, clouds: list[np.ndarray], normals: list[np.ndarray] | None) -> None:
        self.cloud_sizes = np.array([len(c) for c in clouds])
        self.cloud_offsets = _offsets(self.cloud_sizes)
        flat = np.concatenate(clouds)
        self.box = np.stack([flat.min(axis=0), flat.max(axis=0)])
        self.cloud = self.vectors(flat)
        # Without a tangential part normals are multiplied by 0; zeros are as good as any.
        self.normals = self.vectors(np.zeros_like(flat) if normals is None else np.concatenate(normals))
        self.cloud_frame = self.integers(np.repeat(np.arange(len(clouds)), self.cloud_sizes))
        self.clouds = Clouds(self.cloud, self.normals, self.cloud_sizes, self.cloud_offsets)

    def _lay_sample(self, clouds: list[np.ndarray], normals: list[np.ndarray] | None) -> None:
        """The points that grids are fitted to, and the same as they set out over a transition."""
        most, self.sample = self.config.optimiser.points, self.clouds
        if most and max(len(c) for c in clouds) > most:
            chosen = [spread_evenly(c, most) for c in clouds]
            clouds = [c[i] for c, i in zip(clouds, chosen, strict=True)]
            sizes, flat = np.array([len(c) for c in clouds]), np.concatenate(clouds)
            sides = np.zeros_like(flat)
            if normals is not None:
                sides = np.concatenate([n[i] for n, i in zip(normals, chosen, strict=True)])
            self.sample = Clouds(self.vectors(flat), self.vectors(sides), sizes, _offsets(sizes))
        self.sample_transition = self.integers(np.repeat(self.transitions.of_frame, self.sample.sizes))
        source = self.transitions.source
        self.moved_sizes = self.sample.sizes[source]
        self.moved_offsets = _offsets(self.moved_sizes)
        self.origin = self.vectors(np.concatenate([clouds[t] for t in source]))
        self.moved_transition = self.integers(np.repeat(np.arange(len(source)), self.moved_sizes))
        self.moved_target = self.integers(np.repeat(self.transitions.target, self.moved_sizes))

    def _lay_scattered(self, scattered: Sequence[Scattered]) -> None:
        """Noisy clouds as they were measured."""
        clouds = [s.points[morton_order(s.points)] for s in scattered]
        sizes, flat = np.array([len(c) for c in clouds]), self.vectors(np.concatenate(clouds))
        self.scattered = Clouds(flat, flat, sizes, _offsets(sizes))
        self.scattered_frame = self.integers(np.repeat(np.arange(len(clouds)), sizes))
        self._noise = np.array([s.deviation for s in scattered])
        self.deviation = self.numbers(self._noise)

    def noise_of(self, frame: int) -> float:
        """Of the points across their surface, cube units, where that is wider than they stand apart; else 0."""
        return float(self._noise[frame]) if self.scattered is not None else 0.0

    @property
    def wide_noise(self) -> float:
        """The same of most frames."""
        return float(np.median(self._noise)) if self.scattered is not None else 0.0

    def _lay_template(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        # Vertices travel in Morton order; `place` takes results back to the template's own order.
        order = morton_order(vertices)
        self.place = np.argsort(order)
        self.template = vertices[order]
        self.faces = self.place[faces].astype(np.int32)
        edges = self.place[unique_edges(faces)]
        self.edges = wp.array(edges.astype(np.int32), dtype=wp.int32, ndim=2, device=self.device)
        self.mesh: Graph = mesh_graph(edges, len(vertices), self.template_lambda)
        self.vertex_frame = self.integers(np.repeat(np.arange(self.frame_count), len(vertices)))

    def _keep_nodes(self, clouds: list[np.ndarray]) -> np.ndarray:
        kept = np.ones((len(self.transitions), self.levels.node_count), dtype=bool)
        if self.config.grid.prune:
            ends = zip(self.transitions.source, self.transitions.target, strict=True)
            for s, (a, b) in enumerate(ends):
                kept[s] = kept_nodes(self.levels, [clouds[a], clouds[b]], self.config.grid.prune_cells)
        return kept

    @property
    def frame_count(self) -> int:
        return len(self.cloud_sizes)

    @cached_property
    def measures(self) -> CloudMeasures:
        """Of the clouds, against the template's area."""
        area = float(face_areas(self.template, self.faces).sum())
        least = np.inf if self.seen else self.config.keyframe.coverage_min
        measured = None
        if self.scattered is not None:
            measured = np.split(self.scattered.points.numpy(), self.scattered.offsets[1:-1])
        clouds = np.split(self.cloud.numpy(), self.cloud_offsets[1:-1])
        return CloudMeasures(clouds, area, least, self.device, measured)

    @cached_property
    def border(self) -> np.ndarray | None:
        """The template's border, see ``measures.border_of``; vertices in their order here."""
        return border_of(self.faces, self.vertex_count)

    @cached_property
    def edge_length(self) -> float:
        """Mean length of the template's edges, cube units."""
        return mean_edge_length(self.template, self.edges.numpy())

    # What are tasks of their own, (first, last): on CUDA all together.

    def frame_spans(self) -> list[tuple[int, int]]:
        """Of frames."""
        return self.way.cut(self.frame_count)

    def transition_spans(self) -> list[tuple[int, int]]:
        """Of transitions."""
        return self.way.cut(len(self.transitions))

    def vertex_spans(self) -> list[tuple[int, int]]:
        """Of vertices, each in all frames."""
        return self.way.cut(self.vertex_count, ways.VERTICES_PER_TASK)

    def by_frame(self, a: np.ndarray) -> list[np.ndarray]:
        """Rows of all clouds, (N, 3), as float64 by frame."""
        return np.split(a.astype(np.float64), self.cloud_offsets[1:-1])

    @property
    def vertex_count(self) -> int:
        return len(self.template)

    @property
    def template_lambda(self) -> float:
        """Smoothing weight on the template's edges; 0 without preconditioning."""
        sobolev = self.config.sobolev
        return sobolev.lambda_template if sobolev.enabled else 0.0

    def vectors(self, a: np.ndarray) -> wp.array:
        """An (N, 3) array on the device, float32."""
        return wp.array(np.ascontiguousarray(a, dtype=np.float32), dtype=wp.vec3, device=self.device)

    def integers(self, a: np.ndarray) -> wp.array:
        return wp.array(np.ascontiguousarray(a, dtype=np.int32), dtype=wp.int32, device=self.device)

    def numbers(self, a: np.ndarray) -> wp.array:
        return wp.array(np.ascontiguousarray(a, dtype=np.float32), dtype=wp.float32, device=self.device)


def _offsets(sizes: np.ndarray) -> np.ndarray:
    """Where each of the runs of these sizes begins, and where the last ends."""
    return np.concatenate([[0], np.cumsum(sizes)]).astype(int)


def span(offsets: np.ndarray, first: int, last: int) -> tuple[int, int]:
    """Begin and count of the elements of runs ``first .. last``."""
    return int(offsets[first]), int(offsets[last] - offsets[first])
