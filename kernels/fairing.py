"""Fairing of a shape: details finer than a few edges are taken out, and nothing shrinks (Taubin 1995).

    y_i <- y_i + f (mean of its neighbours - y_i)       with f = 0.5, then f = -0.53, and so on

Two such steps pass what is wider than about ten edges and halve what is as fine as the edges themselves.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.sizes import sizes

wp.set_module_options(MODULE_OPTIONS)


@sizes("threads: V; row: V+1; column: E; still: V; places places_out: V")
@wp.kernel
def _towards_mean(
    # In:
    begin: int,
    factor: float,
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    still: wp.array[wp.int32],
    places: wp.array[wp.vec3],
    # Out:
    places_out: wp.array[wp.vec3],
):
    """One thread a vertex."""
    i = begin + wp.tid()
    moved = places[i]
    count = row[i + 1] - row[i]
    if still[i] == 0 and count > 0:
        mean = wp.vec3(0.0, 0.0, 0.0)
        for e in range(row[i], row[i + 1]):
            mean += places[column[e]]
        moved += factor * (mean / float(count) - moved)
    places_out[i] = moved


def towards_mean(
    begin: int, count: int, factor: float, row: wp.array, column: wp.array, still: wp.array, places: wp.array,
    places_out: wp.array,
) -> None:  # fmt: skip
    """Vertices ``begin .. begin + count`` moved towards the mean of their neighbours, by ``factor`` of the way.

    Args:
        factor: below 0 away from it. row, column: neighbours, as in ``Graph``.
        still: shape (V,) int32, other than 0 for vertices that stay, as borders do.
        places, places_out: shape (V,) vec3, not the same array.
    """
    launch(_towards_mean, count, [begin, factor, row, column, still, places, places_out], places.device)
