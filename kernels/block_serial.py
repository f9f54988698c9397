"""The solve of ``block_cg`` as one CPU core does it best: a frame after the other, sixteen floats at a time.

Conjugate gradients as there. With the blocks D of the diagonal as preconditioner, u = D^-1 r, and p = u + turn p, what
the blocks make of p follows the same recursion, q = D p = r + turn q, so that an iteration needs no blocks but the
inverse ones:

    w = (D - alpha A) p = q - alpha sum_j s_ij p_j      j the neighbours, s_ij the stiffness of the edge

Vectors of a frame are flat, three floats a vertex, and nearly fit into the second cache; they are taken from the heap
for the time of a solve.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS
from warpdef.kernels.sizes import sizes

wp.set_module_options(MODULE_OPTIONS)

# Registers of sixteen floats run over the flat vectors, whose ends are padded with zeros. A vertex is four floats of
# which the last is the next vertex's: it may be read anywhere, and written where that is written after it.
_SOLVE = """
#if !defined(__CUDA_ARCH__)
    typedef float many __attribute__((vector_size(64), aligned(4)));
    typedef float four __attribute__((vector_size(16), aligned(4)));
    const int count = rhs.shape[1], block = 128;  // vertices whose vectors stay in the nearest cache
    const size_t first = (size_t)t * count, padded = ((3 * (size_t)count + 15) / 16 + 1) * 16;
    const float* const asked = (const float*)rhs.data + 3 * first;
    const float* const blocks = (const float*)matrix.data + 9 * first;
    float* const solution = (float*)solution_out.data + 3 * first;
    const int* const begin_of = row.data;
    const int* const neighbour = column.data;
    const float* const stiff = (const float*)stiffness.data;  // none: 1 everywhere, as in ``material``
    float* const memory = (float*)malloc(sizeof(float) * (5 * padded + 9 * (size_t)count + 16));
    if (!memory) {
        residual_out.data[t] = INFINITY;
        iterations_out.data[t] = 0;
        for (size_t k = 0; k < 3 * (size_t)count; ++k) solution[k] = NAN;
        return;
    }
    // What w was is known once r is; u takes its place.
    float* const u = memory; float* const w = u;
    float* const r = u + padded; float* const p = r + padded; float* const q = p + padded; float* const x = q + padded;
    float* const inverse = x + padded;
    __builtin_memset(memory, 0, sizeof(float) * 5 * padded);
    for (int k = 0; k < 16; ++k) inverse[9 * (size_t)count + k] = 0.0f;

    const auto load = [](const float* at) { return *(const four*)at; };
    const auto put = [](float* at, four v) { __builtin_memcpy(at, &v, 12); };
    const auto sum_of = [](many v) {
        float total = 0.0f;
        for (int l = 0; l < 16; ++l) total += v[l];
        return total;
    };
    // Over all vertices, block by block: first each vertex, then the floats of the block.
    const auto blockwise = [&](auto each, auto then) {
        for (int i = 0; i < count; i += block) {
            const int end = i + block < count ? i + block : count;
            for (int v = i; v < end; ++v) each(v);
            for (int k = 3 * i; k < 3 * end; k += 16) then(k);
        }
    };
    const auto around = [&](const float* of, int i) {
        four total = {};
        const int begin = begin_of[i], end = begin_of[i + 1];
        if (!stiff) {
            for (int k = begin; k < end; ++k) total += load(of + 3 * (size_t)neighbour[k]);
            return total;
        }
        four sum = {};
        for (int k = begin; k < end; ++k) {
            const size_t j = neighbour[k];
            const four there = load(of + 3 * j);
            total += stiff[j] * there;
            sum += there;
        }
        return 0.5f * (stiff[i] * sum + total);
    };
    const auto degree = [&](int i) {
        const int begin = begin_of[i], end = begin_of[i + 1];
        if (!stiff) return (float)(end - begin);
        float total = (float)(end - begin) * stiff[i];
        for (int k = begin; k < end; ++k) total += stiff[neighbour[k]];
        return 0.5f * total;
    };
    const auto solved = [&](int i) {
        const float* const m = inverse + 9 * (size_t)i;
        const float* const v = r + 3 * i;
        return load(m) * v[0] + load(m + 3) * v[1] + load(m + 6) * v[2];
    };

    many b_sq = {}, r_sq = {}, ru = {};
    for (int i = 0; i < count; ++i) {
        const float* const m = blocks + 9 * (size_t)i;
        const float more = beta + alpha * degree(i);
        const float a = m[0] + more, b = m[1], c = m[2], d = m[4] + more, e = m[5], f = m[8] + more;
        const float aa = d * f - e * e, ab = c * e - b * f, ac = b * e - c * d, bc = b * c - a * e;
        const float whole = a * aa + b * ab + c * ac, share = whole != 0.0f ? 1.0f / whole : 0.0f;
        const float to[9] = {aa, ab, ac, ab, a * f - c * c, bc, ac, bc, a * d - b * b};
        for (int k = 0; k < 9; ++k) inverse[9 * (size_t)i + k] = to[k] * share;
        put(r + 3 * i, four{asked[3 * i], asked[3 * i + 1], asked[3 * i + 2], 0.0f});
    }
    blockwise([&](int i) { put(u + 3 * i, solved(i)); },
              [&](int k) { const many v = *(many*)(r + k); b_sq += v * v; ru += v * *(many*)(u + k); });
    const float asked_sq = sum_of(b_sq), enough = tolerance * tolerance * asked_sq;
    float left = asked_sq, product = sum_of(ru), known = INFINITY, worst = 0.0f;
    int done = 0;
    for (bool going = true; going;) {
        const int begun = done;
        float turn = 0.0f;
        while (done < iterations_max && left > enough) {
            for (int k = 0; k < 3 * count; k += 16) {
                *(many*)(p + k) = *(many*)(u + k) + turn * *(many*)(p + k);
                *(many*)(q + k) = *(many*)(r + k) + turn * *(many*)(q + k);
            }
            many sum = {};
            blockwise([&](int i) { put(w + 3 * i, load(q + 3 * i) - alpha * around(p, i)); },
                      [&](int k) { sum += *(many*)(w + k) * *(many*)(p + k); });
            const float curve = sum_of(sum), step = curve != 0.0f ? product / curve : 0.0f;
            r_sq = many{}; ru = many{};
            for (int i = 0; i < count; i += block) {
                const int end = i + block < count ? i + block : count;
                for (int k = 3 * i; k < 3 * end; k += 16) {
                    // The last register of a block that is not full is the end of everything.
                    const many rest = *(many*)(r + k) - step * *(many*)(w + k);
                    *(many*)(x + k) += step * *(many*)(p + k);
                    *(many*)(r + k) = rest;
                    r_sq += rest * rest;
                }
                for (int v = i; v < end; ++v) put(u + 3 * v, solved(v));
                for (int k = 3 * i; k < 3 * end; k += 16) ru += *(many*)(r + k) * *(many*)(u + k);
            }
            left = sum_of(r_sq);
            const float last = product;
            product = sum_of(ru);
            turn = last != 0.0f ? product / last : 0.0f;
            ++done;
        }
        going = false;
        if (done > begun) {
            r_sq = many{}; ru = many{};
            blockwise([&](int i) {
                const float* const m = blocks + 9 * (size_t)i;
                const float* const v = x + 3 * i;
                const float more = beta + alpha * degree(i);
                four at = alpha * around(x, i) - more * load(v);
                for (int k = 0; k < 3; ++k)
                    at[k] += asked[3 * i + k] - (m[3 * k] * v[0] + m[3 * k + 1] * v[1] + m[3 * k + 2] * v[2]);
                put(r + 3 * i, at);
                put(u + 3 * i, solved(i));
            }, [&](int k) { const many v = *(many*)(r + k); r_sq += v * v; ru += v * *(many*)(u + k); });
            left = sum_of(r_sq); product = sum_of(ru);
            worst = asked_sq != 0.0f ? left / asked_sq : 0.0f;
            // As ``cg_functions.worth_going_on``.
            going = done < iterations_max && worst > tolerance * tolerance && worst < 0.25f * known;
            known = worst;
        }
    }
    __builtin_memcpy(solution, x, sizeof(float) * 3 * count);
    iterations_out.data[t] = done;
    residual_out.data[t] = sqrtf(asked_sq != 0.0f ? left / asked_sq : 0.0f);
    free(memory);
#endif
"""


@wp.func_native(_SOLVE)
def solve_frame(
    t: int,
    alpha: float,
    beta: float,
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    stiffness: wp.array[wp.float32],
    matrix: wp.array2d[wp.mat33],
    rhs: wp.array2d[wp.vec3],
    tolerance: float,
    iterations_max: int,
    solution_out: wp.array2d[wp.vec3],
    iterations_out: wp.array[wp.int32],
    residual_out: wp.array[wp.float32],
): ...


@sizes("threads iterations_out residual_out: T; row: V+1; column: E; stiffness: V?; matrix rhs solution_out: T V")
@wp.kernel
def solve_frames_serially(
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
    # Out:
    solution_out: wp.array2d[wp.vec3],
    iterations_out: wp.array[wp.int32],
    residual_out: wp.array[wp.float32],
):
    """CPU: one thread a frame, from zero."""
    solve_frame(
        begin + wp.tid(), alpha, beta, row, column, stiffness, matrix, rhs, tolerance, iterations_max, solution_out,
        iterations_out, residual_out,
    )  # fmt: skip
