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


_forced: Way | None = None


def way_of(device: wp.Device) -> Way:
    """CUDA's on CUDA; on the CPU its own, or inside ``going`` the one asked for."""
    return (_forced or Way.SPANS) if device.is_cpu else Way.WHOLE


@contextmanager
def going(way: Way) -> Iterator[None]:
    """Let what is built for the CPU in the block go this way."""
    global _forced
    outer, _forced = _forced, way
    try:
        yield
    finally:
        _forced = outer
