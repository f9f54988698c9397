"""Conjugate gradients against a sparse direct solve; residuals are recomputed, not trusted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
import warp as wp
from scipy.sparse import csr_matrix, identity
from scipy.sparse.linalg import spsolve

from warpdef.geometry.triangles import unique_edges
from warpdef.kernels.cg import ConjugateGradients
from warpdef.kernels.graphs import Graph, grid_graph, mesh_graph
from warpdef.kernels.levels import LevelTable, node8
from warpdef.kernels.ways import Way, going

WIDTH = {wp.vec3: 3, node8: 8}


@pytest.fixture(params=[1, 64], ids=["one lane", "64 lanes"])
def lanes(request: pytest.FixtureRequest, device: str) -> int:
    """Of a block on the CPU; CUDA has its own."""
    if device != "cpu" and request.param == 1:
        pytest.skip("CUDA has many lanes")
    return request.param


def matrix_of(graph: Graph) -> csr_matrix:
    """I + lambda (D - A), float64."""
    count, degree = len(graph.node), np.diff(graph.row)
    adjacency = csr_matrix((np.ones(len(graph.column)), graph.column, graph.row), shape=(count, count))
    weight = graph.weight[graph.system].astype(np.float64)
    laplacian = csr_matrix((degree, (range(count), range(count))), shape=(count, count)) - adjacency
    return identity(count, format="csr") + laplacian.multiply(weight[:, None]).tocsr()


class Solve:
    """One solver and its arrays."""

    def __init__(self, graph: Graph, dtype, size: int, device: str, lanes: int, tolerance=1e-6, iterations=200):
        self.graph, self.dtype, self.size, self.device = graph, dtype, size, wp.get_device(device)
        self.lanes = lanes
        with going(Way.WHOLE, lanes):
            self.solver = ConjugateGradients(graph, dtype, tolerance, iterations, self.device)

    def __call__(self, rhs: np.ndarray, first: int = 0, last: int | None = None) -> np.ndarray:
        """Solution in the full array, (size, width); nodes that are not kept hold 7."""
        flat = wp.array(rhs.astype(np.float32), dtype=self.dtype, device=self.device)
        solution = wp.full(self.size, self.dtype(*[7.0] * WIDTH[self.dtype]), dtype=self.dtype, device=self.device)
        with going(Way.WHOLE, self.lanes):
            self.solver.solve(flat, solution, first, len(self.graph.weight) if last is None else last)
        return solution.numpy()

    def residuals(self, rhs: np.ndarray, solution: np.ndarray) -> np.ndarray:
        """|b - A x| / |b| of every system and component, float64; 0 / 0 is 0."""
        b, x = (a[self.graph.node].astype(np.float64) for a in (rhs.astype(np.float32), solution))
        r = b - matrix_of(self.graph) @ x
        first = self.graph.first
        spans = [slice(i, j) for i, j in zip(first[:-1], first[1:], strict=True)]
        left, asked = (np.array([np.linalg.norm(a[span], axis=0) for span in spans]) for a in (r, b))
        return np.divide(left, asked, out=left.copy(), where=asked > 0)


def assert_solved(solve: Solve, rhs: np.ndarray, solution: np.ndarray, tolerance: float = 1e-6) -> None:
    """The residual is what it should be, the report says so, and the solution is the direct solver's."""
    # What is told was added up in float32.
    assert solve.residuals(rhs, solution).max() <= 1.2 * tolerance
    assert solve.solver.residual.numpy().max() <= tolerance
    asked = rhs.astype(np.float32)[solve.graph.node].astype(np.float64)
    expected = np.asarray(spsolve(matrix_of(solve.graph).tocsc(), asked))
    scale = np.abs(expected).max()
    np.testing.assert_allclose(solution[solve.graph.node], expected, rtol=0, atol=2e-5 * scale)


