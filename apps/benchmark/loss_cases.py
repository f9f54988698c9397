"""Rows of ``warpdef bench``: Chamfer in both directions, and isometry."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpdef.apps.benchmark.bed import Bed, Case, Peer, run_tasks
from warpdef.apps.benchmark.peers import add_rows, chamfer_numpy, isometry_numpy
from warpdef.device import Way, on_host
from warpdef.fit.pool import INDEX, VECTOR
from warpdef.kernels.chamfer import fixed_to_moving, moving_to_fixed
from warpdef.kernels.isometry import isometry, isometry_of_vertices, lay_paths, path_width

_PAIR = 45  # flops of one residual and its gradient, by hand; the exponential counted as 10
_EDGE = 40


def loss_cases(bed: Bed) -> list[Case]:
    """The vertices of all frames against the clouds, and their edges against those of the next frame."""
    return [*_chamfer(bed), _isometry(bed)]


def _chamfer(bed: Bed) -> list[Case]:
    p, o, loss = bed.problem, bed.objective, bed.problem.config.loss
    frames = p.frame_count
    vertices = wp.clone(o.vertices).flatten()
    vertex_first = np.arange(frames + 1) * p.vertex_count
    to_cloud, to_vertex = (
        wp.clone(o.transform.correspondences.forth.index),
        wp.clone(o.transform.correspondences.back.index),
    )
    share, weight = p.numbers(np.ones(frames)), p.numbers(np.full(frames, 0.5))
    robust = (loss.robust_alpha, loss.robust_power, loss.tangential)
    losses = wp.zeros(frames, dtype=wp.float64, device=bed.device)
    adj = wp.zeros_like(vertices)
    results = (share, weight, robust, losses, adj)
    out = bed.span_tasks(
        lambda a, n: moving_to_fixed(a, n, vertices, p.vertex_frame, to_cloud, p.cloud, p.normals, *results),
        vertex_first,
    )
    back = bed.span_tasks(
        lambda a, n: fixed_to_moving(a, n, p.cloud, p.normals, p.cloud_frame, to_vertex, vertices, *results),
        p.cloud_offsets,
    )

    def gradient(tasks: list) -> tuple[np.ndarray, ...]:
        adj.zero_()
        losses.zero_()
        run_tasks(tasks)
        return adj.numpy(), losses.numpy().sum()

    x, cloud, normals = on_host(vertices), on_host(p.cloud), on_host(p.normals)
    at_cloud, at_vertex = on_host(to_cloud), on_host(to_vertex)

    def out_numpy(workers: int) -> tuple[np.ndarray, ...]:
        energy, pull = chamfer_numpy(x, cloud[at_cloud], normals[at_cloud], robust, 0.5)
        return pull, energy.sum(dtype=np.float64)

    def back_numpy(workers: int) -> tuple[np.ndarray, ...]:
        energy, pull = chamfer_numpy(x[at_vertex], cloud, normals, robust, 0.5)
        return add_rows(at_vertex, pull, len(x)), energy.sum(dtype=np.float64)

    met = 2 * VECTOR + 2 * INDEX  # a point and a vector, slot and neighbour
    return [
        Case(
            "Chamfer, vertices to cloud", "points", len(x), len(x) * met + len(cloud) * 2 * VECTOR,
            out, len(x) * _PAIR, answer=lambda: gradient(out), peers=[Peer("numpy", out_numpy)],
        ),
        Case(
            "Chamfer, cloud to vertices", "points", len(cloud), len(cloud) * met + len(x) * 3 * VECTOR,
            back, len(cloud) * (_PAIR + 3), answer=lambda: gradient(back), peers=[Peer("numpy", back_numpy)],
        ),
    ]  # fmt: skip


def _isometry(bed: Bed) -> Case:
    p, o = bed.problem, bed.objective
    frames, edges = p.frame_count, len(p.edges)
    share, weight = 1.0 / ((frames - 1) * edges), p.config.loss.isometry_weight
    vertices, adj = wp.clone(o.vertices), wp.zeros_like(o.vertices)
    if bed.problem.way is Way.SPANS:
        paths = wp.zeros((p.vertex_count, 3, path_width(frames)), dtype=wp.float32, device=bed.device)
        lay_paths(0, p.vertex_count, vertices, paths)
        mesh = (p.integers(p.mesh.row), p.integers(p.mesh.column))
        part = {first: k for k, (first, _) in enumerate(p.vertex_spans())}
        losses = wp.zeros((len(part), frames), dtype=wp.float64, device=bed.device)

        def around(begin: int, n: int) -> None:
            isometry_of_vertices(begin, n, paths, *mesh, share, weight, part[begin], losses, adj)

        tasks = bed.vertex_tasks(around)
    else:
        losses = wp.zeros(frames, dtype=wp.float64, device=bed.device)
        tasks = [lambda: isometry(0, frames * edges, vertices, p.edges, share, weight, losses, adj)]

    def gradient() -> tuple[np.ndarray, ...]:
        adj.zero_()
        losses.zero_()
        run_tasks(tasks)
        return adj.numpy(), losses.numpy().sum()

    x, pairs = vertices.numpy(), p.edges.numpy()
    count = frames * edges
    size = frames * p.vertex_count * 3 * VECTOR + count * 2 * INDEX
    peer = Peer("numpy", lambda workers: isometry_numpy(x, pairs, share, weight))
    # An edge whose length changes by a rounding error may pull either way: that many edges' gradients may differ.
    return Case("isometry", "edges", count, size, tasks, count * _EDGE, answer=gradient, peers=[peer], tolerance=1e-2)
