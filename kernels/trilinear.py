"""Trilinear multi-level sampling of six-vectors, and its adjoints (paper, eq. 1).

    T(p) = 1/L sum_l sum_c w_lc(p) T_lc          dT/dp = 1/L sum_l sum_c dw_lc/dp T_lc
    adjoint to a node:      adj T_lc += w_lc(p)/L adj T
    adjoint to a position:  adj p    += (dT/dp)^T adj T

Positions outside the cube are clamped to it, and the derivative along a clamped axis is 0. The three functions are
native snippets: one node is one 8-float register on the CPU (twice the speed of Warp's own loops, measured), and
compiling them takes a tenth of the time. The same text serves CUDA, where the register is a small struct.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS
from warpdef.kernels.levels import node8
from warpdef.kernels.warp_sums import CORNER_SUM

wp.set_module_options(MODULE_OPTIONS)

LEVELS_MAX = 16  # as many as the configuration allows

sample_jacobian = wp.types.matrix(shape=(4, 8), dtype=wp.float32)
part_jacobian = wp.types.matrix(shape=(4, 3), dtype=wp.float32)

# One register of eight floats: a vector extension on the CPU, two 16-byte halves on CUDA.
_REGISTER = """
#if defined(__CUDA_ARCH__)
    struct reg {
        float4 a, b;
        __device__ reg() {}
        __device__ reg(float s) : a(make_float4(s, s, s, s)), b(make_float4(s, s, s, s)) {}
        __device__ reg(float4 a_, float4 b_) : a(a_), b(b_) {}
        __device__ reg operator+(const reg& o) const { return reg(
            make_float4(a.x + o.a.x, a.y + o.a.y, a.z + o.a.z, a.w + o.a.w),
            make_float4(b.x + o.b.x, b.y + o.b.y, b.z + o.b.z, b.w + o.b.w)); }
        __device__ reg operator-(const reg& o) const { return reg(
            make_float4(a.x - o.a.x, a.y - o.a.y, a.z - o.a.z, a.w - o.a.w),
            make_float4(b.x - o.b.x, b.y - o.b.y, b.z - o.b.z, b.w - o.b.w)); }
        __device__ reg operator*(float s) const { return reg(
            make_float4(a.x * s, a.y * s, a.z * s, a.w * s), make_float4(b.x * s, b.y * s, b.z * s, b.w * s)); }
    };
    #define LOAD(q) reg(*(const float4*)(q), *((const float4*)(q) + 1))
    #define UNPACK(v) reg(make_float4(v[0], v[1], v[2], v[3]), make_float4(v[4], v[5], v[6], v[7]))
    #define STORE(q, r) { (q)[0] = (r).a.x; (q)[1] = (r).a.y; (q)[2] = (r).a.z; (q)[3] = (r).a.w; \\
                          (q)[4] = (r).b.x; (q)[5] = (r).b.y; (q)[6] = (r).b.z; (q)[7] = (r).b.w; }
    #if __CUDA_ARCH__ >= 900
        #define ADD_FOUR(q, x, y, z, w) asm volatile("red.global.add.v4.f32 [%0], {%1, %2, %3, %4};" \\
            :: "l"(__cvta_generic_to_global(q)), "f"(x), "f"(y), "f"(z), "f"(w) : "memory")
        #define ADD_TWO(q, x, y) asm volatile("red.global.add.v2.f32 [%0], {%1, %2};" \\
            :: "l"(__cvta_generic_to_global(q)), "f"(x), "f"(y) : "memory")
    #else
        #define ADD_FOUR(q, x, y, z, w) { atomicAdd((q), x); atomicAdd((q) + 1, y); atomicAdd((q) + 2, z); \\
            atomicAdd((q) + 3, w); }
        #define ADD_TWO(q, x, y) { atomicAdd((q), x); atomicAdd((q) + 1, y); }
    #endif
    #define ADD(q, r) { ADD_FOUR(q, (r).a.x, (r).a.y, (r).a.z, (r).a.w); ADD_TWO((q) + 4, (r).b.x, (r).b.y); }
    #define ZERO reg(0.0f)
