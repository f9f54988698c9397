"""The Sobolev solve by cosine transforms in blocks, and a whole step of the descent around it: the way of CUDA.

``cosine.py`` says what is computed. Here a block has a level of a transition to itself, every lane some of its lines,
and between two passes the lanes wait for one another. So gradient solve, Adam's step and value solve of all levels of
all transitions are one launch: what a block needs it has written itself.

    adj u = (I + lambda L)^-1 adj x,    u <- Adam(adj u),    x = (I + lambda L)^-1 u,    adj x = 0
"""

from __future__ import annotations

import numpy as np
import warp as wp

from warpdef.kernels.adam import adam_step
from warpdef.kernels.blocks import block_options, lane, lanes, wait
from warpdef.kernels.launching import MODULE_OPTIONS
from warpdef.kernels.levels import node8
from warpdef.kernels.schedule import SCHEDULE_SIZE
from warpdef.kernels.sizes import sizes

wp.set_module_options(MODULE_OPTIONS)

LANES = 256
"""Of these blocks: the lines that so many lanes hold at a time stay in the nearest cache."""

# A lane takes half a node of every node of a line: four floats, so that neighbours in memory go to neighbouring lanes.
# Along z forwards, divided, and back again without leaving the lane. As in `cosine.solve_level` sums and differences of
# mirrored entries need half of the matrix; its halves lie here as `padded_halves` puts them, so that the factors of
# four outputs are one load.
_SHARED_PASSES = """
#if defined(__CUDA_ARCH__)
    struct quad {
        float x, y, z, w;
        __device__ quad() {}
        __device__ quad(float4 v) : x(v.x), y(v.y), z(v.z), w(v.w) {}
        __device__ quad(float x_, float y_, float z_, float w_) : x(x_), y(y_), z(z_), w(w_) {}
        __device__ quad operator+(const quad& o) const { return quad(x + o.x, y + o.y, z + o.z, w + o.w); }
        __device__ quad operator-(const quad& o) const { return quad(x - o.x, y - o.y, z - o.z, w - o.w); }
        __device__ quad operator*(float s) const { return quad(x * s, y * s, z * s, w * s); }
    };
    #define READ(p) quad(*(const float4*)(p))
    #define FACTORS(p) __ldg((const float4*)(p))
    #define WRITE(p, v) { const quad q_ = v; *(float4*)(p) = make_float4(q_.x, q_.y, q_.z, q_.w); }
    #define NONE quad(0.0f, 0.0f, 0.0f, 0.0f)
#else
    typedef float quad __attribute__((vector_size(16), aligned(4)));
    struct four { float x, y, z, w; };
    #define READ(p) (*(const quad*)(p))
    #define FACTORS(p) (*(const four*)(p))
    #define WRITE(p, v) (*(quad*)(p) = (v))
    #define NONE quad{0.0f, 0.0f, 0.0f, 0.0f}
#endif
    const int n = levels.data[2 * level];
    const int h = n / 2, m = n - h, wide_m = (m + 3) & ~3, wide_h = (h + 3) & ~3;
    const size_t begin = ((size_t)transition * rhs.shape[1] + levels.data[2 * level + 1]) * 8;
    const float* const mu = eigenvalues.data + eigenvalue_offset.data[level];
    const float* const forth = halves.data + half_offset.data[level];
    const float* const back = forth + m * wide_m + h * wide_h;
    const float* const given = (const float*)rhs.data + begin;
    float* const result = (float*)solution.data + begin;

    quad even[MOST], odd[MOST], turned_even[MOST], turned_odd[MOST];
    // Four outputs of `size` inputs.
    const auto four_of = [](const quad* in, const float* factors, int size, int wide, quad* out) {
        quad a = NONE, b = NONE, c = NONE, d = NONE;
        for (int j = 0; j < size; ++j, factors += wide) {
            const quad x = in[j];
            const auto f = FACTORS(factors);
            a = a + x * f.x; b = b + x * f.y; c = c + x * f.z; d = d + x * f.w;
        }
        out[0] = a; out[1] = b; out[2] = c; out[3] = d;
    };
    const auto fold = [&](const float* line, int step) {
        for (int j = 0; j < h; ++j) {
            const quad x = READ(line + j * step), y = READ(line + (n - 1 - j) * step);
            even[j] = x + y; odd[j] = x - y;
        }
        even[h] = READ(line + h * step);
    };
    const auto unfold = [&](const quad* in_even, const quad* in_odd, float* line, int step) {
        for (int k = 0; k < m; k += 4) {
            quad e[4], o[4];
            four_of(in_even, back + k, m, wide_m, e);
            if (k < h) four_of(in_odd, back + m * wide_m + k, h, wide_h, o);
            for (int c = 0; c < 4; ++c) {
                const int j = k + c;
                if (j < h) {
                    WRITE(line + j * step, e[c] + o[c]);
                    WRITE(line + (n - 1 - j) * step, e[c] - o[c]);
                } else if (j == h) WRITE(line + h * step, e[c]);
            }
        }
    };
    for (int pass = 0; pass < 5; ++pass) {
        const int axis = pass < 3 ? pass : 4 - pass;
        const int step = 8 * (axis == 0 ? n * n : axis == 1 ? n : 1);
        for (int q = WP_TILE_THREAD_IDX; q < 2 * n * n; q += WP_TILE_BLOCK_DIM) {
            const int l = q / 2, a = l / n, b = l % n;
            const int at = 8 * (axis == 0 ? l : axis == 1 ? a * n * n + b : l * n) + 4 * (q % 2);
            float* const line = result + at;
            if (pass > 2) {
                for (int k = 0; k < h; ++k) {
                    even[k] = READ(line + 2 * k * step); odd[k] = READ(line + (2 * k + 1) * step);
                }
                even[h] = READ(line + 2 * h * step);
                unfold(even, odd, line, step);
                continue;
            }
            fold(pass == 0 ? given + at : line, step);
            for (int k = 0; k < m; k += 4) four_of(even, forth + k, m, wide_m, turned_even + k);
            for (int k = 0; k < h; k += 4) four_of(odd, forth + m * wide_m + k, h, wide_h, turned_odd + k);
            if (pass < 2) {
                for (int k = 0; k < h; ++k) {
                    WRITE(line + 2 * k * step, turned_even[k]); WRITE(line + (2 * k + 1) * step, turned_odd[k]);
                }
                WRITE(line + 2 * h * step, turned_even[h]);
            } else {
                const float across = 1.0f + lambda_ * (mu[a] + mu[b]);
                for (int k = 0; k < m; ++k) turned_even[k] = turned_even[k] * (1.0f / (across + lambda_ * mu[2 * k]));
                for (int k = 0; k < h; ++k) turned_odd[k] = turned_odd[k] * (1.0f / (across + lambda_ * mu[2 * k + 1]));
                unfold(turned_even, turned_odd, line, step);
            }
        }
        WP_TILE_SYNC();
    }
    #undef READ
    #undef FACTORS
    #undef WRITE
    #undef NONE
""".replace("MOST", "16")


