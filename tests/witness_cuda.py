"""Kernels of the text that CUDA compiles of the samplers, for the CPU; ``test_trilinear_cuda`` says what for."""

from __future__ import annotations

import warp as wp

from warpdef.kernels import trilinear
from warpdef.kernels.levels import node8
from warpdef.kernels.trilinear import part_jacobian, sample_jacobian

CUDA_WORDS = """
    #define AS_CUDA 800
    #define __device__
    struct float2 { float x, y; };
    #define make_float4(x, y, z, w) float4{x, y, z, w}
    const auto atomicAdd = [](float* p, float v) { *p += v; };
    const auto __activemask = []() { return 0u; };
    const auto __match_any_sync = [](unsigned, unsigned long long) { return 0u; };
    const auto __ballot_sync = [](unsigned, bool) { return 0u; };
    const auto __shfl_sync = [](unsigned, unsigned long long v, int) { return v; };
    const auto __shfl_xor_sync = [](unsigned, float v, int) { return v; };
    #define __ffs(v) __builtin_ffs(v)
    #define __popc(v) __builtin_popcount(v)
    struct { int x; } const threadIdx = {0};
    (void)atomicAdd; (void)__activemask; (void)__match_any_sync; (void)__ballot_sync; (void)__shfl_sync;
    (void)__shfl_xor_sync; (void)threadIdx;
"""
FORGET = "\n".join(f"#undef {w}" for w in ("AS_CUDA", "__device__", "make_float4", "__ffs", "__popc"))


def for_cpu(text: str) -> str:
    """Macros of CUDA's branch are not to reach the next snippet."""
    macros = ("LOAD", "UNPACK", "STORE", "ADD", "ADD_FOUR", "ADD_TWO", "ZERO")
    undo = "\n".join(f"#undef {m}" for m in macros)
    body = text.replace("__CUDA_ARCH__", "AS_CUDA").replace("return result;", f"{undo}\n{FORGET}\nreturn result;")
    return CUDA_WORDS + body + ("" if "return result;" in text else f"\n{undo}\n{FORGET}\n")


@wp.func_native(for_cpu(trilinear._VALUE))
def value_of(
    nodes: wp.array2d[node8], transition: int, levels: wp.array[wp.int32], level_count: int, px: float, py: float,
    pz: float,
) -> node8: ...  # fmt: skip


@wp.func_native(for_cpu(trilinear._VALUE_AND_DERIVATIVE))
def derivative_of(
    nodes: wp.array2d[node8], transition: int, levels: wp.array[wp.int32], level_count: int, px: float, py: float,
    pz: float,
) -> sample_jacobian: ...  # fmt: skip


@wp.func_native(for_cpu(trilinear._PART))
def part_of(
    nodes: wp.array2d[node8], transition: int, levels: wp.array[wp.int32], level_count: int, first: int, px: float,
    py: float, pz: float, onto: part_jacobian,
) -> part_jacobian: ...  # fmt: skip


@wp.func_native(for_cpu(trilinear._SCATTER))
def add_to(
    adj_nodes: wp.array2d[node8], transition: int, levels: wp.array[wp.int32], level_count: int, px: float, py: float,
    pz: float, adj_value: node8,
): ...  # fmt: skip


@wp.kernel(module="unique", module_options={"enable_backward": False})
def sample_all(
    nodes: wp.array2d[node8], levels: wp.array[wp.int32], points: wp.array[wp.vec3], adj: wp.array[node8],
    value: wp.array[node8], derivative: wp.array[sample_jacobian], adj_nodes: wp.array2d[node8],
    parts: wp.array2d[part_jacobian],
):  # fmt: skip
    i = wp.tid()
    p = points[i]
    count = levels.shape[0] // 2
    value[i] = value_of(nodes, 1, levels, count, p[0], p[1], p[2])
    derivative[i] = derivative_of(nodes, 1, levels, count, p[0], p[1], p[2])
    for half in range(2):
        parts[half, i] = part_of(nodes, 1, levels, count, 3 * half, p[0], p[1], p[2], parts[half, i])
    add_to(adj_nodes, 1, levels, count, p[0], p[1], p[2], adj[i])