#else
    typedef float reg __attribute__((vector_size(32), aligned(4)));
    typedef float two __attribute__((vector_size(64), aligned(4)));
    #define LOAD_TWO(q) (*(const two*)(q))
    #define LOW(w) __builtin_shufflevector(w, w, 0, 1, 2, 3, 4, 5, 6, 7)
    #define HIGH(w) __builtin_shufflevector(w, w, 8, 9, 10, 11, 12, 13, 14, 15)
    #define JOIN(a, b) __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)
    #define LOAD(q) (*(const reg*)(q))
    #define UNPACK(v) LOAD((const float*)&(v))
    #define STORE(q, r) (*(reg*)(q) = (r))
    #define ADD(q, r) (*(reg*)(q) += (r))
    #define ZERO reg{0, 0, 0, 0, 0, 0, 0, 0}
#endif
"""

# The cells that hold (px, py, pz): base node, strides in floats, fractions, half the nodes an axis, and whether an axis
# is free (not clamped). A comparison that NaN fails sends NaN to the border, so that no index ever leaves the level.
# On the CPU that is a loop of its own, which the compiler turns into SIMD over the levels: nearly half the time of a
# sample (measured).
_CELLS = """
#if !defined(__CUDA_ARCH__)
    int node_of[MOST], nodes_of[MOST];
    float fraction[3][MOST], slope[3][MOST];
    for (int l = 0; l < level_count; ++l) {
        const int n = levels.data[2 * l];
        const float top = (float)(n - 1), half = 0.5f * top;
        const float gx = (px + 1.0f) * half, gy = (py + 1.0f) * half, gz = (pz + 1.0f) * half;
        const float ux = gx > 0.0f ? (gx < top ? gx : top) : 0.0f;
        const float uy = gy > 0.0f ? (gy < top ? gy : top) : 0.0f;
        const float uz = gz > 0.0f ? (gz < top ? gz : top) : 0.0f;
        const int last = n > 1 ? n - 2 : 0;
        int ix = (int)ux, iy = (int)uy, iz = (int)uz;
        ix = ix < last ? ix : last; iy = iy < last ? iy : last; iz = iz < last ? iz : last;
        fraction[0][l] = ux - (float)ix; fraction[1][l] = uy - (float)iy; fraction[2][l] = uz - (float)iz;
        // A clamped axis does not move the sample.
        slope[0][l] = (gx >= 0.0f && gx <= top) ? half : 0.0f;
        slope[1][l] = (gy >= 0.0f && gy <= top) ? half : 0.0f;
        slope[2][l] = (gz >= 0.0f && gz <= top) ? half : 0.0f;
        nodes_of[l] = n;
        node_of[l] = levels.data[2 * l + 1] + ((ix * n + iy) * n + iz);
    }
#endif
""".replace("MOST", str(LEVELS_MAX))

_CELL = """
    #if !defined(__CUDA_ARCH__)
        const int n = nodes_of[l], step = n > 1 ? 8 : 0;
        const int sx = step * n * n, sy = step * n, sz = step;
        const float fx = fraction[0][l], fy = fraction[1][l], fz = fraction[2][l];
        const size_t node = (size_t)node_of[l];
    #else
        const int n = levels.data[2 * l];
        const float top = (float)(n - 1), half = 0.5f * top;
        const float gx = (px + 1.0f) * half, gy = (py + 1.0f) * half, gz = (pz + 1.0f) * half;
        const float ux = gx > 0.0f ? (gx < top ? gx : top) : 0.0f;
        const float uy = gy > 0.0f ? (gy < top ? gy : top) : 0.0f;
        const float uz = gz > 0.0f ? (gz < top ? gz : top) : 0.0f;
        const int last = n > 1 ? n - 2 : 0, step = n > 1 ? 8 : 0;
        int ix = (int)ux, iy = (int)uy, iz = (int)uz;
        ix = ix < last ? ix : last; iy = iy < last ? iy : last; iz = iz < last ? iz : last;
        const float fx = ux - (float)ix, fy = uy - (float)iy, fz = uz - (float)iz;
        const int sx = step * n * n, sy = step * n, sz = step;
        const size_t node = (size_t)levels.data[2 * l + 1] + (size_t)((ix * n + iy) * n + iz);
    #endif
