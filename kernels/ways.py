"""Which way work goes on a device: in serial spans, or whole. The one place that decides it.

The CPU runs a launch as one serial loop, so work is cut into spans, which threads share; what a span adds up it adds
alone, in order. CUDA takes a launch over everything, one thread an element, and adds up atomically. Whatever has two
forms asks here once, when it is built. The CPU can go CUDA's way, too, which is how that way is tested without CUDA.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum

import warp as wp

VERTICES_PER_TASK = 1024
"""Of a mesh, where work goes in spans of vertices."""


class Way(Enum):
    """SPANS: serial spans, a task each. WHOLE: one launch over everything."""

    SPANS = "spans"
    WHOLE = "whole"

    def cut(self, total: int, size: int = 1) -> list[tuple[int, int]]:
        """``0 .. total`` as spans (first, last) that are tasks of their own: of ``size``, or one over everything."""
        if self is Way.WHOLE:
            size = max(total, 1)
        return [(a, min(a + size, total)) for a in range(0, total, size)]


LANES = 768
"""Threads of a block that work on one system together (``blocks``), on CUDA: as many as have 80 registers each."""

_forced: Way | None = None
_forced_lanes = 1


def way_of(device: wp.Device) -> Way:
    """CUDA's on CUDA; on the CPU its own, or inside ``going`` the one asked for."""
    return (_forced or Way.SPANS) if device.is_cpu else Way.WHOLE


def lanes_of(device: wp.Device, wanted: int = LANES) -> int:
    """Threads of a block: those wanted on CUDA; on the CPU one, or inside ``going`` as many as asked for."""
    return _forced_lanes if device.is_cpu else wanted


def cluster_of(device: wp.Device, wanted: int) -> int:
    """Blocks of a cluster: those wanted where a device has clusters, else one."""
    return 1 if device.is_cpu or device.arch < 90 else wanted


@contextmanager
def going(way: Way, lanes: int = 1) -> Iterator[None]:
    """Let what is built for the CPU in the block go this way; more than one lane only where it runs in the block, too.

    Args:
        lanes: threads of a block on the CPU, where Warp runs them as fibers, one after the other between two waits.
    """
    global _forced, _forced_lanes
    outer = _forced, _forced_lanes, wp.config.enable_cpu_blocks
    _forced, _forced_lanes, wp.config.enable_cpu_blocks = way, lanes, lanes > 1
    try:
        yield
    finally:
        _forced, _forced_lanes, wp.config.enable_cpu_blocks = outer
