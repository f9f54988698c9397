"""The whole objective on a three-frame toy: losses and gradient against the float64 twin with pinned neighbours."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest
import reference
import warp as wp
from gradients import along, assert_gradients_close, finite_differences
from toy_objective import LOSS, Toy, toy_faces

from warpdef.device import Way, going
from warpdef.fit.problem import Problem
from warpdef.fit.terms import IsometryTerm


@pytest.mark.parametrize("keyframe", [1, 0, 2], ids=["middle", "first", "last"])
@pytest.mark.parametrize("loss", LOSS.values(), ids=LOSS)
def test_losses_match_the_twin(loss: dict, keyframe: int, device: str) -> None:
    toy = Toy(device, keyframe, **loss)
    o, expected = toy.objective, toy.twin()
    np.testing.assert_allclose(o.input.loss.numpy(), expected.input, rtol=1e-5)
    np.testing.assert_allclose(o.transform.loss.numpy(), expected.transform, rtol=1e-5)
    told = o.losses()
    assert told["total"] == pytest.approx(reference.total(toy.scene, expected, toy.trust), rel=1e-5)
    assert told["isometry"] == pytest.approx(toy.config.loss.isometry_weight * expected.isometry, rel=1e-5)
    assert sum(v for k, v in told.items() if k != "total") == pytest.approx(told["total"])
    if toy.config.loss.confidence:
        bound_is_mean = toy.config.loss.confidence_bound == "mean"
        by_formula = reference.confidence(expected.input, expected.transform, keyframe, 0.7, bound_is_mean)
        np.testing.assert_allclose(toy.trust, by_formula, rtol=1e-4)
        # Seen from an end, the far frame's sum is worse than any single transition's: it is trusted less, and visibly.
        assert keyframe == 1 or toy.config.loss.reduction == "mean" or by_formula.min() < 0.97
    else:
        np.testing.assert_array_equal(toy.trust, 1)


@pytest.mark.parametrize("partial", [(0,), (0, 2), (1, 2), (0, 1, 2)])
def test_pairs_of_partial_frames_count_by_the_way_back(partial: tuple, device: str, rng: np.random.Generator) -> None:
    """Losses and gradient against the twin; what is weighed is less than what every pair would give."""
    toy, full = Toy(device, partial=partial), Toy(device)
    o, expected = toy.objective, toy.twin()
    np.testing.assert_allclose(o.input.loss.numpy(), expected.input, rtol=1e-5)
    np.testing.assert_allclose(o.transform.loss.numpy(), expected.transform, rtol=1e-5)
    lower = o.transform.loss.numpy() < full.objective.transform.loss.numpy()
    np.testing.assert_array_equal(np.flatnonzero(lower), partial)
    total, directions = toy.twin_total(), rng.normal(size=(20, *toy.nodes.shape))
    expected = [along(lambda n: total(n, toy.template), toy.nodes.astype(float), d, 1e-5) for d in directions]
    slopes = np.einsum("dsmc,smc->d", directions, toy.adj_nodes)
    assert_gradients_close(slopes, np.array(expected), elementwise=2e-4, relative=2e-4)


@pytest.mark.parametrize("keyframe", [1, 0])
def test_frames_off_their_clouds_are_trusted_less(keyframe: int, device: str, rng: np.random.Generator) -> None:
    """Their weights are the paper's, in the loss and in the gradient."""
    toy = Toy(device, keyframe, off=0.25)
    o = toy.objective
    expected = reference.confidence(o.input.loss.numpy(), o.transform.loss.numpy(), keyframe, 0.7, False)
    assert np.delete(expected, keyframe).max() < 0.95
    np.testing.assert_allclose(toy.trust, expected, rtol=1e-5)
    total, directions = toy.twin_total(), rng.normal(size=(10, *toy.nodes.shape))
    expected = [along(lambda n: total(n, toy.template), toy.nodes.astype(float), d, 1e-6) for d in directions]
    slopes = np.einsum("dsmc,smc->d", directions, toy.adj_nodes)
    assert_gradients_close(slopes, np.array(expected), elementwise=2e-4, relative=2e-4)


