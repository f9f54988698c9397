"""The Sobolev solve (I + lambda L)^-1 on full grids, exact, by cosine transforms (paper, sec. Spatial Smoothness).

On a full n^3 grid the combinatorial 6-neighbour Laplacian (D - A) is a sum of three path Laplacians. The orthonormal
DCT-II basis C diagonalises a path, with eigenvalues mu_k = 2 - 2 cos(pi k / n), so

    x = (C^T)^3 [ (C)^3 b / (1 + lambda (mu_i + mu_j + mu_k)) ]

is exact up to rounding, at the price of six small matrix products. The operator is symmetric: its own adjoint.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from warpdef.kernels.cosine_blocks import LANES, descend_in_blocks, padded_halves, solve_levels_in_blocks
from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.levels import LevelTable, node8
from warpdef.kernels.sizes import require_span, sizes
from warpdef.kernels.ways import Way, lanes_of, way_of

wp.set_module_options(MODULE_OPTIONS)

_RESOLUTION_MAX = 31  # level 16, the finest that the configuration allows

# Along x for the whole level; along y, z and back again plane by plane, each of which stays in the nearest cache; back
# along x. Basis vector k of a path is even or odd about its middle as k is, so sums and differences of mirrored entries
# need only half of the matrix: h = n // 2 odd and m = n - h even vectors (n is odd). `halves` holds, one behind the
# other, the even half (m x m) and the odd half (h x h), then both transposed. A few lines of nodes are done together,
# four outputs at a time, so that what is loaded serves several products. A line is read before it is written, so all
# but the first step happen in place. CPU only; CUDA has ``cosine_blocks``.
_PASSES = """
#if !defined(__CUDA_ARCH__)
    typedef float one __attribute__((vector_size(32)));
    #if defined(__AVX512F__)
    #define LINES 4
    #else
    #define LINES 2
    #endif
    typedef float many __attribute__((vector_size(32 * LINES)));
    const int n = levels.data[2 * level];
    const int h = n / 2, m = n - h;
    const size_t begin = ((size_t)transition * rhs.shape[1] + levels.data[2 * level + 1]) * 8;
    const float* const mu = eigenvalues.data + eigenvalue_offset.data[level];
    const float* const matrix = halves.data + half_offset.data[level];
    float* const result = (float*)solution.data + begin;

    const auto multiply = [&](const auto* part, auto* sums, const float* row, int size) {
        typedef __remove_cvref(decltype(*part)) reg;
        int k = 0;
        for (; k + 4 <= size; k += 4, row += 4 * size) {
            reg a0 = {}, a1 = {}, a2 = {}, a3 = {};
            for (int j = 0; j < size; ++j) {
                const reg x = part[j];
                a0 += x * row[j]; a1 += x * row[size + j];
                a2 += x * row[2 * size + j]; a3 += x * row[3 * size + j];
            }
            sums[k] = a0; sums[k + 1] = a1; sums[k + 2] = a2; sums[k + 3] = a3;
        }
        for (; k < size; ++k, row += size) {
            reg a = {};
            for (int j = 0; j < size; ++j) a += part[j] * row[j];
            sums[k] = a;
        }
    };
    // A line of registers, `step` floats from one node to the next.
    const auto line = [&](auto reg_of, bool back, int step, auto load, auto store) {
        typedef decltype(reg_of) reg;
        reg even[MOST], odd[MOST], even_sums[MOST], odd_sums[MOST];
        const float* const half = matrix + (back ? m * m + h * h : 0);
        if (back) {
            for (int k = 0; k < h; ++k) { even[k] = load(2 * k * step); odd[k] = load((2 * k + 1) * step); }
            even[h] = load(2 * h * step);
        } else {
            for (int j = 0; j < h; ++j) {
                const reg x = load(j * step), y = load((n - 1 - j) * step);
                even[j] = x + y; odd[j] = x - y;
            }
            even[h] = load(h * step);
        }
        multiply(even, even_sums, half, m);
        multiply(odd, odd_sums, half + m * m, h);
        if (back) {
            for (int j = 0; j < h; ++j) {
                store(j * step, even_sums[j] + odd_sums[j]);
                store((n - 1 - j) * step, even_sums[j] - odd_sums[j]);
            }
            store(h * step, even_sums[h]);
        } else {
            for (int k = 0; k < h; ++k) { store(2 * k * step, even_sums[k]); store((2 * k + 1) * step, odd_sums[k]); }
            store(2 * h * step, even_sums[h]);
        }
    };
    // Lines side by side, `apart` floats from one to the next: as many as registers hold, then one by one. Six copies
    // would be no faster, and take six times as long to compile.
    const auto lines = [&](const float* in, float* out, int count, int apart, int step, bool back)
        __attribute__((noinline)) {
        const auto some = [&](auto reg_of, int c, int together) {
            typedef decltype(reg_of) reg;
            const float* const source = in + c * apart;
            float* const target = out + c * apart;
            line(reg_of, back, step,
                [&](int at) {
                    reg v;
                    for (int k = 0; k < together; ++k)
                        __builtin_memcpy((float*)&v + 8 * k, source + k * apart + at, 32);
                    return v;
                },
                [&](int at, reg v) {
                    for (int k = 0; k < together; ++k)
                        __builtin_memcpy(target + k * apart + at, (float*)&v + 8 * k, 32);
                });
        };
        int c = 0;
        for (; c + LINES <= count; c += LINES) some(many{}, c, LINES);
        for (; c < count; ++c) some(one{}, c, 1);
    };
    const int row = 8 * n, plane = row * n;
    lines((const float*)rhs.data + begin, result, n * n, 8, plane, false);
    for (int x = 0; x < n; ++x) {
        float* const at = result + x * plane;
        lines(at, at, n, 8, row, false);
        lines(at, at, n, row, 8, false);
        float* v = at;
        for (int y = 0; y < n; ++y) for (int z = 0; z < n; ++z, v += 8) {
            const float share = 1.0f / (1.0f + lambda_ * (mu[x] + mu[y] + mu[z]));
            for (int c = 0; c < 8; ++c) v[c] *= share;
        }
        lines(at, at, n, row, 8, true);
        lines(at, at, n, 8, row, true);
    }
    lines(result, result, n * n, 8, plane, true);
