"""Surface vertices of marching tetrahedra on a deforming grid, and their adjoint (Doi and Koide 1991; DMTet 2021).

A node i rests at r_i and carries a signed distance s_i, below 0 inside, and an offset o_i. Edges whose ends lie on
different sides are crossed, each by one vertex v:

    x_i = r_i + bound tanh(o_i)
    v = (1 - t) x_i + t x_j,    t = s_i / (s_i - s_j)
    adjoint: adj x_i += (1 - t) adj v,  adj x_j += t adj v,  adj o_i += bound (1 - tanh^2 o_i) adj x_i
             adj s_i += -s_j / (s_i - s_j)^2 a,  adj s_j += s_i / (s_i - s_j)^2 a,  a = (x_j - x_i) . adj v

A node exactly on the surface (s = 0) counts as outside; all its crossed edges meet in it. Where the ends differ by less
than ``STEEPNESS_MIN`` the vertex sits halfway and says nothing about s. Not differentiated: which edges are crossed.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.levels import node8
from warpdef.kernels.sizes import sizes

wp.set_module_options(MODULE_OPTIONS)

STEEPNESS_MIN = wp.constant(1.0e-4)
DISTANCE = wp.constant(0)  # component of a node's field; its offset are the three behind it


@wp.func
def offset_of(field: node8) -> wp.vec3:
    return wp.vec3(field[1], field[2], field[3])


@wp.func
def bounded(o: wp.vec3, bound: float) -> wp.vec3:
    return bound * wp.vec3(wp.tanh(o[0]), wp.tanh(o[1]), wp.tanh(o[2]))


@wp.func
def adj_bounded(o: wp.vec3, bound: float, adj: wp.vec3) -> wp.vec3:
    h = bounded(o, 1.0)
    return bound * (adj - wp.cw_mul(wp.cw_mul(h, h), adj))


@wp.func
def crossing(s_i: float, s_j: float) -> float:
    """Where on the edge the surface is, 0 at i, 1 at j."""
    t = float(0.5)
    if wp.abs(s_i - s_j) >= STEEPNESS_MIN:
        t = s_i / (s_i - s_j)
    return t


@wp.func
def adj_crossing(s_i: float, s_j: float, adj: float) -> wp.vec2:
    """To s_i and to s_j."""
    d = s_i - s_j
    g = wp.vec2(0.0, 0.0)
    if wp.abs(d) >= STEEPNESS_MIN:
        g = (adj / (d * d)) * wp.vec2(-s_j, s_i)
    return g


@sizes("threads vertices_out outward_out: E; edges: E 2; rest field: N")
@wp.kernel
def _surface_vertices(
    # In:
    begin: int,
    edges: wp.array2d[wp.int32],
    rest: wp.array[wp.vec3],
    field: wp.array[node8],
    bound: float,
    # Out:
    vertices_out: wp.array[wp.vec3],
    outward_out: wp.array[wp.vec3],
):
    """One thread a crossed edge."""
    e = begin + wp.tid()
    i = edges[e, 0]
    j = edges[e, 1]
    x_i = rest[i] + bounded(offset_of(field[i]), bound)
    x_j = rest[j] + bounded(offset_of(field[j]), bound)
    s_i = field[i][DISTANCE]
    s_j = field[j][DISTANCE]
    t = crossing(s_i, s_j)
    vertices_out[e] = (1.0 - t) * x_i + t * x_j
    along = wp.normalize(x_j - x_i)
    if s_i >= 0.0:
        along = -along
    outward_out[e] = along


@sizes("threads adj_vertices: E; edges: E 2; rest field adj_field_out: N")
@wp.kernel
def _adj_surface_vertices(
    # In:
    begin: int,
    edges: wp.array2d[wp.int32],
    rest: wp.array[wp.vec3],
    field: wp.array[node8],
    bound: float,
    adj_vertices: wp.array[wp.vec3],
    # Out, added to:
    adj_field_out: wp.array[node8],
):
    """One thread a crossed edge; its gradient lands on both nodes, which other edges share."""
    e = begin + wp.tid()
    i = edges[e, 0]
    j = edges[e, 1]
    adj = adj_vertices[e]
    o_i = offset_of(field[i])
    o_j = offset_of(field[j])
    d = (rest[j] + bounded(o_j, bound)) - (rest[i] + bounded(o_i, bound))
    s_i = field[i][DISTANCE]
    s_j = field[j][DISTANCE]
    t = crossing(s_i, s_j)
    g = adj_crossing(s_i, s_j, wp.dot(d, adj))
    to_i = adj_bounded(o_i, bound, (1.0 - t) * adj)
    to_j = adj_bounded(o_j, bound, t * adj)
    wp.atomic_add(adj_field_out, i, node8(g[0], to_i[0], to_i[1], to_i[2], 0.0, 0.0, 0.0, 0.0))
    wp.atomic_add(adj_field_out, j, node8(g[1], to_j[0], to_j[1], to_j[2], 0.0, 0.0, 0.0, 0.0))


@sizes("threads sides nearest: Q; target_sides: N")
@wp.kernel
def _part_opposed(
    # In:
    begin: int,
    sides: wp.array[wp.vec3],
    target_sides: wp.array[wp.vec3],
    # In and out:
    nearest: wp.array[wp.int32],
):
    """One thread a query."""
    i = begin + wp.tid()
    j = nearest[i]
    if j >= 0:
        if wp.dot(sides[i], target_sides[j]) <= 0.0:
            nearest[i] = -1


def surface_vertices(
    begin: int, count: int, edges: wp.array, rest: wp.array, field: wp.array, bound: float, vertices_out: wp.array,
    outward_out: wp.array,
) -> None:  # fmt: skip
    """One vertex for each of ``count`` crossed edges from ``begin``, and the edge's direction from inside to outside.

    On a flat surface that direction and the outward normal never make more than a right angle.

    Args:
        edges: shape (E, 2) int32, nodes on different sides. rest: shape (N,) vec3.
        field: shape (N,) node8: signed distance, offset before the bound, and four that are not read.
        bound: largest offset in each coordinate, the rest places' units.
        vertices_out, outward_out: shape (E,) vec3; the direction is of unit length, or 0.
    """
    launch(_surface_vertices, count, [begin, edges, rest, field, bound, vertices_out, outward_out], rest.device)


def adj_surface_vertices(
    begin: int, count: int, edges: wp.array, rest: wp.array, field: wp.array, bound: float, adj_vertices: wp.array,
    adj_field_out: wp.array,
) -> None:  # fmt: skip
    """Add to ``adj_field_out``, shape (N,) node8, what ``adj_vertices``, shape (E,) vec3, ask of the nodes."""
    inputs = [begin, edges, rest, field, bound, adj_vertices, adj_field_out]
    launch(_adj_surface_vertices, count, inputs, rest.device)


def part_opposed(begin: int, count: int, sides: wp.array, target_sides: wp.array, nearest: wp.array) -> None:
    """Set ``nearest`` to -1 where query and target look to opposite sides: the other side of a thin limb.

    Args:
        sides: shape (Q,) vec3, outward. target_sides: shape (N,) vec3. nearest: shape (Q,) int32, -1 for none.
    """
    launch(_part_opposed, count, [begin, sides, target_sides, nearest], sides.device)
