"""Where unseen vertices are expected, and how they are held there."""

from __future__ import annotations

import numpy as np
import pytest
import reference_refine as twin
import warp as wp
import witness_refine
from gradients import assert_gradients_close, finite_differences, gradient_of
from present import present
from test_planes import PlaneScene, put, spans

from warpdef.fit.unseen import _around
from warpdef.kernels.unseen import expected_places, hold_unseen, seen_weights


def expected(device: str, vertices, rotation, near, far, share, cuts=(0,)) -> np.ndarray:
    """(T, V, 3), by the kernel."""
    before, after = (put(a, wp.int32, device) for a in (near, far))
    part = put(share, wp.float32, device)
    out = put(np.full(vertices.shape, np.nan), wp.vec3, device)
    at, turned = put(vertices, wp.vec3, device), put(rotation, wp.mat33, device)
    for begin, count in spans(cuts, vertices.shape[0] * vertices.shape[1]):
        expected_places(begin, count, before, after, part, at, turned, out)
    return out.numpy()


@pytest.mark.parametrize("angle", [0.0, 1e-4, 0.3, 1.2])
def test_a_screw_motion_is_met_exactly(angle: float, device: str, rng: np.random.Generator) -> None:
    """Frame 1 lies in the middle of 0 and 2; frame 3 continues 1 and 2 into the future, as seen from its end."""
    body, axis, shift = rng.normal(size=(20, 3)), rng.normal(size=3), rng.normal(size=3)
    shift = axis * (shift @ axis) / (axis @ axis)
    turn = np.stack([twin.turn_about(axis, angle * t) for t in range(4)])
    vertices = np.einsum("tab,vb->tva", turn, body) + shift * np.arange(4)[:, None, None] + [0.2, 0.1, -0.3]
    rotation = np.repeat(turn[:, None], 20, axis=1)
    found = expected(device, vertices, rotation, [1, 0, 1, 2], [2, 2, 3, 1], [-1.0, 0.5, 0.5, -1.0])
    np.testing.assert_allclose(found, vertices, rtol=0, atol=1e-5)


@pytest.mark.parametrize("angle", [0.0, 1e-4, 0.3, 1.2])
def test_uneven_times_are_met_on_the_same_screw(angle: float, device: str, rng: np.random.Generator) -> None:
    """Frames at 0, 1, 4 and 6: the second stands after a quarter of the way, the last goes on by two thirds of one."""
    times = np.array([0.0, 1.0, 4.0, 6.0])
    body, axis, shift = rng.normal(size=(20, 3)), rng.normal(size=3), rng.normal(size=3)
    shift = 0.2 * axis * (shift @ axis) / (axis @ axis)
    turn = np.stack([twin.turn_about(axis, 0.3 * angle * t) for t in times])
    vertices = np.einsum("tab,vb->tva", turn, body) + shift * times[:, None, None] + [0.2, 0.1, -0.3]
    rotation = np.repeat(turn[:, None], 20, axis=1)
    near, far, share = _around(times)
    np.testing.assert_allclose(share, [-1 / 3, 1 / 4, 3 / 5, -2 / 3])
    found = expected(device, vertices, rotation, near, far, share)
    np.testing.assert_allclose(found, vertices, rtol=0, atol=1e-5)


def test_half_a_turn_and_spans(device: str, rng: np.random.Generator) -> None:
    """Opposite places: no arc is known, the place stays finite and within the circle. Spans are the whole."""
    turn = np.stack([np.eye(3), np.eye(3), twin.turn_about([0, 0, 1], np.pi)])
    vertices = np.array([[[1.0, 0, 0]], [[0, 0, 0]], [[-1.0, 0, 0]]])
    times = ([1, 0, 1], [2, 2, 0], [-1.0, 0.5, -1.0])
    found = expected(device, vertices, turn[:, None], *times)
    assert np.isfinite(found).all() and np.linalg.norm(found[1]) <= 1.001
    many = rng.normal(size=(3, 11, 3))
    rotation = np.repeat(turn[:, None], 11, axis=1)
    whole = expected(device, many, rotation, *times)
    np.testing.assert_array_equal(expected(device, many, rotation, *times, cuts=(0, 5, 20)), whole)


