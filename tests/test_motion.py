"""Moving clouds and vertices, one step and along a chain, and the way back."""

from __future__ import annotations

import numpy as np
import pytest
import reference
import warp as wp
import witness
from gradients import along, assert_gradients_close, finite_differences, gradient_of

from warpdef.kernels.chains import adj_move_chains, move_chains, routes_of
from warpdef.kernels.levels import LevelTable, node8
from warpdef.kernels.motion import (
    adj_move_points,
    adj_move_vertices,
    move_points,
    move_vertices,
    place_vertices,
    scatter_vertices,
)

LEVELS = reference.resolutions(1, 3)
NODES = int(reference.offsets(LEVELS)[-1])


def random_nodes(transitions: int, rng: np.random.Generator) -> np.ndarray:
    """(S, M, 6), large enough that every term of the derivative counts."""
    return rng.normal(size=(transitions, NODES, 6)).astype(np.float32) * 0.3


def points_in_cube(count: int, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(-0.9, 0.9, (count, 3)).astype(np.float32).astype(np.float64)


class Arrays:
    """Short names for uploads to one device."""

    def __init__(self, device: str) -> None:
        self.device = device
        self.levels = LevelTable.build(1, 3).to_device(wp.get_device(device))

    def vectors(self, a: np.ndarray) -> wp.array:
        a = np.ascontiguousarray(a, np.float32)
        return wp.array(a, dtype=wp.vec3, ndim=a.ndim - 1, device=self.device)

    def numbers(self, a, dtype) -> wp.array:
        return wp.array(np.ascontiguousarray(a), dtype=dtype, device=self.device)

    def nodes(self, a: np.ndarray) -> wp.array:
        return wp.array(witness.pad(a), dtype=node8, ndim=a.ndim - 1, device=self.device)

    def zeros(self, shape, dtype) -> wp.array:
        return wp.zeros(shape, dtype=dtype, device=self.device)


@pytest.fixture
def arrays(device: str) -> Arrays:
    return Arrays(device)


def test_clouds_move_each_by_its_own_transition(arrays: Arrays, rng: np.random.Generator) -> None:
    nodes, points = random_nodes(3, rng), points_in_cube(90, rng)
    transition = np.repeat([0, 2, 1], 30).astype(np.int32)
    moved, rotation = arrays.zeros(90, wp.vec3), arrays.zeros(90, wp.vec3)
    inputs = (arrays.nodes(nodes), arrays.levels, arrays.vectors(points), arrays.numbers(transition, wp.int32))
    move_points(0, 90, *inputs, rotation, moved)
    expected = np.concatenate([reference.move(nodes[s], LEVELS, points[transition == s]) for s in (0, 2, 1)])
    np.testing.assert_allclose(moved.numpy(), expected, rtol=0, atol=3e-6)

    adj, adj_nodes = rng.normal(size=(90, 3)), arrays.zeros((3, NODES), node8)
    adj_move_points(0, 90, arrays.levels, inputs[2], inputs[3], rotation, arrays.vectors(adj), adj_nodes)
    expected = np.zeros((3, NODES, 6))
    for s in range(3):
        of = transition == s
        motion = reference.sample(nodes[s], LEVELS, points[of])
        expected[s] = reference.adj_sample(LEVELS, points[of], reference.adj_motion(motion[:, :3], points[of], adj[of]))
    assert_gradients_close(adj_nodes.numpy()[..., :6], expected)


def test_a_span_leaves_the_rest_alone(arrays: Arrays, rng: np.random.Generator) -> None:
    nodes, points = random_nodes(1, rng), points_in_cube(20, rng)
    moved, rotation = arrays.vectors(np.full((20, 3), 7.0)), arrays.zeros(20, wp.vec3)
    transition = arrays.numbers(np.zeros(20), wp.int32)
    move_points(5, 10, arrays.nodes(nodes), arrays.levels, arrays.vectors(points), transition, rotation, moved)
    assert (moved.numpy()[[*range(5), *range(15, 20)]] == 7).all()
    assert (moved.numpy()[5:15] != 7).any(axis=1).all()


def test_the_twin_agrees_with_its_finite_differences(rng: np.random.Generator) -> None:
    nodes, points, adj = random_nodes(1, rng)[0].astype(float), points_in_cube(5, rng), rng.normal(size=(5, 3))
    by_points = finite_differences(lambda p: float((reference.move(nodes, LEVELS, p) * adj).sum()), points)
    found = np.einsum("nia,ni->na", reference.move_derivative(nodes, LEVELS, points), adj)
    assert_gradients_close(found, by_points, elementwise=1e-8, relative=1e-8)
    by_nodes = finite_differences(lambda n: float((reference.move(n, LEVELS, points) * adj).sum()), nodes)
    motion = reference.sample(nodes, LEVELS, points)
    found = reference.adj_sample(LEVELS, points, reference.adj_motion(motion[:, :3], points, adj))
    assert_gradients_close(found, by_nodes, elementwise=1e-8, relative=1e-8)


class GridChain:
    """Four frames with the keyframe at 1: transition 0 leads to frame 0; 1 and 2 to frames 2 and 3."""

    forward, backward = [(1, 1, 2), (2, 2, 3)], [(0, 1, 0)]

    def __init__(self, arrays: Arrays, nodes: np.ndarray, template: np.ndarray) -> None:
        self.arrays, self.count = arrays, len(template)
        ends = np.array(sorted(self.forward + self.backward))
        self.routes = routes_of(range(1, 3), range(0, -1, -1), ends[:, 1], ends[:, 2], wp.get_device(arrays.device))
        self.nodes = arrays.nodes(nodes)
        self.vertices = arrays.vectors(np.tile(template, (4, 1, 1)))
        self.rotation = arrays.zeros((3, self.count), wp.vec3)
        self.jacobian = arrays.zeros((3, self.count), wp.mat33)
        for s, source, target in self.forward + self.backward:
            move_vertices(
                0, self.count, s, source, target, self.nodes, arrays.levels, self.vertices, self.rotation, self.jacobian
            )

    def back(self, chamfer: np.ndarray, isometry: np.ndarray, trust: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradients of nodes (3, M, 6) and of the template through the chain (V, 3)."""
        a = self.arrays
        carry, adj_motion = a.zeros((5, self.count), wp.vec3), a.zeros((3, self.count), node8)
        adj_nodes = a.zeros((3, NODES), node8)
        forces = (a.numbers(trust, wp.float32), a.vectors(chamfer), a.vectors(isometry))
        for steps in (self.forward, self.backward):
            for s, source, target in reversed(steps):
                to = 4 if steps is self.backward else source
                adj_move_vertices(
                    0, self.count, s, source, target, target, to, self.vertices, self.rotation, self.jacobian,
                    *forces, carry, adj_motion,
                )  # fmt: skip
                span = (s * self.count, self.count)
                scatter_vertices(*span, a.levels, self.routes.source, self.vertices, adj_motion, adj_nodes)
        return adj_nodes.numpy()[..., :6], carry.numpy()[1] + carry.numpy()[4]


def test_vertices_that_nothing_goes_back_through_have_the_same_places(arrays: Arrays, rng: np.random.Generator) -> None:
    template = points_in_cube(40, rng)
    chain = GridChain(arrays, random_nodes(3, rng), template)
    alone = arrays.vectors(np.tile(template, (4, 1, 1)))
    for s, source, target in chain.forward + chain.backward:
        place_vertices(0, 40, s, source, target, chain.nodes, arrays.levels, alone)
    assert np.abs(alone.numpy() - template).max() > 0.01
    expected = chain.vertices.numpy()
    # Of two kernels CUDA's compiler fuses as it likes; of one text the CPU's does as much in both.
    rounding = 0.0 if arrays.device == "cpu" else 8 * np.finfo(np.float32).eps * np.abs(expected).max()
    np.testing.assert_allclose(alone.numpy(), expected, rtol=0, atol=rounding)


def test_all_transitions_at_once_are_one_after_the_other(arrays: Arrays, rng: np.random.Generator) -> None:
    """As far as rounding goes, since compilers fuse as they like; also where one direction has no transitions."""

    def assert_same(found: wp.array, expected: wp.array) -> None:
        size = np.abs(expected.numpy()).max()
        np.testing.assert_allclose(found.numpy(), expected.numpy(), rtol=0, atol=8 * np.finfo(np.float32).eps * size)
        assert size > 0

    nodes, template = random_nodes(3, rng), points_in_cube(40, rng)
    one_by_one = GridChain(arrays, nodes, template)
    trust, weighed, plain = rng.uniform(size=4), *rng.normal(size=(2, 4, 40, 3))
    forces = arrays.numbers(trust.astype(np.float32), wp.float32), arrays.vectors(weighed), arrays.vectors(plain)
    start = arrays.vectors(np.tile(template, (4, 1, 1)))
    start[0].assign(np.full((40, 3), 9.0, np.float32))
    start[2].assign(np.full((40, 3), 9.0, np.float32))
    rotation, jacobian = arrays.zeros((3, 40), wp.vec3), arrays.zeros((3, 40), wp.mat33)
    move_chains(one_by_one.routes, one_by_one.nodes, arrays.levels, start, rotation, jacobian)
    pairs = zip(
        (start, rotation, jacobian), (one_by_one.vertices, one_by_one.rotation, one_by_one.jacobian), strict=True
    )
    for found, expected in pairs:
        assert_same(found, expected)
    at_once, apart = ((arrays.zeros((5, 40), wp.vec3), arrays.zeros((3, 40), node8)) for _ in range(2))
    adj_move_chains(one_by_one.routes, start, rotation, jacobian, *forces, *at_once)
    for steps in (one_by_one.forward, one_by_one.backward):
        for s, source, target in reversed(steps):
            to = 4 if steps is one_by_one.backward else source
            adj_move_vertices(0, 40, s, source, target, target, to, start, rotation, jacobian, *forces, *apart)
    for found, expected in zip(at_once, apart, strict=True):
        assert_same(found, expected)
    outer = routes_of(range(3), range(-1, -1, -1), np.arange(3), np.arange(1, 4), wp.get_device(arrays.device))
    start[0].assign(template.astype(np.float32))
    move_chains(outer, one_by_one.nodes, arrays.levels, start, rotation, jacobian)
    expected = template
    for s in range(3):
        expected = reference.move(nodes[s], LEVELS, expected)
        np.testing.assert_allclose(start.numpy()[s + 1], expected, rtol=0, atol=1e-5)


def chain_of_twins(nodes: np.ndarray, template: np.ndarray) -> np.ndarray:
    frames = [np.zeros_like(template), template, None, None]
    for s, source, target in GridChain.forward + GridChain.backward:
        frames[target] = reference.move(nodes[s], LEVELS, frames[source])
    return np.stack(frames)


def test_the_chain_and_its_jacobians_match_the_twin(arrays: Arrays, rng: np.random.Generator) -> None:
    nodes, template = random_nodes(3, rng), points_in_cube(40, rng)
    chain = GridChain(arrays, nodes, template)
    expected = chain_of_twins(nodes, template)
    found = chain.vertices.numpy()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5)
    for s, source, _ in GridChain.forward + GridChain.backward:
        derivative = reference.move_derivative(nodes[s], LEVELS, found[source].astype(np.float64))
        np.testing.assert_allclose(chain.jacobian.numpy()[s].transpose(0, 2, 1), derivative, rtol=0, atol=2e-5)


def test_the_way_back_matches_finite_differences_of_the_twin(arrays: Arrays, rng: np.random.Generator) -> None:
    nodes, template = random_nodes(3, rng), points_in_cube(8, rng)
    chamfer, isometry = rng.normal(size=(2, 4, 8, 3))
    # What stands at the keyframe itself does not travel.
    chamfer[1] = isometry[1] = 0
    trust = np.array([0.3, 1.0, 0.8, 0.5])
    force = trust[:, None, None] * chamfer + isometry
    found_nodes, found_template = GridChain(arrays, nodes, template).back(chamfer, isometry, trust)

    def pulled(n: np.ndarray, x: np.ndarray) -> float:
        return float((chain_of_twins(n, x) * force).sum())

    by_template = finite_differences(lambda x: pulled(nodes, x), template)
    assert_gradients_close(found_template, by_template)
    # Single elements out of those that act, and whole directions, which see all of them.
    single = rng.choice(np.flatnonzero(found_nodes), 200, replace=False)
    by_nodes = finite_differences(lambda n: pulled(n, template), nodes, single)
    assert_gradients_close(found_nodes.ravel()[single], by_nodes)
    directions = rng.normal(size=(20, *nodes.shape))
    expected = [along(lambda n: pulled(n, template), nodes.astype(float), d) for d in directions]
    assert_gradients_close(np.einsum("dsmc,smc->d", directions, found_nodes), np.array(expected))


def test_the_way_back_matches_autodiff(arrays: Arrays, rng: np.random.Generator) -> None:
    nodes, template = random_nodes(3, rng), points_in_cube(40, rng)
    force = rng.normal(size=(4, 40, 3))
    force[1] = 0
    found_nodes, found_template = GridChain(arrays, nodes, template).back(force, np.zeros_like(force), np.ones(4))

    variables = [witness.variable(witness.pad(n), node8, arrays.device) for n in nodes]
    frames = {1: witness.variable(template, wp.vec3, arrays.device)}
    with wp.Tape() as tape:
        for s, source, target in GridChain.forward + GridChain.backward:
            frames[target] = witness.move(LEVELS, variables[s], frames[source])
    tape.backward(grads={frames[t]: arrays.vectors(force[t]) for t in (0, 2, 3)})
    assert_gradients_close(found_nodes, np.stack([gradient_of(v)[:, :6] for v in variables]))
    assert_gradients_close(found_template, gradient_of(frames[1]))


def test_zero_nodes_move_nothing_yet_want_to_turn(arrays: Arrays, rng: np.random.Generator) -> None:
    template, force = points_in_cube(10, rng), rng.normal(size=(4, 10, 3))
    chain = GridChain(arrays, np.zeros((3, NODES, 6), np.float32), template)
    np.testing.assert_array_equal(chain.vertices.numpy(), np.tile(template.astype(np.float32), (4, 1, 1)))
    nodes, _ = chain.back(force, np.zeros_like(force), np.ones(4))
    assert (np.abs(nodes[:, 0]).max(axis=1) > 0.01).all()
    assert (np.abs(nodes[:, 0, :3]).max(axis=1) > 0.01).all()


def test_vertices_that_are_no_numbers_do_not_crash(arrays: Arrays, rng: np.random.Generator) -> None:
    template = points_in_cube(4, rng)
    template[1], template[2] = np.nan, [50.0, -50.0, np.inf]
    chain = GridChain(arrays, random_nodes(3, rng), template)
    chain.back(rng.normal(size=(4, 4, 3)), np.zeros((4, 4, 3)), np.ones(4))
    assert np.isfinite(chain.vertices.numpy()[:, [0, 3]]).all()
    assert np.isnan(chain.vertices.numpy()[:, 1]).all()


def test_a_single_vertex(arrays: Arrays, rng: np.random.Generator) -> None:
    nodes, template = random_nodes(3, rng), points_in_cube(1, rng)
    np.testing.assert_allclose(
        GridChain(arrays, nodes, template).vertices.numpy(), chain_of_twins(nodes, template), rtol=0, atol=1e-5
    )
