"""Both halves of the robust Chamfer distance on frozen neighbours, and their gradient."""

from __future__ import annotations

import numpy as np
import pytest
import reference
import warp as wp
import witness
from gradients import assert_gradients_close, finite_differences, gradient_of

from warpdef.kernels.chamfer import fixed_to_moving, moving_to_fixed

ALPHA = 5.56


class Meeting:
    """40 moving and 55 fixed points in three slots; some want no answer."""

    def __init__(self, device: str, rng: np.random.Generator, normals: bool = True) -> None:
        self.device = device
        self.moving, self.fixed = (rng.uniform(-0.6, 0.6, (n, 3)).astype(np.float32).astype(float) for n in (40, 55))
        self.normals = rng.normal(size=(55, 3))
        self.normals /= np.linalg.norm(self.normals, axis=1, keepdims=True)
        if not normals:
            self.normals[:] = 0
        self.moving_slot, self.fixed_slot = rng.integers(0, 3, 40), rng.integers(0, 3, 55)
        self.forth, self.back = rng.integers(0, 55, 40), rng.integers(0, 40, 55)
        self.forth[[3, 30]] = self.back[[0, 54]] = -1
        self.share, self.weight = np.array([1.0, 0.25, 2.0]), np.array([0.5, 3.0, 0.0625])

        self.reach: np.ndarray | None = None  # of every slot, where pairs count by the way back

    def run(
        self, power: int, tangential: float, alpha: float = ALPHA, before: float = 0.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Losses of the slots (3,), added to 7, and the gradient (40, 3), added to ``before``."""
        d = self.device
        moving, fixed, normals = (
            wp.array(a.astype(np.float32), dtype=wp.vec3, device=d) for a in (self.moving, self.fixed, self.normals)
        )
        forth, back, moving_slot, fixed_slot = (
            wp.array(a.astype(np.int32), dtype=wp.int32, device=d)
            for a in (self.forth, self.back, self.moving_slot, self.fixed_slot)
        )
        share, weight = (wp.array(a.astype(np.float32), dtype=wp.float32, device=d) for a in (self.share, self.weight))
        loss = wp.full(3, 7.0, dtype=wp.float64, device=d)
        adj = wp.full(40, wp.vec3(before, before, before), dtype=wp.vec3, device=d)
        results = (share, weight, (alpha, power, tangential), loss, adj)
        sides = [(), ()]
        if self.reach is not None:
            reach = wp.array(self.reach.astype(np.float32), dtype=wp.float32, device=d)
            sides = [((back, reach),), ((forth, reach),)]
        for begin, count in ((0, 15), (15, 25)):
            moving_to_fixed(begin, count, moving, moving_slot, forth, fixed, normals, *results, *sides[0])
        for begin, count in ((0, 30), (30, 25)):
            fixed_to_moving(begin, count, fixed, normals, fixed_slot, back, moving, *results, *sides[1])
        return loss.numpy() - 7.0, adj.numpy()

    def pairs(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Indices of all pairs that count, and their slots: moving, fixed, slot."""
        a, b = np.flatnonzero(self.forth >= 0), np.flatnonzero(self.back >= 0)
        moving, fixed = np.concatenate([a, self.back[b]]), np.concatenate([self.forth[a], b])
        return moving, fixed, np.concatenate([self.moving_slot[a], self.fixed_slot[b]])

    def twin(self, moving: np.ndarray, power: int, tangential: float, robust: np.ndarray | None = None) -> np.ndarray:
        """Losses of the slots; ``robust`` freezes the weights of the pairs."""
        i, j, slot = self.pairs()
        r = moving[i] - self.fixed[j]
        robust = self.robust(power) if robust is None else robust
        energy = self.share[slot] * robust * reference.residual_energy(r, self.normals[j], tangential)
        return np.bincount(slot, energy, minlength=3)

    def robust(self, power: int) -> np.ndarray:
        i, j, slot = self.pairs()
        robust = reference.robust_weight(self.moving[i] - self.fixed[j], ALPHA, power)
        if self.reach is None:
            return robust
        # The way back: from the moving points of the first pairs, from the fixed points of the others.
        first = int((self.forth >= 0).sum())
        asked = np.concatenate([self.moving[i[:first]], self.fixed[j[first:]]])
        partner = np.concatenate([self.back[j[:first]], self.forth[i[first:]]])
        answered = np.concatenate([self.moving[partner[:first]], self.fixed[partner[first:]]])
        mutual = reference.mutual_weight(asked, answered, self.reach[slot])
        return robust * np.where(partner >= 0, mutual, 1.0)


CASES = [(power, tangential) for power in (2, 4) for tangential in (0.0, 0.1, 1.0)]


ONE_SIDED = [None, np.array([0.7, np.inf, 1.2])]


@pytest.mark.parametrize("reach", ONE_SIDED, ids=["all pairs", "one-sided"])
@pytest.mark.parametrize(("power", "tangential"), CASES)
def test_loss_and_gradient_match_the_twin(
    power: int, tangential: float, reach: np.ndarray | None, device: str, rng: np.random.Generator
) -> None:
    meeting = Meeting(device, rng)
    meeting.reach = reach
    loss, adj = meeting.run(power, tangential)
    np.testing.assert_allclose(loss, meeting.twin(meeting.moving, power, tangential), rtol=1e-5)
    i, j, slot = meeting.pairs()
    by_pair = reference.adj_residual_energy(meeting.moving[i] - meeting.fixed[j], meeting.normals[j], tangential)
    factor = meeting.share[slot] * meeting.weight[slot] * meeting.robust(power)
    expected = np.zeros((40, 3))
    np.add.at(expected, i, factor[:, None] * by_pair)
    assert_gradients_close(adj, expected)


@pytest.mark.parametrize("reach", ONE_SIDED, ids=["all pairs", "one-sided"])
@pytest.mark.parametrize(("power", "tangential"), CASES)
def test_gradient_matches_differences(
    power: int, tangential: float, reach: np.ndarray | None, device: str, rng: np.random.Generator
) -> None:
    """Weights, robust and mutual, are constants to the gradient: frozen in the differences."""
    meeting = Meeting(device, rng)
    meeting.reach = reach
    robust = meeting.robust(power)

    def weighted(moving: np.ndarray) -> float:
        return float((meeting.weight * meeting.twin(moving, power, tangential, robust)).sum())

    assert_gradients_close(meeting.run(power, tangential)[1], finite_differences(weighted, meeting.moving))


@pytest.mark.parametrize("reach", ONE_SIDED, ids=["all pairs", "one-sided"])
@pytest.mark.parametrize(("power", "tangential"), CASES)
def test_gradient_matches_autodiff(
    power: int, tangential: float, reach: np.ndarray | None, device: str, rng: np.random.Generator
) -> None:
    meeting = Meeting(device, rng)
    meeting.reach = reach
    i, j, slot = meeting.pairs()
    factor = meeting.share[slot] * meeting.weight[slot] * meeting.robust(power)
    moving = witness.variable(meeting.moving, wp.vec3, device)
    fixed, normals = (witness.variable(a, wp.vec3, device) for a in (meeting.fixed, meeting.normals))
    indices = [wp.array(a.astype(np.int32), dtype=wp.int32, device=device) for a in (i, j)]
    loss = wp.zeros(1, dtype=wp.float32, device=device, requires_grad=True)
    with wp.Tape() as tape:
        inputs = [moving, fixed, normals, *indices, witness.variable(factor, wp.float32, device), tangential, loss]
        wp.launch(witness.chamfer_pairs, len(i), inputs=inputs, device=device)
    tape.backward(loss)
    assert_gradients_close(meeting.run(power, tangential)[1], gradient_of(moving))


def test_gradient_matches_finite_differences_of_the_kernel(device: str, rng: np.random.Generator) -> None:
    """Without a robust weight nothing is frozen, and the loss itself can be differenced: it is quadratic."""
    meeting = Meeting(device, rng)
    meeting.weight[:] = 1
    _, adj = meeting.run(2, 0.1, alpha=0.0)
    start, step, directions = meeting.moving, 2.0**-10, rng.normal(size=(20, 40, 3))
    found = []
    for direction in directions:
        ends = []
        for sign in (1, -1):
            meeting.moving = start + sign * step * direction
            ends.append(meeting.run(2, 0.1, alpha=0.0)[0].sum())
        found.append((ends[0] - ends[1]) / (2 * step))
    # The loss is a sum of float32 terms: 1e-7 of about 30, over the step.
    expected = np.einsum("dnc,nc->d", directions, adj)
    assert_gradients_close(np.array(found), expected, elementwise=2e-3, direction=1e-5, relative=2e-3)


def test_weight_enters_the_gradient_and_not_the_loss(device: str, rng: np.random.Generator) -> None:
    meeting = Meeting(device, rng)
    loss, adj = meeting.run(2, 0.1)
    meeting.weight *= 2
    twice_loss, twice_adj = meeting.run(2, 0.1)
    np.testing.assert_allclose(twice_loss, loss, rtol=1e-6)
    np.testing.assert_allclose(twice_adj, 2 * adj, rtol=1e-5, atol=1e-6)
    meeting.share *= 2
    both_loss, both_adj = meeting.run(2, 0.1)
    np.testing.assert_allclose(both_loss, 2 * loss, rtol=1e-6)
    np.testing.assert_allclose(both_adj, 4 * adj, rtol=1e-5, atol=1e-6)


def test_an_infinite_reach_is_every_pair_to_the_bit(device: str, rng: np.random.Generator) -> None:
    meeting = Meeting(device, rng)
    loss, adj = meeting.run(2, 0.1)
    meeting.reach = np.full(3, np.inf)
    tolerance = 0 if device == "cpu" else 1e-6
    for found, expected in zip(meeting.run(2, 0.1), (loss, adj), strict=True):
        np.testing.assert_allclose(found, expected, rtol=tolerance)


def test_what_the_other_set_does_not_show_is_not_pulled_over(device: str, rng: np.random.Generator) -> None:
    """A strip of moving points, of which the fixed ones know one half; those in the other half choose its rim."""
    meeting = Meeting(device, rng)
    meeting.moving = np.column_stack([np.linspace(-1, 1, 40), np.zeros((40, 2))])
    meeting.fixed = np.column_stack([np.linspace(-1, 0, 55), np.zeros(55), np.full(55, 0.01)])
    meeting.forth = reference.nearest(meeting.moving, meeting.fixed)
    meeting.back = reference.nearest(meeting.fixed, meeting.moving)
    meeting.moving_slot[:], meeting.fixed_slot[:] = 0, 0
    unseen = meeting.moving[:, 0] > 0.3
    assert np.abs(meeting.run(2, 1.0, alpha=0.0)[1][unseen, 0]).min() > 0.1
    meeting.reach = np.full(3, 0.1)
    _, adj = meeting.run(2, 1.0, alpha=0.0)
    np.testing.assert_allclose(adj[unseen], 0, atol=1e-12)
    assert (adj[meeting.moving[:, 0] < -0.1, 2] < -0.005).all()  # the other half is pulled as ever


def test_without_normals_only_the_plain_distance_is_left(device: str, rng: np.random.Generator) -> None:
    meeting = Meeting(device, rng, normals=False)
    loss, _ = meeting.run(2, 1.0)
    i, j, slot = meeting.pairs()
    distance_sq = ((meeting.moving[i] - meeting.fixed[j]) ** 2).sum(axis=1)
    expected = np.bincount(slot, meeting.share[slot] * np.exp(-ALPHA * distance_sq) * distance_sq, minlength=3)
    np.testing.assert_allclose(loss, expected, rtol=1e-5)


def test_power_four_is_the_fourth_power_of_the_distance(device: str, rng: np.random.Generator) -> None:
    meeting = Meeting(device, rng)
    meeting.forth[:], meeting.back[:] = -1, -1
    meeting.forth[0], meeting.moving_slot[0] = 0, 0
    meeting.fixed[0], meeting.moving[0] = 0, [0.5, 0, 0]
    for power in (2, 4):
        assert meeting.run(power, 1.0)[0][0] == pytest.approx(0.25 * np.exp(-ALPHA * 0.5**power), rel=1e-5)


def test_gradients_are_added_to_what_there_is(device: str, rng: np.random.Generator) -> None:
    meeting = Meeting(device, rng)
    adj, onto = (meeting.run(2, 0.1, before=before)[1] for before in (0.0, 0.25))
    np.testing.assert_allclose(onto, adj + 0.25, rtol=0, atol=4 * np.spacing(np.float32(np.abs(onto).max())))
    assert np.abs(adj).min(axis=1).max() > 0.01


def test_coincident_points_and_no_neighbours(device: str, rng: np.random.Generator) -> None:
    meeting = Meeting(device, rng)
    meeting.forth[:] = meeting.back[:] = -1
    loss, adj = meeting.run(2, 0.1)
    np.testing.assert_array_equal(loss, 0)
    np.testing.assert_array_equal(adj, 0)
    meeting.moving[:], meeting.fixed[:], meeting.forth[:], meeting.back[:] = 0.25, 0.25, 5, 6
    loss, adj = meeting.run(4, 0.1)
    np.testing.assert_array_equal(loss, 0)
    np.testing.assert_array_equal(adj, 0)
