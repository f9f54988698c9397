"""Pairs of vertices and cloud points, as all terms of the vertex stage ask about them: one direction of a search.

A vertex x with normal m and a cloud point q with normal n are paired by nearest neighbour. A pair has a common plane a
(symmetric point-to-plane, Rusinkiewicz 2019) and a weight:

    a = (s n + m) / |s n + m|,   w = exp(-(|x - q| / reach)^2)

which for s = 1 makes a . (x - q) vanish to second order on a curved surface, where the plain n does so to first order
only; s falls to 0 for noisy clouds, whose normals say less than the mesh's. Pairs whose normals differ by more than
``agreement`` (a cosine) have no plane: the other side of a thin limb is no partner. Against a cloud that shows only
part of the surface the vertices' own pairs are weighed by the way back, as in ``chamfer``.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.chamfer import BOTH_SIDES, OneSided, mutual_weight
from warpdef.kernels.launching import MODULE_OPTIONS
from warpdef.kernels.sizes import sizes

wp.set_module_options(MODULE_OPTIONS)


@sizes("vertices normals: P; frame nearest: K; cloud cloud_normals: N; back: N?; reach folded: T; mutual_reach: T?")
@wp.struct
class Pairs:
    """What ``pairs_of`` puts together. Without a way back ``back`` is empty."""

    agreement: float
    share: float
    reach: wp.array[wp.float32]
    folded: wp.array[wp.float32]
    vertices: wp.array[wp.vec3]
    normals: wp.array[wp.vec3]
    frame: wp.array[wp.int32]
    nearest: wp.array[wp.int32]
    cloud: wp.array[wp.vec3]
    cloud_normals: wp.array[wp.vec3]
    back: wp.array[wp.int32]
    mutual_reach: wp.array[wp.float32]


@wp.func
def pair_plane(pairs: Pairs, vertex: int, point: int) -> wp.vec3:
    """Common unit normal of a pair; zero where the two disagree."""
    n = pairs.cloud_normals[point]
    m = pairs.normals[vertex]
    a = wp.vec3(0.0, 0.0, 0.0)
    if wp.dot(n, m) > pairs.agreement:
        a = wp.normalize(pairs.share * n + m)
    return a


@wp.func
def pair_weight(pairs: Pairs, vertex: int, point: int, frame: int) -> float:
    """Weight of a pair by its distance."""
    reach = pairs.reach[frame]
    return wp.exp(-wp.length_sq(pairs.vertices[vertex] - pairs.cloud[point]) / (reach * reach))


@wp.func
def own_weight(pairs: Pairs, vertex: int, point: int, frame: int) -> float:
    """Weight of a vertex's own pair: by distance, and by the way back."""
    mutual = mutual_weight(pairs.vertices, vertex, pairs.back, point, pairs.mutual_reach, frame)
    return pair_weight(pairs, vertex, point, frame) * mutual


def pairs_of(
    pairing: tuple[float, float, wp.array, wp.array], vertices: wp.array, normals: wp.array, frame: wp.array,
    nearest: wp.array, cloud: wp.array, cloud_normals: wp.array, one_sided: OneSided = BOTH_SIDES,
) -> Pairs:  # fmt: skip
    """Pairs of one direction of a search; the arrays are taken as they are and read at every launch.

    Args:
        pairing: (agreement, share of the cloud's normal, reach, folded), the last two of shape (T,) float32: cube
            units; and the weight of a vertex's own pair that has no plane, along the cloud's normal (``planes``).
        vertices, normals: shape (T V,) vec3. cloud, cloud_normals: shape (N,) vec3, oriented.
        frame, nearest: of vertices, shape (T V,), or of cloud points, shape (N,), int32; nearest is -1 for none.
        one_sided: (back, reach): nearest vertex of every cloud point, shape (N,) int32, -1 for none; and shape (T,)
            float32, cube units, infinite for frames that show all of the surface.
    """
    pairs = Pairs()
    pairs.agreement, pairs.share, pairs.reach, pairs.folded = pairing
    pairs.vertices, pairs.normals = vertices, normals
    pairs.frame, pairs.nearest = frame, nearest
    pairs.cloud, pairs.cloud_normals = cloud, cloud_normals
    pairs.back, pairs.mutual_reach = one_sided
    return pairs