@wp.func_native(_SHARED_PASSES)
def solve_level_shared(
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
@wp.kernel(**block_options(LANES))
def solve_levels_in_blocks(
    # In:
    first_transition: int,
    transitions: int,
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
    """One block a level of a transition, the finest levels first: the longest work must not begin last."""
    k = wp.tid() // lanes()
    level = lambdas.shape[0] - 1 - k // transitions
    solve_level_shared(
        first_transition + k % transitions, level, levels, lambdas[level], halves, half_offset,
        eigenvalues, eigenvalue_offset, rhs, solution_out,
    )  # fmt: skip


@sizes(
    "threads: S*L; first_transition: <S; levels: 2*L; lambdas half_offset eigenvalue_offset: L; halves: H; "
    f"eigenvalues: E; rate: R; schedule: {SCHEDULE_SIZE}; moving: S?; adj_x first second u adj_u_out x_out: S M"
)
@wp.kernel(**block_options(LANES))
def descend_in_blocks(
    # In:
    first_transition: int,
    transitions: int,
    levels: wp.array[wp.int32],
    lambdas: wp.array[wp.float32],
    halves: wp.array[wp.float32],
    half_offset: wp.array[wp.int32],
    eigenvalues: wp.array[wp.float32],
    eigenvalue_offset: wp.array[wp.int32],
    rate: wp.array[wp.float32],
    schedule: wp.array[wp.float32],
    beta1: float,
    beta2: float,
    epsilon: float,
    moving: wp.array[wp.int32],
    # In and out: the gradient, then 0
    adj_x: wp.array2d[node8],
    # In and out: Adam's moments, and what it moves
    first: wp.array2d[node8],
    second: wp.array2d[node8],
    u: wp.array2d[node8],
    # Out:
    adj_u_out: wp.array2d[node8],
    x_out: wp.array2d[node8],
):
    """One block a level of a transition, as ``solve_levels_in_blocks``, with ``adam`` between two solves.

    Of a transition that does not move any more the gradient alone is cleared.
    """
    k = wp.tid() // lanes()
    s = first_transition + k % transitions
    level = lambdas.shape[0] - 1 - k // transitions
    weight = lambdas[level]
    going = bool(True)  # the same in all lanes
    if moving.shape[0] > 0:
        going = moving[s] != 0
    if going:
        solve_level_shared(
            s, level, levels, weight, halves, half_offset, eigenvalues, eigenvalue_offset, adj_x, adj_u_out
        )
    n = levels[2 * level]
    begin = levels[2 * level + 1]
    for i in range(begin + lane(), begin + n * n * n, lanes()):
        if going:
            share = rate[i % rate.shape[0]]
            adam_step(i, share, schedule, beta1, beta2, epsilon, adj_u_out[s], first[s], second[s], u[s])
        adj_x[s, i] = node8()
    if going:
        wait()
        solve_level_shared(s, level, levels, weight, halves, half_offset, eigenvalues, eigenvalue_offset, u, x_out)


def padded_halves(matrix: np.ndarray) -> np.ndarray:
    """Of a cosine basis (n, n), n odd: even and odd half transposed, then as they are; rows padded to fours; flat."""
    m = len(matrix) - len(matrix) // 2
    even, odd = matrix[0::2, :m], matrix[1::2, : m - 1]
    rows = [np.pad(part, ((0, 0), (0, -part.shape[1] % 4))) for part in (even.T, odd.T, even, odd)]
    return np.concatenate([part.ravel() for part in rows])
