"""Winding number of a cloud of oriented points: about 1 inside, 0 outside (Barill et al. 2018, without their tree).

    w(x) = sum_i a_i n_i . (p_i - x) / (4 pi |p_i - x|^3)

with the area a_i that point i stands for. Every pair is added, in the points' order: for a coarse grid that is cheap.
A point at x itself has no direction and adds nothing. No gradient.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.sizes import sizes

wp.set_module_options(MODULE_OPTIONS)


@sizes("threads places winding_out: K; points area_normals: N")
@wp.kernel
def _winding_numbers(
    # In:
    begin: int,
    points: wp.array[wp.vec3],
    area_normals: wp.array[wp.vec3],
    places: wp.array[wp.vec3],
    # Out:
    winding_out: wp.array[wp.float32],
):
    """One thread a place."""
    k = begin + wp.tid()
    x = places[k]
    total = float(0.0)
    for i in range(points.shape[0]):
        d = points[i] - x
        r_sq = wp.length_sq(d)
        if r_sq > 1.0e-20:
            total = total + wp.dot(area_normals[i], d) / (r_sq * wp.sqrt(r_sq))
    winding_out[k] = total / (4.0 * wp.PI)


def winding_numbers(
    begin: int, count: int, points: wp.array, area_normals: wp.array, places: wp.array, winding_out: wp.array,
) -> None:  # fmt: skip
    """Winding numbers at ``count`` places from ``begin``.

    Args:
        points, area_normals: shape (N,) vec3, normals outward, as long as their point's area.
        places: shape (K,) vec3. winding_out: shape (K,) float32.
    """
    launch(_winding_numbers, count, [begin, points, area_normals, places, winding_out], points.device)
