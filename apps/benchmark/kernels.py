"""Kernels that only the bench needs: single device functions on their own, and a measure of arithmetic speed."""

from __future__ import annotations

import warp as wp

from warpdef.kernels.cayley import rotate
from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.levels import node8
from warpdef.kernels.sizes import sizes
from warpdef.kernels.trilinear import adj_sample, sample

wp.set_module_options(MODULE_OPTIONS)

FLOPS_PER_ROUND = 160


@sizes("threads points transition value_out: N; nodes: S M; levels: 2*L; level_count: L")
@wp.kernel
def _sample_only(
    # In:
    begin: int,
    nodes: wp.array2d[node8],
    levels: wp.array[wp.int32],
    level_count: int,
    points: wp.array[wp.vec3],
    transition: wp.array[wp.int32],
    # Out:
    value_out: wp.array[node8],
):
    """One thread a point."""
    i = begin + wp.tid()
    x = points[i]
    value_out[i] = sample(nodes, transition[i], levels, level_count, x[0], x[1], x[2])


@sizes("threads points transition adj_value: N; levels: 2*L; level_count: L; adj_nodes_out: S M")
@wp.kernel
def _adj_sample_only(
    # In:
    begin: int,
    levels: wp.array[wp.int32],
    level_count: int,
    points: wp.array[wp.vec3],
    transition: wp.array[wp.int32],
    adj_value: wp.array[node8],
    # Out, added to:
    adj_nodes_out: wp.array2d[node8],
):
    """One thread a point."""
    i = begin + wp.tid()
    x = points[i]
    adj_sample(adj_nodes_out, transition[i], levels, level_count, x[0], x[1], x[2], adj_value[i])


@sizes("threads rotation points moved_out: N")
@wp.kernel
def _rotate_only(
    # In:
    begin: int,
    rotation: wp.array[wp.vec3],
    points: wp.array[wp.vec3],
    # Out:
    moved_out: wp.array[wp.vec3],
):
    """One thread a point."""
    i = begin + wp.tid()
    moved_out[i] = rotate(rotation[i], points[i])


_MULTIPLY_ADD = """
#if defined(__CUDA_ARCH__)
    float a[8];
    for (int k = 0; k < 8; ++k) a[k] = x + (float)k;
    for (int i = 0; i < 10 * rounds; ++i) {
        #pragma unroll
        for (int k = 0; k < 8; ++k) a[k] = a[k] * x + y;
    }
    float total = 0.0f;
    for (int k = 0; k < 8; ++k) total += a[k];
    return total;
#else
    typedef float reg __attribute__((vector_size(32)));
    reg a0 = {x}, a1 = {y}, a2 = {x}, a3 = {y}, a4 = {x}, a5 = {y}, a6 = {x}, a7 = {y}, a8 = {x}, a9 = {y};
    for (int i = 0; i < rounds; ++i) {
        a0 = a0 * x + y; a1 = a1 * x + y; a2 = a2 * x + y; a3 = a3 * x + y; a4 = a4 * x + y;
        a5 = a5 * x + y; a6 = a6 * x + y; a7 = a7 * x + y; a8 = a8 * x + y; a9 = a9 * x + y;
    }
    const reg t = a0 + a1 + a2 + a3 + a4 + a5 + a6 + a7 + a8 + a9;
    return t[0] + t[1] + t[2] + t[3] + t[4] + t[5] + t[6] + t[7];
#endif
"""


@wp.func_native(_MULTIPLY_ADD)
def multiply_adds(rounds: int, x: float, y: float) -> float: ...


@sizes("threads value_out: N")
@wp.kernel
def _multiply_adds(
    # In:
    rounds: int,
    x: float,
    y: float,
    # Out:
    value_out: wp.array[wp.float32],
):
    """One thread an entry: FLOPS_PER_ROUND operations a round, in registers of eight floats as all kernels use."""
    value_out[wp.tid()] = multiply_adds(rounds, x, y)


def sample_only(
    begin: int, count: int, nodes: wp.array, levels: wp.array, points: wp.array, transition: wp.array,
    value_out: wp.array,
) -> None:  # fmt: skip
    """The six-vectors at points; arguments as ``warpdef.kernels.motion.move_points``, value_out (N,) node8."""
    inputs = [begin, nodes, levels, len(levels) // 2, points, transition, value_out]
    launch(_sample_only, count, inputs, nodes.device)


def adj_sample_only(
    begin: int, count: int, levels: wp.array, points: wp.array, transition: wp.array, adj_value: wp.array,
    adj_nodes_out: wp.array,
) -> None:  # fmt: skip
    """Adjoint of ``sample_only``; adds to ``adj_nodes_out``, (S, M) node8."""
    inputs = [begin, levels, len(levels) // 2, points, transition, adj_value, adj_nodes_out]
    launch(_adj_sample_only, count, inputs, adj_nodes_out.device)


def rotate_only(begin: int, count: int, rotation: wp.array, points: wp.array, moved_out: wp.array) -> None:
    """R(z) x of each point; all arrays (N,) vec3."""
    launch(_rotate_only, count, [begin, rotation, points, moved_out], points.device)


def multiply_add_rounds(rounds: int, out: wp.array) -> None:
    """``rounds`` of multiply-adds an entry of ``out``, (N,) float32."""
    launch(_multiply_adds, len(out), [rounds, 0.999, 0.001, out], out.device)
