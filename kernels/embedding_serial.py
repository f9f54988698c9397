"""Places of an embedded mesh, and a Gauss-Newton step of its nodes as one CPU core does it best: matches to moves.

A step turns each node by a small rotation and shifts it, six unknowns, so that its matrix consists of blocks (6, 6),
one for every pair of nodes that share a vertex or a link. It is symmetric and positive definite: in a good order of the
nodes it is L L^T with L of few more blocks, all of whose places are known before (``BlockOrder``). Double precision:
what nothing holds, a weight of 1e-12 does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS
from warpdef.kernels.sizes import sizes

wp.set_module_options(MODULE_OPTIONS)


@dataclass(frozen=True)
class BlockOrder:
    """Where the blocks of L are, for n nodes; int32 throughout.

    place: of each node, in the order in which they are eliminated                  (n,)
    start: first block of each column of L, the one on the diagonal; then their end  (n + 1,)
    row:   of each block, ascending in a column                                     (B,)
    of_vertices: block that a pair of a vertex's nodes adds to, -1 if another does  (V, 16)
    of_links:    block of the pair of a link, or of the pair turned round           (e,)
    """

    place: np.ndarray
    start: np.ndarray
    row: np.ndarray
    of_vertices: np.ndarray
    of_links: np.ndarray


# A block is six registers of eight numbers, of which the last two are never looked at.
_STEP = """
#if !defined(__CUDA_ARCH__)
    typedef double reg __attribute__((vector_size(64), aligned(8)));
    const int nodes = place.shape[0], vertices = rest.shape[0], blocks = row.shape[0];
    const int* const begin = start.data;
    const int* const row_of = row.data;
    const double* const turns = (const double*)rotation.data;
    const double* const anchors = (const double*)anchor.data;
    const double* const shifts = (const double*)shift.data;
    double* const memory = (double*)calloc(48 * (size_t)blocks + 8 * (size_t)nodes + 10 * (size_t)vertices, 8);
    if (!memory) {
        for (int k = 0; k < 6 * nodes; ++k) move_out.data[k] = NAN;
        return;
    }
    reg* const factor = (reg*)memory;
    double* const right = memory + 48 * (size_t)blocks;  // eight a node
    double* const sums = right + 8 * (size_t)nodes;

    // Of a vertex all matches at once: A the sum of w (n n^T + tangential I), its six numbers, that of A goal, and w.
    for (int i = 0; i < chosen.shape[0]; ++i) {
        const double* const n = (const double*)normal.data + 3 * i;
        const double* const to = (const double*)goal.data + 3 * i;
        const double w = match_weight.data[i], along = w * tangential;
        const double across = w * (n[0] * to[0] + n[1] * to[1] + n[2] * to[2]);
        double* const s = sums + 10 * (size_t)chosen.data[i];
        s[0] += w * n[0] * n[0] + along; s[1] += w * n[0] * n[1]; s[2] += w * n[0] * n[2];
        s[3] += w * n[1] * n[1] + along; s[4] += w * n[1] * n[2]; s[5] += w * n[2] * n[2] + along;
        for (int k = 0; k < 3; ++k) s[6 + k] += across * n[k] + along * to[k];
        s[9] += w;
    }
    for (int v = 0; v < vertices; ++v) {
        const double* const s = sums + 10 * (size_t)v;
        if (s[9] == 0.0) continue;
        const double* const x = (const double*)rest.data + 3 * v;
        const double sided[3][3] = {{s[0], s[1], s[2]}, {s[1], s[3], s[4]}, {s[2], s[4], s[5]}};
        double arm[4][3], placed[3] = {};
        reg asked[4][3];  // A times the derivative by each node, a column of the block: w (-[arm]_x, I)
        for (int k = 0; k < 4; ++k) {
            const int node = index.data[4 * v + k];
            const double* const r = turns + 9 * node;
            const double* const g = anchors + 3 * node;
            const double w = weight.data[4 * v + k];
            for (int a = 0; a < 3; ++a) {
                arm[k][a] = r[3 * a] * (x[0] - g[0]) + r[3 * a + 1] * (x[1] - g[1]) + r[3 * a + 2] * (x[2] - g[2]);
                placed[a] += w * (arm[k][a] + g[a] + shifts[3 * node + a]);
            }
            const double p = w * arm[k][0], q = w * arm[k][1], t = w * arm[k][2];
            const reg first = {0.0, t, -q, w, 0.0, 0.0}, second = {-t, 0.0, p, 0.0, w, 0.0};
            const reg third = {q, -p, 0.0, 0.0, 0.0, w};
            for (int a = 0; a < 3; ++a)
                asked[k][a] = sided[a][0] * first + sided[a][1] * second + sided[a][2] * third;
        }
        double pull[3];
        for (int a = 0; a < 3; ++a)
            pull[a] = sided[a][0] * placed[0] + sided[a][1] * placed[1] + sided[a][2] * placed[2] - s[6 + a];
        for (int k = 0; k < 4; ++k) {
            const double w = weight.data[4 * v + k], *const u = arm[k];
            double* const b = right + 8 * place.data[index.data[4 * v + k]];
            b[0] += w * (u[1] * pull[2] - u[2] * pull[1]);
            b[1] += w * (u[2] * pull[0] - u[0] * pull[2]);
            b[2] += w * (u[0] * pull[1] - u[1] * pull[0]);
            for (int a = 0; a < 3; ++a) b[3 + a] += w * pull[a];
            for (int j = 0; j < 4; ++j) {
                const int block = of_vertices.data[16 * v + 4 * k + j];
                if (block < 0) continue;
                reg* const m = factor + 6 * (size_t)block;
                const reg* const p = asked[j];
                m[0] += w * (u[1] * p[2] - u[2] * p[1]);
                m[1] += w * (u[2] * p[0] - u[0] * p[2]);
                m[2] += w * (u[0] * p[1] - u[1] * p[0]);
                for (int a = 0; a < 3; ++a) m[3 + a] += w * p[a];
            }
        }
    }
    // Links: the derivative by the first node is (-[arm]_x, I), by the second (0, -I).
    for (int e = 0; e < link.shape[0]; ++e) {
        const int j = link.data[2 * e], k = link.data[2 * e + 1], pj = place.data[j], pk = place.data[k];
        const double* const r = turns + 9 * j;
        double u[3], bent[3];
        for (int a = 0; a < 3; ++a) {
            u[a] = 0.0;
            for (int c = 0; c < 3; ++c) u[a] += r[3 * a + c] * (anchors[3 * k + c] - anchors[3 * j + c]);
            bent[a] = u[a] + anchors[3 * j + a] + shifts[3 * j + a] - anchors[3 * k + a] - shifts[3 * k + a];
            bent[a] -= usual.data ? ((const double*)usual.data)[3 * e + a] : 0.0;
        }
        const double x = stiffness * u[0], y = stiffness * u[1], z = stiffness * u[2], o = stiffness;
        double* const b = right + 8 * pj;
        b[0] += y * bent[2] - z * bent[1]; b[1] += z * bent[0] - x * bent[2]; b[2] += x * bent[1] - y * bent[0];
        for (int a = 0; a < 3; ++a) { b[3 + a] += o * bent[a]; right[8 * pk + 3 + a] -= o * bent[a]; }
        reg* const own = factor + 6 * (size_t)begin[pj];
        reg* const other = factor + 6 * (size_t)begin[pk];
        reg* const both = factor + 6 * (size_t)of_links.data[e];
        own[0] += reg{y * u[1] + z * u[2], -x * u[1], -x * u[2], 0.0, -z, y};
        own[1] += reg{-x * u[1], x * u[0] + z * u[2], -y * u[2], z, 0.0, -x};
        own[2] += reg{-x * u[2], -y * u[2], x * u[0] + y * u[1], -y, x, 0.0};
        own[3] += reg{0.0, z, -y, o, 0.0, 0.0};
        own[4] += reg{-z, 0.0, x, 0.0, o, 0.0};
        own[5] += reg{y, -x, 0.0, 0.0, 0.0, o};
        for (int a = 0; a < 3; ++a) other[3 + a][3 + a] += o;
        if (pj > pk) {
            both[0] += reg{0.0, 0.0, 0.0, 0.0, z, -y};
            both[1] += reg{0.0, 0.0, 0.0, -z, 0.0, x};
            both[2] += reg{0.0, 0.0, 0.0, y, -x, 0.0};
            for (int a = 0; a < 3; ++a) both[3 + a][3 + a] -= o;
        } else {
            both[3] += reg{0.0, -z, y, -o, 0.0, 0.0};
            both[4] += reg{z, 0.0, -x, 0.0, -o, 0.0};
            both[5] += reg{-y, x, 0.0, 0.0, 0.0, -o};
        }
    }

    // Column after column: the block on the diagonal, those below it, and what they take from the columns to come.
    const double least = 1e-12;  // no pivot is below what is added
    for (int k = 0; k < nodes; ++k) {
        reg* const d = factor + 6 * (size_t)begin[k];
        for (int c = 0; c < 6; ++c) {
            double pivot = d[c][c] + least;
            for (int l = 0; l < c; ++l) pivot -= d[c][l] * d[c][l];
            pivot = sqrt(pivot > least ? pivot : least);
            d[c][c] = pivot;
            for (int i = c + 1; i < 6; ++i) {
                double part = d[i][c];
                for (int l = 0; l < c; ++l) part -= d[i][l] * d[c][l];
                d[i][c] = part / pivot;
            }
        }
        double* const b = right + 8 * k;
        for (int c = 0; c < 6; ++c) {
            for (int l = 0; l < c; ++l) b[c] -= d[c][l] * b[l];
            b[c] /= d[c][c];
        }
        for (int q = begin[k] + 1; q < begin[k + 1]; ++q) {
            reg* const m = factor + 6 * (size_t)q;
            double* const below = right + 8 * row_of[q];
            for (int i = 0; i < 6; ++i)
                for (int c = 0; c < 6; ++c) {
                    double part = m[i][c];
                    for (int l = 0; l < c; ++l) part -= m[i][l] * d[c][l];
                    m[i][c] = part / d[c][c];
                    below[i] -= m[i][c] * b[c];
                }
        }
        for (int q = begin[k] + 1; q < begin[k + 1]; ++q) {
            const reg* const m = factor + 6 * (size_t)q;
            reg turned[6];
            for (int c = 0; c < 6; ++c) turned[c] = reg{m[0][c], m[1][c], m[2][c], m[3][c], m[4][c], m[5][c]};
            int to = begin[row_of[q]];
            for (int p = q; p < begin[k + 1]; ++p) {
                while (row_of[to] < row_of[p]) ++to;
                const reg* const left = factor + 6 * (size_t)p;
                reg* const at = factor + 6 * (size_t)to;
                for (int i = 0; i < 6; ++i) {
                    reg part = at[i];
                    for (int c = 0; c < 6; ++c) part -= left[i][c] * turned[c];
                    at[i] = part;
                }
            }
        }
    }
    for (int k = nodes - 1; k >= 0; --k) {
        double* const b = right + 8 * k;
        for (int q = begin[k] + 1; q < begin[k + 1]; ++q) {
            const reg* const m = factor + 6 * (size_t)q;
            const double* const known = right + 8 * row_of[q];
            for (int c = 0; c < 6; ++c)
                for (int i = 0; i < 6; ++i) b[c] -= m[i][c] * known[i];
        }
        const reg* const d = factor + 6 * (size_t)begin[k];
        for (int c = 5; c >= 0; --c) {
            for (int l = c + 1; l < 6; ++l) b[c] -= d[l][c] * b[l];
            b[c] /= d[c][c];
        }
    }
    for (int node = 0; node < nodes; ++node)
        for (int c = 0; c < 6; ++c) move_out.data[6 * node + c] = -right[8 * place.data[node] + c];
    free(memory);
