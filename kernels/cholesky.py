"""The Sobolev solve on the template by a sparse factorisation done once, exact: the CPU's way.

(I + lambda L) is symmetric and positive definite, so in a good order of its unknowns it is F D F^T with F lower
triangular of unit diagonal, nearly as sparse as the matrix itself. A solve then is one sweep down and one sweep up,
a fraction of what conjugate gradients take. The operator is symmetric: its own adjoint.

    F z = b,   y = D^-1 z,   F^T x = y
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.sizes import require, sizes

wp.set_module_options(MODULE_OPTIONS)


@dataclass(frozen=True)
class Factor:
    """F and D of an (n, n) matrix whose rows and columns have been put in ``order``.

    order: unknown at each place             (n,) int
    row, column, value: F below its diagonal as compressed rows     (n + 1,), (m,), (m,)
    pivot: diagonal of D                     (n,) float
    """

    order: np.ndarray
    row: np.ndarray
    column: np.ndarray
    value: np.ndarray
    pivot: np.ndarray


# A vertex is a register of four. The way up adds to the rows above instead of gathering from those below, so that one
# copy of F serves both ways. Not a kernel for CUDA: every row waits for those before it.
_SWEEPS = """
#if !defined(__CUDA_ARCH__)
    typedef float reg __attribute__((vector_size(16), aligned(4)));
    reg* const x = (reg*)scratch.data;
    const int count = order.shape[0];
    const int* const at = order.data;
    const int* const begin_of = row.data;
    const int* const node = column.data;
    const float* const f = value.data;
    for (int i = 0; i < count; ++i) {
        const wp::vec3 b = rhs.data[at[i]];
        reg even = {b[0], b[1], b[2], 0.0f}, odd = {};
        int k = begin_of[i];
        for (; k + 2 <= begin_of[i + 1]; k += 2) { even -= x[node[k]] * f[k]; odd -= x[node[k + 1]] * f[k + 1]; }
        if (k < begin_of[i + 1]) even -= x[node[k]] * f[k];
        x[i] = even + odd;
    }
    for (int i = 0; i < count; ++i) x[i] *= inverse_pivot.data[i];
    for (int i = count - 1; i >= 0; --i) {
        const reg v = x[i];
        solution_out.data[at[i]] = wp::vec3(v[0], v[1], v[2]);
        for (int k = begin_of[i]; k < begin_of[i + 1]; ++k) x[node[k]] -= v * f[k];
    }
#endif
"""


@wp.func_native(_SWEEPS)
def sweep(
    order: wp.array[wp.int32],
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    value: wp.array[wp.float32],
    inverse_pivot: wp.array[wp.float32],
    rhs: wp.array[wp.vec3],
    scratch: wp.array[wp.vec4],
    solution_out: wp.array[wp.vec3],
): ...


@sizes("threads: 1; order inverse_pivot rhs scratch solution_out: N; row: N+1; column value: E")
@wp.kernel
def _solve_factored(
    # In:
    order: wp.array[wp.int32],
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    value: wp.array[wp.float32],
    inverse_pivot: wp.array[wp.float32],
    rhs: wp.array[wp.vec3],
    # In and out: scratch
    scratch: wp.array[wp.vec4],
    # Out:
    solution_out: wp.array[wp.vec3],
):
    """CPU: one thread."""
    sweep(order, row, column, value, inverse_pivot, rhs, scratch, solution_out)


class CholeskySolver:
    """Solves with one ``Factor`` for three right-hand sides at a time; on the CPU only."""

    def __init__(self, factor: Factor, device: wp.Device) -> None:
        def upload(values: np.ndarray, dtype: type) -> wp.array:
            return wp.array(values, dtype=dtype, device=device)

        self._device = device
        self._factor = [upload(a, wp.int32) for a in (factor.order, factor.row, factor.column)]
        self._factor += [upload(a, wp.float32) for a in (factor.value, 1.0 / factor.pivot)]
        self._scratch = wp.zeros(len(factor.order), dtype=wp.vec4, device=device)

    def solve(self, rhs: wp.array, solution_out: wp.array) -> None:
        """Solve for ``rhs`` into ``solution_out``, both shape (n,) vec3; they may be the same."""
        for array, name in ((rhs, "rhs"), (solution_out, "solution_out")):
            require(array, name, wp.vec3, (len(self._scratch),))
        launch(_solve_factored, 1, [*self._factor, rhs, self._scratch, solution_out], self._device)
