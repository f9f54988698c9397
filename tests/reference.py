"""Float64 NumPy twins of every kernel, written from the formulas and slow on purpose. Imports NumPy only.

A twin never calls the project: where a kernel uses a closed form, the twin takes the definition (a matrix inverse for
the Cayley map, a dense matrix for the Laplacian, brute force for neighbours).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Grids.

_CORNERS = np.array(list(np.ndindex(2, 2, 2)))


def resolutions(coarsest: int, finest: int) -> list[int]:
    """Nodes an axis of levels ``coarsest .. finest``."""
    return [2 * level - 1 for level in range(coarsest, finest + 1)]


def offsets(levels: list[int]) -> np.ndarray:
    """First node of each level, and the number of nodes."""
    return np.concatenate([[0], np.cumsum([n**3 for n in levels])])


def corners(points: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The eight nodes around each point on an n^3 grid over [-1, 1]^3, nodes on the corners.

    Returns:
        node (N, 8) flat indices, x slowest; weight (N, 8); derivative of the weight along x, y, z (N, 8, 3), 0 along
        an axis on which the point is clamped.
    """
    points = np.asarray(points, dtype=np.float64)
    half = 0.5 * (n - 1)
    g = (points + 1.0) * half
    inside = (g >= 0) & (g <= n - 1)
    u = np.clip(np.nan_to_num(g, nan=0.0), 0, n - 1)
    low = np.clip(np.floor(u).astype(int), 0, max(n - 2, 0))
    fraction = u - low
    at = np.minimum(low[:, None] + _CORNERS, n - 1)
    node = (at[..., 0] * n + at[..., 1]) * n + at[..., 2]
    part = np.where(_CORNERS, fraction[:, None], 1 - fraction[:, None])
    slope = np.where(_CORNERS, 1.0, -1.0) * half * inside[:, None]
    others = np.stack([part[..., 1] * part[..., 2], part[..., 2] * part[..., 0], part[..., 0] * part[..., 1]], axis=-1)
    return node, part.prod(axis=2), slope * others


def sample(nodes: np.ndarray, levels: list[int], points: np.ndarray) -> np.ndarray:
    """Mean over levels of the trilinear interpolation. nodes (M, C), points (N, 3) -> (N, C)."""
    total = np.zeros((len(points), nodes.shape[1]))
    for n, begin in zip(levels, offsets(levels)[:-1], strict=True):
        node, weight, _ = corners(points, n)
        total += np.einsum("nk,nkc->nc", weight, nodes[begin + node])
    return total / len(levels)


def sample_derivative(nodes: np.ndarray, levels: list[int], points: np.ndarray) -> np.ndarray:
    """Derivative of ``sample`` along x, y, z: (N, 3, C)."""
    total = np.zeros((len(points), 3, nodes.shape[1]))
    for n, begin in zip(levels, offsets(levels)[:-1], strict=True):
        node, _, slope = corners(points, n)
        total += np.einsum("nka,nkc->nac", slope, nodes[begin + node])
    return total / len(levels)


def adj_sample(levels: list[int], points: np.ndarray, adj: np.ndarray) -> np.ndarray:
    """Adjoint of ``sample`` to the nodes. adj (N, C) -> (M, C)."""
    total = np.zeros((offsets(levels)[-1], adj.shape[1]))
    for n, begin in zip(levels, offsets(levels)[:-1], strict=True):
        node, weight, _ = corners(points, n)
        np.add.at(total, begin + node, weight[:, :, None] * adj[:, None, :])
    return total / len(levels)


# Motion.


def cross_matrix(z: np.ndarray) -> np.ndarray:
    """Z with Z x = z cross x, (..., 3, 3)."""
    z = np.asarray(z, dtype=np.float64)
    matrix = np.zeros((*z.shape, 3))
    matrix[..., 2, 1], matrix[..., 1, 2] = z[..., 0], -z[..., 0]
    matrix[..., 0, 2], matrix[..., 2, 0] = z[..., 1], -z[..., 1]
    matrix[..., 1, 0], matrix[..., 0, 1] = z[..., 2], -z[..., 2]
    return matrix