def test_infinite_reach_changes_no_bit(device: str) -> None:
    """A complete frame beside a partial one goes through the weights all the same."""
    toy, full = Toy(device, partial=(2,)), Toy(device)
    tolerance = 0 if device == "cpu" else 1e-6
    for name in ("transform", "input"):
        found, expected = (getattr(t.objective, name).loss.numpy()[:1] for t in (toy, full))
        np.testing.assert_allclose(found, expected, rtol=tolerance)
    found, expected = (t.objective.sums.weighed.numpy()[:2] for t in (toy, full))
    np.testing.assert_allclose(found, expected, rtol=tolerance)


@pytest.mark.parametrize("keyframe", [1, 0, 2])
def test_neighbours_are_the_nearest(keyframe: int, device: str) -> None:
    toy = Toy(device, keyframe)
    p, o, scene = toy.problem, toy.objective, toy.scene
    moved_sets = np.split(o.input.points.numpy(), p.moved_offsets[1:-1])
    moved, met = toy.pairs()
    for s, (pairs, t) in enumerate(zip(moved, p.transitions.target, strict=True)):
        np.testing.assert_array_equal(pairs.forth, reference.nearest(moved_sets[s], scene.clouds[t]))
        np.testing.assert_array_equal(pairs.back, reference.nearest(scene.clouds[t], moved_sets[s]))
    for t, pairs in enumerate(met):
        np.testing.assert_array_equal(pairs.forth, reference.nearest(o.vertices.numpy()[t], scene.clouds[t]))
        np.testing.assert_array_equal(pairs.back, reference.nearest(scene.clouds[t], o.vertices.numpy()[t]))


@pytest.mark.parametrize("keyframe", [1, 0, 2], ids=["middle", "first", "last"])
def test_gradient_of_every_node_parameter(keyframe: int, device: str) -> None:
    toy = Toy(device, keyframe)
    total = toy.twin_total()
    expected = finite_differences(lambda n: total(n, toy.template), toy.nodes, step=1e-5)
    assert_gradients_close(toy.adj_nodes, expected, elementwise=2e-4, relative=2e-4)


@pytest.mark.parametrize("loss", LOSS.values(), ids=LOSS)
def test_gradient_along_directions_and_single_nodes(loss: dict, device: str, rng: np.random.Generator) -> None:
    toy = Toy(device, levels=4, **loss)
    total, found = toy.twin_total(), toy.adj_nodes
    directions = rng.normal(size=(30, *toy.nodes.shape))
    expected = [along(lambda n: total(n, toy.template), toy.nodes.astype(float), d, 1e-5) for d in directions]
    slopes = np.einsum("dsmc,smc->d", directions, found)
    assert_gradients_close(slopes, np.array(expected), elementwise=2e-4, relative=2e-4)
    single = rng.choice(np.flatnonzero(found), 40, replace=False)
    expected = finite_differences(lambda n: total(n, toy.template), toy.nodes, single, step=1e-5)
    assert_gradients_close(found.ravel()[single], expected, elementwise=2e-4, relative=2e-4)


@pytest.mark.parametrize("keyframe", [1, 0, 2], ids=["middle", "first", "last"])
def test_gradient_of_a_template_that_follows_all_frames(keyframe: int, device: str) -> None:
    toy = Toy(device, keyframe)
    total = toy.twin_total()
    expected = finite_differences(lambda x: total(toy.nodes, x), toy.template, step=1e-5)
    assert_gradients_close(toy.adj_template(True), expected, elementwise=2e-4, relative=2e-4)


def test_gradient_of_a_template_that_follows_the_mesh_term_alone(device: str) -> None:
    toy = Toy(device, mesh_weight=0.75)
    frozen = toy.twin().weights
    expected = finite_differences(lambda x: 0.75 * toy.twin(template=x, weights=frozen).transform[1], toy.template)
    assert_gradients_close(toy.adj_template(False), expected)
    with pytest.raises(AssertionError, match="allowed"):
        assert_gradients_close(toy.adj_template(True), expected)