"""

_SLOPES = """
    #if !defined(__CUDA_ARCH__)
        const float hx = slope[0][l], hy = slope[1][l], hz = slope[2][l];
    #else
        // A clamped axis does not move the sample.
        const float hx = (gx >= 0.0f && gx <= top) ? half : 0.0f;
        const float hy = (gy >= 0.0f && gy <= top) ? half : 0.0f;
        const float hz = (gz >= 0.0f && gz <= top) ? half : 0.0f;
    #endif
"""

_VALUE = (
    _REGISTER
    + """
    const float* base = (const float*)nodes.data + (size_t)transition * nodes.shape[1] * 8;
    reg sum = ZERO;
"""
    + _CELLS
    + """
    for (int l = 0; l < level_count; ++l) {
"""
    + _CELL
    + """
        const float* q = base + 8 * node;
    #if !defined(__CUDA_ARCH__)
        // A node and the next along z are one register; they part last.
        if (n == 1) { sum = sum + LOAD(q); continue; }
        const two c00 = LOAD_TWO(q), c01 = LOAD_TWO(q + sy), c10 = LOAD_TWO(q + sx), c11 = LOAD_TWO(q + sx + sy);
        const two y0 = c00 + (c01 - c00) * fy, y1 = c10 + (c11 - c10) * fy;
        const two w = y0 + (y1 - y0) * fx;
        sum = sum + LOW(w) + (HIGH(w) - LOW(w)) * fz;
    #else
        const reg a00 = LOAD(q) + (LOAD(q + sz) - LOAD(q)) * fz;
        const reg a01 = LOAD(q + sy) + (LOAD(q + sy + sz) - LOAD(q + sy)) * fz;
        const reg a10 = LOAD(q + sx) + (LOAD(q + sx + sz) - LOAD(q + sx)) * fz;
        const reg a11 = LOAD(q + sx + sy) + (LOAD(q + sx + sy + sz) - LOAD(q + sx + sy)) * fz;
        const reg b0 = a00 + (a01 - a00) * fy, b1 = a10 + (a11 - a10) * fy;
        sum = sum + b0 + (b1 - b0) * fx;
    #endif
    }
    sum = sum * (1.0f / (float)level_count);
    wp::vec_t<8, wp::float32> result;
    STORE((float*)&result, sum);
    return result;
"""
)

_VALUE_AND_DERIVATIVE = (
    _REGISTER
    + """
    const float* base = (const float*)nodes.data + (size_t)transition * nodes.shape[1] * 8;
    reg sum = ZERO, dx = ZERO, dy = ZERO, dz = ZERO;
