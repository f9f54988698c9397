"""Conjugate gradients for (A + beta I + alpha L) d = b with a 3x3 block A_i at every vertex of every frame.

The blocks come from point-to-plane residuals, L = D - A_mesh from rigidity, edges as stiff as the ``material`` says.
Preconditioned by the inverse of each diagonal block A_i + (beta + alpha degree) I. Frames are independent systems over
the same mesh, each a block or cluster (``clusters``) that stops as soon as it is done, or on the CPU a thread
(``block_serial``); residuals are told and restarted from as in ``cg``. The operator is symmetric.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.block_serial import solve_frames_serially
from warpdef.kernels.blocks import block_options
from warpdef.kernels.cg_functions import check_limits, ratio, worth_going_on
from warpdef.kernels.clusters import CLUSTER, PARTIAL, cluster_lane, cluster_lanes, cluster_sum, cluster_wait
from warpdef.kernels.graphs import Graph
from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.material import edge_stiffness, stiffness_around
from warpdef.kernels.sizes import sizes
from warpdef.kernels.ways import Way, cluster_of, lanes_of, way_of

wp.set_module_options(MODULE_OPTIONS)

BLOCK_LANES = 256
"""Of a block of the cluster that a frame has."""


@wp.func
def diagonal_block(matrix: wp.mat33, degree: float, alpha: float, beta: float) -> wp.mat33:
    return matrix + (beta + alpha * degree) * wp.identity(n=3, dtype=wp.float32)


@wp.func
def apply_block_row(
    t: int,
    i: int,
    alpha: float,
    beta: float,
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    stiffness: wp.array[wp.float32],
    matrix: wp.array2d[wp.mat33],
    x: wp.array2d[wp.vec3],
) -> wp.vec3:
    """Row i of frame t."""
    own = x[t, i]
    total = matrix[t, i] * own + beta * own
    for k in range(row[i], row[i + 1]):
        j = column[k]
        total += (alpha * edge_stiffness(stiffness, i, j)) * (own - x[t, j])
    return total


@sizes(
    "threads iterations_out residual_out: T; row: V+1; column: E; stiffness: V?; "
    f"matrix rhs inverse r p ap solution_out: T V; partial: {PARTIAL}*T"
)
@wp.kernel(**block_options(BLOCK_LANES, CLUSTER))
def _solve_frames(
    # In:
    begin: int,
    alpha: float,
    beta: float,
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    stiffness: wp.array[wp.float32],
    matrix: wp.array2d[wp.mat33],
    rhs: wp.array2d[wp.vec3],
    tolerance: float,
    iterations_max: int,
    # In and out: scratch, and what blocks of a cluster leave for one another
    inverse: wp.array2d[wp.mat33],
    r: wp.array2d[wp.vec3],
    p: wp.array2d[wp.vec3],
    ap: wp.array2d[wp.vec3],
    partial: wp.array[wp.vec3],
    # Out:
    solution_out: wp.array2d[wp.vec3],
    iterations_out: wp.array[wp.int32],
    residual_out: wp.array[wp.float32],
):
    """One block or cluster a frame, from zero."""
    t = begin + wp.tid() // cluster_lanes()
    count = rhs.shape[1]
    b_sq = float(0.0)
    rz = float(0.0)
    for i in range(cluster_lane(), count, cluster_lanes()):
        b = rhs[t, i]
        degree = stiffness_around(stiffness, i, row, column)
        inverse[t, i] = wp.inverse(diagonal_block(matrix[t, i], degree, alpha, beta))
        z = inverse[t, i] * b
        solution_out[t, i] = wp.vec3(0.0, 0.0, 0.0)
        r[t, i] = b
        p[t, i] = z
        b_sq += wp.length_sq(b)
        rz += wp.dot(b, z)
    sums = cluster_sum(wp.vec3(b_sq, rz, 0.0), t, 2, partial)
    b_sq = sums[0]
    rz = sums[1]
    r_sq = b_sq
    done = int(0)
    known = float(wp.inf)
    going = int(1)
    while going != 0:
        begun = done
        while done < iterations_max and r_sq > tolerance * tolerance * b_sq:
            p_ap = float(0.0)
            for i in range(cluster_lane(), count, cluster_lanes()):
                v = apply_block_row(t, i, alpha, beta, row, column, stiffness, matrix, p)
                ap[t, i] = v
                p_ap += wp.dot(p[t, i], v)
            sums = cluster_sum(wp.vec3(p_ap, 0.0, 0.0), t, 0, partial)
            step = ratio(rz, sums[0])
            r_sq = float(0.0)
            next_rz = float(0.0)
            for i in range(cluster_lane(), count, cluster_lanes()):
                solution_out[t, i] = solution_out[t, i] + step * p[t, i]
                v = r[t, i] - step * ap[t, i]
                r[t, i] = v
                r_sq += wp.length_sq(v)
                next_rz += wp.dot(v, inverse[t, i] * v)
            sums = cluster_sum(wp.vec3(r_sq, next_rz, 0.0), t, 1, partial)
            r_sq = sums[0]
            turn = ratio(sums[1], rz)
            rz = sums[1]
            for i in range(cluster_lane(), count, cluster_lanes()):
                p[t, i] = inverse[t, i] * r[t, i] + turn * p[t, i]
            cluster_wait()
            done = done + 1
        going = 0
        if done > begun:
            r_sq = float(0.0)
            rz = float(0.0)
            for i in range(cluster_lane(), count, cluster_lanes()):
                v = rhs[t, i] - apply_block_row(t, i, alpha, beta, row, column, stiffness, matrix, solution_out)
                z = inverse[t, i] * v
                r[t, i] = v
                p[t, i] = z
                r_sq += wp.length_sq(v)
                rz += wp.dot(v, z)
            sums = cluster_sum(wp.vec3(r_sq, rz, 0.0), t, 2, partial)
            r_sq = sums[0]
            rz = sums[1]
            worst = ratio(r_sq, b_sq)
            if done < iterations_max and worth_going_on(worst, known, tolerance):
                going = 1
            known = worst
    if cluster_lane() == 0:
        iterations_out[t] = done
        residual_out[t] = wp.sqrt(ratio(r_sq, b_sq))


class BlockSolver:
    """Solves for the moves d of all vertices, frame by frame.

    Args:
        graph: the mesh. frame_count: T. tolerance: residual, relative to the right-hand side, to stop at, above 0 and
            below 1. iterations_max: steps after which a frame gives up and says so in ``iterations`` and ``residual``,
            shape (T,), the true one.

    Raises:
        ValueError: limits that no solve can keep.
    """

    def __init__(
        self,
        graph: Graph,
        frame_count: int,
        tolerance: float,
        iterations_max: int,
        device: wp.Device,
    ) -> None:
        check_limits(tolerance, iterations_max)
        shape = (frame_count, len(graph.node))
        self._device = device
        self._limits = (float(tolerance), int(iterations_max))
        self._row = wp.array(graph.row, dtype=wp.int32, device=device)
        self._column = wp.array(graph.column, dtype=wp.int32, device=device)
        self._way = way_of(device)
        self._work: list[wp.array] = []
        if self._way is Way.WHOLE:
            self._work = [wp.zeros(shape, dtype=d, device=device) for d in (wp.mat33, wp.vec3, wp.vec3, wp.vec3)]
            self._work.append(wp.zeros(frame_count * PARTIAL, dtype=wp.vec3, device=device))
        self.iterations = wp.zeros(frame_count, dtype=wp.int32, device=device)
        self.residual = wp.zeros(frame_count, dtype=wp.float32, device=device)
        self._team = lanes_of(device, BLOCK_LANES), cluster_of(device, CLUSTER)

    def solve(
        self, first: int, last: int, alpha: float, beta: float, matrix: wp.array, rhs: wp.array,
        solution_out: wp.array, stiffness: wp.array | None = None,
    ) -> None:  # fmt: skip
        """Solve frames ``first .. last`` (last excluded).

        Args:
            alpha: weight of L. beta: weight of I, above 0. matrix: shape (T, V) mat33, symmetric, semidefinite.
            rhs, solution_out: shape (T, V) vec3.
            stiffness: shape (V,) float32, above 0; an edge of L weighs the mean of its ends. None: 1 everywhere.
        """
        system = [alpha, beta, self._row, self._column, stiffness, matrix, rhs, *self._limits]
        results = [solution_out, self.iterations, self.residual]
        if self._way is Way.SPANS:
            launch(solve_frames_serially, last - first, [first, *system, *results], self._device)
            return
        launch(_solve_frames, last - first, [first, *system, *self._work, *results], self._device, *self._team)