#endif
"""


@wp.func_native(_STEP)
def step_of_nodes(
    rest: wp.array[wp.vec3d],
    index: wp.array2d[wp.int32],
    weight: wp.array2d[wp.float64],
    link: wp.array2d[wp.int32],
    anchor: wp.array[wp.vec3d],
    place: wp.array[wp.int32],
    start: wp.array[wp.int32],
    row: wp.array[wp.int32],
    of_vertices: wp.array2d[wp.int32],
    of_links: wp.array[wp.int32],
    rotation: wp.array[wp.mat33d],
    shift: wp.array[wp.vec3d],
    chosen: wp.array[wp.int32],
    goal: wp.array[wp.vec3d],
    normal: wp.array[wp.vec3d],
    match_weight: wp.array[wp.float64],
    tangential: wp.float64,
    stiffness: wp.float64,
    usual: wp.array[wp.vec3d],
    move_out: wp.array2d[wp.float64],
): ...


@sizes(
    "threads: 1; rest: V; index weight: V 4; of_vertices: V 16; link: E 2; of_links: E; usual: E?; row: B; start: N+1;"
    "anchor place rotation shift: N; chosen goal normal match_weight: M; move_out: N 6"
)
@wp.kernel
def step_nodes_serially(
    # In:
    rest: wp.array[wp.vec3d],
    index: wp.array2d[wp.int32],
    weight: wp.array2d[wp.float64],
    link: wp.array2d[wp.int32],
    anchor: wp.array[wp.vec3d],
    place: wp.array[wp.int32],
    start: wp.array[wp.int32],
    row: wp.array[wp.int32],
    of_vertices: wp.array2d[wp.int32],
    of_links: wp.array[wp.int32],
    rotation: wp.array[wp.mat33d],
    shift: wp.array[wp.vec3d],
    chosen: wp.array[wp.int32],
    goal: wp.array[wp.vec3d],
    normal: wp.array[wp.vec3d],
    match_weight: wp.array[wp.float64],
    tangential: wp.float64,
    stiffness: wp.float64,
    usual: wp.array[wp.vec3d],
    # Out:
    move_out: wp.array2d[wp.float64],
):
    """CPU: one thread."""
    step_of_nodes(
        rest, index, weight, link, anchor, place, start, row, of_vertices, of_links, rotation, shift, chosen, goal,
        normal, match_weight, tangential, stiffness, usual, move_out,
    )  # fmt: skip


@sizes("threads: V; rest placed_out: V; index weight: V K; anchor rotation shift: N")
@wp.kernel
def place_vertices(
    # In:
    begin: int,
    rest: wp.array[wp.vec3d],
    index: wp.array2d[wp.int32],
    weight: wp.array2d[wp.float64],
    anchor: wp.array[wp.vec3d],
    rotation: wp.array[wp.mat33d],
    shift: wp.array[wp.vec3d],
    # Out:
    placed_out: wp.array[wp.vec3d],
):
    """One thread a vertex."""
    v = begin + wp.tid()
    placed = wp.vec3d()
    for k in range(index.shape[1]):
        j = index[v, k]
        placed += weight[v, k] * (rotation[j] * (rest[v] - anchor[j]) + anchor[j] + shift[j])
    placed_out[v] = placed
