"""Rows of ``warpdef bench``: sampling, the rigid motion, points and vertices on their way through the grids."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpdef.apps.benchmark.bed import Bed, Case, Peer, run_tasks
from warpdef.apps.benchmark.kernels import adj_sample_only, rotate_only, sample_only
from warpdef.apps.benchmark.peers import rotate_numpy, sample_scipy, scatter_numpy, torch_peers
from warpdef.fit.pool import NODE
from warpdef.kernels.levels import node8
from warpdef.kernels.motion import adj_move_points, adj_move_vertices, move_points, move_vertices, scatter_vertices

# By hand: a cell's place 21; seven interpolations of eight floats; the sum. With derivatives four more differences and
# three more sums. Scattering splits a register seven times and adds eight.
_SAMPLE, _SAMPLE_AND_DERIVATIVE, _SCATTER = 21 + 7 * 24 + 8, 24 + 17 * 16 + 4 * 8 + 12, 21 + 7 * 16 + 64
_ROTATE, _ADJ_ROTATE, _ROTATE_ALONG = 36, 60, 90


def motion_cases(bed: Bed) -> list[Case]:
    """Sampling, its adjoint, Cayley, and the kernels of an iteration that combine them."""
    return [*_sampling(bed), _cayley(bed), *_points(bed), *_vertices(bed)]


def _sampling(bed: Bed) -> list[Case]:
    p, table = bed.problem, bed.problem.levels
    count, levels = len(p.origin), table.count
    values = wp.zeros(count, dtype=node8, device=bed.device)
    gradient = np.zeros((count, 8), dtype=np.float32)
    gradient[:, :6] = np.random.default_rng(0).normal(size=(count, 6))
    adj_values = wp.array(gradient, dtype=node8, device=bed.device)
    adj_nodes = bed.node_array()
    clouds = np.split(p.origin.numpy(), p.moved_offsets[1:-1])
    nodes = bed.nodes.numpy()
    torch = torch_peers(nodes, gradient, table, clouds)

    forward = bed.span_tasks(
        lambda a, n: sample_only(a, n, bed.nodes, bed.levels, p.origin, p.moved_transition, values), p.moved_offsets
    )
    back = bed.span_tasks(
        lambda a, n: adj_sample_only(a, n, bed.levels, p.origin, p.moved_transition, adj_values, adj_nodes),
        p.moved_offsets,
    )

    def value() -> np.ndarray:
        run_tasks(forward)
        return values.numpy()

    def scattered() -> np.ndarray:
        adj_nodes.zero_()
        run_tasks(back)
        return adj_nodes.numpy()

    grid = bed.nodes.size * NODE
    return [
        Case(
            "sampling", "points", count, count * (12 + 4 + NODE) + grid, forward, count * (levels * _SAMPLE + 8),
            answer=value,
            peers=[
                Peer("scipy map_coordinates", lambda workers: sample_scipy(nodes, table, clouds)),
                *([torch["value"]] if torch else []),
            ],
        ),
        Case(
            "sampling adjoint", "points", count, count * (12 + 4 + NODE) + 2 * grid, back,
            count * (levels * _SCATTER + 8), answer=scattered,
            peers=[
                Peer("numpy bincount", lambda workers: scatter_numpy(gradient, table, clouds)),
                *([torch["gradient"]] if torch else []),
            ],
        ),
    ]  # fmt: skip


def _cayley(bed: Bed) -> Case:
    p, z = bed.problem, bed.objective.input.rotation
    count, out = len(p.origin), bed.zeros(p.origin)
    tasks = bed.span_tasks(lambda a, n: rotate_only(a, n, z, p.origin, out), p.moved_offsets)

    def moved() -> np.ndarray:
        run_tasks(tasks)
        return out.numpy()

    rotation, origin = z.numpy(), p.origin.numpy()
    peer = Peer("numpy", lambda workers: rotate_numpy(rotation, origin))
    return Case("Cayley", "points", count, count * 36, tasks, count * _ROTATE, answer=moved, peers=[peer])


def _points(bed: Bed) -> list[Case]:
    p, o = bed.problem, bed.objective
    count, levels, grid = len(p.origin), p.levels.count, bed.nodes.size * NODE
    z, moved, adj_nodes = bed.zeros(p.origin), bed.zeros(p.origin), bed.node_array()
    forward = bed.span_tasks(
        lambda a, n: move_points(a, n, bed.nodes, bed.levels, p.origin, p.moved_transition, z, moved), p.moved_offsets
    )
    back = bed.span_tasks(
        lambda a, n: adj_move_points(
            a, n, bed.levels, p.origin, p.moved_transition, o.input.rotation, o.input.adj_points, adj_nodes
        ),
        p.moved_offsets,
    )
    return [
        Case("move points", "points", count, count * 40 + grid, forward, count * (levels * _SAMPLE + 8 + _ROTATE)),
        Case(
            "move points adjoint", "points", count, count * 40 + 2 * grid, back,
            count * (levels * _SCATTER + 8 + _ADJ_ROTATE),
        ),
    ]  # fmt: skip


def _vertices(bed: Bed) -> list[Case]:
    p, o, ends = bed.problem, bed.objective, bed.problem.transitions
    levels, grid = p.levels.count, bed.nodes.size * NODE
    count = len(ends) * p.vertex_count
    vertices, z, jacobian = wp.clone(o.vertices), bed.zeros(o.chain.rotation), bed.zeros(o.chain.jacobian)
    sources = p.integers(ends.source)
    carry, adj_motion, adj_nodes = bed.zeros(o.chain.carry), bed.zeros(o.chain.adj_motion), bed.node_array()

    def chain(begin: int, n: int) -> None:
        for s in (*ends.forward, *ends.backward):
            source, target = int(ends.source[s]), int(ends.target[s])
            move_vertices(begin, n, s, source, target, bed.nodes, bed.levels, vertices, z, jacobian)

    def pull(begin: int, n: int) -> None:
        for s in (*reversed(ends.forward), *reversed(ends.backward)):
            source, target = int(ends.source[s]), int(ends.target[s])
            adj_move_vertices(
                begin, n, s, source, target, target, source, o.vertices, o.chain.rotation, o.chain.jacobian,
                o.confidence, o.sums.weighed, o.sums.plain, carry, adj_motion,
            )  # fmt: skip

    def scatter(first: int, last: int) -> None:
        span = (first * p.vertex_count, (last - first) * p.vertex_count)
        scatter_vertices(*span, bed.levels, sources, o.vertices, o.chain.adj_motion, adj_nodes)

    motion = _ROTATE + 3 * (_ROTATE + _ROTATE_ALONG)
    return [
        Case(
            "move vertices", "vertices", count, count * (12 + 12 + 12 + 36) + grid, bed.vertex_tasks(chain),
            count * (levels * _SAMPLE_AND_DERIVATIVE + 32 + motion),
        ),
        Case(
            "move vertices adjoint", "vertices", count, count * (6 * 12 + 36 + NODE), bed.vertex_tasks(pull),
            count * (_ADJ_ROTATE + 24),
        ),
        Case(
            "scatter vertices", "vertices", count, count * (12 + NODE) + 2 * grid, bed.transition_tasks(scatter),
            count * (levels * _SCATTER + 8),
        ),
    ]  # fmt: skip