@pytest.fixture(params=["full", "pruned", "scattered"])
def grid(request: pytest.FixtureRequest, rng: np.random.Generator) -> tuple[Graph, int]:
    """Two transitions of four levels: all nodes, most, or so few that many stand alone and a system is empty."""
    levels, lambdas = LevelTable.build(1, 4), 0.25 * 1.5 ** np.arange(4) * 4
    kept = rng.random((2, levels.node_count)) < {"full": 1.1, "pruned": 0.7, "scattered": 0.1}[request.param]
    graph = grid_graph(levels, kept, lambdas)
    if request.param == "scattered":
        assert (np.diff(graph.row) == 0).any() and (np.diff(graph.first) == 0).any()
    return graph, kept.size


def test_grids(grid, device: str, lanes: int, rng: np.random.Generator) -> None:
    graph, size = grid
    solve, rhs = Solve(graph, node8, size, device, lanes), rng.normal(size=(size, 8))
    solution = solve(rhs)
    assert_solved(solve, rhs, solution)
    others = np.setdiff1d(np.arange(size), graph.node)
    np.testing.assert_array_equal(solution[others], 7)


def test_a_mesh(device: str, lanes: int, rng: np.random.Generator) -> None:
    vertices, faces = synthetic.icosphere(2)
    graph = mesh_graph(unique_edges(faces), len(vertices), 16.0)
    solve, rhs = Solve(graph, wp.vec3, len(vertices), device, lanes), rng.normal(size=vertices.shape)
    assert_solved(solve, rhs, solve(rhs))


@pytest.fixture
def sphere() -> tuple[Graph, int]:
    vertices, faces = synthetic.icosphere(2)
    return mesh_graph(unique_edges(faces), len(vertices), 16.0), len(vertices)


def test_the_start_is_the_last_solution(sphere, device: str, lanes: int, rng: np.random.Generator) -> None:
    solve, rhs = Solve(sphere[0], wp.vec3, sphere[1], device, lanes, tolerance=1e-4), rng.normal(size=(sphere[1], 3))
    solve(rhs)
    cold = int(solve.solver.iterations.numpy()[0])
    again = solve(rhs)
    assert solve.residuals(rhs, again).max() <= 1.1e-4
    assert solve.solver.iterations.numpy()[0] <= 1
    near = rhs + 1e-3 * rng.normal(size=rhs.shape)
    solution = solve(near)
    assert solve.residuals(near, solution).max() <= 1.1e-4
    assert 0 < solve.solver.iterations.numpy()[0] < cold
    solve.solver.forget()
    solve(rhs)
    assert solve.solver.iterations.numpy()[0] == cold


def test_each_component_has_its_own_scale(sphere, device: str, lanes: int, rng: np.random.Generator) -> None:
    """A small rotation beside a large translation, and a component that is zero stays exactly zero.

    The first is constant, an eigenvector: it is done after one step, which must not stop the others.
    """
    solve = Solve(sphere[0], wp.vec3, sphere[1], device, lanes, tolerance=1e-5)
    rhs = rng.normal(size=(sphere[1], 3)) * [0, 1e3, 0] + [1e-6, 0, 0]
    solution = solve(rhs)
    assert (solve.residuals(rhs, solution) <= 1.2e-5).all()
    np.testing.assert_array_equal(solution[:, 2], 0)
    assert solve.solver.residual.numpy()[0] <= 1e-5


def test_a_zero_right_hand_side_is_zero_at_once(sphere, device: str, lanes: int) -> None:
    solve = Solve(sphere[0], wp.vec3, sphere[1], device, lanes)
    np.testing.assert_array_equal(solve(np.zeros((sphere[1], 3))), 0)
    assert solve.solver.iterations.numpy()[0] == 0 and solve.solver.residual.numpy()[0] == 0


