"""Embedded deformation: nodes, weights, and the Gauss-Newton step against finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import icosphere

from warpdef.fit.embedded import DeformationGraph, Pose, _cross_matrix, rotations
from warpdef.geometry.triangles import unique_edges


def rotation(axis: list[float], angle: float) -> np.ndarray:
    unit = np.array(axis) / np.linalg.norm(axis)
    return rotations(angle * unit[None])[0]


@pytest.fixture(scope="module")
def sphere() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    vertices, faces = icosphere(3)
    return vertices.astype(np.float64), faces, unique_edges(faces)


def test_weights_are_a_partition_of_unity(sphere):
    vertices, _, edges = sphere
    graph = DeformationGraph.build(vertices, edges, 30)
    assert len(set(graph.node.tolist())) == 30
    np.testing.assert_allclose(graph.weight.sum(axis=1), 1.0)
    assert (graph.weight >= 0).all()
    # A node is its own nearest, and nothing else counts there but nodes at hand.
    np.testing.assert_array_equal(graph.index[graph.node, 0], np.arange(30))
    pairs = {tuple(pair) for pair in graph.link.tolist()}
    assert pairs == {(b, a) for a, b in pairs}


def test_nodes_spread(sphere):
    vertices, _, edges = sphere
    graph = DeformationGraph.build(vertices, edges, 30)
    apart = np.linalg.norm(vertices[graph.node][:, None] - vertices[graph.node][None], axis=2)
    np.fill_diagonal(apart, np.inf)
    far = np.linalg.norm(vertices[:, None] - vertices[graph.node][None], axis=2).min(axis=1)
    assert apart.min() > 0.6 * far.max()


def test_every_component_has_a_node(sphere):
    vertices, faces, edges = sphere
    count = len(vertices)
    two = np.concatenate([vertices, vertices + [5.0, 0, 0]])
    graph = DeformationGraph.build(two, np.concatenate([edges, edges + count]), 12)
    sides = graph.node < count
    assert 3 < sides.sum() < 9
    first = (graph.index[:count] < 12) & (graph.weight[:count] > 0)
    assert sides[graph.index[:count][first]].all()


def test_more_nodes_than_vertices():
    vertices, faces = icosphere(0)
    graph = DeformationGraph.build(vertices.astype(float), unique_edges(faces), 400)
    assert len(graph.node) == len(vertices)


def test_rigid_motion_of_all_nodes_moves_all_vertices_rigidly(sphere):
    vertices, _, edges = sphere
    graph = DeformationGraph.build(vertices, edges, 25)
    r, t = rotation([1, 2, 3], 0.7), np.array([0.3, -0.1, 0.2])
    anchor = vertices[graph.node]
    pose = Pose(np.tile(r, (25, 1, 1)), anchor @ r.T + t - anchor)
    np.testing.assert_allclose(graph.place(vertices, pose), vertices @ r.T + t, atol=1e-12)


def test_step_is_gauss_newton(sphere):
    """It solves J^T J x = -J^T r, J by finite differences of the residuals as the energy is written."""
    vertices, _, edges = sphere
    vertices = vertices * [1.0, 0.7, 0.4]
    graph = DeformationGraph.build(vertices, edges, 9)
    rng = np.random.default_rng(0)
    pose = Pose(rotations(0.3 * rng.normal(size=(9, 3))), 0.1 * rng.normal(size=(9, 3)))
    chosen = rng.choice(len(vertices), 200, replace=False)
    goal = vertices[chosen] + 0.1 * rng.normal(size=(200, 3))
    normal = rng.normal(size=(200, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    rigidity, tangential = 0.3, 0.05

    def residuals(move: np.ndarray) -> np.ndarray:
        move = move.reshape(9, 6)
        at = Pose(rotations(move[:, :3]) @ pose.rotation, pose.shift + move[:, 3:])
        r = graph.place(vertices, at)[chosen] - goal
        g, (j, k) = vertices[graph.node], graph.link.T
        bent = np.einsum("eab,eb->ea", at.rotation[j], g[k] - g[j]) + g[j] + at.shift[j] - g[k] - at.shift[k]
        parts = [(normal * r).sum(axis=1) / np.sqrt(200), np.sqrt(tangential / 200) * r.ravel()]
        return np.concatenate([*parts, np.sqrt(rigidity / len(j)) * bent.ravel()])

    h = 1e-6
    jacobian = np.stack([(residuals(h * e) - residuals(-h * e)) / (2 * h) for e in np.eye(54)], axis=1)
    expected = np.linalg.solve(jacobian.T @ jacobian, -jacobian.T @ residuals(np.zeros(54))).reshape(9, 6)
    after = graph.step(vertices, pose, chosen, goal, normal, rigidity, tangential)
    np.testing.assert_allclose(after.shift - pose.shift, expected[:, 3:], atol=1e-5)
    np.testing.assert_allclose(after.rotation, rotations(expected[:, :3]) @ pose.rotation, atol=1e-5)


def test_step_without_matches_keeps_an_unbent_mesh(sphere):
    vertices, _, edges = sphere
    graph = DeformationGraph.build(vertices, edges, 12)
    none = np.zeros((0, 3))
    pose = graph.step(vertices, Pose.identity(12), np.zeros(0, dtype=int), none, none, 1.0, 0.1)
    np.testing.assert_allclose(graph.place(vertices, pose), vertices, atol=1e-9)


def test_rotations_of_vectors():
    v = np.array([[0.0, 0, 0], [1e-9, 0, 0], [0.3, -0.2, 0.5], [0, 0, np.pi]])
    r = rotations(v)
    np.testing.assert_allclose(r @ r.transpose(0, 2, 1), np.tile(np.eye(3), (4, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(r), 1.0)
    angles = np.arccos(np.clip((np.trace(r, axis1=1, axis2=2) - 1) / 2, -1, 1))
    np.testing.assert_allclose(angles, np.linalg.norm(v, axis=1), atol=1e-7)
    np.testing.assert_allclose(np.einsum("nab,nb->na", _cross_matrix(v), [[1.0, 2, 3]] * 4), np.cross(v, [1, 2, 3]))


def test_what_is_bent_as_usual_stays_so(sphere):
    """Without matches a step straightens a pose; with its own bend as the usual one it leaves it, turned or not."""
    vertices, _, edges = sphere
    graph = DeformationGraph.build(vertices, edges, 12)
    rng = np.random.default_rng(0)
    pose = Pose(rotations(0.2 * rng.normal(size=(12, 3))), 0.1 * rng.normal(size=(12, 3)))
    turn, anchor = rotation([1, 2, 3], 0.7), vertices[graph.node]
    turned = Pose(turn @ pose.rotation, (anchor + pose.shift) @ turn.T - anchor)
    bend = graph.bend(vertices, pose)
    np.testing.assert_allclose(graph.bend(vertices, turned), bend, atol=1e-12)
    nothing = (np.zeros(0, dtype=int), np.zeros((0, 3)), np.zeros((0, 3)), 0.1, 0.1)
    usual = np.einsum("eab,eb->ea", turned.rotation[graph.link[:, 0]], bend)
    np.testing.assert_allclose(graph.step(vertices, turned, *nothing, usual=usual).shift, turned.shift, atol=1e-9)
    assert np.abs(graph.step(vertices, turned, *nothing).shift - turned.shift).max() > 0.01