def rotation(z: np.ndarray) -> np.ndarray:
    """The Cayley map by its definition, (I + Z)(I - Z)^-1."""
    matrix = cross_matrix(z)
    return (np.eye(3) + matrix) @ np.linalg.inv(np.eye(3) - matrix)


def rotation_derivative(z: np.ndarray) -> np.ndarray:
    """dR/dz_c = (I + R) dZ_c (I - Z)^-1, (..., component, 3, 3)."""
    matrix = cross_matrix(z)
    turned, inverse = np.eye(3) + rotation(z), np.linalg.inv(np.eye(3) - matrix)
    return turned[..., None, :, :] @ cross_matrix(np.eye(3)) @ inverse[..., None, :, :]


def move(nodes: np.ndarray, levels: list[int], points: np.ndarray) -> np.ndarray:
    """y = R(z) x + t with (z, t) sampled at x. nodes (M, 6)."""
    motion = sample(nodes, levels, points)
    return np.einsum("nij,nj->ni", rotation(motion[:, :3]), points) + motion[:, 3:6]


def move_derivative(nodes: np.ndarray, levels: list[int], points: np.ndarray) -> np.ndarray:
    """dy/dx, (N, 3, 3): row i is the derivative of y_i."""
    motion, slope = sample(nodes, levels, points), sample_derivative(nodes, levels, points)
    by_rotation = np.einsum("ncij,nj->nic", rotation_derivative(motion[:, :3]), points)
    through_field = np.einsum("nic,nac->nia", by_rotation, slope[..., :3]) + slope[..., 3:6].transpose(0, 2, 1)
    return rotation(motion[:, :3]) + through_field


def adj_motion(z: np.ndarray, points: np.ndarray, adj: np.ndarray) -> np.ndarray:
    """Adjoint of R(z) x + t to (z, t), (N, 6)."""
    by_rotation = np.einsum("ncij,nj,ni->nc", rotation_derivative(z), points, adj)
    return np.concatenate([by_rotation, adj], axis=1)


# Chamfer and isometry.


