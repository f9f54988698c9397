"""What conjugate gradients on a graph and on 3x3 blocks have in common."""

import functools
from typing import Any

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS

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


@wp.func
def worth_going_on(worst: float, known: float, tolerance: float) -> bool:
    """Whether to restart from a recomputed residual: it asks for more, and the last restart has halved it.

    Squares of relative residuals; ``known`` is the one before, infinite at first. What a restart does not halve is the
    rounding of the solution itself.
    """
    return worst > tolerance * tolerance and worst < 0.25 * known


def check_limits(tolerance: float, iterations_max: int) -> None:
    """Refuse what no solve can keep.

    Raises:
        ValueError: a tolerance that is not above 0 and below 1; less than one iteration.
    """
    if not 0.0 < tolerance < 1.0:
        raise ValueError(f"tolerance: expected a number above 0 and below 1, got {tolerance}")
    if iterations_max < 1:
        raise ValueError(f"iterations_max: expected at least 1, got {iterations_max}")


@functools.cache
def functions_for(dtype: Any) -> tuple[wp.Function, wp.Function, wp.Function]:
    """``apply_row``, ``ratios`` and ``asked`` for one component count."""

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

    return apply_row, ratios, asked
