"""Conjugate gradients on a graph step by step, one launch a phase over all systems: the way of CUDA.

``cg.py`` says what they compute. No postponed annotations here: the kernels' types are variables of the factory.
"""

from typing import Any

import warp as wp

from warpdef.kernels.cg_functions import functions_for, worst_residual_sq
from warpdef.kernels.launching import MODULE_OPTIONS
from warpdef.kernels.sizes import sizes


def steps_for(dtype: Any) -> dict[str, wp.Kernel]:
    """The kernels for one component count."""
    apply_row, ratios, asked = functions_for(dtype)

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

    @sizes("threads node system x r p: N; step: <I; first: S+1; row: N+1; column: E; weight b_sq: S; rhs: F; r_sq: I S")
    @wp.kernel(module="unique")
    def look(
        # In:
        step: int,
        last: int,
        tolerance: float,
        node: wp.array[wp.int32],
        system: wp.array[wp.int32],
        first: wp.array[wp.int32],
        row: wp.array[wp.int32],
        column: wp.array[wp.int32],
        weight: wp.array[wp.float32],
        rhs: wp.array[dtype],
        b_sq: wp.array[dtype],
        x: wp.array[dtype],
        # In and out:
        r: wp.array[dtype],
        p: wp.array[dtype],
        r_sq: wp.array2d[dtype],
    ):
        """One thread a node: true residuals of systems that are done, where they start anew; the last time of all."""
        i = wp.tid()
        s = system[i]
        if last != 0 or worst_residual_sq(r_sq[step - 1, s], b_sq[s]) <= tolerance * tolerance:
            residual = rhs[node[i]] - apply_row(i, weight[s], row, column, x)
            r[i] = residual
            p[i] = residual
            wp.atomic_add(r_sq, step, s, wp.cw_mul(residual, residual))
        elif i == first[s]:
            r_sq[step, s] = r_sq[step - 1, s]

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

    @sizes("threads b_sq iterations_out residual_out: S; looks: C; r_sq: I S")
    @wp.kernel(module="unique")
    def report(
        # In:
        tolerance: float,
        looks: wp.array[wp.int32],
        b_sq: wp.array[dtype],
        r_sq: wp.array2d[dtype],
        # Out:
        iterations_out: wp.array[wp.int32],
        residual_out: wp.array[wp.float32],
    ):
        """One thread a system; rows ``looks`` of ``r_sq`` hold true residuals, those behind each its recursion's."""
        s = wp.tid()
        done = int(0)
        last = looks.shape[0] - 1
        for c in range(last):
            step = looks[c]
            while step < looks[c + 1] - 1 and worst_residual_sq(r_sq[step, s], b_sq[s]) > tolerance * tolerance:
                step = step + 1
                done = done + 1
        iterations_out[s] = done
        residual_out[s] = wp.sqrt(worst_residual_sq(r_sq[looks[last], s], b_sq[s]))

    @sizes("threads array_out: N")
    @wp.kernel(module="unique")
    def clear(
        # Out:
        array_out: wp.array[dtype],
    ):
        array_out[wp.tid()] = dtype()

    kernels = (start, settle, look, multiply, update, turn, report, clear)
    for kernel in kernels:
        kernel.module.options.update(MODULE_OPTIONS)
    return {kernel.func.__name__: kernel for kernel in kernels}
