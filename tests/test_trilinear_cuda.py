"""What CUDA compiles of the samplers, compiled for the CPU: the same text with CUDA's own words explained to it.

Warps, which a CPU has not, are never complete here, so every thread adds on its own: what they do together is in
``test_warp_sums``.
"""

from __future__ import annotations

import numpy as np
import pytest
import reference
import warp as wp
import witness
from gradients import assert_gradients_close

from warpdef.kernels import trilinear
from warpdef.kernels.levels import LevelTable, node8
from warpdef.kernels.trilinear import sample_jacobian

CUDA_WORDS = """
    #define AS_CUDA 800
    #define __device__
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
LEVELS = reference.resolutions(1, 4)
NODES = int(reference.offsets(LEVELS)[-1])


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


@wp.func_native(for_cpu(trilinear._SCATTER))
def add_to(
    adj_nodes: wp.array2d[node8], transition: int, levels: wp.array[wp.int32], level_count: int, px: float, py: float,
    pz: float, adj_value: node8,
): ...  # fmt: skip


@wp.kernel(module="unique", module_options={"enable_backward": False})
def sample_all(
    nodes: wp.array2d[node8], levels: wp.array[wp.int32], points: wp.array[wp.vec3], adj: wp.array[node8],
    value: wp.array[node8], derivative: wp.array[sample_jacobian], adj_nodes: wp.array2d[node8],
):  # fmt: skip
    i = wp.tid()
    p = points[i]
    count = levels.shape[0] // 2
    value[i] = value_of(nodes, 1, levels, count, p[0], p[1], p[2])
    derivative[i] = derivative_of(nodes, 1, levels, count, p[0], p[1], p[2])
    add_to(adj_nodes, 1, levels, count, p[0], p[1], p[2], adj[i])


@pytest.mark.parametrize("reach", [0.95, 1.4])
def test_the_text_for_cuda_is_the_twin(reach: float, rng: np.random.Generator) -> None:
    """Points inside the cube, and some outside, where an axis is clamped."""
    nodes, points = rng.normal(size=(2, NODES, 6)), rng.uniform(-reach, reach, (200, 3)).astype(np.float32)
    adj = rng.normal(size=(200, 6))
    levels = LevelTable.build(1, 4).to_device(wp.get_device("cpu"))
    value, derivative, adj_nodes = (
        wp.zeros(shape, dtype=dtype, device="cpu")
        for shape, dtype in ((200, node8), (200, sample_jacobian), ((2, NODES), node8))
    )
    on_device = [wp.array(witness.pad(a), dtype=node8, ndim=a.ndim - 1, device="cpu") for a in (nodes, adj)]
    places = wp.array(points, dtype=wp.vec3, device="cpu")
    inputs = [on_device[0], levels, places, on_device[1], value, derivative, adj_nodes]
    wp.launch(sample_all, dim=200, inputs=inputs, device="cpu")
    places = points.astype(np.float64)
    np.testing.assert_allclose(value.numpy()[:, :6], reference.sample(nodes[1], LEVELS, places), rtol=0, atol=3e-6)
    found = derivative.numpy()[..., :6]
    np.testing.assert_allclose(found[:, 0], reference.sample(nodes[1], LEVELS, places), rtol=0, atol=3e-6)
    expected = reference.sample_derivative(nodes[1], LEVELS, places)
    np.testing.assert_allclose(found[:, 1:], expected, rtol=0, atol=2e-5)
    assert_gradients_close(adj_nodes.numpy()[1, :, :6], reference.adj_sample(LEVELS, places, adj))
    assert (adj_nodes.numpy()[0] == 0).all()
