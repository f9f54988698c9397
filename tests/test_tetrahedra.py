"""Surface vertices on crossed edges, their adjoint, and winding numbers."""

from __future__ import annotations

import numpy as np
import pytest
import reference_tetrahedra as twin
import synthetic
import warp as wp
import witness_tetrahedra
from gradients import assert_gradients_close, finite_differences, gradient_of
from numpy.typing import ArrayLike

from warpdef.kernels.levels import node8
from warpdef.kernels.tetrahedra import adj_surface_vertices, part_opposed, surface_vertices
from warpdef.kernels.winding import winding_numbers

BOUND = 0.3


def vectors(a: ArrayLike, device: str) -> wp.array:
    return wp.array(np.asarray(a, np.float32), dtype=wp.vec3, device=device)


def indices(a: ArrayLike, device: str) -> wp.array:
    return wp.array(np.asarray(a, np.int32), dtype=wp.int32, device=device)


class Grid:
    """Random nodes, half of them inside, and some edges that cross, in either direction."""

    def __init__(self, device: str, rng: np.random.Generator, nodes: int = 30, edges: int = 100) -> None:
        self.device = device
        self.rest = rng.normal(size=(nodes, 3)).astype(np.float32).astype(float)
        self.field = rng.normal(size=(nodes, 4)).astype(np.float32).astype(float)
        sign = np.where(np.arange(nodes) < nodes // 2, -1, 1)
        self.field[:, 0] = sign * (0.2 + np.abs(self.field[:, 0])).astype(np.float32)
        ends = np.column_stack([rng.integers(0, nodes // 2, edges), rng.integers(nodes // 2, nodes, edges)])
        self.edges = np.where(rng.random((edges, 1)) < 0.5, ends, ends[:, ::-1])
        self.weight = rng.normal(size=(edges, 3)).astype(np.float32).astype(float)

    def put(self, grad: bool = False) -> list:
        full = np.zeros((len(self.field), 8), dtype=np.float32)
        full[:, :4] = self.field
        full[:, 4:] = 7.0  # not read
        field = wp.array(full, dtype=node8, device=self.device, requires_grad=grad)
        return [indices(self.edges, self.device), vectors(self.rest, self.device), field, BOUND]

    def spans(self, cuts: tuple[int, ...]) -> list[tuple[int, int]]:
        places = [*cuts, len(self.edges)]
        return [(a, b - a) for a, b in zip(places[:-1], places[1:], strict=True)]

    def run(self, cuts=(0,)) -> tuple[np.ndarray, np.ndarray]:
        """Vertices and outward directions, (E, 3) each."""
        out = [vectors(np.full((len(self.edges), 3), np.nan), self.device) for _ in range(2)]
        for begin, count in self.spans(cuts):
            surface_vertices(begin, count, *self.put(), *out)
        return out[0].numpy(), out[1].numpy()

    def adjoint(self, start: float = 0.0, cuts=(0,)) -> np.ndarray:
        """(N, 8)."""
        out = wp.array(np.full((len(self.field), 8), start, np.float32), dtype=node8, device=self.device)
        for begin, count in self.spans(cuts):
            edges, rest, field, bound = self.put()
            adj_surface_vertices(begin, count, edges, rest, field, bound, vectors(self.weight, self.device), out)
        return out.numpy()


@pytest.fixture
def grid(device: str, rng: np.random.Generator) -> Grid:
    return Grid(device, rng)


def test_vertices_match_the_twin(grid: Grid) -> None:
    vertices, _ = grid.run()
    np.testing.assert_allclose(vertices, twin.vertices(grid.edges, grid.rest, grid.field, BOUND), rtol=0, atol=2e-6)


def test_directions_lead_outwards(grid: Grid) -> None:
    _, outward = grid.run()
    x = grid.rest + BOUND * np.tanh(grid.field[:, 1:])
    inner = np.where(grid.field[grid.edges[:, 0], 0] < 0, *grid.edges.T)
    outer = grid.edges.sum(axis=1) - inner
    d = x[outer] - x[inner]
    np.testing.assert_allclose(outward, d / np.linalg.norm(d, axis=1, keepdims=True), atol=2e-6)


def test_adjoint_matches_the_twin(grid: Grid) -> None:
    found = grid.adjoint()
    assert_gradients_close(found[:, :4], twin.adj_vertices(grid.edges, grid.rest, grid.field, BOUND, grid.weight))
    np.testing.assert_array_equal(found[:, 4:], 0)


def test_adjoint_matches_finite_differences(grid: Grid) -> None:
    def loss(field: np.ndarray) -> float:
        return float((grid.weight * twin.vertices(grid.edges, grid.rest, field, BOUND)).sum())

    assert_gradients_close(grid.adjoint()[:, :4], finite_differences(loss, grid.field))


def test_adjoint_matches_finite_differences_of_the_kernel(grid: Grid, rng: np.random.Generator) -> None:
    adj, field, step = grid.adjoint()[:, :4], grid.field.copy(), 1e-2
    directions = rng.normal(size=(20, *field.shape))
    found = []
    for direction in directions:
        ends = []
        for sign in (1, -1):
            grid.field = field + sign * step * direction
            ends.append(float((grid.weight * grid.run()[0].astype(float)).sum()))
        found.append((ends[0] - ends[1]) / (2 * step))
    expected = np.einsum("dnc,nc->d", directions, adj)
    assert_gradients_close(np.array(found), expected, elementwise=0.02, direction=1e-3, relative=0.02)


def test_adjoint_matches_autodiff(grid: Grid) -> None:
    edges, rest, field, bound = grid.put(grad=True)
    loss = wp.zeros(1, dtype=wp.float32, device=grid.device, requires_grad=True)
    with wp.Tape() as tape:
        inputs = [edges, rest, field, bound, vectors(grid.weight, grid.device), loss]
        wp.launch(witness_tetrahedra.weighted_vertices, len(grid.edges), inputs=inputs, device=grid.device)
    tape.backward(loss)
    assert_gradients_close(grid.adjoint()[:, :4], gradient_of(field)[:, :4])


def test_the_adjoint_adds_and_spans_are_the_whole(grid: Grid) -> None:
    whole = grid.adjoint()
    np.testing.assert_allclose(grid.adjoint(start=5.0), whole + 5.0, rtol=0, atol=1e-4)
    tolerance = 0 if grid.device == "cpu" else 1e-4  # CUDA adds in any order
    np.testing.assert_allclose(grid.adjoint(cuts=(0, 1, 60)), whole, rtol=0, atol=tolerance)
    for found, expected in zip(grid.run(cuts=(0, 1, 60)), grid.run(), strict=True):
        np.testing.assert_array_equal(found, expected)


class Edge:
    """One edge along x from 0 to 2."""

    def __init__(self, device: str, s_i: float, s_j: float) -> None:
        self.grid = Grid(device, np.random.default_rng(0), nodes=2, edges=1)
        self.grid.edges = np.array([[0, 1]])
        self.grid.rest = np.array([[0.0, 0, 0], [2, 0, 0]])
        self.grid.field = np.array([[s_i, 0, 0, 0], [s_j, 0, 0, 0]])
        self.grid.weight = np.array([[1.0, 0, 0]])


@pytest.mark.parametrize(
    ("s_i", "s_j", "place"), [(-1, 3, 0.5), (3, -1, 1.5), (0, -1, 0), (-1, 0, 2), (-1e-3, 1e-3, 1)]
)
def test_an_edge_by_hand(device: str, s_i: float, s_j: float, place: float) -> None:
    """A node exactly on the surface carries the vertex; it still feels where the surface ought to be."""
    edge = Edge(device, s_i, s_j).grid
    vertices, outward = edge.run()
    np.testing.assert_allclose(vertices, [[place, 0, 0]], atol=1e-6)
    np.testing.assert_array_equal(outward, [[1 if s_i < 0 else -1, 0, 0]])
    d = s_i - s_j
    np.testing.assert_allclose(edge.adjoint()[:, 0], [-2 * s_j / d**2, 2 * s_i / d**2], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("tiny", [0.0, 1e-30, 1e-5, 4.9e-5])
def test_a_field_without_slope_has_no_gradient(device: str, tiny: float) -> None:
    edge = Edge(device, tiny, -tiny).grid
    np.testing.assert_array_equal(edge.run()[0], [[1, 0, 0]])
    adj = edge.adjoint()
    np.testing.assert_array_equal(adj[:, 0], 0)
    np.testing.assert_allclose(adj[:, 1], BOUND / 2)


def test_an_edge_of_no_length_and_endless_offsets(device: str) -> None:
    edge = Edge(device, -1.0, 1.0).grid
    edge.rest[:] = 0.5
    vertices, outward = edge.run()
    np.testing.assert_array_equal(vertices, [[0.5, 0.5, 0.5]])
    np.testing.assert_array_equal(outward, 0)
    np.testing.assert_array_equal(edge.adjoint()[:, 0], 0)
    edge.field[:, 1:] = 1e30
    np.testing.assert_allclose(edge.run()[0], 0.5 + BOUND, rtol=1e-6)
    np.testing.assert_array_equal(edge.adjoint()[:, 1:], 0)


def test_opposed_pairs_are_parted(device: str) -> None:
    sides = np.array([[0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 0, 0], [1, 0, 0]])
    nearest = indices([0, 1, 2, 0, -1], device)
    targets = vectors([[0, 0, 1], [0, 0, -1], [1, 0, 0]], device)
    part_opposed(0, 5, vectors(sides, device), targets, nearest)
    np.testing.assert_array_equal(nearest.numpy(), [0, -1, -1, -1, -1])


# Winding numbers.


def run_winding(points, area_normals, places, device: str, cuts=(0,)) -> np.ndarray:
    out = wp.array(np.full(len(places), np.nan, np.float32), dtype=wp.float32, device=device)
    ends = [*cuts, len(places)]
    for begin, end in zip(ends[:-1], ends[1:], strict=True):
        sources, sides, at = (vectors(a, device) for a in (points, area_normals, places))
        winding_numbers(begin, end - begin, sources, sides, at, out)
    return out.numpy()


def test_winding_numbers_match_the_twin(device: str, rng: np.random.Generator) -> None:
    points, normals, places = (rng.normal(size=(n, 3)).astype(np.float32) for n in (200, 200, 50))
    expected = twin.winding(*(a.astype(float) for a in (points, normals, places)))
    found = run_winding(points, normals, places, device)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)
    np.testing.assert_array_equal(run_winding(points, normals, places, device, cuts=(0, 1, 20)), found)


def test_winding_numbers_of_a_sphere(device: str, rng: np.random.Generator) -> None:
    """About one inside, none outside, however far; turned inside out, the negative."""
    sphere, _ = synthetic.icosphere(3)
    area = 4 * np.pi / len(sphere)
    direction = rng.normal(size=(40, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    for radius, expected in ((0.0, 1), (0.5, 1), (0.8, 1), (1.3, 0), (5.0, 0), (1e4, 0)):
        found = run_winding(sphere, area * sphere, radius * direction, device)
        np.testing.assert_allclose(found, expected, atol=0.05)
        np.testing.assert_allclose(run_winding(sphere, -area * sphere, radius * direction, device), -found, atol=1e-6)


def test_a_point_says_nothing_about_its_own_place(device: str) -> None:
    points = np.array([[0.0, 0, 0], [0, 0, 2]])
    found = run_winding(points, np.array([[0.0, 0, 1], [0, 0, 1]]), points[:1], device)
    np.testing.assert_allclose(found, 1 / (4 * np.pi * 4), rtol=1e-6)
