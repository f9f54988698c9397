"""The step of an embedded mesh's nodes, against a dense solve of the same equations, and the order of its blocks."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import icosphere

from warpdef.fit.embedded import DeformationGraph, Pose, _cross_matrix, rotations
from warpdef.geometry.triangles import unique_edges
from warpdef.kernels.embedding import EmbeddedMesh

Matches = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def graph_of(count: int, apart: bool = False) -> tuple[DeformationGraph, np.ndarray]:
    vertices, faces = icosphere(2)
    rest, edges = vertices.astype(np.float64) * [1.0, 0.6, 0.3], unique_edges(faces)
    if apart:  # a second one, that no match holds
        edges = np.concatenate([edges, edges + len(rest)])
        rest = np.concatenate([rest, rest + [5.0, 0.0, 0.0]])
    return DeformationGraph.build(rest, edges, count), rest


def random_pose(count: int, rng: np.random.Generator) -> Pose:
    return Pose(rotations(0.4 * rng.normal(size=(count, 3))), 0.1 * rng.normal(size=(count, 3)))


def matches(rest: np.ndarray, count: int, rng: np.random.Generator) -> Matches:
    """Some vertices several times."""
    chosen = rng.integers(len(rest), size=count)
    normal = rng.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return chosen, rest[chosen] + 0.2 * rng.normal(size=(count, 3)), normal, rng.uniform(0.1, 1.0, count)


def dense_step(graph, rest, pose, found, tangential, stiffness, usual) -> np.ndarray:
    """The same sums written residual by residual."""
    chosen, goal, normal, weight = found
    count, anchor = len(graph.node), rest[graph.node]
    system, right = 1e-12 * np.eye(6 * count), np.zeros(6 * count)

    def add(derivative: np.ndarray, residual: np.ndarray, asked: np.ndarray) -> None:
        nonlocal system, right
        system = system + derivative.T @ asked @ derivative
        right = right + derivative.T @ asked @ residual

    for v, to, n, w in zip(chosen, goal, normal, weight, strict=True):
        derivative, at = np.zeros((3, count, 6)), np.zeros(3)
        for j, share in zip(graph.index[v], graph.weight[v], strict=True):
            arm = pose.rotation[j] @ (rest[v] - anchor[j])
            at += share * (arm + anchor[j] + pose.shift[j])
            derivative[:, j, :3] -= share * _cross_matrix(arm)
            derivative[:, j, 3:] += share * np.eye(3)
        add(derivative.reshape(3, -1), at - to, w * (np.outer(n, n) + tangential * np.eye(3)))
    for e, (j, k) in enumerate(graph.link):
        derivative, arm = np.zeros((3, count, 6)), pose.rotation[j] @ (anchor[k] - anchor[j])
        derivative[:, j, :3], derivative[:, j, 3:], derivative[:, k, 3:] = -_cross_matrix(arm), np.eye(3), -np.eye(3)
        bent = arm + anchor[j] + pose.shift[j] - anchor[k] - pose.shift[k]
        add(derivative.reshape(3, -1), bent - (0.0 if usual is None else usual[e]), stiffness * np.eye(3))
    return np.linalg.solve(system, -right).reshape(count, 6)


def mesh_of(graph: DeformationGraph, rest: np.ndarray) -> EmbeddedMesh:
    return EmbeddedMesh(rest, graph.index, graph.weight, graph.link, rest[graph.node], graph._order)


@pytest.mark.parametrize("with_usual", [False, True])
@pytest.mark.parametrize("nodes", [1, 4, 23])
def test_it_solves_the_normal_equations(nodes: int, with_usual: bool, rng: np.random.Generator) -> None:
    graph, rest = graph_of(nodes)
    pose, found = random_pose(nodes, rng), matches(rest, 300, rng)
    usual = 0.1 * rng.normal(size=(len(graph.link), 3)) if with_usual else None
    expected = dense_step(graph, rest, pose, found, 0.05, 0.3, usual)
    move = mesh_of(graph, rest).step(pose.rotation, pose.shift, *found, 0.05, 0.3, usual)
    np.testing.assert_allclose(move, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def test_what_nothing_holds_stays(rng: np.random.Generator) -> None:
    graph, rest = graph_of(30, apart=True)
    half = len(rest) // 2
    held = graph.node < half
    assert 5 < held.sum() < 25
    pose = Pose.identity(30)
    move = mesh_of(graph, rest).step(pose.rotation, pose.shift, *matches(rest[:half], 300, rng), 0.05, 0.3)
    assert np.abs(move[held]).max() > 1e-3 and np.abs(move[~held]).max() < 1e-9


def test_places_are_blended_motions(rng: np.random.Generator) -> None:
    graph, rest = graph_of(12)
    pose, anchor = random_pose(12, rng), rest[graph.node]
    arms = np.einsum("vjab,vjb->vja", pose.rotation[graph.index], rest[:, None] - anchor[graph.index])
    expected = np.einsum("vj,vja->va", graph.weight, arms + anchor[graph.index] + pose.shift[graph.index])
    np.testing.assert_allclose(mesh_of(graph, rest).place(pose.rotation, pose.shift), expected, atol=1e-13)


def test_the_order_holds_all_blocks_that_elimination_makes() -> None:
    graph, _ = graph_of(40)
    order = graph._order
    np.testing.assert_array_equal(np.sort(order.place), np.arange(40))
    columns = [set(order.row[a:b].tolist()) for a, b in zip(order.start[:-1], order.start[1:], strict=True)]
    assert all(min(column) == c and order.row[order.start[c]] == c for c, column in enumerate(columns))
    for column in columns:
        below = sorted(column)[1:]
        assert all(set(below[i:]) <= columns[k] for i, k in enumerate(below))
    j, k = order.place[graph.link].T
    assert all(a in columns[b] for a, b in zip(np.maximum(j, k), np.minimum(j, k), strict=True))
    # Least degree first: far from all that there could be.
    assert len(order.row) < 0.8 * 40 * 41 / 2


def test_arrays_of_another_length_are_refused(rng: np.random.Generator) -> None:
    graph, rest = graph_of(4)
    pose, (chosen, goal, normal, weight) = random_pose(4, rng), matches(rest, 9, rng)
    with pytest.raises(ValueError, match=r"normal: expected length M \(M = 9 of chosen\), got 8"):
        mesh_of(graph, rest).step(pose.rotation, pose.shift, chosen, goal, normal[1:], weight, 0.1, 0.1)
    with pytest.raises(ValueError, match=r"shift: expected length N \(N = 4 of anchor\), got 3"):
        mesh_of(graph, rest).place(pose.rotation, pose.shift[1:])
