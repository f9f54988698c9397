"""The whole objective on a three-frame toy: losses and gradient against the float64 twin with pinned neighbours."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
import pytest
import reference
import reference_refine as twin_refine
import synthetic
import warp as wp
import witness
from descent import chained
from gradients import along, assert_gradients_close, finite_differences

from warpdef.config import Config
from warpdef.device import Way, going, on_host
from warpdef.fit.objective import Objective
from warpdef.fit.problem import Problem
from warpdef.fit.terms import IsometryTerm
from warpdef.kernels.levels import node8
from warpdef.kernels.motion import template_gradient
from warpdef.kernels.schedule import DELTA, SCHEDULE_SIZE

# Chosen so that every term has a say: on sums, isometry at 250 would be a few per cent of a toy's loss.
LOSS = {
    "as configured": {},
    "mean, power 4, plain distance": {
        "reduction": "mean",
        "robust_power": 4,
        "tangential": 1.0,
        "isometry_weight": 1.0,
    },
    "no confidence": {"confidence": False, "mesh_weight": 0.5, "input_weight": 2.0, "transform_weight": 3.0},
    "no isometry, along normals": {"isometry_weight": 0.0, "tangential": 0.0, "confidence_bound": "mean"},
}


class Toy:
    """A turning ellipsoid in three frames of unequal clouds, evaluated once at random nodes.

    partial: frames that are taken to show part of the surface. off: how far the template is moved off its cloud.
    chain: the paper's descent, else cloud to cloud. points: of each frame that grids are then fitted to; 0: all.
    """

    def __init__(
        self,
        device: str,
        keyframe: int = 1,
        levels: int = 2,
        warmup: bool = False,
        partial: tuple = (),
        off: float = 0.0,
        chain: bool = True,
        points: int = 0,
        **loss,
    ) -> None:
        rng = np.random.default_rng(5)
        moving = synthetic.turning_ellipsoid(3, 40, rng, subdivisions=1)
        sizes = [40, 23, 31]
        clouds, normals = ([a[:n] for a, n in zip(s, sizes, strict=True)] for s in (moving.clouds, moving.normals))
        config = replace(Config(), grid=replace(Config().grid, levels=levels), loss=replace(Config().loss, **loss))
        optimiser = replace(config.optimiser, points=points)
        config = chained(config) if chain else replace(config, optimiser=optimiser)
        self.device, self.config, self.levels = device, config, reference.resolutions(1, levels)
        template = moving.vertices[keyframe] + 0.02 * rng.normal(size=moving.vertices[0].shape) + [off, 0.0, 0.0]
        self.problem = p = Problem(clouds, normals, template, moving.faces, keyframe, config, wp.get_device(device))
        p.measures.complete = ~np.isin(np.arange(3), partial)
        self.nodes = (rng.normal(size=(2, p.levels.node_count, 6)) * 0.08).astype(np.float32)
        self.template = p.template.astype(np.float32).astype(np.float64)
        self.evaluate(self.nodes, warmup)

    def evaluate(self, nodes: np.ndarray, warmup: bool = False) -> None:
        p = self.problem
        on_device = wp.array(witness.pad(nodes), dtype=node8, ndim=2, device=self.device)
        self._adj_nodes = wp.zeros_like(on_device)
        schedule = np.zeros(SCHEDULE_SIZE, dtype=np.float32)
        schedule[DELTA] = 0.7
        self.objective = o = Objective(p, on_device, self._adj_nodes, p.numbers(schedule))
        for phase in o.phases(warmup):
            for task in phase.tasks:
                task()
        if not warmup and self.config.optimiser.chain:
            for first, last in p.transition_spans():
                o.chain.scatter(first, last)

    @property
    def adj_nodes(self) -> np.ndarray:
        """Gradient of the nodes, (S, M, 6)."""
        found = self._adj_nodes.numpy()
        np.testing.assert_array_equal(found[..., 6:], 0)
        return found[..., :6]

    def adj_template(self, follow: bool) -> np.ndarray:
        o, found = self.objective, self.problem.vectors(np.zeros_like(self.template))
        template_gradient(self.problem.transitions.keyframe, follow, o.sums.weighed, o.sums.plain, o.chain.carry, found)
        return found.numpy()

    @property
    def trust(self) -> np.ndarray:
        return self.objective.confidence.numpy().astype(np.float64)

    # The twin, at the same float32 positions.

    @property
    def scene(self) -> reference.TwinScene:
        p, loss = self.problem, self.config.loss
        split = p.sample.offsets[1:-1]
        clouds = np.split(p.sample.points.numpy().astype(np.float64), split)
        # Fewer points on the same surface stand farther apart, by the root of their number.
        spacing = np.array([twin_refine.spacing(c) for c in p.by_frame(p.cloud.numpy())])
        spacing *= np.sqrt(p.cloud_sizes / p.sample.sizes)
        ends = p.template[on_host(p.edges)]
        source, target = p.transitions.source, p.transitions.target
        between = 0.75 * (spacing[source] + spacing[target])
        vertex_reach = spacing + 0.25 * np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean()
        return reference.TwinScene(
            moved_reach=np.where(p.measures.complete[target], np.inf, between),
            met_reach=np.where(p.measures.complete[source], np.inf, between),
            vertex_reach=np.where(p.measures.complete, np.inf, vertex_reach),
            clouds=clouds,
            normals=np.split(p.sample.normals.numpy().astype(np.float64), split),
            edges=p.edges.numpy(),
            levels=self.levels,
            keyframe=p.transitions.keyframe,
            alpha=loss.robust_alpha,
            power=loss.robust_power,
            tangential=loss.tangential,
            share_mean=loss.reduction == "mean",
            mesh_weight=loss.mesh_weight,
            input_weight=loss.input_weight,
            transform_weight=loss.transform_weight,
            isometry_weight=loss.isometry_weight,
        )

    def pairs(self) -> tuple[list[reference.NearestPairs], list[reference.NearestPairs]]:
        """The kernel's neighbours: of moved clouds, of vertices."""
        p, o, count = self.problem, self.objective, self.problem.vertex_count
        first, moved_offsets = p.sample.offsets, p.moved_offsets
        forth, back = o.input.correspondences.forth.index.numpy(), o.input.correspondences.back.index.numpy()
        moved = []
        for s, t in enumerate(p.transitions.target):
            there, here = slice(*moved_offsets[s : s + 2]), slice(*first[t : t + 2])
            moved.append(reference.NearestPairs(forth[there] - first[t], back[here] - moved_offsets[s]))
        forth, back = o.transform.correspondences.forth.index.numpy(), o.transform.correspondences.back.index.numpy()
        first = p.cloud_offsets
        met = [
            reference.NearestPairs(
                forth[t * count : (t + 1) * count] - first[t], back[first[t] : first[t + 1]] - t * count
            )
            for t in range(p.frame_count)
        ]
        return moved, met

    def twin(
        self, nodes: np.ndarray | None = None, template: np.ndarray | None = None, weights=None
    ) -> reference.Terms:
        nodes = self.nodes.astype(np.float64) if nodes is None else nodes
        template = self.template if template is None else template
        return reference.terms(self.scene, nodes, template, *self.pairs(), weights)

    def twin_total(self):
        """The twin's objective of nodes and template; all that the gradient takes for constant is frozen."""
        scene, pairs, trust = self.scene, self.pairs(), self.trust
        weights = self.twin().weights

        def total(nodes: np.ndarray, template: np.ndarray) -> float:
            return reference.total(scene, reference.terms(scene, nodes, template, *pairs, weights), trust)

        return total


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
    without = Problem(toy.scene.clouds, None, toy.template, _faces(), 1, toy.config, wp.get_device(device))
    np.testing.assert_array_equal(without.normals.numpy(), 0)
    np.testing.assert_allclose(without.cloud.numpy(), p.cloud.numpy())
    expected = toy.objective.input.loss.numpy()
    toy.problem = without
    toy.evaluate(toy.nodes)
    np.testing.assert_allclose(toy.objective.input.loss.numpy(), expected, rtol=1e-5)