#endif
""".replace("MOST", str(_RESOLUTION_MAX // 2 + 1))


@wp.func_native(_PASSES)
def solve_level(
    transition: int,
    level: int,
    levels: wp.array[wp.int32],
    lambda_: float,
    halves: wp.array[wp.float32],
    half_offset: wp.array[wp.int32],
    eigenvalues: wp.array[wp.float32],
    eigenvalue_offset: wp.array[wp.int32],
    rhs: wp.array2d[node8],
    solution: wp.array2d[node8],
): ...


@sizes(
    "threads: S*L; first_transition: <S; levels: 2*L; lambdas half_offset eigenvalue_offset: L; halves: H; "
    "eigenvalues: E; rhs solution_out: S M"
)
@wp.kernel
def _solve_levels(
    # In:
    first_transition: int,
    levels: wp.array[wp.int32],
    lambdas: wp.array[wp.float32],
    halves: wp.array[wp.float32],
    half_offset: wp.array[wp.int32],
    eigenvalues: wp.array[wp.float32],
    eigenvalue_offset: wp.array[wp.int32],
    rhs: wp.array2d[node8],
    # Out:
    solution_out: wp.array2d[node8],
):
    """CPU: one thread a level of a transition."""
    count = lambdas.shape[0]
    k = wp.tid()
    level = k % count
    solve_level(
        first_transition + k // count, level, levels, lambdas[level], halves, half_offset,
        eigenvalues, eigenvalue_offset, rhs, solution_out,
    )  # fmt: skip


def cosine_matrix(n: int) -> np.ndarray:
    """The orthonormal DCT-II basis of a path of n nodes, one basis vector a row, shape (n, n) float64."""
    k, j = np.mgrid[0:n, 0:n]
    matrix = np.sqrt(2.0 / n) * np.cos(np.pi * k * (j + 0.5) / n)
    matrix[0] = np.sqrt(1.0 / n)
    return matrix


def mirrored_halves(n: int) -> np.ndarray:
    """``cosine_matrix`` of an odd n less what mirror symmetry repeats: even half, odd half, both transposed; flat."""
    matrix, m = cosine_matrix(n), n - n // 2
    even, odd = matrix[0::2, :m], matrix[1::2, : m - 1]
    return np.concatenate([part.ravel() for part in (even, odd, even.T, odd.T)])


class CosineSolver:
    """``(I + lambda_l L_l)^-1`` for every level of every transition, full grids.

    Args:
        levels: the node layout. lambdas: smoothing weight of each level, L numbers.
        transition_count: rows S of the arrays to solve for. device: where they live.
    """

    def __init__(self, levels: LevelTable, lambdas: np.ndarray, transition_count: int, device: wp.Device) -> None:
        resolution = [int(n) for n in levels.resolution]
        if max(resolution) > _RESOLUTION_MAX:
            raise ValueError(f"levels: expected at most {_RESOLUTION_MAX} nodes an axis, got {max(resolution)}")
        mu = [2.0 - 2.0 * np.cos(np.pi * np.arange(n) / n) for n in resolution]

        def upload(rows: list[np.ndarray]) -> tuple[wp.array, wp.array]:
            offset = np.concatenate([[0], np.cumsum([r.size for r in rows])[:-1]])
            flat = np.concatenate([r.ravel() for r in rows])
            return wp.array(flat, dtype=wp.float32, device=device), wp.array(offset, dtype=wp.int32, device=device)

        self._device, self._way = device, way_of(device)
        self._levels = levels.to_device(device)
        self._lambdas = wp.array(lambdas, dtype=wp.float32, device=device)
        halves = [mirrored_halves(n) if self._way is Way.SPANS else padded_halves(cosine_matrix(n)) for n in resolution]
        self._tables = [self._levels, self._lambdas, *upload(halves), *upload(mu)]
        self._lanes = lanes_of(device, LANES)

    def solve(self, rhs: wp.array, solution_out: wp.array, first: int, last: int) -> None:
        """Solve for transitions ``first .. last`` (last excluded).

        Args:
            rhs, solution_out: shape (S, M) node8, not the same array.
        """
        require_span("transitions", first, last - first, len(rhs))
        count = last - first
        if self._way is Way.SPANS:
            inputs = [first, *self._tables, rhs, solution_out]
            launch(_solve_levels, count * len(self._lambdas), inputs, self._device)
            return
        inputs = [first, count, *self._tables, rhs, solution_out]
        launch(solve_levels_in_blocks, count * len(self._lambdas), inputs, self._device, self._lanes)

    @property
    def descends(self) -> bool:
        """Whether ``descend`` can: where work goes whole."""
        return self._way is Way.WHOLE

    def descend(
        self, first: int, last: int, rate: wp.array, schedule: wp.array, betas: tuple[float, float], epsilon: float,
        adj_x: wp.array, moments: tuple[wp.array, wp.array], u: wp.array, adj_u_out: wp.array, x_out: wp.array,
        moving: wp.array | None = None,
    ) -> None:  # fmt: skip
        """A step of the descent for transitions ``first .. last``: both solves with Adam between, ``adj_x`` cleared.

        Args:
            rate, schedule, betas, epsilon: see ``adam.adam``. moments: first and second. All others shape (S, M) node8.
            moving: shape (S,) int32, 0 for transitions that stay as they are; None: none does.
        """
        require_span("transitions", first, last - first, len(u))
        inputs = [first, last - first, *self._tables, rate, schedule, *betas, epsilon, moving]
        arrays = [adj_x, *moments, u, adj_u_out, x_out]
        launch(descend_in_blocks, (last - first) * len(self._lambdas), [*inputs, *arrays], self._device, self._lanes)
