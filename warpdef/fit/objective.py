"""The objective and its gradient, hand-written from end to end (paper, sec. Optimization Objectives).

    L = mesh CD_R(X_k, P_k) + 1/S sum_s input CD_R(M(P_source), P_target)
      + 1/S sum_t transform w(t) CD_R(X_t, P_t) + isometry L_isometry

An evaluation is four phases, each of tasks that write apart from one another:

    move      a transition moves its cloud and compares it with the next; vertices run through all steps
    compare   a frame compares its vertices with its cloud; edges are compared with themselves a frame on
    trust     the confidence of every frame
    pull      vertices run back, and leave a six-vector gradient a step

The gradient of the nodes is then complete but for the vertices' scatter, which is the optimiser's first move.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import warp as wp

from warpdef.fit.problem import Problem
from warpdef.fit.workers import Phase
from warpdef.kernels.cells import PointGrid
from warpdef.kernels.chamfer import BOTH_SIDES, fixed_to_moving, moving_to_fixed
from warpdef.kernels.confidence import confidence
from warpdef.kernels.isometry import isometry, isometry_of_vertices, lay_paths, path_width
from warpdef.kernels.levels import node8
from warpdef.kernels.motion import adj_move_points, adj_move_vertices, move_points, move_vertices, scatter_vertices
from warpdef.kernels.neighbours import NearestSearch
from warpdef.kernels.vectors import clear_losses, clear_vectors

VERTICES_PER_TASK = 1024
# How far apart a point and its partner's partner may be where a cloud shows part of the surface (``chamfer``): about as
# far as on a surface that both sets cover. Twice that, and the rim of what is seen draws the unseen over, bit by bit.
_REACH_SPACINGS = 1.0
_REACH_EDGES = 0.25
_REACH_CLOUDS = 0.75


class Objective:
    """Buffers and phases of one problem. ``nodes`` and ``adj_nodes`` belong to the optimiser.

    Losses, unweighted, after a run: ``loss_input`` (S,), ``loss_transform`` (T,; the mesh term at the keyframe),
    ``loss_isometry`` (parts, T), to be summed over parts. Vertices of all frames: ``vertices`` (T, V), cube units,
    Morton order.
    """

    def __init__(self, problem: Problem, nodes: wp.array, adj_nodes: wp.array, schedule: wp.array) -> None:
        self.problem, self.nodes, self.adj_nodes, self.schedule = problem, nodes, adj_nodes, schedule
        p, device = problem, problem.device
        frames, steps, count = p.frame_count, len(p.transitions), p.vertex_count
        self.levels = p.levels.to_device(device)

        self.vertices = p.vectors(np.tile(p.template, (frames, 1))).reshape((frames, count))
        self.rotation = wp.zeros((steps, count), dtype=wp.vec3, device=device)
        self.jacobian = wp.zeros((steps, count), dtype=wp.mat33, device=device)
        self.adj_chamfer = wp.zeros((frames, count), dtype=wp.vec3, device=device)
        self.adj_isometry = wp.zeros((frames, count), dtype=wp.vec3, device=device)
        self.carry = wp.zeros((frames + 1, count), dtype=wp.vec3, device=device)
        self.adj_motion = wp.zeros((steps, count), dtype=node8, device=device)

        self.moved_rotation, self.moved, self.adj_moved = (wp.zeros_like(p.origin) for _ in range(3))
        self.cloud_grid = PointGrid(p.cloud, p.cloud_sizes, p.box)
        self.moved_grid = PointGrid(self.moved, p.moved_sizes, p.box)
        self.vertex_grid = PointGrid(self.vertices.flatten(), np.full(frames, count), p.box)
        self.cloud_grid.build()

        flat = self.vertices.flatten()
        self.moved_to_cloud = NearestSearch(self.cloud_grid, self.moved, p.moved_target)
        self.cloud_to_moved = NearestSearch(self.moved_grid, p.cloud, p.cloud_transition)
        self.vertex_to_cloud = NearestSearch(self.cloud_grid, flat, p.vertex_frame)
        self.cloud_to_vertex = NearestSearch(self.vertex_grid, p.cloud, p.cloud_frame)

        self.loss_input = wp.zeros(steps, dtype=wp.float64, device=device)
        self.loss_transform = wp.zeros(frames, dtype=wp.float64, device=device)
        parts = len(self.vertex_runs())
        self.loss_isometry = wp.zeros((parts, frames), dtype=wp.float64, device=device)
        width = path_width(frames) if device.is_cpu else 0
        self.paths = wp.zeros((count, 3, width), dtype=wp.float32, device=device)
        self._row, self._column = p.integers(p.mesh.row), p.integers(p.mesh.column)
        self.confidence = wp.full(frames, 1.0, dtype=wp.float32, device=device)
        self._weigh()

    def _weigh(self) -> None:
        p, loss = self.problem, self.problem.config.loss
        steps, target = len(p.transitions), p.transitions.target
        mean = loss.reduction == "mean"

        def share(sizes: np.ndarray) -> wp.array:
            return p.numbers(1.0 / sizes if mean else np.ones(len(sizes)))

        self._moved_share, self._met_share = share(p.moved_sizes), share(p.cloud_sizes[target])
        self._vertex_share = share(np.full(p.frame_count, p.vertex_count))
        self._cloud_share = share(p.cloud_sizes)
        self._input_weight = p.numbers(np.full(steps, loss.input_weight / steps))
        transform = np.full(p.frame_count, loss.transform_weight / steps)
        transform[p.transitions.keyframe] = loss.mesh_weight
        self._transform_weight = p.numbers(transform)
        self._robust = (loss.robust_alpha, loss.robust_power, loss.tangential)
        self._isometry_share = 1.0 / (steps * len(p.edges))
        self._weigh_sides()

    def _weigh_sides(self) -> None:
        """Which pairs count where a cloud shows part of the surface; all of them where every cloud shows all of it."""
        p = self.problem
        self.vertex_sides = self._moved_sides = self._met_sides = BOTH_SIDES
        if p.complete.all():
            return

        def reach(spacing: np.ndarray, answered_by: np.ndarray) -> wp.array:
            return p.numbers(np.where(p.complete[answered_by], np.inf, spacing))

        source, target = p.transitions.source, p.transitions.target
        clouds = _REACH_CLOUDS * (p.spacing[source] + p.spacing[target])
        vertices = _REACH_SPACINGS * p.spacing + _REACH_EDGES * p.edge_length
        self.vertex_sides = self.cloud_to_vertex.index, reach(vertices, np.arange(p.frame_count))
        self._moved_sides = self.cloud_to_moved.index, reach(clouds, target)
        self._met_sides = self.moved_to_cloud.index, reach(clouds, source)

    # Tasks. Each is called once to be recorded, or at every iteration on CUDA.

    def _input_term(self, first: int, last: int) -> None:
        """Move the clouds of transitions ``first .. last``, compare, and leave the gradient in their nodes."""
        p = self.problem
        begin, count = span(p.moved_first, first, last)
        met_begin, met_count = span(p.cloud_first, *p.transitions.targets(first, last))
        clear_losses(first, last - first, self.loss_input)
        move_points(
            begin, count, self.nodes, self.levels, p.origin, p.moved_transition, self.moved_rotation, self.moved
        )
        self.moved_grid.build(first, last)
        self.moved_to_cloud.run(begin, count)
        self.cloud_to_moved.run(met_begin, met_count)
        results = (self._input_weight, self._robust, self.loss_input, self.adj_moved)
        moving_to_fixed(
            begin, count, self.moved, p.moved_transition, self.moved_to_cloud.index, p.cloud, p.normals,
            self._moved_share, *results, self._moved_sides,
        )  # fmt: skip
        fixed_to_moving(
            met_begin, met_count, p.cloud, p.normals, p.cloud_transition, self.cloud_to_moved.index, self.moved,
            self._met_share, *results, self._met_sides,
        )  # fmt: skip
        adj_move_points(
            begin, count, self.levels, p.origin, p.moved_transition, self.moved_rotation, self.adj_moved, self.adj_nodes
        )

    def _chain(self, begin: int, count: int) -> None:
        """Vertices ``begin .. begin + count`` from the keyframe to both ends."""
        ends = self.problem.transitions
        for s in (*ends.forward, *ends.backward):
            source, target = int(ends.source[s]), int(ends.target[s])
            move_vertices(
                begin, count, s, source, target, self.nodes, self.levels, self.vertices, self.rotation, self.jacobian
            )
        if self.problem.device.is_cpu:
            lay_paths(begin, count, self.vertices, self.paths)

    def _compare(self, first: int, last: int) -> None:
        """Chamfer terms of frames ``first .. last``; the gradient is not yet weighted by the confidence."""
        p = self.problem
        flat, adj = self.vertices.flatten(), self.adj_chamfer.flatten()
        begin, count = first * p.vertex_count, (last - first) * p.vertex_count
        met_begin, met_count = span(p.cloud_first, first, last)
        clear_losses(first, last - first, self.loss_transform)
        self.vertex_grid.build(first, last)
        self.vertex_to_cloud.run(begin, count)
        self.cloud_to_vertex.run(met_begin, met_count)
        results = (self._transform_weight, self._robust, self.loss_transform, adj)
        moving_to_fixed(
            begin,
            count,
            flat,
            p.vertex_frame,
            self.vertex_to_cloud.index,
            p.cloud,
            p.normals,
            self._vertex_share,
            *results,
            self.vertex_sides,
        )
        fixed_to_moving(
            met_begin, met_count, p.cloud, p.normals, p.cloud_frame, self.cloud_to_vertex.index, flat,
            self._cloud_share, *results,
        )  # fmt: skip

    def _keep_lengths(self, begin: int, count: int) -> None:
        """Isometry: on the CPU around vertices ``begin .. begin + count``, on CUDA everywhere."""
        p, weight, share = self.problem, self.problem.config.loss.isometry_weight, self._isometry_share
        if weight == 0:
            return
        if p.device.is_cpu:
            part = begin // VERTICES_PER_TASK
            clear_losses(part * p.frame_count, p.frame_count, self.loss_isometry.flatten())
            results = (part, self.loss_isometry, self.adj_isometry)
            isometry_of_vertices(begin, count, self.paths, self._row, self._column, share, weight, *results)
            return
        loss = self.loss_isometry.flatten()
        clear_losses(0, len(loss), loss)
        clear_vectors(0, self.adj_isometry.size, self.adj_isometry.flatten())
        everything = p.frame_count * len(p.edges)
        isometry(0, everything, self.vertices, p.edges, share, weight, loss, self.adj_isometry)

    def _trust(self) -> None:
        p, loss = self.problem, self.problem.config.loss
        mean = loss.confidence_bound == "mean"
        losses = (self.loss_input, self.loss_transform)
        confidence(loss.confidence, mean, p.transitions.keyframe, self.schedule, *losses, self.confidence)

    def _pull(self, begin: int, count: int) -> None:
        """The chain backwards. The backward chain's share at the keyframe goes to the spare row T of ``carry``."""
        ends, spare = self.problem.transitions, self.problem.frame_count
        for steps in (ends.forward, ends.backward):
            for s in reversed(steps):
                source, target = int(ends.source[s]), int(ends.target[s])
                to = spare if source == ends.keyframe and steps is ends.backward else source
                adj_move_vertices(
                    begin, count, s, source, target, target, to, self.vertices, self.rotation, self.jacobian,
                    self.confidence, self.adj_chamfer, self.adj_isometry, self.carry, self.adj_motion,
                )  # fmt: skip

    def scatter(self, first: int, last: int) -> None:
        """Add the vertices' gradients to the nodes of transitions ``first .. last``: the optimiser calls it."""
        p = self.problem
        for s in range(first, last):
            source = int(p.transitions.source[s])
            scatter_vertices(0, p.vertex_count, s, source, self.levels, self.vertices, self.adj_motion, self.adj_nodes)

    def forget(self) -> None:
        """Let every search begin anew, after positions that were no numbers."""
        for search in (self.moved_to_cloud, self.cloud_to_moved, self.vertex_to_cloud, self.cloud_to_vertex):
            search.forget()
        for grid in (self.cloud_grid, self.moved_grid, self.vertex_grid):
            grid.forget()

    def chain_all(self) -> None:
        """All vertices of all frames for the nodes as they are."""
        self._chain(0, self.problem.vertex_count)

    def placed_vertices(self) -> np.ndarray:
        """Vertices of all frames, (T, V, 3) float32, cube units, in the template's own order."""
        return self.vertices.numpy()[:, self.problem.place]

    # Phases.

    def steps(self) -> list[tuple[int, int]]:
        """Spans of transitions that are tasks of their own: one each on the CPU, all together on CUDA."""
        return spans(len(self.problem.transitions), 1 if self.problem.device.is_cpu else None)

    def vertex_runs(self) -> list[tuple[int, int]]:
        """Begins and counts of vertices that are tasks of their own, likewise."""
        p = self.problem
        return [(a, b - a) for a, b in spans(p.vertex_count, VERTICES_PER_TASK if p.device.is_cpu else None)]

    def phases(self, warmup: bool) -> list[Phase]:
        """All phases of an evaluation; during warm-up only the input and mesh terms."""
        p, cpu = self.problem, self.problem.device.is_cpu
        clouds = [partial(self._input_term, a, b) for a, b in self.steps()]
        if warmup:
            k = p.transitions.keyframe
            return [Phase("move", [*clouds, partial(self._compare, k, k + 1)])]
        runs = self.vertex_runs()
        frames = spans(p.frame_count, 1 if cpu else None)
        lengths = [partial(self._keep_lengths, a, n) for a, n in runs]
        return [
            Phase("move", [*(partial(self._chain, a, n) for a, n in runs), *clouds]),
            Phase("compare", [*(partial(self._compare, a, b) for a, b in frames), *lengths]),
            Phase("trust", [self._trust]),
            Phase("pull", [partial(self._pull, a, n) for a, n in runs]),
        ]

    def losses(self) -> dict[str, float]:
        """Weighted terms of the last evaluation, as they enter the objective, and their sum."""
        p, loss = self.problem, self.problem.config.loss
        steps, key = len(p.transitions), p.transitions.keyframe
        transform = self.loss_transform.numpy() * self.confidence.numpy()
        terms = {
            "mesh": loss.mesh_weight * float(transform[key]),
            "input": loss.input_weight * float(self.loss_input.numpy().sum()) / steps,
            "transform": loss.transform_weight * float(np.delete(transform, key).sum()) / steps,
            "isometry": loss.isometry_weight * float(self.loss_isometry.numpy().sum()),
        }
        return {**terms, "total": sum(terms.values())}


def span(first_of: np.ndarray, first: int, last: int) -> tuple[int, int]:
    """Begin and count of runs ``first .. last``."""
    return int(first_of[first]), int(first_of[last] - first_of[first])


def spans(total: int, size: int | None) -> list[tuple[int, int]]:
    """``0 .. total`` cut into spans of ``size``; None: one span."""
    size = size or total
    return [(a, min(a + size, total)) for a in range(0, total, size)]
