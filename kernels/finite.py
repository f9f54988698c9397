"""Whether an array holds nothing but finite numbers, found where the array lies. No gradient."""

from __future__ import annotations

from typing import Any

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.levels import node8
from warpdef.kernels.sizes import sizes

wp.set_module_options(MODULE_OPTIONS)


@sizes("threads array: N; flag_out: 1")
@wp.kernel
def _flag_not_finite(
    # In:
    array: wp.array[Any],
    # Out:
    flag_out: wp.array[wp.int32],
):
    """One thread an entry; all that write, write the same."""
    a = array[wp.tid()]
    # x - x is 0 for every finite number, and NaN for NaN and infinity.
    if not wp.dot(a - a, a - a) == 0.0:
        flag_out[0] = 1


for _dtype in (node8, wp.vec3):
    wp.overload(_flag_not_finite, [wp.array[_dtype], wp.array[wp.int32]])


def flag_not_finite(array: wp.array, flag_out: wp.array) -> None:
    """Set ``flag_out[0]`` to 1 if ``array`` holds NaN or infinity; else leave it.

    Args:
        array: node8 or vec3, any shape. flag_out: shape (1,) int32.
    """
    flat = array.flatten()
    launch(_flag_not_finite, len(flat), [flat, flag_out], array.device)
