"""The rotations of ``rigidity``, sixteen vertices at a time: how the CPU follows them.

The same as ``rigidity.followed_rotation`` for each, a vertex a lane: Newton's method from the rotation that is there. A
step turns by the quaternion (w / 2, 1) as it does there, written as a matrix; what rounding leaves of a rotation is
made orthogonal by R (3 - R^T R) / 2 at the end. Lanes in which no step came to rest are told, for singular values.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS

wp.set_module_options(MODULE_OPTIONS)

LANES_OF_ROTATIONS = wp.constant(16)

_FOLLOW = """
    int left = 0;
#if !defined(__CUDA_ARCH__)
    typedef float lanes __attribute__((vector_size(64)));
    typedef int whole __attribute__((vector_size(64)));
    typedef float four __attribute__((vector_size(16)));
    const int count = rest.shape[0];
    const float* const y = (const float*)rest.data;
    float* const turned = (float*)rotation.data;
    const auto load = [](const float* at) { four v = {}; __builtin_memcpy(&v, at, 12); return v; };
    float sums[9][16] = {}, starts[9][16] = {};
    for (int l = 0; l < last - first; ++l) {
        const int t = (first + l) / count, i = first + l - t * count;
        const float* const x = (const float*)vertices.data + 3 * (size_t)t * count;
        const four xi = load(x + 3 * (size_t)i), yi = load(y + 3 * (size_t)i);
        four a = {}, b = {}, c = {};
        for (int e = row.data[i], end = row.data[i + 1]; e < end; ++e) {
            const size_t j = 3 * (size_t)column.data[e];
            const four dx = xi - load(x + j), dy = yi - load(y + j);
            a += dy * dx[0]; b += dy * dx[1]; c += dy * dx[2];
            if (tie > 0.0f) {
                const float w = tie * (dy[0] * dy[0] + dy[1] * dy[1] + dy[2] * dy[2]);
                const float* const p = (const float*)first_axis.data + 3 * (size_t)t * count + j;
                const float* const q = (const float*)second_axis.data + 3 * (size_t)t * count + j;
                a += w * load(p); b += w * load(q);
                c += w * four{p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0], 0.0f};
            }
        }
        for (int k = 0; k < 3; ++k) { sums[k][l] = a[k]; sums[3 + k][l] = b[k]; sums[6 + k][l] = c[k]; }
        for (int k = 0; k < 9; ++k) starts[k][l] = turned[9 * (size_t)(first + l) + k];
    }
    lanes s[9], r[9];
    __builtin_memcpy(s, sums, sizeof(s));
    __builtin_memcpy(r, starts, sizeof(r));
    const auto any = [](whole v) { int some = 0; for (int l = 0; l < 16; ++l) some |= v[l]; return some; };
    // (A^T B)_pq, of matrices row by row.
    const auto across = [](const lanes* a, const lanes* b, int p, int q) {
        return a[p] * b[q] + a[3 + p] * b[3 + q] + a[6 + p] * b[6 + q];
    };
    lanes scale = {};
    for (int k = 0; k < 9; ++k) { const lanes size = s[k] < 0.0f ? -s[k] : s[k]; scale = size > scale ? size : scale; }
    // Orthogonal to 1e-3, and no reflection; what is no number is neither.
    lanes off = {};
    for (int p = 0; p < 3; ++p) for (int q = 0; q < 3; ++q) {
        const lanes d = across(r, r, p, q) - (p == q ? 1.0f : 0.0f);
        off += d * d;
    }
    const lanes volume = r[0] * (r[4] * r[8] - r[5] * r[7]) + r[1] * (r[5] * r[6] - r[3] * r[8])
        + r[2] * (r[3] * r[7] - r[4] * r[6]);
    whole going = (scale > 0.0f) & (off < 1.0e-6f) & (volume > 0.0f), found = {};
    const lanes share = 1.0f / scale;
    for (int k = 0; k < 9; ++k) s[k] *= share;
    for (int step = 0; step < STEPS && any(going); ++step) {
        lanes m[9];
        for (int p = 0; p < 3; ++p) for (int q = 0; q < 3; ++q) m[3 * p + q] = across(r, s, p, q);
        const lanes a = m[4] + m[8], d = m[0] + m[8], f = m[0] + m[4];
        const lanes b = -0.5f * (m[1] + m[3]), c = -0.5f * (m[2] + m[6]), e = -0.5f * (m[5] + m[7]);
        const lanes aa = d * f - e * e, ab = c * e - b * f, ac = b * e - c * d;
        const lanes dd = a * f - c * c, de = b * c - a * e, minor = a * d - b * b, det = a * aa + b * ab + c * ac;
        const whole good = going & (a > CURVATURE) & (minor > CURVATURE) & (det > CURVATURE);
        const lanes u = m[7] - m[5], v = m[2] - m[6], w = m[3] - m[1], half = 0.5f / det;
        const lanes hx = half * (aa * u + ab * v + ac * w), hy = half * (ab * u + dd * v + de * w);
        const lanes hz = half * (ac * u + de * v + minor * w), size = hx * hx + hy * hy + hz * hz;
        const lanes k = 2.0f / (1.0f + size);
        const lanes turn[9] = {1.0f - k * (hy * hy + hz * hz), k * (hx * hy - hz), k * (hx * hz + hy),
                               k * (hx * hy + hz), 1.0f - k * (hx * hx + hz * hz), k * (hy * hz - hx),
                               k * (hx * hz - hy), k * (hy * hz + hx), 1.0f - k * (hx * hx + hy * hy)};
        for (int p = 0; p < 3; ++p) {
            const lanes x0 = r[3 * p], x1 = r[3 * p + 1], x2 = r[3 * p + 2];
            for (int q = 0; q < 3; ++q) {
                const lanes next = x0 * turn[q] + x1 * turn[3 + q] + x2 * turn[6 + q];
                r[3 * p + q] = good ? next : r[3 * p + q];
            }
        }
        const whole still = good & (4.0f * size < STILL);
        found |= still;
        going = good & ~still & (4.0f * size < 1.0f);
    }
    lanes g[9];
    for (int p = 0; p < 3; ++p) for (int q = 0; q < 3; ++q)
        g[3 * p + q] = (p == q ? 1.5f : 0.0f) - 0.5f * across(r, r, p, q);
    for (int p = 0; p < 3; ++p) for (int q = 0; q < 3; ++q) {
        const lanes v = r[3 * p] * g[q] + r[3 * p + 1] * g[3 + q] + r[3 * p + 2] * g[6 + q];
        for (int l = 0; l < 16; ++l) starts[3 * p + q][l] = v[l];
    }
    for (int l = 0; l < last - first; ++l) {
        if (found[l]) for (int k = 0; k < 9; ++k) turned[9 * (size_t)(first + l) + k] = starts[k][l];
        else left |= 1 << l;
    }
#endif
    return left;
"""


def following(steps: int, curvature: float, still: float) -> str:
    """The snippet for these limits of ``rigidity``."""
    return _FOLLOW.replace("STEPS", str(steps)).replace("CURVATURE", f"{curvature}f").replace("STILL", f"{still}f")