def test_a_right_hand_side_that_turns_zero(sphere, device: str, lanes: int, rng: np.random.Generator) -> None:
    """The last solution is a bad start then, and no residual is small against nothing."""
    solve = Solve(sphere[0], wp.vec3, sphere[1], device, lanes, tolerance=1e-5)
    rhs = rng.normal(size=(sphere[1], 3))
    solve(rhs)
    rhs[:, 1] = 0
    solution = solve(rhs)
    np.testing.assert_array_equal(solution[:, 1], 0)
    assert (solve.residuals(rhs, solution) <= 1.2e-5).all()
    np.testing.assert_array_equal(solve(0 * rhs), 0)
    assert solve.solver.residual.numpy()[0] == 0


def test_giving_up_is_said(sphere, device: str, lanes: int, rng: np.random.Generator) -> None:
    solve = Solve(sphere[0], wp.vec3, sphere[1], device, lanes, tolerance=1e-6, iterations=3)
    rhs = rng.normal(size=(sphere[1], 3))
    solution = solve(rhs)
    assert solve.solver.iterations.numpy()[0] == 3
    told = float(solve.solver.residual.numpy()[0])
    assert told > 1e-6
    assert told == pytest.approx(solve.residuals(rhs, solution).max(), rel=1e-3)


def stiff(sphere: tuple[Graph, int], weight: float) -> tuple[Graph, int]:
    return replace(sphere[0], weight=np.array([weight], np.float32)), sphere[1]


def test_where_rounding_forbids_the_tolerance_it_is_said(
    sphere, device: str, lanes: int, rng: np.random.Generator
) -> None:
    """The recursion believes 1e-4; the solution's own rounding leaves twice that. More restarts would not help."""
    graph, size = stiff(sphere, 1e4)
    solve = Solve(graph, wp.vec3, size, device, lanes, tolerance=1e-4)
    rhs = rng.normal(size=(sphere[1], 3))
    solution = solve(rhs)
    told = float(solve.solver.residual.numpy()[0])
    assert told > 1e-4
    assert told == pytest.approx(solve.residuals(rhs, solution).max(), rel=0.25)
    assert solve.solver.iterations.numpy()[0] < 50


def test_where_the_recursion_drifts_it_starts_again(device: str, lanes: int, rng: np.random.Generator) -> None:
    """Tolerances that one run of the recursion, believed, would miss."""
    vertices, faces = synthetic.icosphere(3)
    graph, rhs = mesh_graph(unique_edges(faces), len(vertices), 1e4), vertices + 0.1 * rng.normal(size=vertices.shape)
    solve = Solve(graph, wp.vec3, len(vertices), device, lanes, tolerance=1e-4)
    solution = solve(rhs)
    assert solve.solver.residual.numpy()[0] <= 1e-4
    assert solve.residuals(rhs, solution).max() <= 1e-4


@pytest.mark.parametrize("tolerance", [0.0, -1.0, 1.0, float("nan"), float("inf")])
def test_a_tolerance_that_cannot_work_is_refused(sphere, device: str, tolerance: float) -> None:
    with pytest.raises(ValueError, match=f"tolerance: expected a number above 0 and below 1, got {tolerance}"):
        ConjugateGradients(sphere[0], wp.vec3, tolerance, 10, wp.get_device(device))


@pytest.mark.parametrize("iterations", [0, -3])
def test_no_iterations_are_refused(sphere, device: str, iterations: int) -> None:
    with pytest.raises(ValueError, match=f"iterations_max: expected at least 1, got {iterations}"):
        ConjugateGradients(sphere[0], wp.vec3, 1e-4, iterations, wp.get_device(device))


def test_systems_stop_apart(device: str, lanes: int, rng: np.random.Generator) -> None:
    """A level of one node is done at once and then stands still while the finest goes on."""
    levels = LevelTable.build(1, 5)
    graph = grid_graph(levels, np.ones((1, levels.node_count), bool), 0.25 * 1.5 ** np.arange(5))
    solve, rhs = Solve(graph, node8, levels.node_count, device, lanes), rng.normal(size=(levels.node_count, 8))
    assert_solved(solve, rhs, solve(rhs))
    done = solve.solver.iterations.numpy()
    assert done[0] <= 1 and done[1] < done[4]


