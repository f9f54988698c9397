"""The same answers by NumPy, SciPy and, where it is installed, torch: what the kernels' speed is compared with."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.util import find_spec

import numpy as np

from warpdef.apps.benchmark.bed import Peer
from warpdef.kernels.cosine import cosine_matrix
from warpdef.kernels.graphs import Graph
from warpdef.kernels.levels import LevelTable


def level_blocks(nodes: np.ndarray, table: LevelTable) -> list[np.ndarray]:
    """Views (S, n, n, n, 8) of each level of an array (S, M, 8)."""
    spans = zip(table.resolution, table.offset[:-1], strict=True)
    return [nodes[:, o : o + n**3].reshape(len(nodes), n, n, n, 8) for n, o in spans]


def sample_scipy(nodes: np.ndarray, table: LevelTable, clouds: Sequence[np.ndarray]) -> np.ndarray:
    """Mean over levels of trilinear samples at the points of each transition, (N, 8), by ``scipy.ndimage``."""
    from scipy.ndimage import map_coordinates

    values = [np.zeros((len(c), 8), dtype=np.float32) for c in clouds]
    for block in level_blocks(nodes, table):
        n = block.shape[1]
        for s, cloud in enumerate(clouds):
            at = ((cloud + 1.0) * (0.5 * (n - 1))).T
            for c in range(6):
                values[s][:, c] += map_coordinates(block[s, ..., c], at, order=1, mode="nearest")
    return np.concatenate(values) / table.count


def scatter_numpy(adj: np.ndarray, table: LevelTable, clouds: Sequence[np.ndarray]) -> np.ndarray:
    """Adjoint of ``sample_scipy``, (S, M, 8), by weighted ``numpy.bincount``."""
    out = np.zeros((len(clouds), table.node_count, 8), dtype=np.float32)
    ends = np.cumsum([len(c) for c in clouds])[:-1]
    for s, (cloud, g) in enumerate(zip(clouds, np.split(adj, ends), strict=True)):
        for n, offset in zip(table.resolution, table.offset[:-1], strict=True):
            at = np.clip((cloud + 1.0) * (0.5 * (n - 1)), 0, n - 1)
            low = np.minimum(at.astype(np.int64), max(n - 2, 0))
            f = at - low
            for corner in np.ndindex(2, 2, 2):
                weight = np.prod(np.where(corner, f, 1.0 - f), axis=1) / table.count
                x, y, z = np.minimum(low + corner, n - 1).T
                node = (x * n + y) * n + z
                for c in range(6):
                    out[s, offset : offset + n**3, c] += np.bincount(node, weight * g[:, c], n**3)
    return out


def rotate_numpy(z: np.ndarray, x: np.ndarray) -> np.ndarray:
    """R(z) x of the Cayley map, (N, 3)."""
    k = 2.0 / (1.0 + np.einsum("ni,ni->n", z, z))
    c = np.cross(z, x)
    return x + k[:, None] * (c + np.cross(z, c))


def torch_peers(nodes: np.ndarray, adj: np.ndarray, table: LevelTable, clouds: Sequence[np.ndarray]) -> dict[str, Peer]:
    """``grid_sample`` a level, forwards and backwards to the nodes; empty without torch or with unequal clouds.

    Args:
        nodes: (S, M, 8). adj: (N, 8), gradient of the samples.
    """
    if find_spec("torch") is None or len({len(c) for c in clouds}) > 1:
        return {}
    import torch  # pyright: ignore[reportMissingImports] - a peer where it happens to be installed; no dependency

    # Our first axis is x; grid_sample's last input axis is its first coordinate.
    at = torch.from_numpy(np.stack(clouds)[:, None, None, :, ::-1].astype(np.float32))
    blocks = [
        torch.from_numpy(np.ascontiguousarray(b.transpose(0, 4, 1, 2, 3)[:, :6])).requires_grad_(True)
        for b in level_blocks(nodes, table)
    ]
    pull = torch.from_numpy(np.ascontiguousarray(adj.reshape(len(clouds), -1, 8)[:, :, :6].transpose(0, 2, 1)))

    def forward(workers: int) -> torch.Tensor:
        torch.set_num_threads(workers)
        sample = torch.nn.functional.grid_sample
        found = [sample(b, at, mode="bilinear", padding_mode="border", align_corners=True) for b in blocks]
        return sum(found[1:], start=found[0])[:, :, 0, 0] / len(blocks)

    def value(workers: int) -> np.ndarray:
        with torch.no_grad():
            result = forward(workers).numpy().transpose(0, 2, 1).reshape(-1, 6)
        return np.pad(result, ((0, 0), (0, 2)))

    def gradient(workers: int) -> np.ndarray:
        pulled = torch.autograd.grad(forward(workers), blocks, pull)
        flat = [p.numpy().transpose(0, 2, 3, 4, 1).reshape(len(nodes), -1, 6) for p in pulled]
        return np.pad(np.concatenate(flat, axis=1), ((0, 0), (0, 0), (0, 2)))

    name = "torch grid_sample"
    # torch has no backward pass without a forward one.
    return {"value": Peer(name, value, True), "gradient": Peer(f"{name} and backward", gradient, True)}


def chamfer_numpy(
    moving: np.ndarray, fixed: np.ndarray, normals: np.ndarray, robust: tuple[float, int, float], weight: float
) -> tuple[np.ndarray, np.ndarray]:
    """Energies (N,) of pairs and their gradients (N, 3) to the moving points; arguments a row a pair."""
    alpha, power, tangential = robust
    r = moving - fixed
    d_sq = np.einsum("ni,ni->n", r, r)
    along = np.einsum("ni,ni->n", normals, r)
    w = np.exp(-alpha * (d_sq if power == 2 else d_sq * d_sq))
    energy = w * ((1.0 - tangential) * along**2 + tangential * d_sq)
    pull = (2.0 * weight * w)[:, None] * ((1.0 - tangential) * along[:, None] * normals + tangential * r)
    return energy, pull


def add_rows(index: np.ndarray, rows: np.ndarray, count: int) -> np.ndarray:
    """Rows (N, C) summed by index into (count, C)."""
    return np.stack([np.bincount(index, rows[:, c], count) for c in range(rows.shape[1])], axis=1)


def isometry_numpy(
    vertices: np.ndarray, edges: np.ndarray, share: float, weight: float
) -> tuple[np.ndarray, np.ndarray]:
    """Gradient (T, V, 3) of the change of edge length between neighbouring frames, and the loss."""
    d = vertices[:, edges[:, 0]] - vertices[:, edges[:, 1]]
    length = np.linalg.norm(d, axis=2)
    change = np.diff(length, axis=0)
    pull = np.zeros_like(length)
    pull[1:] += np.sign(change)
    pull[:-1] -= np.sign(change)
    with np.errstate(invalid="ignore", divide="ignore"):
        g = np.where(length > 0, weight * share * pull / length, 0.0)[..., None] * d
    count = vertices.shape[1]
    both = np.concatenate([edges[:, 0], edges[:, 1]])
    gradient = np.stack([add_rows(both, np.concatenate([row, -row]), count) for row in g])
    return gradient, share * np.abs(change).sum(dtype=np.float64)


def cosine_numpy(rhs: np.ndarray, table: LevelTable, lambdas: np.ndarray) -> Callable[[int], np.ndarray]:
    """(I + lambda L)^-1 on full grids by batched matrix products, (S, M, 8); BLAS takes the threads it likes."""
    bases = [cosine_matrix(int(n)).astype(np.float32) for n in table.resolution]
    scales = []
    for n, weight in zip(table.resolution, lambdas, strict=True):
        mu = 2.0 - 2.0 * np.cos(np.pi * np.arange(n) / n)
        total = mu[:, None, None] + mu[None, :, None] + mu[None, None, :]
        scales.append((1.0 / (1.0 + weight * total)).astype(np.float32)[..., None])

    def along_axes(matrix: np.ndarray, block: np.ndarray) -> np.ndarray:
        s, n = block.shape[:2]
        block = np.matmul(matrix, block.reshape(s, n, n * n * 8))
        block = np.matmul(matrix, block.reshape(s * n, n, n * 8))
        return np.matmul(matrix, block.reshape(s * n * n, n, 8)).reshape(s, n, n, n, 8)

    def solve(workers: int) -> np.ndarray:
        out = np.empty_like(rhs)
        for base, scale, source, target in zip(
            bases, scales, level_blocks(rhs, table), level_blocks(out, table), strict=True
        ):
            target[...] = along_axes(base.T, along_axes(base, source) * scale)
        return out

    return solve


class Factored:
    """Every system of a graph, factored once by SuperLU; what a direct solver then needs for each right-hand side."""

    def __init__(self, graph: Graph) -> None:
        from scipy.sparse import csr_array, identity
        from scipy.sparse.linalg import splu

        degree = np.diff(graph.row)
        adjacency = csr_array((np.ones(len(graph.column)), graph.column, graph.row), shape=(len(degree),) * 2)
        self._node = graph.node
        self._factors = []
        for s, weight in enumerate(graph.weight):
            span = slice(graph.first[s], graph.first[s + 1])
            laplacian = -adjacency[span, span].tocsc()
            laplacian.setdiag(degree[span])
            matrix = identity(laplacian.shape[0], format="csc") + float(weight) * laplacian
            factor = splu(matrix.tocsc(), options={"SymmetricMode": True}, permc_spec="MMD_AT_PLUS_A")
            self._factors.append((span, factor))

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solutions for a flat full array (N, components) float64; nodes that are not kept stay 0."""
        out = np.zeros_like(rhs)
        for span, factor in self._factors:
            node = self._node[span]
            out[node] = factor.solve(rhs[node])
        return out
