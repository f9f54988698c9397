"""Rigid motions y = R(z) x + t by the Cayley map (paper, sec. Transformation Parameterization).

    R(z) = (I + Z)(I - Z)^-1 = I + k (Z + Z^2),   k = 2 / (1 + |z|^2),   angle = 2 atan |z|

so no inverse is needed: R(z) x = x + k (c + z x c) with c = z x x. R(-z) is the transpose.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS

wp.set_module_options(MODULE_OPTIONS)


@wp.func
def rotate(z: wp.vec3, x: wp.vec3) -> wp.vec3:
    """R(z) x."""
    k = 2.0 / (1.0 + wp.dot(z, z))
    c = wp.cross(z, x)
    return x + k * (c + wp.cross(z, c))


@wp.func
def rotate_along(z: wp.vec3, x: wp.vec3, dz: wp.vec3) -> wp.vec3:
    """Derivative of R(z) x along dz: dk v + k dv, with v = c + z x c and dk = -k^2 (z . dz)."""
    k = 2.0 / (1.0 + wp.dot(z, z))
    c = wp.cross(z, x)
    v = c + wp.cross(z, c)
    dc = wp.cross(dz, x)
    dv = dc + wp.cross(dz, c) + wp.cross(z, dc)
    return k * dv - (k * k * wp.dot(z, dz)) * v


@wp.func
def adj_rotate(z: wp.vec3, x: wp.vec3, adj: wp.vec3) -> wp.vec3:
    """Adjoint of R(z) x to z: the transpose of ``rotate_along``. At z = 0 it is 2 x cross adj, not zero."""
    k = 2.0 / (1.0 + wp.dot(z, z))
    c = wp.cross(z, x)
    v = c + wp.cross(z, c)
    pulled = wp.cross(x, adj) + wp.cross(c, adj) + wp.cross(x, wp.cross(adj, z))
    return k * pulled - (k * k * wp.dot(adj, v)) * z
