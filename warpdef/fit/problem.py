"""What one optimisation works on: clouds, template and transitions as device arrays, laid out once.

T frames, S = T - 1 transitions; transition s lies between frames s and s + 1 and leads away from the keyframe k: from
s to s + 1 for s >= k, from s + 1 to s for s < k. Every frame but k is the target of exactly one transition. Frames
stand behind each other in flat arrays, points along a Morton curve, so a frame is one span.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import warp as wp

from warpdef.config import Config
from warpdef.fit.morton import morton_order
from warpdef.geometry.triangles import face_areas, unique_edges
from warpdef.kernels.graphs import Graph, kept_nodes, mesh_graph
from warpdef.kernels.levels import LevelTable
from warpdef.transitions import Transitions

_NEIGHBOURS = 16  # of a point, for the local shape of its cloud
COMPLETE = 0.87
"""Share of the largest frame's area from which a cloud shows all of the surface; whole bodies in motion keep 0.9."""
COMPLETE_TEMPLATE = 0.7
"""Share of the template's area that it must have as well; thin limbs and few points cost whole bodies up to 0.24."""
_JUDGED = 100  # points from which a cloud's area says something


class Problem:
    """Static data of a run on one device.

    Args:
        clouds: T arrays (N_t, 3), cube units. normals: T arrays (N_t, 3), unit length; or None.
        vertices: template at the keyframe, (V, 3), cube units. faces: (F, 3). keyframe: its frame.
        oriented: whether a frame's normals are known to point outwards; None: all are.
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
    ) -> None:
        self.config, self.device = config, device
        self.transitions = Transitions.away_from(keyframe, len(clouds))
        self.levels = LevelTable.build(config.grid.coarsest, config.grid.levels)
        orders = [morton_order(c) for c in clouds]
        clouds = [c[o] for c, o in zip(clouds, orders, strict=True)]
        if normals is not None:
            normals = [n[o] for n, o in zip(normals, orders, strict=True)]
        self._lay_clouds(clouds, normals)
        self._lay_moved(clouds)
        self._lay_template(vertices, faces)
        self.oriented = np.ones(len(clouds), dtype=bool) if oriented is None else np.asarray(oriented)
        self.kept = self._keep_nodes(clouds)

    def _lay_clouds(self, clouds: list[np.ndarray], normals: list[np.ndarray] | None) -> None:
        self.cloud_sizes = np.array([len(c) for c in clouds])
        self.cloud_first = _first(self.cloud_sizes)
        flat = np.concatenate(clouds)
        self.box = np.stack([flat.min(axis=0), flat.max(axis=0)])
        self.cloud = self.vectors(flat)
        # Without a tangential part normals are multiplied by 0; zeros are as good as any.
        self.normals = self.vectors(np.zeros_like(flat) if normals is None else np.concatenate(normals))
        self.cloud_frame = self.integers(np.repeat(np.arange(len(clouds)), self.cloud_sizes))
        self.cloud_transition = self.integers(np.repeat(self.transitions.of_frame, self.cloud_sizes))

    def _lay_moved(self, clouds: list[np.ndarray]) -> None:
        source = self.transitions.source
        self.moved_sizes = self.cloud_sizes[source]
        self.moved_first = _first(self.moved_sizes)
        self.origin = self.vectors(np.concatenate([clouds[t] for t in source]))
        self.moved_transition = self.integers(np.repeat(np.arange(len(source)), self.moved_sizes))
        self.moved_target = self.integers(np.repeat(self.transitions.target, self.moved_sizes))

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
    def spacing(self) -> np.ndarray:
        """Mean distance of a cloud's points to their nearest fellow, cube units, shape (T,)."""
        return self._local_shape[0]

    @cached_property
    def thickness(self) -> float:
        """Thickness over width of the clouds' neighbourhoods, median over points, then frames: what noise adds to."""
        return float(np.median(self._local_shape[1]))

    @cached_property
    def complete(self) -> np.ndarray:
        """Which frames show all of the surface, by their area, shape (T,) bool."""
        area, whole = self._local_shape[2], float(face_areas(self.template, self.faces).sum())
        # Noise adds to a cloud's area: what exceeds the template's says nothing.
        least = max(COMPLETE * min(area.max(), whole), COMPLETE_TEMPLATE * whole)
        return (area >= least) | (self.cloud_sizes < _JUDGED)

    @cached_property
    def border(self) -> np.ndarray | None:
        """Border vertices' neighbours before and after on the border, and one inside; -1 elsewhere. (V, 3).

        None for a closed template. A vertex at which several borders meet has neighbours of one of them.
        """
        a, b, c = (np.roll(self.faces, -k, axis=1).ravel().astype(np.int64) for k in range(3))
        alone = ~np.isin(a * self.vertex_count + b, b * self.vertex_count + a)
        if not alone.any():
            return None
        border = np.full((self.vertex_count, 3), -1)
        border[a[alone], 1], border[a[alone], 2], border[b[alone], 0] = b[alone], c[alone], a[alone]
        border[(border < 0).any(axis=1)] = -1
        return border

    @cached_property
    def edge_length(self) -> float:
        """Mean length of the template's edges, cube units."""
        ends = self.template[self.edges.numpy()]
        return float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).mean())

    @cached_property
    def _local_shape(self) -> np.ndarray:
        """Spacing, thickness and area of every frame, shape (3, T)."""
        from scipy.spatial import cKDTree

        cloud, first = self.cloud.numpy().astype(np.float64), self.cloud_first
        found = []
        for a, b in zip(first[:-1], first[1:], strict=True):
            distance, index = cKDTree(cloud[a:b]).query(cloud[a:b], k=min(_NEIGHBOURS, b - a))
            near = cloud[a:b][index]
            near -= near.mean(axis=1, keepdims=True)
            spread = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", near, near))
            thin, wide = np.sqrt(np.maximum(np.median(spread[:, :2], axis=0), 0.0))
            # As many points stand for the disc to the last neighbour as lie inside it.
            area = np.pi * (distance[:, -1] ** 2).sum() / max(distance.shape[1] - 1, 1)
            found.append((distance[:, 1].mean(), thin / max(wide, 1e-12), area))
        return np.array(found).T

    def by_frame(self, a: np.ndarray) -> list[np.ndarray]:
        """Rows of all clouds, (N, 3), as float64 by frame."""
        return np.split(a.astype(np.float64), self.cloud_first[1:-1])

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


def _first(sizes: np.ndarray) -> np.ndarray:
    """Where each of the runs of these sizes begins, and where the last ends."""
    return np.concatenate([[0], np.cumsum(sizes)]).astype(int)
