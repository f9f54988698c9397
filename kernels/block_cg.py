"""Conjugate gradients for (A + beta I + alpha L) d = b with a 3x3 block A_i at every vertex of every frame.

The blocks come from point-to-plane residuals, L = D - A_mesh from rigidity. Preconditioned by the inverse of each
diagonal block A_i + (beta + alpha degree) I. Frames are independent systems over the same mesh. The CPU runs a frame
in one thread and stops early; CUDA runs the same recurrence over all frames, one launch a phase, a fixed number of
steps, a converged frame standing still. Residuals are told and restarted from as in ``cg``. The operator is symmetric.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from warpdef.kernels.cg_functions import check_limits, iterations_between_looks, ratio, worth_going_on
from warpdef.kernels.graphs import Graph
from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.sizes import sizes
from warpdef.kernels.ways import Way, way_of

wp.set_module_options(MODULE_OPTIONS)


@wp.func
def diagonal_block(matrix: wp.mat33, degree: int, alpha: float, beta: float) -> wp.mat33:
    return matrix + (beta + alpha * float(degree)) * wp.identity(n=3, dtype=wp.float32)


@wp.func
def apply_block_row(
    t: int,
    i: int,
    alpha: float,
    beta: float,
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    matrix: wp.array2d[wp.mat33],
    x: wp.array2d[wp.vec3],
) -> wp.vec3:
    """Row i of frame t."""
    begin = row[i]
    end = row[i + 1]
    total = diagonal_block(matrix[t, i], end - begin, alpha, beta) * x[t, i]
    for k in range(begin, end):
        total -= alpha * x[t, column[k]]
    return total


@sizes("threads iterations_out residual_out: T; row: V+1; column: E; matrix rhs inverse r p ap solution_out: T V")
@wp.kernel
def _solve_frames(
    # In:
    begin: int,
    alpha: float,
    beta: float,
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    matrix: wp.array2d[wp.mat33],
    rhs: wp.array2d[wp.vec3],
    tolerance: float,
    iterations_max: int,
    # In and out: scratch
    inverse: wp.array2d[wp.mat33],
    r: wp.array2d[wp.vec3],
    p: wp.array2d[wp.vec3],
    ap: wp.array2d[wp.vec3],
    # Out:
    solution_out: wp.array2d[wp.vec3],
    iterations_out: wp.array[wp.int32],
    residual_out: wp.array[wp.float32],
):
    """CPU: one thread a frame, from zero."""
    t = begin + wp.tid()
    count = rhs.shape[1]
    b_sq = float(0.0)
    rz = float(0.0)
    for i in range(count):
        b = rhs[t, i]
        inverse[t, i] = wp.inverse(diagonal_block(matrix[t, i], row[i + 1] - row[i], alpha, beta))
        z = inverse[t, i] * b
        solution_out[t, i] = wp.vec3(0.0, 0.0, 0.0)
        r[t, i] = b
        p[t, i] = z
        b_sq += wp.length_sq(b)
        rz += wp.dot(b, z)
    r_sq = b_sq
    done = int(0)
    known = float(wp.inf)
    going = int(1)
    while going != 0:
        begun = done
        while done < iterations_max and r_sq > tolerance * tolerance * b_sq:
            p_ap = float(0.0)
            for i in range(count):
                v = apply_block_row(t, i, alpha, beta, row, column, matrix, p)
                ap[t, i] = v
                p_ap += wp.dot(p[t, i], v)
            step = ratio(rz, p_ap)
            r_sq = float(0.0)
            next_rz = float(0.0)
            for i in range(count):
                solution_out[t, i] = solution_out[t, i] + step * p[t, i]
                v = r[t, i] - step * ap[t, i]
                r[t, i] = v
                r_sq += wp.length_sq(v)
                next_rz += wp.dot(v, inverse[t, i] * v)
            turn = ratio(next_rz, rz)
            for i in range(count):
                p[t, i] = inverse[t, i] * r[t, i] + turn * p[t, i]
            rz = next_rz
            done = done + 1
        going = 0
        if done > begun:
            r_sq = float(0.0)
            rz = float(0.0)
            for i in range(count):
                v = rhs[t, i] - apply_block_row(t, i, alpha, beta, row, column, matrix, solution_out)
                z = inverse[t, i] * v
                r[t, i] = v
                p[t, i] = z
                r_sq += wp.length_sq(v)
                rz += wp.dot(v, z)
            worst = ratio(r_sq, b_sq)
            if done < iterations_max and worth_going_on(worst, known, tolerance):
                going = 1
            known = worst
    iterations_out[t] = done
    residual_out[t] = wp.sqrt(ratio(r_sq, b_sq))


# The same in steps, for CUDA. sums[step, t] = (r . z, p . A p, |r|^2); sums[0, t] holds |b|^2 in its third. A row for
# every step, and one for each look at the true residual.


@wp.func
def running(step: int, t: int, tolerance: float, sums: wp.array2d[wp.vec3]) -> bool:
    return sums[step, t][2] > tolerance * tolerance * sums[0, t][2]


@sizes("threads matrix rhs inverse_out r_out p_out solution_out: T V; row: V+1; sums_out: I T")
@wp.kernel
def _start(
    # In:
    alpha: float,
    beta: float,
    row: wp.array[wp.int32],
    matrix: wp.array2d[wp.mat33],
    rhs: wp.array2d[wp.vec3],
    # Out:
    inverse_out: wp.array2d[wp.mat33],
    r_out: wp.array2d[wp.vec3],
    p_out: wp.array2d[wp.vec3],
    solution_out: wp.array2d[wp.vec3],
    # Out, added to:
    sums_out: wp.array2d[wp.vec3],
):
    """One thread a vertex of a frame."""
    t, i = wp.tid()
    b = rhs[t, i]
    inverse = wp.inverse(diagonal_block(matrix[t, i], row[i + 1] - row[i], alpha, beta))
    z = inverse * b
    inverse_out[t, i] = inverse
    r_out[t, i] = b
    p_out[t, i] = z
    solution_out[t, i] = wp.vec3(0.0, 0.0, 0.0)
    wp.atomic_add(sums_out, 0, t, wp.vec3(wp.dot(b, z), 0.0, wp.length_sq(b)))


@sizes("threads matrix p ap_out: T V; step: <I; row: V+1; column: E; sums: I T")
@wp.kernel
def _multiply(
    # In:
    step: int,
    tolerance: float,
    alpha: float,
    beta: float,
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    matrix: wp.array2d[wp.mat33],
    p: wp.array2d[wp.vec3],
    # In and out:
    sums: wp.array2d[wp.vec3],
    # Out:
    ap_out: wp.array2d[wp.vec3],
):
    """One thread a vertex of a frame."""
    t, i = wp.tid()
    if running(step, t, tolerance, sums):
        v = apply_block_row(t, i, alpha, beta, row, column, matrix, p)
        ap_out[t, i] = v
        wp.atomic_add(sums, step, t, wp.vec3(0.0, wp.dot(p[t, i], v), 0.0))


@sizes("threads inverse p ap r solution: T V; step: <I; sums: I T")
@wp.kernel
def _update(
    # In:
    step: int,
    tolerance: float,
    inverse: wp.array2d[wp.mat33],
    p: wp.array2d[wp.vec3],
    ap: wp.array2d[wp.vec3],
    # In and out:
    r: wp.array2d[wp.vec3],
    solution: wp.array2d[wp.vec3],
    sums: wp.array2d[wp.vec3],
):
    """One thread a vertex of a frame."""
    t, i = wp.tid()
    if running(step, t, tolerance, sums):
        s = sums[step, t]
        length = ratio(s[0], s[1])
        solution[t, i] = solution[t, i] + length * p[t, i]
        v = r[t, i] - length * ap[t, i]
        r[t, i] = v
        wp.atomic_add(sums, step + 1, t, wp.vec3(wp.dot(v, inverse[t, i] * v), 0.0, wp.length_sq(v)))
    elif i == 0:
        sums[step + 1, t] = sums[step, t]


@sizes("threads inverse r p: T V; step: <I; sums: I T")
@wp.kernel
def _turn(
    # In:
    step: int,
    tolerance: float,
    inverse: wp.array2d[wp.mat33],
    r: wp.array2d[wp.vec3],
    sums: wp.array2d[wp.vec3],
    # In and out:
    p: wp.array2d[wp.vec3],
):
    """One thread a vertex of a frame."""
    t, i = wp.tid()
    if running(step, t, tolerance, sums):
        p[t, i] = inverse[t, i] * r[t, i] + ratio(sums[step + 1, t][0], sums[step, t][0]) * p[t, i]


@sizes("threads matrix rhs inverse solution r p: T V; step: <I; row: V+1; column: E; sums: I T")
@wp.kernel
def _look(
    # In:
    step: int,
    last: int,
    tolerance: float,
    alpha: float,
    beta: float,
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    matrix: wp.array2d[wp.mat33],
    rhs: wp.array2d[wp.vec3],
    inverse: wp.array2d[wp.mat33],
    solution: wp.array2d[wp.vec3],
    # In and out:
    r: wp.array2d[wp.vec3],
    p: wp.array2d[wp.vec3],
    sums: wp.array2d[wp.vec3],
):
    """One thread a vertex of a frame: the true residual of frames that are done, as ``cg_steps.look``."""
    t, i = wp.tid()
    if last != 0 or not running(step - 1, t, tolerance, sums):
        v = rhs[t, i] - apply_block_row(t, i, alpha, beta, row, column, matrix, solution)
        z = inverse[t, i] * v
        r[t, i] = v
        p[t, i] = z
        wp.atomic_add(sums, step, t, wp.vec3(wp.dot(v, z), 0.0, wp.length_sq(v)))
    elif i == 0:
        sums[step, t] = sums[step - 1, t]


@sizes("threads sums_out: N")
@wp.kernel
def _clear(
    # Out:
    sums_out: wp.array[wp.vec3],
):
    sums_out[wp.tid()] = wp.vec3(0.0, 0.0, 0.0)


@sizes("threads iterations_out residual_out: T; looks: C; sums: I T")
@wp.kernel
def _report(
    # In:
    tolerance: float,
    looks: wp.array[wp.int32],
    sums: wp.array2d[wp.vec3],
    # Out:
    iterations_out: wp.array[wp.int32],
    residual_out: wp.array[wp.float32],
):
    """One thread a frame; rows ``looks`` of ``sums`` hold true residuals, those behind each its recursion's."""
    t = wp.tid()
    done = int(0)
    last = looks.shape[0] - 1
    for c in range(last):
        step = looks[c]
        while step < looks[c + 1] - 1 and running(step, t, tolerance, sums):
            step = step + 1
            done = done + 1
    iterations_out[t] = done
    residual_out[t] = wp.sqrt(ratio(sums[looks[last], t][2], sums[0, t][2]))