@pytest.mark.parametrize("keyframe", [1, 0], ids=["middle", "first"])
def test_gradient_matches_differences_of_the_kernels_own_loss(
    keyframe: int, device: str, rng: np.random.Generator
) -> None:
    """Neighbours free, float32 throughout.

    Without robust weight and confidence, which the gradient takes for constant; and on plain distances, since only
    those are continuous where a neighbour changes.
    """
    toy = Toy(device, keyframe, robust_alpha=0.0, confidence=False, tangential=1.0)
    found, start, step = toy.adj_nodes, toy.nodes, 2e-4
    directions, expected = rng.normal(size=(6, *start.shape)), []
    for direction in directions:
        ends = []
        for sign in (1, -1):
            toy.evaluate(start + sign * step * direction)
            ends.append(toy.objective.losses()["total"])
        expected.append((ends[0] - ends[1]) / (2 * step))
    slopes = np.einsum("dsmc,smc->d", directions, found)
    assert_gradients_close(slopes, np.array(expected), elementwise=0.02, direction=1e-3, relative=0.02)


def test_warm_up_sees_the_input_and_mesh_terms_alone(device: str) -> None:
    toy = Toy(device, warmup=True)
    scene, o = toy.scene, toy.objective
    weights, moved = None, toy.pairs()[0]

    def input_term(nodes: np.ndarray) -> float:
        values = []
        for s in range(2):
            source, target = scene.ends(s)
            moving = reference.move(nodes[s], scene.levels, scene.clouds[source])
            frozen = weights[s] if weights else None
            values.append(reference.chamfer(scene, moving, target, moved[s], frozen))
        found.append([w for _, w in values])
        return sum(v for v, _ in values) / 2

    found: list = []
    assert o.losses()["input"] == pytest.approx(input_term(toy.nodes.astype(float)), rel=1e-5)
    weights = found[0]
    expected = finite_differences(input_term, toy.nodes, step=1e-5)
    assert_gradients_close(toy.adj_nodes, expected, elementwise=2e-4, relative=2e-4)
    assert o.transform.loss.numpy()[1] > 0
    assert not o.transform.loss.numpy()[[0, 2]].any() and not cast(IsometryTerm, o.terms[1]).loss.numpy().any()


@pytest.mark.parametrize("way", Way)
@pytest.mark.parametrize("warmup", [False, True])
def test_an_evaluation_begins_anew(way: Way, warmup: bool, device: str) -> None:
    """What sums and losses held before has no say."""
    with going(way):
        toy = Toy(device, warmup=warmup)
    o = toy.objective
    kept = [o.input.adj_points, *((o.sums.weighed[1],) if warmup else (o.sums.weighed, o.sums.plain))]
    before, told = [a.numpy().copy() for a in kept], o.losses()
    for array in (o.input.adj_points, o.sums.weighed, o.sums.plain):
        array.fill_(wp.vec3(1.0, 2.0, 3.0))
    for phase in o.phases(warmup):
        for task in phase.tasks:
            task()
    assert o.losses() == pytest.approx(told, rel=1e-6)
    for array, expected in zip(kept, before, strict=True):
        np.testing.assert_allclose(array.numpy(), expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_zero_nodes_leave_the_vertices_and_still_ask_for_a_turn(device: str) -> None:
    toy = Toy(device)
    toy.evaluate(np.zeros_like(toy.nodes))
    np.testing.assert_array_equal(toy.objective.vertices.numpy(), np.tile(toy.template.astype(np.float32), (3, 1, 1)))
    assert np.abs(toy.adj_nodes[:, 0, :3]).max() > 0.01


def test_normals_unknown_is_the_plain_distance(device: str) -> None:
    """Clouds without normals: only the part that the tangential weight scales is left."""
    toy = Toy(device, tangential=1.0)
    p = toy.problem
    without = Problem(toy.scene.clouds, None, toy.template, toy_faces(), 1, toy.config, wp.get_device(device))
    np.testing.assert_array_equal(without.normals.numpy(), 0)
    np.testing.assert_allclose(without.cloud.numpy(), p.cloud.numpy())
    expected = toy.objective.input.loss.numpy()
    toy.problem = without
    toy.evaluate(toy.nodes)
    np.testing.assert_allclose(toy.objective.input.loss.numpy(), expected, rtol=1e-5)
