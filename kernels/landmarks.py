"""Known correspondences: places on the mesh drawn to where they are known to be in a frame.

    E = h sum_k | p_k - q_k |^2,   p_k = sum_c b_c x_c,
    A_i += h b_i I,   b_i += h b_i (q_k - p_k)          for each corner i of landmark k

x_c the corners of the triangle that it lies in, b_c its barycentric coordinates there, q_k its known place. The
coordinates add up to 1, so that A bounds the term's own matrix b b^T from above: a step never overshoots.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.sizes import sizes

wp.set_module_options(MODULE_OPTIONS)


@sizes("threads slot: S; row: S+1; member share: E; corners parts: L 3; places: L; vertices matrix_out rhs_out: P")
@wp.kernel
def _draw_to_landmarks(
    # In:
    begin: int,
    weight: float,
    slot: wp.array[wp.int32],
    row: wp.array[wp.int32],
    member: wp.array[wp.int32],
    share: wp.array[wp.float32],
    corners: wp.array2d[wp.int32],
    parts: wp.array2d[wp.float32],
    places: wp.array[wp.vec3],
    vertices: wp.array[wp.vec3],
    # Out, added to:
    matrix_out: wp.array[wp.mat33],
    rhs_out: wp.array[wp.vec3],
):
    """One thread a vertex of a frame that landmarks ask for."""
    s = begin + wp.tid()
    total = float(0.0)
    drawn = wp.vec3(0.0, 0.0, 0.0)
    for e in range(row[s], row[s + 1]):
        k = member[e]
        p = wp.vec3(0.0, 0.0, 0.0)
        for c in range(3):
            p += parts[k, c] * vertices[corners[k, c]]
        total += share[e]
        drawn += share[e] * (places[k] - p)
    i = slot[s]
    matrix_out[i] = matrix_out[i] + weight * total * wp.identity(n=3, dtype=float)
    rhs_out[i] = rhs_out[i] + weight * drawn


def draw_to_landmarks(
    begin: int, count: int, weight: float, slot: wp.array, row: wp.array, member: wp.array, share: wp.array,
    corners: wp.array, parts: wp.array, places: wp.array, vertices: wp.array, matrix_out: wp.array,
    rhs_out: wp.array,
) -> None:  # fmt: skip
    """Add what landmarks ask of ``count`` of their vertices, from ``begin``.

    Args:
        weight: of a landmark against one plane.
        slot: shape (S,) int32, the vertices asked, counted over all frames. row: shape (S + 1,) int32.
        member, share: landmark and barycentric coordinate of each entry of a row, shape (E,).
        corners: shape (L, 3) int32, counted over all frames. parts: shape (L, 3) float32. places: shape (L,) vec3.
        vertices, rhs_out: shape (T V,) vec3. matrix_out: shape (T V,) mat33.
    """
    inputs = [begin, weight, slot, row, member, share, corners, parts, places, vertices, matrix_out, rhs_out]
    launch(_draw_to_landmarks, count, inputs, vertices.device)