class Held(PlaneScene):
    """The scene of random pairs, and a place where each vertex is expected; the second frame is left alone."""

    def __init__(self, device: str, rng: np.random.Generator, hold=(0.4, 0.0)) -> None:
        super().__init__(device, rng)
        self.expected = rng.normal(size=self.x.shape).astype(np.float32)
        self.hold, self.mutual_reach = np.array(hold, np.float32), np.array([2.0, np.inf], np.float32)

    def run(self, start: float = 0.0, cuts=(0,)):
        pairs, sums = self.pairs("met"), self.sums(start)
        places, hold = put(self.expected, wp.vec3, self.device), put(self.hold, wp.float32, self.device)
        for begin, count in spans(cuts, self.count):
            hold_unseen(begin, count, pairs, places, hold, *sums)
        return tuple(a.numpy() for a in sums)

    def twin(self) -> tuple[np.ndarray, np.ndarray]:
        """h u of every vertex (V,), and where it stands from the place expected of it (V, 3)."""
        pairs, seen = self.planes("met"), np.zeros(self.count)
        seen[pairs.owner] = pairs.w * (pairs.a != 0).any(axis=1)
        return self.hold[self.frame["met"]] * (1 - seen), self.x - self.expected.astype(np.float64)


@pytest.fixture
def held(device: str, rng: np.random.Generator) -> Held:
    return Held(device, rng)


def test_holding_matches_the_twin(held: Held) -> None:
    h, d = held.twin()
    for found, expected_sum in zip(held.run(), (h[:, None, None] * np.eye(3), -h[:, None] * d), strict=True):
        assert_gradients_close(found, expected_sum)
        assert found[:30].any() and not found[30:].any()
    for found, fresh in zip(held.run(start=5.0, cuts=(0, 7, 31)), held.run(), strict=True):
        np.testing.assert_allclose(found, fresh + 5.0, rtol=0, atol=1e-5)


def test_trust_is_what_is_not_held(held: Held) -> None:
    h, _ = held.twin()
    out = put(np.full(held.count, np.nan), wp.float32, held.device)
    for begin, count in spans((0, 7, 31), held.count):
        seen_weights(begin, count, held.pairs("met"), out)
    trust = out.numpy()
    np.testing.assert_allclose(trust[:30], 1.0 - h[:30] / 0.4, atol=1e-5)
    assert ((trust >= 0) & (trust <= 1 + 1e-6)).all() and trust[30:].any()


def test_the_right_hand_side_and_the_matrix_are_those_of_the_energy(held: Held, rng: np.random.Generator) -> None:
    """E(m) = sum h u |d + m|^2, with h u and the places held: minus half its slope, half its second derivative."""
    (h, d), (matrix, rhs) = held.twin(), held.run()

    def energy(move: np.ndarray) -> float:
        return float((h * ((d + move) ** 2).sum(axis=1)).sum())

    assert_gradients_close(rhs, -0.5 * finite_differences(energy, np.zeros_like(d)))
    for move in rng.normal(size=(20, held.count, 3)):
        found = -2 * (rhs * move).sum() + np.einsum("ia,iab,ib->", move, matrix, move)
        assert found == pytest.approx(energy(move) - energy(0 * move), rel=1e-4)


def test_the_right_hand_side_matches_autodiff(held: Held) -> None:
    """A place is three planes, one across each axis."""
    (h, d), on = held.twin(), held.device
    move = wp.zeros(held.count, dtype=wp.vec3, device=on, requires_grad=True)
    loss = wp.zeros(1, dtype=wp.float32, device=on, requires_grad=True)
    pairs = [put(np.repeat(np.arange(held.count), 3), wp.int32, on), put(np.repeat(d, 3, axis=0), wp.vec3, on)]
    pairs += [put(np.tile(np.eye(3), (held.count, 1)), wp.vec3, on), put(np.repeat(h, 3), wp.float32, on)]
    with wp.Tape() as tape:
        wp.launch(witness_refine.plane_pairs, 3 * held.count, inputs=[move, *pairs, loss], device=on)
    tape.backward(loss)
    assert_gradients_close(held.run()[1], -0.5 * gradient_of(move))


def test_what_lies_on_the_points_is_free_and_what_has_none_is_held(device: str, rng: np.random.Generator) -> None:
    held = Held(device, rng, hold=(1.0, 1.0))
    present(held.mutual_reach)[:] = np.inf
    held.index["met"][:30] = -1
    pair = held.index["met"][31:33]
    held.x[31:33], held.m[31:33] = held.q[pair], held.n[pair]
    matrix, rhs = held.run()
    np.testing.assert_array_equal(matrix[:30], np.tile(np.eye(3), (30, 1, 1)))
    np.testing.assert_allclose(rhs[:30], held.expected[:30] - held.x[:30], rtol=1e-6)
    np.testing.assert_allclose(matrix[31:33], 0, atol=1e-6)
    np.testing.assert_allclose(rhs[31:33], 0, atol=1e-5)
