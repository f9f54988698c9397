"""Elementary work on arrays, recordable like any launch: clear, copy, add, blend, go on. Linear: no adjoints."""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.levels import node8
from warpdef.kernels.sizes import sizes

wp.set_module_options(MODULE_OPTIONS)


@sizes("threads array_out: N")
@wp.kernel
def _clear(
    # In:
    begin: int,
    # Out:
    array_out: wp.array[wp.float64],
):
    array_out[begin + wp.tid()] = wp.float64(0.0)


@sizes("threads array_out: N")
@wp.kernel
def _clear_rows(
    # In:
    begin: int,
    # Out:
    array_out: wp.array[wp.vec3],
):
    array_out[begin + wp.tid()] = wp.vec3(0.0, 0.0, 0.0)


@sizes("threads: V; array_out: T V")
@wp.kernel
def _clear_columns(
    # In:
    begin: int,
    # Out:
    array_out: wp.array2d[wp.vec3],
):
    i = begin + wp.tid()
    for t in range(array_out.shape[0]):
        array_out[t, i] = wp.vec3(0.0, 0.0, 0.0)


@sizes("threads source target_out: N")
@wp.kernel
def _copy(
    # In:
    source: wp.array[wp.vec3],
    # Out:
    target_out: wp.array[wp.vec3],
):
    i = wp.tid()
    target_out[i] = source[i]


@sizes("threads change target_out: N")
@wp.kernel
def _add_scaled(
    # In:
    begin: int,
    scale: float,
    change: wp.array[wp.vec3],
    # Out, added to:
    target_out: wp.array[wp.vec3],
):
    i = begin + wp.tid()
    target_out[i] = target_out[i] + scale * change[i]


@sizes("threads source target: N")
@wp.kernel
def _blend(
    # In:
    share: float,
    source: wp.array[wp.vec3],
    # In and out:
    target: wp.array[wp.vec3],
):
    i = wp.tid()
    target[i] = target[i] + share * (source[i] - target[i])


@sizes("threads earlier places: N")
@wp.kernel
def _go_on(
    # In:
    begin: int,
    share: float,
    # In and out:
    earlier: wp.array[wp.vec3],
    places: wp.array[wp.vec3],
):
    i = begin + wp.tid()
    place = places[i]
    places[i] = place + share * (place - earlier[i])
    earlier[i] = place


@sizes("threads array_out: N")
@wp.kernel
def _clear_nodes(
    # In:
    begin: int,
    # Out:
    array_out: wp.array[node8],
):
    array_out[begin + wp.tid()] = node8()


def clear_losses(begin: int, count: int, array: wp.array) -> None:
    """Zero a span of a float64 array."""
    launch(_clear, count, [begin, array], array.device)


def clear_vectors(begin: int, count: int, array: wp.array) -> None:
    """Zero a span of a vec3 array."""
    launch(_clear_rows, count, [begin, array], array.device)


def clear_columns(begin: int, count: int, array: wp.array) -> None:
    """Zero columns of a two-dimensional vec3 array, in all rows."""
    launch(_clear_columns, count, [begin, array], array.device)


def copy_vectors(source: wp.array, target_out: wp.array) -> None:
    """Copy a vec3 array, recordable like any launch."""
    launch(_copy, len(source), [source, target_out], source.device)


def add_scaled(begin: int, count: int, scale: float, change: wp.array, target_out: wp.array) -> None:
    """``target += scale change`` for a span of a vec3 array."""
    launch(_add_scaled, count, [begin, scale, change, target_out], target_out.device)


def blend(share: float, source: wp.array, target_out: wp.array) -> None:
    """``target += share (source - target)``; a share above 1 overshoots."""
    launch(_blend, len(source), [share, source, target_out], target_out.device)


def go_on(begin: int, count: int, share: float, earlier: wp.array, places: wp.array) -> None:
    """A span of places moved on by ``share`` of their way from ``earlier``, which then is where they were."""
    launch(_go_on, count, [begin, share, earlier, places], places.device)


def clear_nodes(begin: int, count: int, array: wp.array) -> None:
    """Zero a span of a node8 array."""
    launch(_clear_nodes, count, [begin, array], array.device)
