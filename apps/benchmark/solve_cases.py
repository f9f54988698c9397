"""Rows of ``warpdef bench``: the Sobolev solves and Adam."""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle
from typing import Any

import numpy as np
import warp as wp

from warpdef.apps.benchmark.bed import Bed, Case, Peer, run_tasks
from warpdef.apps.benchmark.peers import Factored, cosine_numpy
from warpdef.config import Config
from warpdef.device import Way
from warpdef.fit.pool import NODE
from warpdef.fit.sobolev import factorise, level_lambdas
from warpdef.kernels.adam import adam
from warpdef.kernels.cg import ConjugateGradients
from warpdef.kernels.cholesky import CholeskySolver
from warpdef.kernels.cosine import CosineSolver
from warpdef.kernels.graphs import Graph, grid_graph, kept_nodes
from warpdef.kernels.levels import node8
from warpdef.kernels.schedule import SCHEDULE_SIZE

_WARM_SHARE = 0.01


def solve_cases(bed: Bed) -> list[Case]:
    """Cosine transforms, the template factorised, conjugate gradients on pruned grids and template, and Adam."""
    exact = [_factored(bed)] if bed.problem.way is Way.SPANS else []
    return [_cosine(bed), *_pruned(bed), *exact, *_template(bed), _adam(bed)]


def _cosine(bed: Bed) -> Case:
    p, table = bed.problem, bed.problem.levels
    lambdas, transitions = level_lambdas(p.config), len(p.transitions)
    solver = CosineSolver(table, lambdas, transitions, bed.device)
    rhs, out = bed.node_array(bed.gradient), bed.node_array()
    tasks = bed.transition_tasks(lambda a, b: solver.solve(rhs, out, a, b))

    def solution() -> np.ndarray:
        run_tasks(tasks)
        return out.numpy()

    # Six passes of n multiply-adds a component, and the division.
    flops = transitions * 8 * int(sum(12 * int(n) ** 4 + 5 * int(n) ** 3 for n in table.resolution))
    peer = Peer("numpy matmul (BLAS)", cosine_numpy(bed.gradient, table, lambdas))
    return Case("cosine solve", "nodes", rhs.size, 2 * rhs.size * NODE, tasks, flops, answer=solution, peers=[peer])


def _pruned(bed: Bed) -> list[Case]:
    p = bed.problem
    clouds = np.split(p.cloud.numpy(), p.cloud_offsets[1:-1])
    ends = zip(p.transitions.source, p.transitions.target, strict=True)
    kept = np.stack([kept_nodes(p.levels, [clouds[a], clouds[b]], Config().grid.prune_cells) for a, b in ends])
    graph = grid_graph(p.levels, kept, level_lambdas(p.config))
    rhs = np.where(kept[..., None], bed.gradient, 0.0).reshape(-1, 8)
    each = p.levels.count
    return _conjugate("pruned-grid CG", bed, graph, rhs, node8, lambda call: bed.transition_tasks(
        lambda a, b: call(a * each, b * each)
    ))  # fmt: skip


def _factored(bed: Bed) -> Case:
    o, graph = bed.objective, bed.problem.mesh
    rhs = o.sums.weighed.numpy()[bed.problem.transitions.keyframe].copy()
    factor = factorise(graph)
    solver = CholeskySolver(factor, bed.device)
    b, out = bed.problem.vectors(rhs), wp.zeros(len(rhs), dtype=wp.vec3, device=bed.device)

    def solution() -> np.ndarray:
        solver.solve(b, out)
        return out.numpy()

    known = Factored(graph)
    exact_rhs = rhs.astype(np.float64)
    peer = Peer("scipy splu, factored before", lambda workers: known.solve(exact_rhs))
    count, entries = len(graph.node), len(factor.value)
    # F is read twice: an index and a number an entry; every entry is a multiply-add for three components, twice.
    size = 2 * 8 * entries + count * (4 + 4 + 12 + 12 + 3 * 16)
    tasks = [lambda: solver.solve(b, out)]
    flops = 12 * entries
    return Case("template solve", "vertices", count, size, tasks, flops, answer=solution, peers=[peer])


def _template(bed: Bed) -> list[Case]:
    o, key = bed.objective, bed.problem.transitions.keyframe
    rhs = o.sums.weighed.numpy()[key]
    return _conjugate("template CG", bed, bed.problem.mesh, rhs, wp.vec3, lambda call: [lambda: call(0, 1)])


