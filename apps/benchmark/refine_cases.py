"""Rows of ``warpdef bench``: the vertex stage's kernels, one by one, and a whole round."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import warp as wp

from warpdef.apps.benchmark.bed import Bed, Case, Peer, run_tasks
from warpdef.apps.benchmark.peers import add_rows
from warpdef.apps.benchmark.refine_peers import block_cg_scipy, planes_numpy, rotations_numpy, vertex_normals_numpy
from warpdef.apps.benchmark.timing import DeviceTimer, Timing
from warpdef.device import frame_of, on_host
from warpdef.fit.pool import INDEX, MATRIX, VECTOR
from warpdef.fit.refine import Refinement
from warpdef.fit.workers import Team
from warpdef.kernels.block_cg import BlockSolver
from warpdef.kernels.pairs import pairs_of
from warpdef.kernels.planes import cloud_planes, vertex_normals, vertex_planes
from warpdef.kernels.rigidity import fit_rotations, rest_rhs, rigid_rhs

_RIGIDITY = 0.1
ROUND = "vertex stage: a round"


def refine_cases(bed: Bed) -> list[Case]:
    """Normals, planes both ways, rotations, right-hand sides and the block solve, on the vertices of the bed."""
    return [*_planes(bed), *_rigid(bed)]


def _spans(bed: Bed) -> np.ndarray:
    return np.arange(bed.problem.frame_count + 1) * bed.problem.vertex_count


def _filled(bed: Bed, dtype: type, count: int) -> wp.array:
    return wp.zeros(count, dtype=dtype, device=bed.device)


def _planes(bed: Bed) -> list[Case]:
    p, o, c = bed.problem, bed.objective, bed.problem.config.refine
    x, frames, count = wp.clone(o.vertices), p.frame_count, p.vertex_count
    total, points = frames * count, len(p.cloud)
    corner = np.argsort(p.faces.ravel(), kind="stable")
    around = np.concatenate([[0], np.cumsum(np.bincount(p.faces.ravel(), minlength=count))])
    faces = wp.array(p.faces, dtype=wp.int32, ndim=2, device=bed.device)
    face_row, face_of = p.integers(around), p.integers(corner // 3)
    m = wp.zeros_like(x)

    def normals_of(begin: int, n: int) -> None:
        vertex_normals(begin, n, faces, face_row, face_of, x, m)

    normals_of(0, total)
    flat, normals = x.flatten(), m.flatten()
    to_cloud, to_vertex = (
        wp.clone(o.transform.correspondences.forth.index),
        wp.clone(o.transform.correspondences.back.index),
    )
    reach = c.reach * p.measures.spacing
    pairing = (c.agreement, 1.0, p.numbers(reach), p.numbers(0.0 * reach))
    matrix, rhs = _filled(bed, wp.mat33, total), _filled(bed, wp.vec3, total)
    mesh, cloud = (flat, normals), (p.cloud, p.normals)
    met = pairs_of(pairing, *mesh, p.vertex_frame, to_cloud, *cloud)
    asked = pairs_of(pairing, *mesh, p.cloud_frame, to_vertex, *cloud)
    tasks = {
        "normals": bed.span_tasks(normals_of, _spans(bed)),
        "out": bed.span_tasks(lambda a, n: vertex_planes(a, n, met, matrix, rhs), _spans(bed)),
        "back": bed.span_tasks(lambda a, n: cloud_planes(a, n, asked, matrix, rhs), p.cloud_offsets),
    }

    def answer(which: str) -> tuple[np.ndarray, ...]:
        for array in (matrix, rhs) if which != "normals" else (m,):
            array.zero_()
        run_tasks(tasks[which])
        return (m.numpy(),) if which == "normals" else (matrix.numpy(), rhs.numpy())

    at, mesh_normals, points_at, cloud_normals = (on_host(a) for a in (flat, normals, p.cloud, p.normals))
    j, i = on_host(to_cloud), on_host(to_vertex)
    reach_out, reach_back = reach[on_host(p.vertex_frame)], reach[on_host(p.cloud_frame)]

    def out_numpy(workers: int) -> tuple[np.ndarray, ...]:
        return planes_numpy(at, mesh_normals, points_at[j], cloud_normals[j], reach_out, c.agreement)

    def back_numpy(workers: int) -> tuple[np.ndarray, ...]:
        found = planes_numpy(at[i], mesh_normals[i], points_at, cloud_normals, reach_back, c.agreement)
        return add_rows(i, found[0].reshape(-1, 9), total).reshape(-1, 3, 3), add_rows(i, found[1], total)

    x_numpy = x.numpy()
    pair = 4 * VECTOR + 2 * INDEX
    normals_peer = Peer("numpy", lambda workers: (vertex_normals_numpy(x_numpy, p.faces),))
    return [
        Case(
            "vertex normals", "vertices", total, total * (2 * VECTOR + 12 * INDEX), tasks["normals"],
            answer=lambda: answer("normals"), peers=[normals_peer],
        ),
        Case(
            "planes, vertices to cloud", "points", total, total * (pair + MATRIX + VECTOR), tasks["out"],
            answer=lambda: answer("out"), peers=[Peer("numpy", out_numpy)],
        ),
        Case(
            "planes, cloud to vertices", "points", points, points * pair + 2 * total * (MATRIX + VECTOR),
            tasks["back"], answer=lambda: answer("back"), peers=[Peer("numpy", back_numpy)],
        ),
    ]  # fmt: skip


def _rigid(bed: Bed) -> list[Case]:
    p, o, c = bed.problem, bed.objective, bed.problem.config.refine
    x, frames, count = wp.clone(o.vertices), p.frame_count, p.vertex_count
    total, half_edges = frames * count, frames * len(p.mesh.column)
    mesh, every = (p.integers(p.mesh.row), p.integers(p.mesh.column)), p.integers(np.arange(frames))
    rest = wp.clone(frame_of(x, p.transitions.keyframe))
    rotation = _filled(bed, wp.mat33, total).reshape(x.shape)
    fit_rotations(0, total, *mesh, rest, x, rotation)
    rhs, rest_sum = wp.zeros_like(x), _filled(bed, wp.vec3, count)
    tasks = {
        "rotations": bed.span_tasks(lambda a, n: fit_rotations(a, n, *mesh, rest, x, rotation), _spans(bed)),
        "rhs": bed.span_tasks(lambda a, n: rigid_rhs(a, n, 1.0, *mesh, rest, rotation, x, rhs), _spans(bed)),
        "rest": bed.vertex_tasks(lambda a, n: rest_rhs(a, n, every, *mesh, rotation, x, rest_sum)),
    }
    i, j = np.repeat(np.arange(count), np.diff(p.mesh.row)), p.mesh.column
    x_numpy, y, fitted = x.numpy(), rest.numpy(), rotation.numpy()

    def turned_rhs() -> np.ndarray:
        rhs.zero_()
        run_tasks(tasks["rhs"])
        return rhs.numpy()

    def rotations() -> np.ndarray:
        run_tasks(tasks["rotations"])
        return rotation.numpy()

    def rest_rhs_found() -> np.ndarray:
        run_tasks(tasks["rest"])
        return rest_sum.numpy()

    def rhs_numpy(workers: int) -> np.ndarray:
        turned = 0.5 * np.einsum("teab,eb->tea", fitted[:, i] + fitted[:, j], y[i] - y[j])
        return np.stack([add_rows(i, r, count) for r in turned - (x_numpy[:, i] - x_numpy[:, j])])

    def rest_numpy(workers: int) -> np.ndarray:
        turned = 0.5 * np.einsum("teba,teb->ea", fitted[:, i] + fitted[:, j], x_numpy[:, i] - x_numpy[:, j])
        return add_rows(i, turned / frames, count)

    rotations_peer = Peer("numpy svd", lambda workers: rotations_numpy(x_numpy, y, i, j))
    edge = half_edges * INDEX
    return [
        # A vertex whose edges lie on a line may turn about it as it likes: its rotation is not compared but by norm.
        Case(
            "rotations", "vertices", total, total * (VECTOR + MATRIX) + edge, tasks["rotations"],
            answer=rotations, peers=[rotations_peer], tolerance=1e-2,
        ),
        Case(
            "rigid right-hand side", "vertices", total, total * (3 * VECTOR + MATRIX) + edge, tasks["rhs"],
            answer=turned_rhs, peers=[Peer("numpy", rhs_numpy)],
        ),
        Case(
            "rest right-hand side", "vertices", total, total * (VECTOR + MATRIX) + edge, tasks["rest"],
            answer=rest_rhs_found, peers=[Peer("numpy", rest_numpy)],
        ),
        _block_cg(bed, turned_rhs().copy(), c.damping),
    ]  # fmt: skip


def _block_cg(bed: Bed, given: np.ndarray, damping: float) -> Case:
    """Every vertex held across its normal only, as one residual each would."""
    p, c = bed.problem, bed.problem.config.refine
    frames, count = p.frame_count, p.vertex_count
    normal = np.stack([vertex_normals_numpy(x[None], p.faces)[0] for x in bed.objective.vertices.numpy()])
    blocks = np.einsum("tva,tvb->tvab", normal, normal).astype(np.float32)
    matrix = wp.array(blocks, dtype=wp.mat33, ndim=2, device=bed.device)
    rhs = wp.array(given.astype(np.float32), dtype=wp.vec3, ndim=2, device=bed.device)
    moves = wp.zeros_like(rhs)
    solver = BlockSolver(p.mesh, frames, c.tolerance, c.iterations_max, bed.device)
    tasks = bed.frame_tasks(lambda a, b: solver.solve(a, b, _RIGIDITY, damping, matrix, rhs, moves))

    def solution() -> np.ndarray:
        run_tasks(tasks)
        return moves.numpy()

    peer = Peer(
        "scipy cg, block Jacobi",
        lambda workers: block_cg_scipy(blocks, p.mesh, _RIGIDITY, damping, given, c.tolerance),
    )
    size = frames * count * (MATRIX + 2 * VECTOR)
    # Both stop at the same residual; the solutions differ by at most the condition number times that.
    return Case(
        "block CG", "vertices", frames * count, size, tasks, answer=solution, peers=[peer], tolerance=20 * c.tolerance
    )


def round_rows(bed: Bed, teams: Mapping[int, Team]) -> Iterator[dict]:
    """Whole rounds of the vertex stage, from the bed's vertices: one row a thread count."""
    o, p = bed.objective, bed.problem
    start, normals = o.vertices.numpy().copy(), p.normals.numpy().copy()
    for threads, team in teams.items():
        o.vertices.assign(start)
        p.normals.assign(normals)
        stage = Refinement(o, team)
        stage.prepare()
        stage.start()
        stage.run_round()  # modules load, a graph is captured
        clock = DeviceTimer(bed.device)
        timing = Timing.of([clock.seconds(stage.run_round) for _ in range(max(stage.config.iterations - 1, 1))])
        elements = p.frame_count * p.vertex_count
        yield {
            "name": ROUND,
            "size": bed.size.name,
            "threads": threads,
            "unit": "vertices",
            "elements": elements,
            "melements_per_s": 1e-6 * elements / timing.median,
            **timing.to_json(),
            "peers": [],
            "error": None,
        }
    o.vertices.assign(start)
    p.normals.assign(normals)
