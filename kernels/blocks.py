"""Blocks: threads that work on one system together, wait for one another, and add up what each has found.

    for i in range(first + lane(), end, lanes()): ...    every lane its share
    total = block_sum(mine)                              the same bits in every lane
    wait()                                               what others have written can be read

On CUDA a block has ``LANES`` lanes. On the CPU it has one, which has all shares and waits for nobody, so that the same
kernel is a serial loop there; a test may ask for more (``ways.going``), which Warp then runs as fibers. Every lane must
come to every sum and every wait: they stand under conditions only where all lanes answer alike. Sums are added up in a
fixed order: no float atomics, and the same bits in every run. A kernel for blocks is compiled for its own number of
lanes, hence a module of its own (``block_options``), and is launched with ``lanes_of`` its device.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS
from warpdef.kernels.levels import node8
from warpdef.kernels.ways import LANES

wp.set_module_options(MODULE_OPTIONS)


def block_options(lanes: int = LANES, cluster: int = 1) -> dict[str, Any]:
    """Of a kernel for blocks of so many lanes: its module, and registers for as many; blocks of a cluster."""
    options = {"module": "unique", "launch_bounds": (lanes, 1), "cluster_dim": cluster}
    return {**options, "module_options": MODULE_OPTIONS | {"block_dim": lanes}}


@wp.func_native("return WP_TILE_THREAD_IDX;")
def lane() -> int: ...


@wp.func_native("return WP_TILE_BLOCK_DIM;")
def lanes() -> int: ...


@wp.func_native("WP_TILE_SYNC();")
def wait(): ...


# Every warp by itself, then the warps' results: first through registers, then through shared memory. VALUE is of type
# TYPE with COUNT components, AT(v, c) is one of them, JOIN puts two together and NOTHING changes nothing.
_REDUCE = """
#if defined(__CUDA_ARCH__)
    __shared__ float part[32][COUNT];
    const int place = threadIdx.x % 32, warp = threadIdx.x / 32;
    TYPE total = value;
    for (int c = 0; c < COUNT; ++c) {
        float v = AT(value, c);
        for (int o = 16; o > 0; o /= 2) { const float w = __shfl_xor_sync(0xffffffffu, v, o); v = JOIN(v, w); }
        if (place == 0) part[warp][c] = v;
    }
    __syncthreads();
    for (int c = 0; c < COUNT; ++c) {
        float v = place < WP_TILE_BLOCK_DIM / 32 ? part[place][c] : NOTHING;
        for (int o = 16; o > 0; o /= 2) { const float w = __shfl_xor_sync(0xffffffffu, v, o); v = JOIN(v, w); }
        AT(total, c) = v;
    }
    __syncthreads();
    return total;
#else
    if (WP_TILE_BLOCK_DIM == 1) return value;
    struct parts { TYPE of[WP_TILE_BLOCK_DIM]; };
    wp::wp_block_shared<parts> shared;
    shared->of[WP_TILE_THREAD_IDX] = value;
    WP_TILE_SYNC();
    TYPE total = shared->of[0];
    for (int l = 1; l < WP_TILE_BLOCK_DIM; ++l)
        for (int c = 0; c < COUNT; ++c) AT(total, c) = JOIN(AT(total, c), AT(shared->of[l], c));
    WP_TILE_SYNC();
    return total;
#endif
"""
_ADD = "#define JOIN(a, b) ((a) + (b))\n#define NOTHING 0.0f\n"
_MAX = "#define JOIN(a, b) ((a) > (b) ? (a) : (b))\n#define NOTHING (-3.0e38f)\n"
_SCALAR = "#define AT(v, c) (v)\n#define COUNT 1\n#define TYPE float\n"
_VECTOR = "#define AT(v, c) ((v)[c])\n#define COUNT WIDTH\n#define TYPE wp::vec_t<WIDTH, wp::float32>\n"
_FORGET = "\n#undef JOIN\n#undef NOTHING\n#undef AT\n#undef COUNT\n#undef TYPE\n"


@wp.func_native(_MAX + _SCALAR + _REDUCE + _FORGET)
def block_max(value: float) -> float: ...


@wp.func_native(_ADD + _VECTOR.replace("WIDTH", "3") + _REDUCE + _FORGET)
def block_sum(value: wp.vec3) -> wp.vec3: ...


@wp.func_native(_ADD + _VECTOR.replace("WIDTH", "8") + _REDUCE + _FORGET)
def block_sum(value: node8) -> node8: ...  # noqa: F811 - an overload, for Warp


# What all lanes before this one have together, and what all lanes have.
@wp.func_native("""
#if defined(__CUDA_ARCH__)
    __shared__ int part[32];
    const int place = threadIdx.x % 32, warp = threadIdx.x / 32;
    int up_to = value;
    for (int o = 1; o < 32; o *= 2) {
        const int v = __shfl_up_sync(0xffffffffu, up_to, o);
        if (place >= o) up_to += v;
    }
    if (place == 31) part[warp] = up_to;
    __syncthreads();
    int before = up_to - value, total = 0;
    for (int w = 0; w < WP_TILE_BLOCK_DIM / 32; ++w) { before += w < warp ? part[w] : 0; total += part[w]; }
    __syncthreads();
    return wp::vec_t<2, wp::int32>(before, total);
#else
    if (WP_TILE_BLOCK_DIM == 1) return wp::vec_t<2, wp::int32>(0, value);
    struct parts { int of[WP_TILE_BLOCK_DIM]; };
    wp::wp_block_shared<parts> shared;
    shared->of[WP_TILE_THREAD_IDX] = value;
    WP_TILE_SYNC();
    int before = 0, total = 0;
    for (int l = 0; l < WP_TILE_BLOCK_DIM; ++l) {
        before += l < WP_TILE_THREAD_IDX ? shared->of[l] : 0;
        total += shared->of[l];
    }
    WP_TILE_SYNC();
    return wp::vec_t<2, wp::int32>(before, total);
#endif
""")
def sum_before(value: int) -> wp.vec2i: ...
