"""Residuals across the border of an open mesh: against twin, differences and autodiff, and an edge found again."""

from __future__ import annotations

import numpy as np
import pytest
import reference
import reference_refine as twin
import warp as wp
import witness_refine
from gradients import assert_gradients_close, finite_differences, gradient_of
from test_planes import PlaneScene, put, spans

from warpdef.fit.pairing import _BORDER_GAP
from warpdef.kernels.borders import cloud_borders, vertex_borders

STIFFNESS = 0.7


class BorderEdge(PlaneScene):
    """The scene of random pairs, in which every second vertex has border neighbours; vertex 6 has coincident ones."""

    def __init__(self, device: str, rng: np.random.Generator) -> None:
        super().__init__(device, rng)
        self.border = rng.integers(0, 30, (30, 3))
        self.border[1::2] = -1
        self.x[self.border[6]] = self.x[6]
        self.mutual_reach = np.array([2.0, np.inf], np.float32)
        self.gap = np.array([0.2, 0.5], np.float32)

    def run(self, way: str, start: float = 0.0, cuts=(0,)):
        kernel = {"met": vertex_borders, "asked": cloud_borders}[way]
        on, pairs, sums = self.device, self.pairs(way), self.sums(start)
        border = wp.array(self.border.astype(np.int32), dtype=wp.int32, ndim=2, device=on)
        gap = [put(self.gap, wp.float32, on)] if way == "met" else []
        for begin, count in spans(cuts, len(self.frame[way])):
            kernel(begin, count, pairs, border, STIFFNESS, *gap, *sums)
        return tuple(a.numpy() for a in sums)

    def offset(self, way: str) -> np.ndarray:
        """x - q of all pairs."""
        paired = np.flatnonzero(self.index[way] >= 0)
        other = self.index[way][paired]
        vertex, point = (paired, other) if way == "met" else (other, paired)
        return self.x[vertex].astype(np.float64) - self.q[point]

    def border_planes(self, way: str) -> twin.Planes:
        pairs = self.planes(way)
        first, v = pairs.owner // 30 * 30, pairs.owner % 30
        around = self.x.astype(np.float64)[first[:, None] + np.maximum(self.border[v], 0)]
        b = twin.outward(around[:, 0], self.x.astype(np.float64)[pairs.owner], around[:, 1], around[:, 2])
        b[self.border[v, 0] < 0] = 0.0
        gap = self.gap[first // 30].astype(np.float64) if way == "met" else None
        return twin.border_planes(pairs, b, self.offset(way), STIFFNESS, gap)


@pytest.fixture
def edge(device: str, rng: np.random.Generator) -> BorderEdge:
    return BorderEdge(device, rng)


@pytest.fixture(params=["met", "asked"])
def way(request: pytest.FixtureRequest) -> str:
    return request.param


def test_normal_equations_match_the_twin(edge: BorderEdge, way: str) -> None:
    planes = edge.border_planes(way)
    assert 5 < (planes.a != 0).any(axis=1).sum() < 0.5 * len(planes.a)
    for found, expected in zip(edge.run(way), planes.normal_equations(edge.count), strict=True):
        assert_gradients_close(found, expected)


def test_the_right_hand_side_is_minus_half_the_gradient(edge: BorderEdge, way: str) -> None:
    """At no move, with directions, weights and pairs held."""
    slope = finite_differences(edge.border_planes(way).energy, np.zeros((edge.count, 3)))
    assert_gradients_close(edge.run(way)[1], -0.5 * slope)


def test_the_right_hand_side_matches_autodiff(edge: BorderEdge, way: str) -> None:
    planes, on = edge.border_planes(way), edge.device
    move = wp.zeros(edge.count, dtype=wp.vec3, device=on, requires_grad=True)
    loss = wp.zeros(1, dtype=wp.float32, device=on, requires_grad=True)
    # The witness wants an offset whose part along the plane is the residual.
    held = [put(planes.owner, wp.int32, on), put(planes.r[:, None] * planes.a, wp.vec3, on)]
    held += [put(planes.a, wp.vec3, on), put(planes.w, wp.float32, on)]
    with wp.Tape() as tape:
        wp.launch(witness_refine.plane_pairs, len(planes.w), inputs=[move, *held, loss], device=on)
    tape.backward(loss)
    assert_gradients_close(edge.run(way)[1], -0.5 * gradient_of(move))


def test_it_adds_and_spans_are_the_whole(edge: BorderEdge, way: str) -> None:
    whole = edge.run(way)
    tolerance = 0 if edge.device == "cpu" else 1e-5
    for found, cut, fresh in zip(edge.run(way, start=5.0), edge.run(way, cuts=(0, 7, 44)), whole, strict=True):
        np.testing.assert_allclose(found, fresh + 5.0, rtol=0, atol=1e-5)
        np.testing.assert_allclose(cut, fresh, rtol=0, atol=tolerance)


def test_inside_and_without_direction_nothing_is_added(edge: BorderEdge, way: str) -> None:
    found = edge.run(way)
    inside = np.tile(edge.border[:, 0] < 0, 2)
    # Vertex 6 of the first frame lies where all its neighbours lie.
    inside[6] = True
    assert not any(a[inside].any() for a in found)
    edge.border[:] = -1
    assert not any(a.any() for a in edge.run(way))


def test_a_straight_edge_is_found_where_the_points_end(device: str, rng: np.random.Generator) -> None:
    """Random points below y = 0: a border line there is asked to stay, one below to rise and one above to sink."""
    edge, count, points = BorderEdge(device, rng), 400, 4800
    cloud = np.column_stack([rng.uniform(-6, 6, points), rng.uniform(-1, 0, points), np.zeros(points)])
    spacing = 0.5 / np.sqrt(points / 12)  # mean distance to the nearest fellow
    # The line, and the vertices a step inside that say which way is out.
    k, line = np.arange(count), np.linspace(-4, 4, count)
    around = np.column_stack([np.maximum(k - 1, 0), np.minimum(k + 1, count - 1), k + count])
    edge.border, edge.count = np.concatenate([around, np.full((count, 3), -1)]), 2 * count
    up = np.array([0, 0, 1], dtype=np.float32)
    edge.q, edge.m, edge.n = cloud.astype(np.float32), np.tile(up, (2 * count, 1)), np.tile(up, (points, 1))
    edge.frame = {"met": np.zeros(2 * count), "asked": np.zeros(points)}
    edge.reach, edge.mutual_reach, edge.gap = np.array([10.0]), np.array([np.inf]), np.array([_BORDER_GAP * spacing])
    edge.folded = np.zeros(1, np.float32)
    moves = []
    for height in (-3 * spacing, 0.0, 3 * spacing):
        flat = np.column_stack([line, np.full(count, height), np.zeros(count)])
        edge.x = np.concatenate([flat, flat - [0, 2 * spacing, 0]]).astype(np.float32)
        pairs = {"met": reference.nearest(edge.x, cloud), "asked": reference.nearest(cloud, edge.x)}
        edge.index = pairs
        sums = [edge.run(way) for way in pairs]
        matrix, rhs = (np.sum([s[i][:count].sum(axis=0) for s in sums], axis=0) for i in (0, 1))
        moves.append(rhs[1] / matrix[1, 1])
    # The depth of the nearest point spreads by sqrt(1 / pi - 0.45^2) / sqrt(density), 0.68 spacings, and is another one
    # every 1 / sqrt(density) of the line's 8.
    assert abs(moves[1]) < 3 * 0.68 * spacing / np.sqrt(8 / (2 * spacing))
    assert moves[0] > 0.5 * spacing and moves[2] < -2.0 * spacing