def _conjugate(
    name: str, bed: Bed, graph: Graph, rhs: np.ndarray, dtype: Any, tasks_of: Callable[[Callable], list]
) -> list[Case]:
    """Cold: from zero. Warm: from the last solution, after the right-hand side has changed by ``_WARM_SHARE``."""
    limits = Config().sobolev
    noise = np.random.default_rng(0).normal(size=rhs.shape)
    noise[:, 6:] = 0.0
    changed = rhs + _WARM_SHARE * np.linalg.norm(rhs) / np.linalg.norm(noise) * noise * (rhs != 0)
    sides = [wp.array(r.astype(np.float32), dtype=dtype, device=bed.device) for r in (rhs, changed)]
    b, out = wp.clone(sides[0]), wp.zeros(len(rhs), dtype=dtype, device=bed.device)

    def fresh() -> ConjugateGradients:
        return ConjugateGradients(graph, dtype, limits.tolerance, limits.iterations_max, bed.device)

    warm = fresh()
    warm_tasks = tasks_of(lambda first, last: warm.solve(b, out, first, last))
    turns = cycle(sides)

    cold = fresh()
    cold_tasks = tasks_of(lambda first, last: cold.solve(sides[0], out, first, last))

    def solution() -> np.ndarray:
        cold.forget()
        run_tasks(cold_tasks)
        return out.numpy()

    factored = Factored(graph)
    exact_rhs = rhs.astype(np.float64)
    peer = Peer("scipy splu, factored before", lambda workers: factored.solve(exact_rhs))
    count, unit = len(graph.node), "nodes" if dtype is node8 else "vertices"
    width = NODE if dtype is node8 else 12
    size = count * 2 * width
    # The tolerance is on the residual; the solution's error is larger by at most the condition number.
    known = {"answer": solution, "peers": [peer], "tolerance": 1e-2}
    return [
        Case(f"{name}, cold", unit, count, size, cold_tasks, before=cold.forget, **known),
        Case(f"{name}, warm", unit, count, size, warm_tasks, before=lambda: wp.copy(b, next(turns))),
    ]


def _adam(bed: Bed) -> Case:
    p, config = bed.problem, bed.problem.config.optimiser
    count, nodes = bed.nodes.size, p.levels.node_count
    rates = config.rate * config.rate_growth ** np.arange(p.levels.count)[p.levels.node_level()]
    scale, bias_1, bias_2 = 0.5, 1.0 / (1.0 - config.beta1**100), 1.0 / (1.0 - config.beta2**100)
    rate, schedule = p.numbers(rates), p.numbers(np.array([scale, bias_1, bias_2, 0.0]))
    if len(schedule) != SCHEDULE_SIZE:
        raise ValueError(f"schedule: expected {SCHEDULE_SIZE} entries, got {len(schedule)}")
    g = bed.gradient.reshape(-1, 8)
    start = [0.1 * g, 0.01 * g * g, bed.nodes.numpy().reshape(-1, 8)]
    gradient = bed.node_array(bed.gradient).flatten()
    state = [wp.array(a, dtype=node8, device=bed.device) for a in start]
    betas, epsilon = (config.beta1, config.beta2), config.epsilon
    tasks = bed.transition_tasks(
        lambda a, b: adam(a * nodes, (b - a) * nodes, rate, schedule, betas, epsilon, gradient, *state)
    )

    def step() -> np.ndarray:
        for array, values in zip(state, start, strict=True):
            array.assign(values)
        run_tasks(tasks)
        return state[2].numpy()

    per_node = np.tile(rates, len(p.transitions))[:, None].astype(np.float32)

    def by_numpy(workers: int) -> np.ndarray:
        m = np.float32(config.beta1) * start[0] + np.float32(1 - config.beta1) * g
        v = np.float32(config.beta2) * start[1] + np.float32(1 - config.beta2) * g * g
        change = m * np.float32(bias_1) / (np.sqrt(v * np.float32(bias_2)) + np.float32(epsilon))
        return start[2] - np.float32(scale) * per_node * change

    peer = Peer("numpy", by_numpy)
    return Case("Adam", "nodes", count, count * 7 * NODE, tasks, count * 8 * 13, answer=step, peers=[peer])
