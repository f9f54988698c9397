"""Block conjugate gradients against a sparse direct solve; residuals are recomputed, not trusted."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic
import warp as wp
from scipy.sparse import block_diag, csr_matrix, diags, identity, kron
from scipy.sparse.linalg import spsolve

from warpdef.geometry.triangles import unique_edges
from warpdef.kernels.block_cg import BlockSolver
from warpdef.kernels.graphs import Graph, mesh_graph
from warpdef.kernels.ways import Way, going

FRAMES, ALPHA, BETA = 4, 0.3, 0.01
SERIAL = 0


@pytest.fixture(params=[SERIAL, 1, 64], ids=["serial", "one lane", "64 lanes"])
def lanes(request: pytest.FixtureRequest, device: str) -> int:
    """Of a block on the CPU, or the CPU's own way; CUDA has its own number."""
    if device != "cpu" and request.param != 64:
        pytest.skip("CUDA has many lanes")
    return request.param


@pytest.fixture
def graph() -> Graph:
    """A sphere of 162 vertices, and one vertex without edges, the last."""
    vertices, faces = synthetic.icosphere(2)
    return mesh_graph(unique_edges(faces), len(vertices) + 1, 1.0)


@pytest.fixture
def system(graph: Graph, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Blocks as planes make them, of rank 0 to 3, the first frame without any; and right-hand sides."""
    count = len(graph.node)
    normals = rng.normal(size=(FRAMES, count, 3, 3))
    normals *= rng.integers(0, 2, (FRAMES, count, 3, 1)) * np.array([0, 0.5, 1, 2])[:, None, None, None]
    matrix = np.einsum("tvka,tvkb->tvab", normals, normals).astype(np.float32)
    assert set(np.linalg.matrix_rank(matrix[1:].reshape(-1, 3, 3))) == {0, 1, 2, 3}
    return matrix, rng.normal(size=(FRAMES, count, 3)).astype(np.float32)


def matrix_of(graph: Graph, blocks: np.ndarray, alpha: float, beta: float, stiffness=None) -> csr_matrix:
    """A + beta I + alpha L of one frame, float64; the numbers are those the kernel gets."""
    count = len(graph.node)
    alpha, beta = (float(np.float32(a)) for a in (alpha, beta))
    stiffness = np.ones(count) if stiffness is None else stiffness.astype(np.float64)
    weight = 0.5 * (stiffness[np.repeat(np.arange(count), np.diff(graph.row))] + stiffness[graph.column])
    adjacency = csr_matrix((weight, graph.column, graph.row), shape=(count, count))
    scalar = alpha * (diags(np.asarray(adjacency.sum(axis=1)).ravel()) - adjacency) + beta * identity(count)
    return (block_diag(blocks.astype(np.float64)) + kron(scalar, identity(3))).tocsr()


class BlockSolve:
    """One solver, all its frames; ``solution`` holds 7 where nobody wrote."""

    def __init__(self, graph: Graph, device: str, lanes: int, tolerance=1e-5, iterations=300, frames=FRAMES):
        self.graph, self.device, self.frames = graph, wp.get_device(device), frames
        self.lanes, self.way = max(lanes, 1), Way.WHOLE if lanes else Way.SPANS
        with going(self.way, self.lanes):
            self.solver = BlockSolver(graph, frames, tolerance, iterations, self.device)

    def __call__(self, matrix, rhs, alpha=ALPHA, beta=BETA, spans=None, stiffness=None) -> np.ndarray:
        blocks = wp.array(matrix.astype(np.float32), dtype=wp.mat33, device=self.device)
        asked = wp.array(rhs.astype(np.float32), dtype=wp.vec3, device=self.device)
        stiff = None if stiffness is None else wp.array(stiffness, dtype=wp.float32, device=self.device)
        solution = wp.full(rhs.shape[:2], wp.vec3(7.0, 7.0, 7.0), dtype=wp.vec3, device=self.device)
        for first, last in spans or [(0, self.frames)]:
            with going(self.way, self.lanes):
                self.solver.solve(first, last, alpha, beta, blocks, asked, solution, stiff)
        np.testing.assert_array_equal(asked.numpy(), rhs.astype(np.float32))
        return solution.numpy()

    def residuals(self, matrix, rhs, solution, alpha=ALPHA, beta=BETA, stiffness=None) -> np.ndarray:
        """|b - M x| / |b| of every frame, float64; 0 / 0 is 0."""
        left = []
        for blocks, b, x in zip(matrix, rhs.astype(np.float64), solution.astype(np.float64), strict=True):
            r = b.ravel() - matrix_of(self.graph, blocks, alpha, beta, stiffness) @ x.ravel()
            left.append(np.linalg.norm(r) / (np.linalg.norm(b) or 1.0))
        return np.array(left)

    @property
    def told(self) -> np.ndarray:
        return self.solver.residual.numpy()

    @property
    def iterations(self) -> np.ndarray:
        return self.solver.iterations.numpy()


@pytest.mark.parametrize(("alpha", "beta"), [(ALPHA, BETA), (3.0, 0.1), (1e-3, 1.0)])
def test_it_is_the_direct_solution(alpha, beta, graph, system, device: str, lanes: int) -> None:
    solve, (matrix, rhs) = BlockSolve(graph, device, lanes), system
    solution = solve(matrix, rhs, alpha, beta)
    # What is told was added up in float32.
    assert (solve.residuals(matrix, rhs, solution, alpha, beta) <= 1.2e-5).all()
    assert (solve.told <= 1e-5).all() and (solve.iterations > 1).all()
    for t in range(FRAMES):
        m = matrix_of(graph, matrix[t], alpha, beta)
        expected = np.asarray(spsolve(m.tocsc(), rhs[t].ravel().astype(np.float64))).reshape(-1, 3)
        # |x - x*| <= |M^-1| |r|, and the smallest eigenvalue of M is beta at least.
        bound = 2e-5 * np.linalg.norm(rhs[t]) / beta
        assert np.linalg.norm(solution[t] - expected) <= bound
        assert np.linalg.norm(solution[t] - expected) <= 1e-3 * np.linalg.norm(expected)


def test_edges_are_as_stiff_as_their_ends(graph, system, device: str, lanes: int, rng: np.random.Generator) -> None:
    solve, (matrix, rhs) = BlockSolve(graph, device, lanes), system
    stiffness = rng.uniform(0.5, 2.0, len(graph.node)).astype(np.float32)
    solution = solve(matrix, rhs, stiffness=stiffness)
    assert (solve.residuals(matrix, rhs, solution, stiffness=stiffness) <= 1.2e-5).all()
    assert (solve.residuals(matrix, rhs, solution) > 1e-2).all()
    even = solve(matrix, rhs, stiffness=np.ones(len(graph.node), np.float32))
    np.testing.assert_array_equal(even, BlockSolve(graph, device, lanes)(matrix, rhs))


def test_a_zero_right_hand_side_is_zero_at_once(graph, system, device: str, lanes: int) -> None:
    """In every frame, or in one while the others go on."""
    solve, (matrix, rhs) = BlockSolve(graph, device, lanes), system
    rhs[2] = 0
    solution = solve(matrix, rhs)
    np.testing.assert_array_equal(solution[2], 0)
    assert solve.iterations[2] == 0 and solve.told[2] == 0
    assert (solve.residuals(matrix, rhs, solution) <= 2e-5).all()
    assert (np.delete(solve.iterations, 2) > 1).all()
    np.testing.assert_array_equal(solve(matrix, 0 * rhs), 0)
    np.testing.assert_array_equal(solve.iterations, 0)
    np.testing.assert_array_equal(solve.told, 0)


def test_giving_up_is_said(graph, system, device: str, lanes: int) -> None:
    solve, (matrix, rhs) = BlockSolve(graph, device, lanes, tolerance=1e-6, iterations=3), system
    solution = solve(matrix, rhs)
    np.testing.assert_array_equal(solve.iterations, 3)
    assert (solve.told > 1e-6).all()
    np.testing.assert_allclose(solve.told, solve.residuals(matrix, rhs, solution), rtol=1e-3)


def test_what_is_told_is_the_true_residual(graph, system, device: str, lanes: int) -> None:
    """So stiff that the recursion drifts; the first frame, without any planes, cannot have what is asked for."""
    solve, (matrix, rhs) = BlockSolve(graph, device, lanes, tolerance=1e-4), system
    left = solve.residuals(matrix, rhs, solve(matrix, rhs, 1e4, BETA), 1e4, BETA)
    assert (left > 1e-4).any() and (solve.iterations < 300).all()
    np.testing.assert_allclose(solve.told, left, rtol=0.5, atol=5e-5)
    solve = BlockSolve(graph, device, lanes, tolerance=1e-3)
    left = solve.residuals(matrix, rhs, solve(matrix, rhs, 3e3, BETA), 3e3, BETA)
    assert (solve.told[1:] <= 1e-3).all() and (left[1:] <= 1.02e-3).all()


@pytest.mark.parametrize(
    ("tolerance", "iterations", "message"),
    [(0.0, 5, "tolerance"), (float("nan"), 5, "tolerance"), (1e-3, 0, "iterations_max")],
)
def test_limits_that_cannot_work_are_refused(
    graph, device: str, tolerance: float, iterations: int, message: str
) -> None:
    with pytest.raises(ValueError, match=f"{message}: expected"):
        BlockSolver(graph, FRAMES, tolerance, iterations, wp.get_device(device))


def test_a_loose_tolerance_stops_early_and_is_kept(graph, system, device: str, lanes: int) -> None:
    solve, (matrix, rhs) = BlockSolve(graph, device, lanes, tolerance=1e-2), system
    solution = solve(matrix, rhs)
    left = solve.residuals(matrix, rhs, solution)
    assert (left <= 1.01e-2).all()
    np.testing.assert_allclose(solve.told, left, rtol=1e-2)
    fine = BlockSolve(graph, device, lanes)
    fine(matrix, rhs)
    assert (solve.iterations < fine.iterations).all()


def test_frames_stop_apart(graph, system, device: str, lanes: int) -> None:
    """A frame whose blocks hold every vertex is soon done and stands still while one without blocks goes on."""
    matrix, rhs = system
    matrix[3] = 1e3 * np.eye(3)
    solve = BlockSolve(graph, device, lanes)
    solution = solve(matrix, rhs)
    assert solve.iterations[3] <= 3 < 10 < solve.iterations[0]
    assert (solve.residuals(matrix, rhs, solution) <= 2e-5).all()


@pytest.mark.parametrize("lanes", [SERIAL, 1])
def test_single_frames_are_all_frames(graph, system, lanes: int) -> None:
    """CPU: spans of frames, in any order, give the bits of one call."""
    matrix, rhs = system
    whole, single = BlockSolve(graph, "cpu", lanes), BlockSolve(graph, "cpu", lanes)
    expected = whole(matrix, rhs)
    np.testing.assert_array_equal(single(matrix, rhs, spans=[(3, 4), (0, 1), (1, 3)]), expected)
    np.testing.assert_array_equal(single.iterations, whole.iterations)
    np.testing.assert_array_equal(single.told, whole.told)


@pytest.mark.parametrize("lanes", [SERIAL, 1])
def test_a_span_leaves_the_others_alone(graph, system, lanes: int) -> None:
    matrix, rhs = system
    solve = BlockSolve(graph, "cpu", lanes)
    solution = solve(matrix, rhs, spans=[(1, 2)])
    assert (solution[[0, 2, 3]] == 7).all() and (solution[1] != 7).any()
    np.testing.assert_array_equal(solve.iterations[[0, 2, 3]], 0)
    np.testing.assert_array_equal(solution[1], BlockSolve(graph, "cpu", lanes)(matrix, rhs)[1])


def test_any_number_of_lanes_agrees(graph, system) -> None:
    """More lanes than vertices, and fewer; each adds up in an order of its own."""
    matrix, rhs = system
    for limits in ({}, {"iterations": 5}):
        one = BlockSolve(graph, "cpu", 1, **limits)
        expected = one(matrix, rhs)
        for lanes in (3, 32, 200):
            shared = BlockSolve(graph, "cpu", lanes, **limits)
            apart = np.linalg.norm((shared(matrix, rhs) - expected).reshape(FRAMES, -1), axis=1)
            # |x - x*| <= |r| / beta for each of the two: no eigenvalue is smaller. Five steps are the same five.
            left = 2 * 1.2e-5 * np.linalg.norm(rhs.reshape(FRAMES, -1), axis=1) / BETA
            assert (apart <= (1e-5 * np.linalg.norm(expected) if limits else left)).all()
            np.testing.assert_allclose(shared.iterations, one.iterations, rtol=0, atol=1)
            if limits:
                np.testing.assert_allclose(shared.told, one.told, rtol=1e-3)


def test_every_solve_starts_from_zero(graph, system, device: str, lanes: int) -> None:
    """What an earlier solve left behind, converged or not, changes nothing."""
    matrix, rhs = system
    used = BlockSolve(graph, device, lanes)
    used(matrix[::-1], 1e3 * rhs)
    used(matrix, 0 * rhs)
    fresh = BlockSolve(graph, device, lanes)
    # Bits, on every device: sums are added up in a fixed order.
    np.testing.assert_array_equal(used(matrix, rhs), fresh(matrix, rhs))
    np.testing.assert_array_equal(used.iterations, fresh.iterations)


def test_without_edges_every_vertex_solves_its_own_block(graph, system, device: str, lanes: int) -> None:
    """alpha = 0: the preconditioner is the inverse, and one step is all."""
    matrix, rhs = system
    solve = BlockSolve(graph, device, lanes)
    solution = solve(matrix, rhs, alpha=0.0, beta=0.5)
    blocks = matrix.astype(np.float64) + 0.5 * np.eye(3)
    np.testing.assert_allclose(solution, np.linalg.solve(blocks, rhs[..., None])[..., 0], rtol=0, atol=1e-5)
    assert (solve.iterations <= 2).all()


def test_a_vertex_without_edges_and_block_is_only_damped(graph, system, device: str, lanes: int) -> None:
    matrix, rhs = system
    matrix[:, -1] = 0
    solution = BlockSolve(graph, device, lanes)(matrix, rhs, alpha=1.0, beta=0.5)
    np.testing.assert_allclose(solution[:, -1], rhs[:, -1] / 0.5, rtol=0, atol=1e-3)


def test_one_vertex_one_frame(device: str, lanes: int) -> None:
    lonely = mesh_graph(np.zeros((0, 2), int), 1, 1.0)
    matrix, rhs = np.diag([1.0, 2.0, 3.0])[None, None], np.array([[[1.0, 1.0, 1.0]]])
    solution = BlockSolve(lonely, device, lanes, frames=1)(matrix, rhs, beta=1.0)
    np.testing.assert_allclose(solution, [[[1 / 2, 1 / 3, 1 / 4]]], rtol=1e-5)