class BlockSolver:
    """Solves for the moves d of all vertices, frame by frame.

    Args:
        graph: the mesh. frame_count: T. tolerance: residual, relative to the right-hand side, to stop at, above 0 and
            below 1. iterations_max: steps after which a frame gives up and says so in ``iterations`` and ``residual``,
            shape (T,), the true one. stepwise: one launch a phase over all frames, the way of CUDA; None: where the
            device is no CPU.

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
        stepwise: bool | None = None,
    ) -> None:
        check_limits(tolerance, iterations_max)
        shape = (frame_count, len(graph.node))
        self._device = device
        self._limits = (float(tolerance), int(iterations_max))
        self._row = wp.array(graph.row, dtype=wp.int32, device=device)
        self._column = wp.array(graph.column, dtype=wp.int32, device=device)
        self._inverse = wp.zeros(shape, dtype=wp.mat33, device=device)
        self._r, self._p, self._ap = (wp.zeros(shape, dtype=wp.vec3, device=device) for _ in range(3))
        self.iterations = wp.zeros(frame_count, dtype=wp.int32, device=device)
        self.residual = wp.zeros(frame_count, dtype=wp.float32, device=device)
        self._stepwise = way_of(device) is Way.WHOLE if stepwise is None else stepwise
        steps = iterations_between_looks(iterations_max) if self._stepwise else []
        self._looks = np.cumsum([0, *(n + 1 for n in steps)])
        self._look_rows = wp.array(self._looks, dtype=wp.int32, device=device)
        self._sums = wp.zeros((self._looks[-1] + 1, frame_count), dtype=wp.vec3, device=device)

    def solve(
        self, first: int, last: int, alpha: float, beta: float, matrix: wp.array, rhs: wp.array,
        solution_out: wp.array,
    ) -> None:  # fmt: skip
        """Solve frames ``first .. last`` (last excluded); stepwise all of them.

        Args:
            alpha: weight of L. beta: weight of I, above 0. matrix: shape (T, V) mat33, symmetric, semidefinite.
            rhs, solution_out: shape (T, V) vec3.
        """
        if self._stepwise:
            self._solve_stepwise(alpha, beta, matrix, rhs, solution_out)
            return
        system = [alpha, beta, self._row, self._column, matrix, rhs, *self._limits]
        work = [self._inverse, self._r, self._p, self._ap]
        results = [solution_out, self.iterations, self.residual]
        launch(_solve_frames, last - first, [first, *system, *work, *results], self._device)

    def _solve_stepwise(
        self, alpha: float, beta: float, matrix: wp.array, rhs: wp.array, solution_out: wp.array,
    ) -> None:  # fmt: skip
        device, shape, sums, tolerance = self._device, rhs.shape, self._sums, self._limits[0]
        work, system = [self._r, self._p], [alpha, beta, self._row, self._column, matrix]
        launch(_clear, int(np.prod(sums.shape)), [sums.flatten()], device)
        launch(_start, shape, [alpha, beta, self._row, matrix, rhs, self._inverse, *work, solution_out, sums], device)
        for first, last in zip(self._looks[:-1], self._looks[1:], strict=True):
            for step in range(int(first), int(last) - 1):
                launch(_multiply, shape, [step, tolerance, *system, self._p, sums, self._ap], device)
                moved = [self._inverse, self._p, self._ap, self._r, solution_out, sums]
                launch(_update, shape, [step, tolerance, *moved], device)
                launch(_turn, shape, [step, tolerance, self._inverse, self._r, sums, self._p], device)
            final = int(last == self._looks[-1])
            known = [*system, rhs, self._inverse, solution_out]
            launch(_look, shape, [int(last), final, tolerance, *known, *work, sums], device)
        launch(_report, shape[0], [tolerance, self._look_rows, sums, self.iterations, self.residual], device)