def test_a_span_of_systems_leaves_the_others_alone(rng: np.random.Generator) -> None:
    levels = LevelTable.build(1, 3)
    graph = grid_graph(levels, np.ones((3, levels.node_count), bool), np.ones(3))
    size = 3 * levels.node_count
    solve, rhs = Solve(graph, node8, size, "cpu", 1), rng.normal(size=(size, 8))
    middle = solve(rhs, 3, 6)
    span = slice(levels.node_count, 2 * levels.node_count)
    assert (middle[: span.start] == 7).all() and (middle[span.stop :] == 7).all()
    np.testing.assert_array_equal(middle[span], Solve(graph, node8, size, "cpu", 1)(rhs)[span])


def test_no_smoothing_is_the_identity(sphere, device: str, lanes: int, rng: np.random.Generator) -> None:
    graph, size = sphere
    plain = Graph(graph.node, graph.system, graph.first, graph.row, graph.column, np.zeros(1, np.float32))
    rhs = rng.normal(size=(size, 3)).astype(np.float32)
    np.testing.assert_allclose(Solve(plain, wp.vec3, size, device, lanes)(rhs), rhs, rtol=1e-6)


def test_any_number_of_lanes_agrees(grid, rng: np.random.Generator) -> None:
    """More lanes than a system has nodes, and fewer; each adds up in an order of its own."""
    graph, size = grid
    rhs = rng.normal(size=(size, 8))
    one = Solve(graph, node8, size, "cpu", 1)
    expected = one(rhs)
    for lanes in (3, 32, 200):
        shared = Solve(graph, node8, size, "cpu", lanes)
        found = shared(rhs)
        # No eigenvalue of the matrix is below 1, so each is off by its residual at most.
        np.testing.assert_allclose(found, expected, rtol=0, atol=2 * 1.2e-6 * np.linalg.norm(rhs, axis=0).max())
        np.testing.assert_allclose(shared.solver.iterations.numpy(), one.solver.iterations.numpy(), rtol=0, atol=1)
        shared.solver.forget()
        np.testing.assert_array_equal(shared(rhs), found)  # the same bits in every run


def test_the_operator_and_its_transpose(grid, device: str, rng: np.random.Generator) -> None:
    """z = alpha A x + beta y, also in place; and A is its own adjoint."""
    graph, size = grid
    solver, count = Solve(graph, node8, size, device, 1).solver, len(graph.node)
    x, y = rng.normal(size=(2, count, 8))
    dx, dy = (wp.array(a.astype(np.float32), dtype=node8, device=device) for a in (x, y))
    z = wp.full(count, node8(*[np.nan] * 8), dtype=node8, device=device)
    matrix = matrix_of(graph)
    solver.multiply_add(dx, z, z, 1.0, 0.0)  # beta = 0 must not read y
    np.testing.assert_allclose(z.numpy(), matrix @ x, rtol=0, atol=1e-5)
    assert (z.numpy() * y).sum() == pytest.approx(((matrix @ y) * x).sum(), rel=1e-4, abs=1e-2)
    solver.multiply_add(dx, dy, dy, -0.5, 2.0)
    np.testing.assert_allclose(dy.numpy(), 2 * y - 0.5 * (matrix @ x), rtol=0, atol=1e-5)


def test_gather_and_scatter(grid, device: str, rng: np.random.Generator) -> None:
    graph, size = grid
    solver = Solve(graph, node8, size, device, 1).solver
    full = wp.array(rng.normal(size=(size, 8)).astype(np.float32), dtype=node8, device=device)
    compact, back = wp.zeros(len(graph.node), dtype=node8, device=device), wp.zeros(size, dtype=node8, device=device)
    solver.gather(full, compact)
    np.testing.assert_array_equal(compact.numpy(), full.numpy()[graph.node])
    solver.scatter(compact, back)
    expected = np.zeros((size, 8), np.float32)
    expected[graph.node] = full.numpy()[graph.node]
    np.testing.assert_array_equal(back.numpy(), expected)