# Without a chain: cloud to cloud alone.


@pytest.mark.parametrize("points", [0, 20], ids=["all points", "some points"])
@pytest.mark.parametrize("partial", [(), (0,), (0, 1, 2)])
def test_cloud_to_cloud_alone_matches_the_twin(partial: tuple, points: int, device: str) -> None:
    """Loss and gradient; the vertices and what is compared with them have no say and stay as they were."""
    toy = Toy(device, partial=partial, chain=False, points=points)
    p, o, scene, (pairs, _) = toy.problem, toy.objective, toy.scene, toy.pairs()
    assert p.sample.sizes.tolist() == ([20, 20, 20] if points else [40, 23, 31])

    def values(nodes: np.ndarray, weights: tuple) -> list:
        found = []
        for s in range(2):
            source, target = scene.ends(s)
            moving = reference.move(nodes[s], scene.levels, scene.clouds[source])
            found.append(reference.chamfer(scene, moving, target, pairs[s], weights[s], scene.reach_of_moved(s)))
        return found

    expected, weights = zip(*values(toy.nodes.astype(float), (None, None)), strict=True)
    np.testing.assert_allclose(o.input.loss.numpy(), expected, rtol=1e-5)
    mean = sum(expected) / 2
    assert o.losses() == pytest.approx({"input": mean, "total": mean}, rel=1e-5)
    slopes = finite_differences(lambda n: sum(v for v, _ in values(n, weights)) / 2, toy.nodes, step=1e-5)
    assert_gradients_close(toy.adj_nodes, slopes, elementwise=2e-4, relative=2e-4)
    np.testing.assert_array_equal(o.vertices.numpy(), np.tile(toy.template.astype(np.float32), (3, 1, 1)))
    assert not o.transform.loss.numpy().any() and not o.sums.weighed.numpy().any()


def test_clouds_seen_in_part_count_less_in_a_guide(device: str) -> None:
    full, partial = (Toy(device, chain=False, partial=p).objective.input.loss.numpy() for p in ((), (0, 1, 2)))
    assert (partial < full).all()


def test_vertices_are_fitted_to_all_points_whatever_grids_are_fitted_to(device: str) -> None:
    p = Toy(device, chain=False, points=20).problem
    assert p.clouds.sizes.tolist() == p.cloud_sizes.tolist() == [40, 23, 31] and len(p.cloud) == 94
    chosen, normals = (np.split(a.numpy(), p.sample.offsets[1:-1]) for a in (p.sample.points, p.sample.normals))
    for t, (cloud, sides) in enumerate(zip(p.by_frame(p.cloud.numpy()), p.by_frame(p.normals.numpy()), strict=True)):
        where = (chosen[t][:, None] == cloud.astype(np.float32)).all(axis=2)
        assert (where.sum(axis=1) == 1).all() and len(set(where.argmax(axis=1))) == 20
        np.testing.assert_array_equal(normals[t], sides[where.argmax(axis=1)].astype(np.float32))


def _faces() -> np.ndarray:
    return synthetic.icosphere(1)[1]