"""
    + _CELLS
    + """
    for (int l = 0; l < level_count; ++l) {
"""
    + _CELL
    + _SLOPES
    + """
        const float* q = base + 8 * node;
    #if !defined(__CUDA_ARCH__)
        if (n == 1) { sum = sum + LOAD(q); continue; }
        const two c00 = LOAD_TWO(q), c01 = LOAD_TWO(q + sy), c10 = LOAD_TWO(q + sx), c11 = LOAD_TWO(q + sx + sy);
        const two d0 = c01 - c00, d1 = c11 - c10;
        const two y0 = c00 + d0 * fy, y1 = c10 + d1 * fy;
        const two ex = y1 - y0, ey = d0 + (d1 - d0) * fx, w = y0 + ex * fx;
        const reg ez = HIGH(w) - LOW(w);
        sum = sum + LOW(w) + ez * fz;
        dx = dx + (LOW(ex) + (HIGH(ex) - LOW(ex)) * fz) * hx;
        dy = dy + (LOW(ey) + (HIGH(ey) - LOW(ey)) * fz) * hy;
        dz = dz + ez * hz;
    #else
        // Edge by edge along z: of all corners at once registers would not hold the lerps beside the four sums.
        #pragma unroll 4
        for (int edge = 0; edge < 4; ++edge) {
            const bool far_x = edge / 2, far_y = edge % 2;
            const float* const p = q + (far_x ? sx : 0) + (far_y ? sy : 0);
            const float wx = far_x ? fx : 1.0f - fx, wy = far_y ? fy : 1.0f - fy;
            const reg low = LOAD(p), rise = LOAD(p + sz) - low, between = low + rise * fz;
            sum = sum + between * (wx * wy);
            dx = dx + between * (far_x ? hx * wy : -hx * wy);
            dy = dy + between * (far_y ? hy * wx : -hy * wx);
            dz = dz + rise * (hz * wx * wy);
        }
    #endif
    }
    const float share = 1.0f / (float)level_count;
    wp::mat_t<4, 8, wp::float32> result;
    float* r = (float*)&result;
    STORE(r, sum * share); STORE(r + 8, dx * share); STORE(r + 16, dy * share); STORE(r + 24, dz * share);
    return result;
"""
)

# Three of the six numbers, from ``first`` on, 0 or 3, added onto what is there: whoever takes one half after the other
# holds half as many numbers at a time.
_PART = (
    """
    const float* base = (const float*)nodes.data + (size_t)transition * nodes.shape[1] * 8;
    const float share = 1.0f / (float)level_count;
    wp::mat_t<4, 3, wp::float32> result = onto;
    float* r = (float*)&result;
"""
    + _CELLS
    + """
    for (int l = 0; l < level_count; ++l) {
"""
    + _CELL
    + _SLOPES
    + """
        #pragma unroll 4
        for (int edge = 0; edge < 4; ++edge) {
            const bool far_x = edge / 2, far_y = edge % 2;
            const float* const p = base + 8 * node + (far_x ? sx : 0) + (far_y ? sy : 0);
            const float wx = share * (far_x ? fx : 1.0f - fx), wy = far_y ? fy : 1.0f - fy, w = wx * wy;
            const float sharing = share * wy, along_x = far_x ? hx * sharing : -hx * sharing;
            const float along_y = far_y ? hy * wx : -hy * wx, along_z = hz * w;
            float low[3], high[3];
    #if defined(__CUDA_ARCH__)
            if (first == 0) {
                const float4 a = *(const float4*)p, b = *(const float4*)(p + sz);
                low[0] = a.x; low[1] = a.y; low[2] = a.z; high[0] = b.x; high[1] = b.y; high[2] = b.z;
            } else {
                const float2 a = *(const float2*)(p + 4), b = *(const float2*)(p + sz + 4);
                low[0] = p[3]; low[1] = a.x; low[2] = a.y; high[0] = p[sz + 3]; high[1] = b.x; high[2] = b.y;
            }
    #else
            for (int k = 0; k < 3; ++k) { low[k] = p[first + k]; high[k] = p[sz + first + k]; }
    #endif
            for (int k = 0; k < 3; ++k) {
                const float rise = high[k] - low[k], between = low[k] + rise * fz;
                r[k] += between * w;
                r[3 + k] += between * along_x;
                r[6 + k] += between * along_y;
                r[9 + k] += rise * along_z;
            }
        }
    }
    return result;
"""
)

_SCATTER = (
    _REGISTER
    + """
    float* base = (float*)adj_nodes.data + (size_t)transition * adj_nodes.shape[1] * 8;
    const float share = 1.0f / (float)level_count;
    const reg g = UNPACK(adj_value) * share;  // a local value need not be aligned as nodes are
    #if defined(__CUDA_ARCH__)
        // Complete warps add up cell by cell first, unless their points are strewn over many.
        #define F float
        #define PLACE place
        #define SHUFFLE(v, m) __shfl_xor_sync(all, v, m)
        #define PICK(c, a, b) ((c) ? (a) : (b))
        #define NOTHING 0.0f
        const unsigned all = 0xffffffffu;
        const int place = threadIdx.x % 32;
        const bool together = __activemask() == all;
    #endif
