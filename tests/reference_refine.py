"""Float64 NumPy twins of the vertex stage, written from the formulas and slow on purpose. Imports NumPy only.

Meshes come as undirected edges (E, 2), each once. T frames, V vertices: x (T, V, 3), rest y (V, 3), R (T, V, 3, 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import reference

# Rigidity.


def nearest_rotation(s: np.ndarray) -> np.ndarray:
    """The rotation R that maximises trace(R^T s) by its textbook form: U diag(1, 1, det(U V^T)) V^T; (..., 3, 3)."""
    u, _, vt = np.linalg.svd(s)
    u[..., 2] *= np.linalg.det(u @ vt)[..., None]
    return u @ vt


def fit_rotations(
    x: np.ndarray, y: np.ndarray, edges: np.ndarray, tie: float = 0.0, before: np.ndarray | None = None
) -> np.ndarray:
    s = np.zeros((*x.shape, 3))
    if before is not None:
        weight = tie * ((y[edges[:, 0]] - y[edges[:, 1]]) ** 2).sum(axis=1)[:, None, None]
        for own, other in (edges.T, edges.T[::-1]):
            for t in range(len(x)):
                np.add.at(s[t], own, weight * before[t, other])
    outer = np.einsum("tea,eb->teab", x[:, edges[:, 0]] - x[:, edges[:, 1]], y[edges[:, 0]] - y[edges[:, 1]])
    for end in (0, 1):
        for t in range(len(x)):
            np.add.at(s[t], edges[:, end], outer[t])
    return nearest_rotation(s)


def rigid_residual(x: np.ndarray, y: np.ndarray, rotation: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(x_i - x_j) - (R_i + R_j)/2 (y_i - y_j), (T, E, 3)."""
    i, j = edges.T
    return x[:, i] - x[:, j] - np.einsum("teab,eb->tea", 0.5 * (rotation[:, i] + rotation[:, j]), y[i] - y[j])


def edge_stiffness(stiffness: np.ndarray | None, edges: np.ndarray) -> np.ndarray:
    """(E,), of ends (V,); None: 1."""
    return np.ones(len(edges)) if stiffness is None else stiffness[edges].mean(axis=1)


def rigid_energy(x, y, rotation, edges: np.ndarray, stiffness: np.ndarray | None = None) -> float:
    squares = (rigid_residual(x, y, rotation, edges) ** 2).sum(axis=2)
    return float((edge_stiffness(stiffness, edges) * squares).sum())


def rigid_rhs(x, y, rotation, edges: np.ndarray, stiffness: np.ndarray | None = None) -> np.ndarray:
    """Minus half the gradient of ``rigid_energy`` to x, (T, V, 3)."""
    rhs = np.zeros(x.shape)
    residual = edge_stiffness(stiffness, edges)[:, None] * rigid_residual(x, y, rotation, edges)
    for t in range(len(x)):
        np.add.at(rhs[t], edges[:, 0], -residual[t])
        np.add.at(rhs[t], edges[:, 1], residual[t])
    return rhs


