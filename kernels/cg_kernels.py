"""Conjugate gradients on a graph, a system in one block, and what goes with a solve; for one component count.

``cg.py`` says what they compute. No postponed annotations here: the kernels' types are variables of the factory.
"""

from typing import Any

import warp as wp

from warpdef.kernels.blocks import block_options
from warpdef.kernels.cg_functions import functions_for, worst_residual_sq, worth_going_on
from warpdef.kernels.clusters import CLUSTER, PARTIAL, cluster_lane, cluster_lanes, cluster_sum, cluster_wait
from warpdef.kernels.launching import MODULE_OPTIONS
from warpdef.kernels.sizes import sizes


def team_for(dtype: Any) -> tuple[int, int]:
    """Lanes of a block and blocks of a cluster that solve one system.

    A mesh is one large system of short vectors; grids are many small ones of long vectors, which need more registers.
    """
    return (256, CLUSTER) if dtype is wp.vec3 else (512, 1)


def kernels_for(dtype: Any) -> dict[str, wp.Kernel]:
    """The kernels for one component count."""
    apply_row, ratios, asked = functions_for(dtype)

    @sizes(
        "threads weight iterations_out residual_out: S; node x r p ap: N; first: S+1; row: N+1; column: E; rhs "
        f"solution_out: F; partial: {PARTIAL}*S"
    )
    @wp.kernel(**block_options(*team_for(dtype)))
    def solve_systems(
        # In:
        begin: int,
        node: wp.array[wp.int32],
        first: wp.array[wp.int32],
        row: wp.array[wp.int32],
        column: wp.array[wp.int32],
        weight: wp.array[wp.float32],
        tolerance: float,
        iterations_max: int,
        rhs: wp.array[dtype],
        # In and out: the last solution, then this one, compact
        x: wp.array[dtype],
        # In and out: scratch, compact, and what blocks of a cluster leave for one another
        r: wp.array[dtype],
        p: wp.array[dtype],
        ap: wp.array[dtype],
        partial: wp.array[dtype],
        # Out:
        solution_out: wp.array[dtype],
        iterations_out: wp.array[wp.int32],
        residual_out: wp.array[wp.float32],
    ):
        """One block or cluster a system."""
        s = begin + wp.tid() // cluster_lanes()
        lowest = first[s]
        end = first[s + 1]
        w = weight[s]
        r_sq = dtype()
        b_sq = dtype()
        for i in range(lowest + cluster_lane(), end, cluster_lanes()):
            b = rhs[node[i]]
            residual = b - apply_row(i, w, row, column, x)
            r[i] = residual
            p[i] = residual
            r_sq += wp.cw_mul(residual, residual)
            b_sq += wp.cw_mul(b, b)
        r_sq = cluster_sum(r_sq, s, 2, partial)
        b_sq = cluster_sum(b_sq, s, 1, partial)
        keep = asked(b_sq)
        if worst_residual_sq(r_sq - wp.cw_mul(keep, r_sq), b_sq) > 0.0:
            r_sq = wp.cw_mul(keep, r_sq)
            for i in range(lowest + cluster_lane(), end, cluster_lanes()):
                x[i] = wp.cw_mul(keep, x[i])
                r[i] = wp.cw_mul(keep, r[i])
                p[i] = r[i]
            cluster_wait()
        done = int(0)
        known = float(wp.inf)
        going = int(1)
        while going != 0:
            begun = done
            while done < iterations_max and worst_residual_sq(r_sq, b_sq) > tolerance * tolerance:
                p_ap = dtype()
                for i in range(lowest + cluster_lane(), end, cluster_lanes()):
                    v = apply_row(i, w, row, column, p)
                    ap[i] = v
                    p_ap += wp.cw_mul(p[i], v)
                alpha = ratios(r_sq, cluster_sum(p_ap, s, 0, partial))
                next_sq = dtype()
                for i in range(lowest + cluster_lane(), end, cluster_lanes()):
                    x[i] = x[i] + wp.cw_mul(alpha, p[i])
                    v = r[i] - wp.cw_mul(alpha, ap[i])
                    r[i] = v
                    next_sq += wp.cw_mul(v, v)
                next_sq = cluster_sum(next_sq, s, 1, partial)
                beta = ratios(next_sq, r_sq)
                for i in range(lowest + cluster_lane(), end, cluster_lanes()):
                    p[i] = r[i] + wp.cw_mul(beta, p[i])
                cluster_wait()
                r_sq = next_sq
                done = done + 1
            going = 0
            if done > begun:
                r_sq = dtype()
                for i in range(lowest + cluster_lane(), end, cluster_lanes()):
                    residual = rhs[node[i]] - apply_row(i, w, row, column, x)
                    r[i] = residual
                    p[i] = residual
                    r_sq += wp.cw_mul(residual, residual)
                r_sq = cluster_sum(r_sq, s, 2, partial)
                worst = worst_residual_sq(r_sq, b_sq)
                if done < iterations_max and worth_going_on(worst, known, tolerance):
                    going = 1
                known = worst
        for i in range(lowest + cluster_lane(), end, cluster_lanes()):
            solution_out[node[i]] = x[i]
        if cluster_lane() == 0:
            iterations_out[s] = done
            residual_out[s] = wp.sqrt(worst_residual_sq(r_sq, b_sq))

    @sizes("threads node x: N; solution_out: F")
    @wp.kernel(module="unique", module_options=MODULE_OPTIONS)
    def finish(
        # In:
        node: wp.array[wp.int32],
        x: wp.array[dtype],
        # Out:
        solution_out: wp.array[dtype],
    ):
        """One thread a node."""
        i = wp.tid()
        solution_out[node[i]] = x[i]

    @sizes("threads node compact_out: N; full: F")
    @wp.kernel(module="unique", module_options=MODULE_OPTIONS)
    def gather(
        # In:
        node: wp.array[wp.int32],
        full: wp.array[dtype],
        # Out:
        compact_out: wp.array[dtype],
    ):
        i = wp.tid()
        compact_out[i] = full[node[i]]

    @sizes("threads system x y z_out: N; row: N+1; column: E; weight: S")
    @wp.kernel(module="unique", module_options=MODULE_OPTIONS)
    def multiply_add(
        # In:
        system: wp.array[wp.int32],
        row: wp.array[wp.int32],
        column: wp.array[wp.int32],
        weight: wp.array[wp.float32],
        x: wp.array[dtype],
        y: wp.array[dtype],
        alpha: float,
        beta: float,
        # Out:
        z_out: wp.array[dtype],
    ):
        """One thread a node: z = alpha (I + lambda L) x + beta y."""
        i = wp.tid()
        z = alpha * apply_row(i, weight[system[i]], row, column, x)
        if beta != 0.0:
            z += beta * y[i]
        z_out[i] = z

    return {kernel.func.__name__: kernel for kernel in (solve_systems, finish, gather, multiply_add)}