"""
    + _CELLS
    + """
    for (int l = 0; l < level_count; ++l) {
"""
    + _CELL
    + """
        float* q = base + 8 * node;
    #if !defined(__CUDA_ARCH__)
        if (n == 1) { ADD(q, g); continue; }
        const reg gz = g * fz;
        const two h = JOIN(g - gz, gz);
        const two h1 = h * fx, h0 = h - h1, h01 = h0 * fy, h11 = h1 * fy;
        *(two*)q += h0 - h01; *(two*)(q + sy) += h01;
        *(two*)(q + sx) += h1 - h11; *(two*)(q + sx + sy) += h11;
    #else
        const unsigned long long cell = (unsigned long long)q;
        unsigned leaders = 0;
        if (together) {
            const unsigned alike = __match_any_sync(all, cell);
            leaders = __ballot_sync(all, __ffs(alike) - 1 == place);
        }
        if (!together || __popc(leaders) > CELLS_AT_ONCE) {
            if (n == 1) { ADD(q, g); continue; }
            const reg g1 = g * fx, g0 = g - g1;
            const reg g01 = g0 * fy, g00 = g0 - g01, g11 = g1 * fy, g10 = g1 - g11;
            const reg h00 = g00 * fz, h01 = g01 * fz, h10 = g10 * fz, h11 = g11 * fz;
            ADD(q, g00 - h00); ADD(q + sz, h00);
            ADD(q + sy, g01 - h01); ADD(q + sy + sz, h01);
            ADD(q + sx, g10 - h10); ADD(q + sx + sz, h10);
            ADD(q + sx + sy, g11 - h11); ADD(q + sx + sy + sz, h11);
            continue;
        }
        const float given[6] = {g.a.x, g.a.y, g.a.z, g.a.w, g.b.x, g.b.y};
        for (; leaders; leaders &= leaders - 1) {
            const unsigned long long of = __shfl_sync(all, cell, __ffs(leaders) - 1);
            const bool mine = cell == of;
"""
    + CORNER_SUM
    + """
            const int along = ((place & 16) ? sx : 0) + ((place & 8) ? sy : 0) + ((place & 4) ? sz : 0);
            float* const corner = (float*)of + along;
            if (n == 1 && place >= 4) continue;  // all corners are one node, and one of them has it all
            if (place % 4 == 0) ADD_FOUR(corner, corner_sum[0], corner_sum[1], corner_sum[2], corner_sum[3]);
            if (place % 4 == 1) ADD_TWO(corner + 4, corner_sum[4], corner_sum[5]);
        }
    #endif
    }
    #if defined(__CUDA_ARCH__)
        #undef F
        #undef PLACE
        #undef SHUFFLE
        #undef PICK
        #undef NOTHING
    #endif
"""
).replace("CELLS_AT_ONCE", "6")


@wp.func_native(_VALUE)
def sample(
    nodes: wp.array2d[node8],
    transition: int,
    levels: wp.array[wp.int32],
    level_count: int,
    px: float,
    py: float,
    pz: float,
) -> node8: ...


@wp.func_native(_VALUE_AND_DERIVATIVE)
def sample_with_derivative(
    nodes: wp.array2d[node8],
    transition: int,
    levels: wp.array[wp.int32],
    level_count: int,
    px: float,
    py: float,
    pz: float,
) -> sample_jacobian: ...


@wp.func_native(_PART)
def sample_part(
    nodes: wp.array2d[node8],
    transition: int,
    levels: wp.array[wp.int32],
    level_count: int,
    first: int,
    px: float,
    py: float,
    pz: float,
    onto: part_jacobian,
) -> part_jacobian: ...


@wp.func_native(_SCATTER)
def adj_sample(
    adj_nodes: wp.array2d[node8],
    transition: int,
    levels: wp.array[wp.int32],
    level_count: int,
    px: float,
    py: float,
    pz: float,
    adj_value: node8,
): ...
