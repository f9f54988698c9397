"""The Sobolev solve (I + lambda L)^-1 on full grids, exact, by cosine transforms (paper, sec. Spatial Smoothness).

On a full n^3 grid the combinatorial 6-neighbour Laplacian (D - A) is a sum of three path Laplacians. The orthonormal
DCT-II basis C diagonalises a path, with eigenvalues mu_k = 2 - 2 cos(pi k / n), so

    x = (C^T)^3 [ (C)^3 b / (1 + lambda (mu_i + mu_j + mu_k)) ]

is exact up to rounding, at the price of six small matrix products. The operator is symmetric: its own adjoint.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.levels import LevelTable, node8

wp.set_module_options(MODULE_OPTIONS)

# Along one axis: out[b, k, :] = sum_j C[k, j] in[b, j, :], rows of `length` registers. Four outputs at a time, so
# that every input register is loaded once for four products. CPU only; CUDA has its own kernel below.
_PASSES = """
#if !defined(__CUDA_ARCH__)
    typedef float reg __attribute__((vector_size(32), aligned(4)));
    const int n = levels.data[2 * level];
    const size_t begin = ((size_t)transition * rhs.shape[1] + levels.data[2 * level + 1]) * 8;
    const float* const matrix = matrices.data + matrix_offset.data[level];
    const float* const mu = eigenvalues.data + eigenvalue_offset.data[level];
    const float* source = (const float*)rhs.data + begin;
    float* const one = (float*)scratch.data + begin;
    float* const two = (float*)solution.data + begin;
    for (int pass = 0; pass < 6; ++pass) {
        // Forwards x, y, z, then back z, y, x.
        const int axis = pass < 3 ? pass : 5 - pass;
        const int backwards = pass >= 3;
        const int length = axis == 0 ? n * n : (axis == 1 ? n : 1);
        const int batch = n * n / length;
        const int step_k = backwards ? 1 : n, step_j = backwards ? n : 1;
        float* const target = pass % 2 == 0 ? one : two;
        for (int b = 0; b < batch; ++b) {
            const reg* in = (const reg*)source + (size_t)b * n * length;
            reg* out = (reg*)target + (size_t)b * n * length;
            for (int c = 0; c < length; ++c) {
                int k = 0;
                for (; k + 4 <= n; k += 4) {
                    const float* m = matrix + k * step_k;
                    reg a0 = {}, a1 = {}, a2 = {}, a3 = {};
                    for (int j = 0; j < n; ++j, m += step_j) {
                        const reg x = in[(size_t)j * length + c];
                        a0 += x * m[0]; a1 += x * m[step_k]; a2 += x * m[2 * step_k]; a3 += x * m[3 * step_k];
                    }
                    out[(size_t)k * length + c] = a0; out[(size_t)(k + 1) * length + c] = a1;
                    out[(size_t)(k + 2) * length + c] = a2; out[(size_t)(k + 3) * length + c] = a3;
                }
                for (; k < n; ++k) {
                    const float* m = matrix + k * step_k;
                    reg a = {};
                    for (int j = 0; j < n; ++j, m += step_j) a += in[(size_t)j * length + c] * m[0];
                    out[(size_t)k * length + c] = a;
                }
            }
        }
        if (pass == 2) {
            reg* v = (reg*)target;
            for (int x = 0; x < n; ++x) for (int y = 0; y < n; ++y) for (int z = 0; z < n; ++z)
                *v++ *= 1.0f / (1.0f + lambda_ * (mu[x] + mu[y] + mu[z]));
        }
        source = target;
    }