def strains(x: np.ndarray, y: np.ndarray, rotation: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Mean square strain of a vertex's edges over all frames, (V,)."""
    left = (rigid_residual(x, y, rotation, edges) ** 2).sum(axis=2).mean(axis=0)
    whole = ((y[edges[:, 0]] - y[edges[:, 1]]) ** 2).sum(axis=1)
    strained, size = np.zeros(len(y)), np.zeros(len(y))
    for end in (0, 1):
        np.add.at(strained, edges[:, end], left)
        np.add.at(size, edges[:, end], whole)
    return np.divide(strained, size, out=np.zeros(len(y)), where=size > 0)


def rest_rhs(x: np.ndarray, rotation: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Minus half the gradient of ``rigid_energy`` to y at y = 0, over the number of frames."""
    i, j = edges.T
    turned = np.einsum("teba,teb->ea", 0.5 * (rotation[:, i] + rotation[:, j]), x[:, i] - x[:, j]) / len(x)
    rhs = np.zeros(x.shape[1:])
    np.add.at(rhs, i, turned)
    np.add.at(rhs, j, -turned)
    return rhs


def trusted_rest_rhs(
    x: np.ndarray, y: np.ndarray, rotation: np.ndarray, trust: np.ndarray, staying: float, edges: np.ndarray
) -> np.ndarray:
    """The same, of each edge the mean over the frames that show it, and of the edge as it is in y (V, 3)."""
    i, j = edges.T
    weight = trust[:, i] * trust[:, j]
    turned = np.einsum("te,teba,teb->ea", weight, 0.5 * (rotation[:, i] + rotation[:, j]), x[:, i] - x[:, j])
    mean = (turned + staying * (y[i] - y[j])) / (weight.sum(axis=0) + staying)[:, None]
    rhs = np.zeros(y.shape)
    np.add.at(rhs, i, mean)
    np.add.at(rhs, j, -mean)
    return rhs


# Planes.


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area-weighted unit normals, (V, 3); zero where nothing tells."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.zeros(vertices.shape)
    for k in range(3):
        np.add.at(normals, faces[:, k], np.cross(b - a, c - a))
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)


@dataclass(frozen=True)
class Planes:
    """Frozen point-to-plane residuals a . (x_owner + d_owner - q) of weight w, one a pair.

    owner: the vertex that is asked to move (P,). a: (P, 3), zero for a pair left out. w, r: (P,), r at d = 0.
    """

    owner: np.ndarray
    a: np.ndarray
    w: np.ndarray
    r: np.ndarray

    def energy(self, d: np.ndarray) -> float:
        return float((self.w * (self.r + (self.a * d[self.owner]).sum(axis=1)) ** 2).sum())

    def normal_equations(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """A (V, 3, 3) and b (V, 3) of the best moves A d = b."""
        matrix, rhs = np.zeros((count, 3, 3)), np.zeros((count, 3))
        np.add.at(matrix, self.owner, self.w[:, None, None] * self.a[:, :, None] * self.a[:, None, :])
        np.add.at(rhs, self.owner, -(self.w * self.r)[:, None] * self.a)
        return matrix, rhs


def planes(
    x,
    m,
    q,
    n,
    owner,
    reach,
    agreement: float,
    share: float = 1.0,
    mutual: np.ndarray | float = 1.0,
    folded: np.ndarray | float = 0.0,
) -> Planes:
    """Pairs of vertices x with normals m and cloud points q with normals n, all (P, 3). reach: a number or (P,).

    share: how much n counts in the common normal. mutual: a further weight of each pair, (P,). folded: the weight along
    n of pairs without a common plane, a number or (P,).
    """
    kept = (n * m).sum(axis=1) > agreement
    a = np.where(kept[:, None], share * n + m, 0.0)
    length = np.linalg.norm(a, axis=1, keepdims=True)
    a = np.divide(a, length, out=np.zeros_like(a), where=length > 0)
    w = mutual * np.exp(-((np.linalg.norm(x - q, axis=1) / reach) ** 2))
    a, w = (
        np.where(length > 0, a, np.where(np.reshape(folded, (-1, 1)) > 0, n, 0.0)),
        np.where(length[:, 0] > 0, w, w * folded),
    )
    return Planes(np.asarray(owner), a, w, (a * (x - q)).sum(axis=1))


# Borders, and what is not seen.


def outward(before: np.ndarray, x: np.ndarray, after: np.ndarray, inner: np.ndarray) -> np.ndarray:
    """Part of x - inner across after - before, unit, by projection; all (P, 3)."""
    out = np.zeros(x.shape)
    for k in range(len(x)):
        line = (after[k] - before[k])[:, None]
        across = (np.eye(3) - line @ np.linalg.pinv(line)) @ (x[k] - inner[k])
        length = np.linalg.norm(across)
        out[k] = across / length if length > 0 else 0.0
    return out


def border_planes(pairs: Planes, b: np.ndarray, offset: np.ndarray, stiffness: float, gap=None) -> Planes:
    """Residuals across the border for pairs of ``planes``; b: (P, 3), zero off the border. offset: x - q, (P, 3).

    gap: (P,) for vertices' own pairs; None for points, which count where they lie outside.
    """
    along = (b * offset).sum(axis=1)
    counts = (pairs.a != 0).any(axis=1) & (b != 0).any(axis=1)
    if gap is None:
        gap, counts = 0.0, counts & (along < 0)
    return Planes(pairs.owner, np.where(counts[:, None], b, 0.0), stiffness * pairs.w, along - gap)


def turn_about(axis: Sequence[float] | np.ndarray, angle: float) -> np.ndarray:
    """Rotation by Rodrigues' formula."""
    k = reference.cross_matrix(np.asarray(axis, float) / np.linalg.norm(axis))
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


# The stage.


def laplacian(edges: np.ndarray, count: int) -> np.ndarray:
    return reference.smoother(edges, count, 1.0) - np.eye(count)


def block_matrix(blocks: np.ndarray, edges: np.ndarray, alpha: float, beta: float) -> np.ndarray:
    """A + beta I + alpha L, dense, (3 V, 3 V). blocks: (V, 3, 3)."""
    count = len(blocks)
    matrix = np.kron(alpha * laplacian(edges, count) + beta * np.eye(count), np.eye(3))
    for i, block in enumerate(blocks):
        matrix[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += block
    return matrix


def spacing(cloud: np.ndarray) -> float:
    """Mean distance of a point to its nearest fellow."""
    distance = np.linalg.norm(cloud[:, None] - cloud[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    return float(distance.min(axis=1).mean())


def gone_on(x, earlier, y, rotation, edges, c) -> tuple[np.ndarray, np.ndarray]:
    """Vertices farther along their way since ``earlier``, and rotations that three fits spread by three edges."""
    x = x + c.momentum * (x - earlier)
    for _ in range(3):
        rotation = fit_rotations(x, y, edges, c.rotation_smoothness, rotation)
    return x, rotation


def refine_round(x, y, rotation, edges, faces, clouds, normals, c) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One round: every frame pairs, moves and turns; then all frames together say what the shape is.

    Args:
        c: an object with the fields of the stage's configuration.

    Returns:
        x, y, rotation after the round.
    """
    x, count = x.copy(), x.shape[1]
    pulled = c.rigidity * rigid_rhs(x, y, rotation, edges)
    for t, (q, n) in enumerate(zip(clouds, normals, strict=True)):
        m, reach = vertex_normals(x[t], faces), c.reach * spacing(q)
        forth, back = reference.nearest(x[t], q), reference.nearest(q, x[t])
        met = planes(x[t], m, q[forth], n[forth], np.arange(count), reach, c.agreement)
        asked = planes(x[t][back], m[back], q, n, back, reach, c.agreement)
        (a, b), (a_asked, b_asked) = met.normal_equations(count), asked.normal_equations(count)
        system = block_matrix(a + a_asked, edges, c.rigidity, c.damping)
        x[t] += np.linalg.solve(system, (b + b_asked + pulled[t]).ravel()).reshape(count, 3)
    rotation = fit_rotations(x, y, edges, c.rotation_smoothness, rotation)
    s = c.shape_smoothness
    best = np.linalg.solve(np.eye(count) + s * laplacian(edges, count), y + s * rest_rhs(x, rotation, edges))
    return x, y + c.shape_step * (best - y), rotation
