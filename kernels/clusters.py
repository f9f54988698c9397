"""Clusters: blocks that work on one system together, on devices that have them (sm_90 and later).

A system that one block has to itself uses one multiprocessor; a cluster of eight blocks uses eight. To a kernel it is a
block with eight times the lanes: the same loops, waits and sums as in ``blocks``. A sum goes over each block, whose
result it leaves in memory, then over blocks, in a fixed order. So that a quick block does not overwrite what a slow one
still reads, a sum has a slot: the next two sums must have others.

Hardware starts all blocks of a cluster at the same time or none, so that waiting for one another cannot hang. On other
devices and on the CPU a cluster is one block.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.blocks import block_sum
from warpdef.kernels.launching import MODULE_OPTIONS
from warpdef.kernels.levels import node8

wp.set_module_options(MODULE_OPTIONS)

CLUSTER = 8
"""Blocks of a cluster: as many as every device that has clusters allows."""
SLOTS = 3
PARTIAL = SLOTS * CLUSTER
"""What blocks leave for one another, ``partial``, a system."""

_RANK = """
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900
    int rank, size;
    asm("mov.u32 %0, %%cluster_ctarank;" : "=r"(rank));
    asm("mov.u32 %0, %%cluster_nctarank;" : "=r"(size));
#else
    const int rank = 0, size = 1;
#endif
"""


@wp.func_native(
    _RANK + "return size > 1 ? rank * WP_TILE_BLOCK_DIM + (int)WP_TILE_THREAD_IDX : (int)WP_TILE_THREAD_IDX;"
)
def cluster_lane() -> int: ...


@wp.func_native(_RANK + "(void)rank; return size * WP_TILE_BLOCK_DIM;")
def cluster_lanes() -> int: ...


_WAIT = """
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900
    asm volatile("barrier.cluster.arrive.release;" ::: "memory");
    asm volatile("barrier.cluster.wait.acquire;" ::: "memory");
#else
    WP_TILE_SYNC();
#endif
"""


@wp.func_native(_WAIT)
def cluster_wait(): ...


# The sum of all blocks from that of each, which every lane of it has.
_ACROSS = (
    _RANK
    + """
    if (size == 1) return value;
    auto* const of_blocks = partial.data + ((size_t)system * SLOTS + slot) * CLUSTER;
    if (WP_TILE_THREAD_IDX == 0) of_blocks[rank] = value;
""".replace("SLOTS", str(SLOTS)).replace("CLUSTER", str(CLUSTER))
    + _WAIT
    + """
    auto total = of_blocks[0];
    for (int b = 1; b < size; ++b) total = total + of_blocks[b];
    return total;
"""
)


@wp.func_native(_ACROSS)
def across_blocks(value: wp.vec3, system: int, slot: int, partial: wp.array[wp.vec3]) -> wp.vec3: ...


@wp.func_native(_ACROSS)
def across_blocks(value: node8, system: int, slot: int, partial: wp.array[node8]) -> node8: ...  # noqa: F811


@wp.func
def cluster_sum(value: wp.vec3, system: int, slot: int, partial: wp.array[wp.vec3]) -> wp.vec3:
    """Of all lanes, the same bits in each."""
    return across_blocks(block_sum(value), system, slot, partial)


@wp.func
def cluster_sum(value: node8, system: int, slot: int, partial: wp.array[node8]) -> node8:  # noqa: F811
    return across_blocks(block_sum(value), system, slot, partial)