def nearest(queries: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Brute force; ties go to the lowest index."""
    difference = np.asarray(queries, np.float64)[:, None] - np.asarray(targets, np.float64)[None]
    return (difference**2).sum(axis=2).argmin(axis=1)


def robust_weight(r: np.ndarray, alpha: float, power: int) -> np.ndarray:
    return np.exp(-alpha * np.linalg.norm(r, axis=-1) ** power)


def mutual_weight(asked: np.ndarray, answered: np.ndarray, reach: np.ndarray | float) -> np.ndarray:
    """exp(-(b / reach)^4), b the distance from who asks to the partner of its partner."""
    return np.exp(-((np.linalg.norm(answered - asked, axis=-1) / reach) ** 4))


def residual_energy(r: np.ndarray, normals: np.ndarray, tangential: float) -> np.ndarray:
    """Squared length along the normal (unit; zero where unknown), and ``tangential`` times the square of the rest."""
    along = (r * normals).sum(axis=-1, keepdims=True) * normals
    return (along**2).sum(axis=-1) + tangential * ((r - along) ** 2).sum(axis=-1)


def adj_residual_energy(r: np.ndarray, normals: np.ndarray, tangential: float) -> np.ndarray:
    along = (r * normals).sum(axis=-1, keepdims=True) * normals
    return 2 * (along + tangential * (r - along))


def isometry(vertices: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Change of every edge's length between neighbouring frames, summed over edges, (T - 1,)."""
    length = np.linalg.norm(vertices[:, edges[:, 0]] - vertices[:, edges[:, 1]], axis=2)
    return np.abs(np.diff(length, axis=0)).sum(axis=1)


def adj_isometry(vertices: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Gradient of the sum of ``isometry`` to the vertices; 0 for an edge of no length."""
    d = vertices[:, edges[:, 0]] - vertices[:, edges[:, 1]]
    length = np.linalg.norm(d, axis=2)
    sign = np.sign(np.diff(length, axis=0))
    signs = np.zeros_like(length)
    signs[1:] += sign
    signs[:-1] -= sign
    unit = np.divide(d, length[..., None], out=np.zeros_like(d), where=length[..., None] > 0)
    adj = np.zeros_like(vertices)
    for t in range(len(vertices)):
        np.add.at(adj[t], edges[:, 0], signs[t, :, None] * unit[t])
        np.add.at(adj[t], edges[:, 1], -signs[t, :, None] * unit[t])
    return adj


# Sobolev.


def grid_edges(n: int) -> np.ndarray:
    """The 6-neighbour pairs of an n^3 grid, (E, 2)."""
    number = np.arange(n**3).reshape(n, n, n)
    pairs = [
        np.stack([number[tuple(low)].ravel(), number[tuple(high)].ravel()], axis=1)
        for axis in range(3)
        for low, high in [(_along(axis, slice(None, -1)), _along(axis, slice(1, None)))]
    ]
    return np.concatenate(pairs)


def _along(axis: int, span: slice) -> list[slice]:
    index = [slice(None)] * 3
    index[axis] = span
    return index


def smoother(edges: np.ndarray, count: int, weight: float) -> np.ndarray:
    """I + weight (D - A), dense."""
    adjacency = np.zeros((count, count))
    adjacency[edges[:, 0], edges[:, 1]] = adjacency[edges[:, 1], edges[:, 0]] = 1.0
    return np.eye(count) + weight * (np.diag(adjacency.sum(axis=1)) - adjacency)


# Adam and the schedule.


def adam(parameter, gradients, rate, scales, beta1, beta2, epsilon):
    """Adam over a list of gradients with the step lengths ``rate * scale``; returns the parameter at the end."""
    parameter = np.array(parameter, dtype=np.float64)
    first, second = np.zeros_like(parameter), np.zeros_like(parameter)
    for step, (g, scale) in enumerate(zip(gradients, scales, strict=True), start=1):
        first = beta1 * first + (1 - beta1) * g
        second = beta2 * second + (1 - beta2) * g**2
        first_hat, second_hat = first / (1 - beta1**step), second / (1 - beta2**step)
        parameter -= rate * scale * first_hat / (np.sqrt(second_hat) + epsilon)
    return parameter


def confidence(loss_input, loss_transform, keyframe: int, delta: float, bound_is_mean: bool) -> np.ndarray:
    """w(t) = product over the frames between keyframe and t (t too) of (1 + max(0, CD - cd_max))^-delta."""
    bound = np.mean(loss_input) if bound_is_mean else np.max(loss_input)
    factor = (1 + np.maximum(0, np.asarray(loss_transform) - bound)) ** -delta
    weights = np.ones(len(loss_transform))
    for t in range(len(weights)):
        between = range(keyframe + 1, t + 1) if t > keyframe else range(t, keyframe)
        weights[t] = np.prod([factor[tau] for tau in between])
    return weights


# The whole objective, with neighbours and robust weights frozen.


@dataclass(frozen=True)
class TwinScene:
    """A sequence and the constants of its objective; frames and transitions as in the paper, T and S = T - 1.

    clouds, normals: T arrays (N_t, 3). edges: (E, 2). levels: resolutions. share_mean: Chamfer as a mean.
    moved_reach, met_reach: (S,), of moved clouds' pairs and of the pairs of the clouds they meet; vertex_reach: (T,);
    infinite where every pair counts, as it does without them.
    """

    clouds: list[np.ndarray]
    normals: list[np.ndarray]
    edges: np.ndarray
    levels: list[int]
    keyframe: int
    alpha: float
    power: int
    tangential: float
    share_mean: bool
    mesh_weight: float
    input_weight: float
    transform_weight: float
    isometry_weight: float
    moved_reach: np.ndarray | None = None
    met_reach: np.ndarray | None = None
    vertex_reach: np.ndarray | None = None

    def ends(self, s: int) -> tuple[int, int]:
        """Source and target frame of transition s: away from the keyframe."""
        return (s, s + 1) if s >= self.keyframe else (s + 1, s)

    def reach_of_moved(self, s: int) -> tuple[float, float]:
        if self.moved_reach is None or self.met_reach is None:
            return np.inf, np.inf
        return self.moved_reach[s], self.met_reach[s]

    def reach_of_vertices(self, t: int) -> float:
        return np.inf if self.vertex_reach is None else self.vertex_reach[t]


@dataclass(frozen=True)
class NearestPairs:
    """Nearest neighbours between a moving set and a cloud, both ways: (A,) into the cloud, (B,) into the set."""

    forth: np.ndarray
    back: np.ndarray


def chain(scene: TwinScene, nodes: np.ndarray, template: np.ndarray) -> np.ndarray:
    """Vertices of all frames, (T, V, 3). nodes (S, M, 6)."""
    vertices = np.zeros((len(scene.clouds), *template.shape))
    vertices[scene.keyframe] = template
    last = len(scene.clouds) - 1
    for s in [*range(scene.keyframe, last), *range(scene.keyframe - 1, -1, -1)]:
        source, target = scene.ends(s)
        vertices[target] = move(nodes[s], scene.levels, vertices[source])
    return vertices


def chamfer(scene: TwinScene, moving, frame: int, pairs: NearestPairs, weights=None, reach=(np.inf, np.inf)):
    """Both halves of CD_R against a frame's cloud, and the weights, robust and mutual, which ``weights`` freezes."""
    cloud, normals = scene.clouds[frame], scene.normals[frame]
    halves = [(moving - cloud[pairs.forth], normals[pairs.forth]), (moving[pairs.back] - cloud, normals)]
    if weights is None:
        weights = [robust_weight(r, scene.alpha, scene.power) for r, _ in halves]
        weights[0] = weights[0] * mutual_weight(moving, moving[pairs.back[pairs.forth]], reach[0])
        weights[1] = weights[1] * mutual_weight(cloud, cloud[pairs.forth[pairs.back]], reach[1])
    energies = [w * residual_energy(r, n, scene.tangential) for w, (r, n) in zip(weights, halves, strict=True)]
    return sum(e.mean() if scene.share_mean else e.sum() for e in energies), weights


@dataclass(frozen=True)
class Terms:
    """Unweighted terms: input (S,), transform (T,; the mesh term at the keyframe), isometry; and what was frozen."""

    input: np.ndarray
    transform: np.ndarray
    isometry: float
    weights: list


def terms(
    scene: TwinScene, nodes, template, moved_pairs: list[NearestPairs], vertex_pairs: list[NearestPairs], weights=None
) -> Terms:
    """Evaluate with these neighbours; ``weights`` (of an earlier ``Terms``) freezes the robust weights too."""
    steps, frames = len(scene.clouds) - 1, len(scene.clouds)
    weights = iter(weights) if weights is not None else iter([None] * (steps + frames))
    moved = []
    for s in range(steps):
        source, target = scene.ends(s)
        moving = move(nodes[s], scene.levels, scene.clouds[source])
        moved.append(chamfer(scene, moving, target, moved_pairs[s], next(weights), scene.reach_of_moved(s)))
    vertices = chain(scene, nodes, template)
    met = [
        chamfer(scene, vertices[t], t, vertex_pairs[t], next(weights), (scene.reach_of_vertices(t), np.inf))
        for t in range(frames)
    ]
    lengths = float(isometry(vertices, scene.edges).sum()) / (steps * len(scene.edges))
    return Terms(np.array([v for v, _ in moved]), np.array([v for v, _ in met]), lengths, [w for _, w in moved + met])


def total(scene: TwinScene, found: Terms, trust: np.ndarray) -> float:
    """The objective. trust (T,): confidence of each frame, 1 at the keyframe."""
    steps = len(found.input)
    transform = trust * found.transform
    others = transform.sum() - transform[scene.keyframe]
    return (
        scene.mesh_weight * transform[scene.keyframe]
        + scene.input_weight * found.input.sum() / steps
        + scene.transform_weight * others / steps
        + scene.isometry_weight * found.isometry
    )
