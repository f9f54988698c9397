"""The kernels of conjugate gradients on a graph, for one component count at a time.

``cg.py`` says what they compute. No postponed annotations here: the kernels' types are variables of the factory.
"""

from typing import Any

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS
from warpdef.kernels.sizes import sizes

wp.set_module_options(MODULE_OPTIONS)


@wp.func
def ratio(a: float, b: float) -> float:
    """a / b, and 0 where b is 0: a component that is solved exactly stands still. NaN stays NaN."""
    q = float(0.0)
    if b != 0.0:
        q = a / b
    return q


@wp.func
def worst_residual_sq(r_sq: Any, b_sq: Any) -> float:
    """Largest |r|^2 / |b|^2 of the components; a zero right-hand side asks for a zero residual. NaN wins."""
    worst = float(0.0)
    for c in range(len(r_sq)):
        share = float(0.0)
        if r_sq[c] != 0.0:
            share = 1.0
            if b_sq[c] != 0.0:
                share = r_sq[c] / b_sq[c]
        if worst == worst and not (share <= worst):
            worst = share
    return worst


def kernels_for(dtype: Any) -> dict[str, wp.Kernel]:
    """The kernels for one component count."""

    @wp.func
    def apply_row(
        i: int,
        weight: float,
        row: wp.array[wp.int32],
        column: wp.array[wp.int32],
        x: wp.array[dtype],
    ) -> dtype:
        """Row i of (I + lambda (D - A)) x."""
        begin = row[i]
        end = row[i + 1]
        total = (1.0 + weight * float(end - begin)) * x[i]
        for k in range(begin, end):
            total -= weight * x[column[k]]
        return total

    @wp.func
    def ratios(a: dtype, b: dtype) -> dtype:
        q = dtype()
        for c in range(len(a)):
            q[c] = ratio(a[c], b[c])
        return q

    @wp.func
    def asked(b_sq: dtype) -> dtype:
        """1 for components with a right-hand side, 0 for the others, whose solution is 0 whatever the start was."""
        one = dtype()
        for c in range(len(b_sq)):
            if b_sq[c] > 0.0:
                one[c] = 1.0
        return one

    @sizes(
        "threads weight iterations_out residual_out: S; node x r p ap: N; first: S+1; row: N+1; column: E; rhs "
        "solution_out: F"
    )
    @wp.kernel(module="unique")
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
        # In and out: scratch, compact
        r: wp.array[dtype],
        p: wp.array[dtype],
        ap: wp.array[dtype],
        # Out:
        solution_out: wp.array[dtype],
        iterations_out: wp.array[wp.int32],
        residual_out: wp.array[wp.float32],
    ):
        """CPU: one thread a system."""
        s = begin + wp.tid()
        lowest = first[s]
        end = first[s + 1]
        w = weight[s]
        r_sq = dtype()
        b_sq = dtype()
        for i in range(lowest, end):
            b = rhs[node[i]]
            residual = b - apply_row(i, w, row, column, x)
            r[i] = residual
            p[i] = residual
            r_sq += wp.cw_mul(residual, residual)
            b_sq += wp.cw_mul(b, b)
        keep = asked(b_sq)
        if worst_residual_sq(r_sq - wp.cw_mul(keep, r_sq), b_sq) > 0.0:
            r_sq = wp.cw_mul(keep, r_sq)
            for i in range(lowest, end):
                x[i] = wp.cw_mul(keep, x[i])
                r[i] = wp.cw_mul(keep, r[i])
                p[i] = r[i]
        done = int(0)
        while done < iterations_max and worst_residual_sq(r_sq, b_sq) > tolerance * tolerance:
            p_ap = dtype()
            for i in range(lowest, end):
                v = apply_row(i, w, row, column, p)
                ap[i] = v
                p_ap += wp.cw_mul(p[i], v)
            alpha = ratios(r_sq, p_ap)
            next_sq = dtype()
            for i in range(lowest, end):
                x[i] = x[i] + wp.cw_mul(alpha, p[i])
                v = r[i] - wp.cw_mul(alpha, ap[i])
                r[i] = v
                next_sq += wp.cw_mul(v, v)
            beta = ratios(next_sq, r_sq)
            for i in range(lowest, end):
                p[i] = r[i] + wp.cw_mul(beta, p[i])
            r_sq = next_sq
            done = done + 1
        for i in range(lowest, end):
            solution_out[node[i]] = x[i]
        iterations_out[s] = done
        residual_out[s] = wp.sqrt(worst_residual_sq(r_sq, b_sq))

    @sizes("threads node system x r_out p_out: N; row: N+1; column: E; weight b_sq_out: S; rhs: F; r_sq_out: I S")
    @wp.kernel(module="unique")
    def start(
        # In:
        node: wp.array[wp.int32],
        system: wp.array[wp.int32],
        row: wp.array[wp.int32],
        column: wp.array[wp.int32],
        weight: wp.array[wp.float32],
        rhs: wp.array[dtype],
        x: wp.array[dtype],
        # Out:
        r_out: wp.array[dtype],
        p_out: wp.array[dtype],
        # Out, added to:
        b_sq_out: wp.array[dtype],
        r_sq_out: wp.array2d[dtype],
    ):
        """One thread a node."""
        i = wp.tid()
        s = system[i]
        b = rhs[node[i]]
        residual = b - apply_row(i, weight[s], row, column, x)
        r_out[i] = residual
        p_out[i] = residual
        wp.atomic_add(b_sq_out, s, wp.cw_mul(b, b))
        wp.atomic_add(r_sq_out, 0, s, wp.cw_mul(residual, residual))

    @sizes("threads system x r p: N; first: S+1; b_sq: S; r_sq: I S")
    @wp.kernel(module="unique")
    def settle(
        # In:
        system: wp.array[wp.int32],
        first: wp.array[wp.int32],
        b_sq: wp.array[dtype],
        # In and out:
        x: wp.array[dtype],
        r: wp.array[dtype],
        p: wp.array[dtype],
        r_sq: wp.array2d[dtype],
    ):
        """One thread a node: components that nothing is asked of are 0 and done."""
        i = wp.tid()
        s = system[i]
        keep = asked(b_sq[s])
        x[i] = wp.cw_mul(keep, x[i])
        r[i] = wp.cw_mul(keep, r[i])
        p[i] = wp.cw_mul(keep, p[i])
        if i == first[s]:
            r_sq[0, s] = wp.cw_mul(keep, r_sq[0, s])

    @sizes("threads system p ap_out: N; step: <I; row: N+1; column: E; weight b_sq: S; r_sq p_ap_out: I S")
    @wp.kernel(module="unique")
    def multiply(
        # In:
        step: int,
        tolerance: float,
        system: wp.array[wp.int32],
        row: wp.array[wp.int32],
        column: wp.array[wp.int32],
        weight: wp.array[wp.float32],
        b_sq: wp.array[dtype],
        r_sq: wp.array2d[dtype],
        p: wp.array[dtype],
        # Out:
        ap_out: wp.array[dtype],
        # Out, added to:
        p_ap_out: wp.array2d[dtype],
    ):
        """One thread a node: A p and its part of p . A p."""
        i = wp.tid()
        s = system[i]
        if worst_residual_sq(r_sq[step, s], b_sq[s]) > tolerance * tolerance:
            v = apply_row(i, weight[s], row, column, p)
            ap_out[i] = v
            wp.atomic_add(p_ap_out, step, s, wp.cw_mul(p[i], v))

    @sizes("threads system p ap x r: N; step: <I; first: S+1; b_sq: S; p_ap r_sq: I S")
    @wp.kernel(module="unique")
    def update(
        # In:
        step: int,
        tolerance: float,
        system: wp.array[wp.int32],
        first: wp.array[wp.int32],
        b_sq: wp.array[dtype],
        p_ap: wp.array2d[dtype],
        p: wp.array[dtype],
        ap: wp.array[dtype],
        # In and out:
        x: wp.array[dtype],
        r: wp.array[dtype],
        r_sq: wp.array2d[dtype],
    ):
        """One thread a node: step along p, new residual and its part of the norm."""
        i = wp.tid()
        s = system[i]
        if worst_residual_sq(r_sq[step, s], b_sq[s]) > tolerance * tolerance:
            alpha = ratios(r_sq[step, s], p_ap[step, s])
            x[i] = x[i] + wp.cw_mul(alpha, p[i])
            residual = r[i] - wp.cw_mul(alpha, ap[i])
            r[i] = residual
            wp.atomic_add(r_sq, step + 1, s, wp.cw_mul(residual, residual))
        elif i == first[s]:
            # Copied, not added up anew: another order of the sum must not wake a system that is done.
            r_sq[step + 1, s] = r_sq[step, s]

    @sizes("threads system r p: N; step: <I; b_sq: S; r_sq: I S")
    @wp.kernel(module="unique")
    def turn(
        # In:
        step: int,
        tolerance: float,
        system: wp.array[wp.int32],
        b_sq: wp.array[dtype],
        r_sq: wp.array2d[dtype],
        r: wp.array[dtype],
        # In and out:
        p: wp.array[dtype],
    ):
        """One thread a node: the next direction."""
        i = wp.tid()
        s = system[i]
        if worst_residual_sq(r_sq[step, s], b_sq[s]) > tolerance * tolerance:
            p[i] = r[i] + wp.cw_mul(ratios(r_sq[step + 1, s], r_sq[step, s]), p[i])

    @sizes("threads node x: N; solution_out: F")
    @wp.kernel(module="unique")
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

    @sizes("threads b_sq iterations_out residual_out: S; steps: <I; r_sq: I S")
    @wp.kernel(module="unique")
    def report(
        # In:
        steps: int,
        tolerance: float,
        b_sq: wp.array[dtype],
        r_sq: wp.array2d[dtype],
        # Out:
        iterations_out: wp.array[wp.int32],
        residual_out: wp.array[wp.float32],
    ):
        """One thread a system."""
        s = wp.tid()
        done = int(0)
        while done < steps and worst_residual_sq(r_sq[done, s], b_sq[s]) > tolerance * tolerance:
            done = done + 1
        iterations_out[s] = done
        residual_out[s] = wp.sqrt(worst_residual_sq(r_sq[steps, s], b_sq[s]))

    @sizes("threads array_out: N")
    @wp.kernel(module="unique")
    def clear(
        # Out:
        array_out: wp.array[dtype],
    ):
        array_out[wp.tid()] = dtype()

    @sizes("threads node compact_out: N; full: F")
    @wp.kernel(module="unique")
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
    @wp.kernel(module="unique")
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

    kernels = (solve_systems, start, settle, multiply, update, turn, finish, report, clear, gather, multiply_add)
    for kernel in kernels:
        kernel.module.options.update(MODULE_OPTIONS)
    return {kernel.func.__name__: kernel for kernel in kernels}