#endif
"""


@wp.func_native(_PASSES)
def solve_level(
    transition: int,
    level: int,
    levels: wp.array(dtype=wp.int32),
    lambda_: float,
    matrices: wp.array(dtype=wp.float32),
    matrix_offset: wp.array(dtype=wp.int32),
    eigenvalues: wp.array(dtype=wp.float32),
    eigenvalue_offset: wp.array(dtype=wp.int32),
    rhs: wp.array2d(dtype=node8),
    scratch: wp.array2d(dtype=node8),
    solution: wp.array2d(dtype=node8),
): ...


@wp.kernel
def _solve_levels(
    # In:
    first_transition: int,
    levels: wp.array(dtype=wp.int32),
    lambdas: wp.array(dtype=wp.float32),
    matrices: wp.array(dtype=wp.float32),
    matrix_offset: wp.array(dtype=wp.int32),
    eigenvalues: wp.array(dtype=wp.float32),
    eigenvalue_offset: wp.array(dtype=wp.int32),
    rhs: wp.array2d(dtype=node8),
    # Scratch and out:
    scratch: wp.array2d(dtype=node8),
    solution_out: wp.array2d(dtype=node8),
):
    """CPU: one thread a level of a transition, all six passes."""
    count = lambdas.shape[0]
    k = wp.tid()
    level = k % count
    solve_level(
        first_transition + k // count, level, levels, lambdas[level], matrices, matrix_offset,
        eigenvalues, eigenvalue_offset, rhs, scratch, solution_out,
    )  # fmt: skip


@wp.kernel
def _cosine_axis(
    # In:
    axis: int,
    backwards: int,
    levels: wp.array(dtype=wp.int32),
    node_level: wp.array(dtype=wp.int32),
    lambdas: wp.array(dtype=wp.float32),
    matrices: wp.array(dtype=wp.float32),
    matrix_offset: wp.array(dtype=wp.int32),
    eigenvalues: wp.array(dtype=wp.float32),
    eigenvalue_offset: wp.array(dtype=wp.int32),
    values: wp.array2d(dtype=node8),
    # Out:
    values_out: wp.array2d(dtype=node8),
):
    """CUDA: one thread a node, one pass along one axis; the last forward pass also divides by the eigenvalues."""
    s, i = wp.tid()
    level = node_level[i]
    n = levels[2 * level]
    begin = levels[2 * level + 1]
    local = i - begin
    x = local // (n * n)
    y = (local // n) % n
    z = local % n
    k = x
    step = n * n
    if axis == 1:
        k = y
        step = n
    if axis == 2:
        k = z
        step = 1
    step_k = n
    step_j = int(1)
    if backwards != 0:
        step_k = 1
        step_j = n
    m = matrix_offset[level] + k * step_k
    total = node8()
    for j in range(n):
        total += matrices[m + j * step_j] * values[s, i + (j - k) * step]
    if axis == 2 and backwards == 0:
        e = eigenvalue_offset[level]
        total = total / (1.0 + lambdas[level] * (eigenvalues[e + x] + eigenvalues[e + y] + eigenvalues[e + z]))
    values_out[s, i] = total


def cosine_matrix(n: int) -> np.ndarray:
    """The orthonormal DCT-II basis of a path of n nodes, one basis vector a row, shape (n, n) float64."""
    k, j = np.mgrid[0:n, 0:n]
    matrix = np.sqrt(2.0 / n) * np.cos(np.pi * k * (j + 0.5) / n)
    matrix[0] = np.sqrt(1.0 / n)
    return matrix


class CosineSolver:
    """``(I + lambda_l L_l)^-1`` for every level of every transition, full grids.

    Args:
        levels: the node layout. lambdas: smoothing weight of each level, L numbers.
        transition_count: rows S of the arrays to solve for. device: where they live.
    """

    def __init__(self, levels: LevelTable, lambdas: np.ndarray, transition_count: int, device: wp.Device) -> None:
        resolution = [int(n) for n in levels.resolution]
        mu = [2.0 - 2.0 * np.cos(np.pi * np.arange(n) / n) for n in resolution]

        def upload(rows: list[np.ndarray]) -> tuple[wp.array, wp.array]:
            offset = np.concatenate([[0], np.cumsum([r.size for r in rows])[:-1]])
            flat = np.concatenate([r.ravel() for r in rows])
            return wp.array(flat, dtype=wp.float32, device=device), wp.array(offset, dtype=wp.int32, device=device)

        self._device = device
        self._levels = levels.to_device(device)
        self._node_level = wp.array(levels.node_level(), dtype=wp.int32, device=device)
        self._lambdas = wp.array(lambdas, dtype=wp.float32, device=device)
        self._tables = [*upload([cosine_matrix(n) for n in resolution]), *upload(mu)]
        self._scratch = wp.zeros((transition_count, levels.node_count), dtype=node8, device=device)

    def solve(self, rhs: wp.array, solution_out: wp.array, first: int, last: int) -> None:
        """Solve for transitions ``first .. last`` (last excluded); on CUDA for all of them.

        Args:
            rhs, solution_out: shape (S, M) node8, not the same array.
        """
        if self._device.is_cpu:
            inputs = [first, self._levels, self._lambdas, *self._tables, rhs, self._scratch, solution_out]
            launch(_solve_levels, (last - first) * len(self._lambdas), inputs, self._device)
            return
        self.solve_by_axis(rhs, solution_out)

    def solve_by_axis(self, rhs: wp.array, solution_out: wp.array) -> None:
        """The same, one launch a pass: what CUDA runs."""
        shared = [self._levels, self._node_level, self._lambdas, *self._tables]
        targets = (self._scratch, solution_out)
        source = rhs
        for step, (axis, backwards) in enumerate([(0, 0), (1, 0), (2, 0), (2, 1), (1, 1), (0, 1)]):
            target = targets[step % 2]
            launch(_cosine_axis, rhs.shape, [axis, backwards, *shared, source, target], self._device)
            source = target
