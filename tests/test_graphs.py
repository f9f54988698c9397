"""Graphs of pruned grids and meshes, and which nodes pruning keeps."""

from __future__ import annotations

import numpy as np
import pytest
import reference
import synthetic

from warpdef.geometry.triangles import unique_edges
from warpdef.kernels.graphs import Graph, grid_graph, kept_nodes, mesh_graph
from warpdef.kernels.levels import LevelTable


def dense(graph: Graph) -> np.ndarray:
    """I + lambda L of all systems behind each other, read from the compressed rows."""
    count = len(graph.node)
    matrix = np.eye(count)
    for i in range(count):
        weight, neighbours = graph.weight[graph.system[i]], graph.column[graph.row[i] : graph.row[i + 1]]
        matrix[i, i] += weight * len(neighbours)
        matrix[i, neighbours] -= weight
    return matrix


def expected_grid(levels: LevelTable, kept: np.ndarray, lambdas: np.ndarray) -> np.ndarray:
    """The same by definition: edges between kept nodes only."""
    size = len(lambdas) * len(kept)
    blocks = []
    for s in range(len(kept)):
        for n, begin, weight in zip(levels.resolution, levels.offset[:-1], lambdas, strict=True):
            keep = kept[s, begin : begin + n**3]
            edges = reference.grid_edges(int(n))
            edges = edges[keep[edges].all(axis=1)]
            blocks.append(reference.smoother(edges, int(n) ** 3, weight)[np.ix_(keep, keep)])
    assert len(blocks) == size
    total = np.zeros((int(kept.sum()),) * 2)
    at = 0
    for block in blocks:
        total[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return total


@pytest.mark.parametrize("share", [1.0, 0.6, 0.15])
def test_grid_graph_is_the_six_neighbour_laplacian(share: float, rng: np.random.Generator) -> None:
    levels, lambdas = LevelTable.build(1, 3), np.array([0.5, 1.0, 2.0])
    kept = rng.random((2, levels.node_count)) < share
    graph = grid_graph(levels, kept, lambdas)
    np.testing.assert_allclose(dense(graph), expected_grid(levels, kept, lambdas), rtol=0, atol=1e-6)
    np.testing.assert_array_equal(graph.node, np.flatnonzero(kept))
    # Systems stand behind each other, empty ones included.
    assert len(graph.first) == 7 and graph.first[-1] == len(graph.node)
    for system in range(6):
        span = graph.node[graph.first[system] : graph.first[system + 1]]
        s, level = divmod(system, 3)
        low = s * levels.node_count + levels.offset[level]
        assert ((span >= low) & (span < low + levels.resolution[level] ** 3)).all()
        assert (graph.system[graph.first[system] : graph.first[system + 1]] == system).all()


def test_a_system_without_nodes_is_an_empty_span() -> None:
    levels = LevelTable.build(1, 2)
    kept = np.ones((2, levels.node_count), dtype=bool)
    kept[0, 1:] = False
    assert grid_graph(levels, kept, np.ones(2)).first.tolist() == [0, 1, 1, 2, 29]


def test_mesh_graph_is_the_uniform_laplacian() -> None:
    vertices, faces = synthetic.icosphere(1)
    edges = unique_edges(faces)
    graph = mesh_graph(edges, len(vertices), 16.0)
    np.testing.assert_allclose(dense(graph), reference.smoother(edges, len(vertices), 16.0))
    assert graph.first.tolist() == [0, len(vertices)]


def kept_by_definition(n: int, points: np.ndarray, cells: int) -> np.ndarray:
    """A node stays if one of its coordinates' cubes of ``cells`` nodes around it holds a corner of an occupied cell."""
    occupied = np.zeros((n, n, n), dtype=bool)
    for p in points:
        low = np.clip(np.floor((p + 1) / 2 * (n - 1)).astype(int), 0, max(n - 2, 0))
        for corner in np.ndindex(2, 2, 2):
            occupied[tuple(np.minimum(low + corner, n - 1))] = True
    kept = np.zeros_like(occupied)
    for node in np.ndindex(n, n, n):
        around = tuple(slice(max(c - cells, 0), c + cells + 1) for c in node)
        kept[node] = occupied[around].any()
    return kept.ravel()


@pytest.mark.parametrize("cells", [0, 1, 3, 50])
def test_pruning_keeps_a_cube_around_occupied_cells(cells: int, rng: np.random.Generator) -> None:
    levels = LevelTable.build(1, 6)
    clouds = [rng.normal(size=(5, 3)) * 0.1 + 0.6, np.array([[-1.0, -1, 1], [1, 1, 1]])]
    expected = np.concatenate([kept_by_definition(int(n), np.concatenate(clouds), cells) for n in levels.resolution])
    found = kept_nodes(levels, clouds, cells)
    np.testing.assert_array_equal(found, expected)
    assert found[0] and (cells == 50) == found.all()


def test_every_node_a_point_reads_is_kept(rng: np.random.Generator) -> None:
    levels, points = LevelTable.build(1, 8), rng.uniform(-1, 1, (30, 3))
    kept = kept_nodes(levels, [points], 0)
    assert not kept.all()
    for n, begin in zip(levels.resolution, levels.offset[:-1], strict=True):
        nodes, weights, _ = reference.corners(points, int(n))
        assert kept[begin + nodes[weights > 0]].all()
