"""Rows of ``warpdef bench``: building grids of points, and nearest neighbours, cold and tracked."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count as count_from

import numpy as np
import warp as wp

from warpdef.apps.benchmark.bed import Bed, Case, Peer, run_tasks
from warpdef.device import on_host
from warpdef.fit.pool import INDEX, VECTOR
from warpdef.kernels.cells import PointGrid
from warpdef.kernels.neighbours import NearestSearch


def search_cases(bed: Bed) -> list[Case]:
    """Vertices of all frames, which move, and the clouds, which do not, seek each other."""
    p, frames = bed.problem, bed.problem.frame_count
    vertex_first = np.arange(frames + 1) * p.vertex_count
    vertex_sizes = np.full(frames, p.vertex_count)
    moving = wp.clone(bed.objective.vertices).flatten()
    to_vertices = _Pair(bed, p.cloud, p.cloud_frame, p.cloud_offsets, moving, vertex_sizes, vertex_first)
    to_clouds = _Pair(bed, moving, p.vertex_frame, vertex_first, p.cloud, p.cloud_sizes, p.cloud_offsets)
    build_bytes = len(moving) * (4 * VECTOR + 4 * INDEX) + to_vertices.cells * INDEX
    return [
        Case(
            "neighbours: build", "points", len(moving), build_bytes, to_vertices.build_tasks,
            answer=to_vertices.distances, peers=to_vertices.peers(build=True), tolerance=1e-5,
        ),
        to_vertices.cold("neighbours: cloud to vertices, cold"),
        to_vertices.tracked("neighbours: cloud to vertices, tracked", moving),
        to_clouds.cold("neighbours: vertices to cloud, cold"),
        to_clouds.tracked("neighbours: vertices to cloud, tracked", moving),
    ]  # fmt: skip


class _Pair:
    """Queries and targets, a group a frame."""

    def __init__(
        self,
        bed: Bed,
        queries: wp.array,
        query_group: wp.array,
        query_first: np.ndarray,
        targets: wp.array,
        target_sizes: np.ndarray,
        target_first: np.ndarray,
    ) -> None:
        self._bed, self._queries, self._targets = bed, queries, targets
        self._query_first, self._target_first = query_first, target_first
        self._grid = PointGrid(targets, target_sizes)
        self._search = NearestSearch(self._grid, queries, query_group)
        self.cells = int(self._grid.start.size)
        self.build_tasks = bed.frame_tasks(self._grid.build)
        self._query_tasks = bed.span_tasks(self._search.run, query_first)

    def _forget(self) -> None:
        self._search.index.fill_(-1)

    def distances(self) -> np.ndarray:
        """From every query to the target found, float64."""
        self._forget()
        run_tasks(self.build_tasks)
        run_tasks(self._query_tasks)
        found = on_host(self._targets)[on_host(self._search.index)].astype(np.float64)
        return np.linalg.norm(self._queries.numpy() - found, axis=1)

    def cold(self, name: str) -> Case:
        """Nothing is known of any query."""
        run_tasks(self.build_tasks)
        return Case(
            name, "queries", len(self._queries), self._bytes(), self._query_tasks, before=self._forget,
            answer=self.distances, peers=self.peers(), tolerance=1e-5,
        )  # fmt: skip

    def tracked(self, name: str, moving: wp.array) -> Case:
        """What an iteration sees: positions of consecutive iterations, and what the last search learnt."""
        bed = self._bed
        steps = bed.path(bed.vertex_path)
        turn = count_from()

        def move() -> None:
            # There and back again, so that no step is longer than one of the descent.
            k, last = next(turn), len(steps) - 1
            wp.copy(moving, steps[last - abs(last - k % (2 * last))])
            run_tasks(self.build_tasks)

        return Case(
            name, "queries", len(self._queries), self._bytes(), self._query_tasks, before=move,
            answer=self.distances, peers=self.peers(), tolerance=1e-5,
        )  # fmt: skip

    def _bytes(self) -> int:
        # Query, group, anchor, bound, reading, index read; four of them written; the sorted targets and the cells read.
        query = 3 * VECTOR + 2 * 4 + 2 * 8 + 2 * 4 + 2 * INDEX
        return len(self._queries) * query + len(self._targets) * (2 * VECTOR + INDEX) + self.cells * INDEX

    def peers(self, build: bool = False) -> list[Peer]:
        """cKDTree, its build or its queries timed."""
        from scipy.spatial import cKDTree

        def queries() -> list[np.ndarray]:
            return np.split(self._queries.numpy(), self._query_first[1:-1])

        def trees() -> list:
            return [cKDTree(t) for t in np.split(self._targets.numpy(), self._target_first[1:-1])]

        def distances(workers: int) -> np.ndarray:
            pairs = zip(trees(), queries(), strict=True)
            return np.concatenate([tree.query(q, workers=workers)[0] for tree, q in pairs])

        return [Peer("scipy cKDTree", distances, not build, _timed(trees, queries, build))]


def _timed(trees: Callable[[], list], queries: Callable[[], list], build: bool) -> Callable[[int], object]:
    built: list = []

    def query(workers: int) -> object:
        if not built:
            built.extend(zip(trees(), queries(), strict=True))
        return [tree.query(q, workers=workers)[0] for tree, q in built]

    return (lambda workers: trees()) if build else query
