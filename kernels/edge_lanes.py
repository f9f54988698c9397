"""The right-hand sides of ``rigidity`` as the CPU adds them up: rows of rotations as registers of four floats.

The vertex's own rotation is the same for all of its edges, so it waits for their sum:

    sum_j (R_i + R_j) e_ij = R_i sum_j e_ij + sum_j R_j e_ij

and rows are summed up across only once, at the end.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS
from warpdef.kernels.sizes import sizes

wp.set_module_options(MODULE_OPTIONS)

_BEGIN = """
#if !defined(__CUDA_ARCH__)
    typedef float four __attribute__((vector_size(16)));
    typedef float any __attribute__((vector_size(16), aligned(4)));
    // A row, or a place; or with the first number of the next row, which meets the zero behind an edge.
    const auto load = [](const float* at) { four v = {}; __builtin_memcpy(&v, at, 12); return v; };
    const auto row_of = [](const float* at) { return (four)*(const any*)at; };
    const size_t count = vertices.shape[1], own = i;
    const int begin = row.data[i], end = row.data[i + 1];
"""
_RIGID = (
    _BEGIN
    + """
    const float* const stiff = (const float*)stiffness.data;  // none: 1 everywhere, as in ``material``
    const float* const y = (const float*)rest.data;
    const float* const x = (const float*)vertices.data + 3 * t * count;
    const float* const turned = (const float*)rotation.data + 9 * t * count;
    const four yi = load(y + 3 * own), xi = load(x + 3 * own);
    four a = {}, b = {}, c = {}, edges = {}, there = {};
    for (int e = begin; e < end; ++e) {
        const size_t j = column.data[e];
        const float* const m = turned + 9 * j;
        const float weight = stiff ? 0.5f * (stiff[own] + stiff[j]) : 1.0f;
        const four edge = weight * (yi - load(y + 3 * j));
        a += row_of(m) * edge; b += row_of(m + 3) * edge; c += load(m + 6) * edge;
        edges += edge; there += weight * (xi - load(x + 3 * j));
    }
    const float* const m = turned + 9 * own;
    a += row_of(m) * edges; b += row_of(m + 3) * edges; c += load(m + 6) * edges;
    return wp::vec_t<3, wp::float32>(0.5f * (a[0] + a[1] + a[2]) - there[0], 0.5f * (b[0] + b[1] + b[2]) - there[1],
        0.5f * (c[0] + c[1] + c[2]) - there[2]);
#else
    return wp::vec_t<3, wp::float32>();
#endif
"""
)
_REST = (
    _BEGIN
    + """
    four total = {};
    for (int f = 0; f < frames.shape[0]; ++f) {
        const size_t t = frames.data[f];
        const float* const x = (const float*)vertices.data + 3 * t * count;
        const float* const turned = (const float*)rotation.data + 9 * t * count;
        const four xi = load(x + 3 * own);
        four edges = {};
        const auto turn_back = [&](const float* m, four edge) {
            total += row_of(m) * edge[0] + row_of(m + 3) * edge[1] + load(m + 6) * edge[2];
        };
        for (int e = begin; e < end; ++e) {
            const size_t j = column.data[e];
            const four edge = xi - load(x + 3 * j);
            edges += edge;
            turn_back(turned + 9 * j, edge);
        }
        turn_back(turned + 9 * own, edges);
    }
    total *= 0.5f / (float)frames.shape[0];
    return wp::vec_t<3, wp::float32>(total[0], total[1], total[2]);
#else
    return wp::vec_t<3, wp::float32>();
#endif
"""
)


@wp.func_native(_RIGID)
def rigid_sum(
    t: int,
    i: int,
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    stiffness: wp.array[wp.float32],
    rest: wp.array[wp.vec3],
    rotation: wp.array2d[wp.mat33],
    vertices: wp.array2d[wp.vec3],
) -> wp.vec3: ...


@wp.func_native(_REST)
def rest_sum(
    i: int,
    frames: wp.array[wp.int32],
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    rotation: wp.array2d[wp.mat33],
    vertices: wp.array2d[wp.vec3],
) -> wp.vec3: ...


@sizes("threads: T*V; row: V+1; column: E; stiffness: V?; rest: V; rotation vertices rhs_out: T V")
@wp.kernel
def rigid_rhs_in_lanes(
    # In:
    begin: int,
    weight: float,
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    stiffness: wp.array[wp.float32],
    rest: wp.array[wp.vec3],
    rotation: wp.array2d[wp.mat33],
    vertices: wp.array2d[wp.vec3],
    # Out, added to:
    rhs_out: wp.array2d[wp.vec3],
):
    """CPU: one thread a vertex of a frame."""
    k = begin + wp.tid()
    t = k // rest.shape[0]
    i = k - t * rest.shape[0]
    rhs_out[t, i] = rhs_out[t, i] + weight * rigid_sum(t, i, row, column, stiffness, rest, rotation, vertices)


@sizes("threads rhs_out: V; frames: A; row: V+1; column: E; rotation vertices: T V")
@wp.kernel
def rest_rhs_in_lanes(
    # In:
    begin: int,
    frames: wp.array[wp.int32],
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    rotation: wp.array2d[wp.mat33],
    vertices: wp.array2d[wp.vec3],
    # Out:
    rhs_out: wp.array[wp.vec3],
):
    """CPU: one thread a vertex."""
    i = begin + wp.tid()
    rhs_out[i] = rest_sum(i, frames, row, column, rotation, vertices)
