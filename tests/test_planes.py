"""Vertex normals, and the normal equations of symmetric point-to-plane pairs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import reference
import reference_refine as twin
import synthetic
import warp as wp
import witness_refine
from gradients import assert_gradients_close, finite_differences, gradient_of

from warpdef.kernels.chamfer import BOTH_SIDES
from warpdef.kernels.pairs import pairs_of
from warpdef.kernels.planes import cloud_planes, vertex_normals, vertex_planes

AGREEMENT = 0.3
SHARE = 0.7


def put(a: np.ndarray, dtype, device: str) -> wp.array:
    return wp.array(np.asarray(a, np.int32 if dtype is wp.int32 else np.float32), dtype=dtype, device=device)


def spans(cuts, total: int):
    places = [*cuts, total]
    return [(a, b - a) for a, b in zip(places[:-1], places[1:], strict=True)]


# Normals.


def normals_of(vertices: np.ndarray, faces: np.ndarray, device: str, cuts=(0,)) -> np.ndarray:
    """(T, V, 3), by the kernel."""
    corner = np.argsort(faces.ravel(), kind="stable")
    row = np.concatenate([[0], np.cumsum(np.bincount(faces.ravel(), minlength=vertices.shape[1]))])
    triangles, rows, around = (put(a, wp.int32, device) for a in (faces, row, corner // 3))
    out = put(np.full(vertices.shape, np.nan), wp.vec3, device)
    for begin, count in spans(cuts, vertices.shape[0] * vertices.shape[1]):
        vertex_normals(begin, count, triangles, rows, around, put(vertices, wp.vec3, device), out)
    return out.numpy()


def test_normals_match_the_twin(device: str, rng: np.random.Generator) -> None:
    sphere, faces = synthetic.icosphere(1)
    vertices = (sphere + 0.2 * rng.normal(size=(3, *sphere.shape))).astype(np.float32)
    found = normals_of(vertices, faces, device)
    expected = np.stack([twin.vertex_normals(v.astype(np.float64), faces) for v in vertices])
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(found, axis=2), 1, rtol=1e-6)
    np.testing.assert_array_equal(normals_of(vertices, faces, device, cuts=(0, 42, 50, 99)), found)


def test_normals_of_a_sphere_point_outwards(device: str) -> None:
    sphere, faces = synthetic.icosphere(2)
    assert ((normals_of(sphere[None], faces, device)[0] * sphere).sum(axis=1) > 0.999).all()


@pytest.mark.parametrize("size", [1.0, 1e-3, 1e-6])
def test_faces_without_area_and_vertices_without_faces(size: float, device: str) -> None:
    """0, 1, 2: a triangle. 3, 4, 5: points in a row. 6, 6, 7: twice the same corner. 8: no face. 9 - 11: one place."""
    vertices = np.zeros((1, 12, 3))
    vertices[0, 1:3] = [[1, 0, 0], [0, 1, 0]]
    vertices[0, 3:6] = [[0, 0, 1], [1, 0, 1], [2, 0, 1]]
    vertices[0, 6:8] = [[3, 1, 0], [4, 1, 0]]
    faces = np.array([[0, 1, 2], [3, 4, 5], [6, 6, 7], [9, 10, 11], [0, 0, 1]])
    expected = np.zeros((1, 12, 3))
    expected[0, :3] = [0, 0, 1]
    np.testing.assert_array_equal(normals_of(size * vertices, faces, device), expected)


# Pairs.


class PlaneScene:
    """Two frames of random vertices and cloud points, their normals within or beyond agreement, all of them paired.

    met: vertex to cloud; asked: cloud to vertex. Some have no partner.
    """

    def __init__(self, device: str, rng: np.random.Generator, vertices: int = 30, points: int = 90) -> None:
        self.device, self.count = device, 2 * vertices
        self.x, self.q = (rng.normal(size=(2 * n, 3)).astype(np.float32) for n in (vertices, points))
        self.m, self.n = (_units(rng.normal(size=(2 * n, 3)) + [0, 0, 1]) for n in (vertices, points))
        self.frame = {"met": np.repeat([0, 1], vertices), "asked": np.repeat([0, 1], points)}
        self.index = {
            "met": rng.integers(0, points, 2 * vertices) + points * self.frame["met"],
            "asked": rng.integers(0, vertices, 2 * points) + vertices * self.frame["asked"],
        }
        for index in self.index.values():
            index[::7] = -1
        self.reach = np.array([1.5, 4.0], np.float32)
        self.folded = np.zeros(2, np.float32)
        self.mutual_reach: np.ndarray | None = None  # of each frame, where pairs count by the way back

    def run(self, way: str, start: float = 0.0, cuts=(0,), agreement: float = AGREEMENT, share: float = SHARE):
        """A (V, 3, 3) and b (V, 3) of all frames by the kernel, into arrays that hold ``start``."""
        kernel = {"met": vertex_planes, "asked": cloud_planes}[way]
        pairs, sums = self.pairs(way, agreement, share), self.sums(start)
        for begin, count in spans(cuts, len(self.frame[way])):
            kernel(begin, count, pairs, *sums)
        return tuple(a.numpy() for a in sums)

    def pairs(self, way: str, agreement: float = AGREEMENT, share: float = SHARE) -> Any:
        """As the kernels take them; the way back belongs to those that vertices meet."""
        on = self.device
        mesh, cloud = ([put(a, wp.vec3, on) for a in pair] for pair in ((self.x, self.m), (self.q, self.n)))
        pairing = (agreement, share, put(self.reach, wp.float32, on), put(self.folded, wp.float32, on))
        frame, index = (put(a, wp.int32, on) for a in (self.frame[way], self.index[way]))
        sides = BOTH_SIDES
        if way == "met" and self.mutual_reach is not None:
            sides = (put(self.index["asked"], wp.int32, on), put(self.mutual_reach, wp.float32, on))
        return pairs_of(pairing, mesh[0], mesh[1], frame, index, cloud[0], cloud[1], sides)

    def sums(self, start: float = 0.0) -> tuple[wp.array, wp.array]:
        """A and b of all frames, filled."""
        matrix, rhs = np.full((self.count, 3, 3), start), np.full((self.count, 3), start)
        return put(matrix, wp.mat33, self.device), put(rhs, wp.vec3, self.device)

    def planes(self, way: str, agreement: float = AGREEMENT) -> twin.Planes:
        """The same pairs for the twin, those without a partner left out."""
        paired = np.flatnonzero(self.index[way] >= 0)
        other = self.index[way][paired]
        vertex, point = (paired, other) if way == "met" else (other, paired)
        x, m, q, n = (a.astype(np.float64) for a in (self.x[vertex], self.m[vertex], self.q[point], self.n[point]))
        reach, folded = (a[self.frame[way][paired]].astype(np.float64) for a in (self.reach, self.folded))
        mutual = self.mutual(vertex, point) if way == "met" else 1.0
        folded = folded if way == "met" else 0.0
        return twin.planes(x, m, q, n, vertex, reach, agreement, SHARE, mutual, folded)

    def any_order(self, way: str) -> tuple[float, float]:
        """How far sums of the same terms in two orders may be apart, by entry of A and of b; 0 where one thread adds.

        A float32 sum of k terms is off by at most (k - 1) u sum |terms| to first order, u = 2^-24, in whatever order
        (Higham, Accuracy and Stability of Numerical Algorithms, 2002, eq. 4.4). Two of them by twice that.
        """
        if way == "met" or self.device == "cpu":
            return 0.0, 0.0
        planes, most = self.planes(way), int(np.bincount(self.planes(way).owner).max())
        sizes = twin.Planes(planes.owner, np.abs(planes.a), planes.w, -np.abs(planes.r)).normal_equations(self.count)
        matrix, rhs = (2 * (most - 1) * 2.0**-24 * float(size.max()) for size in sizes)
        return matrix, rhs

    def mutual(self, vertex: np.ndarray, point: np.ndarray) -> np.ndarray | float:
        """Weights of vertices' own pairs by the way back."""
        if self.mutual_reach is None:
            return 1.0
        answered = self.index["asked"][point]
        x, reach = self.x.astype(np.float64), self.mutual_reach[self.frame["met"][vertex]]
        return np.where(answered >= 0, reference.mutual_weight(x[vertex], x[answered], reach), 1.0)


def _units(a: np.ndarray) -> np.ndarray:
    return (a / np.linalg.norm(a, axis=1, keepdims=True)).astype(np.float32)


SCENES = {
    "all pairs": (None, (0.0, 0.0)),
    "one-sided": ((2.0, 3.0), (0.0, 0.0)),
    "one frame one-sided": ((np.inf, 1.5), (0.3, 0.0)),
    "folded": (None, (0.1, 0.2)),
}


@pytest.fixture(params=SCENES.values(), ids=list(SCENES))
def scene(device: str, rng: np.random.Generator, request: pytest.FixtureRequest) -> PlaneScene:
    scene, (mutual_reach, folded) = PlaneScene(device, rng), request.param
    scene.mutual_reach = None if mutual_reach is None else np.array(mutual_reach, np.float32)
    scene.folded = np.array(folded, np.float32)
    return scene


@pytest.fixture(params=["met", "asked"])
def way(request: pytest.FixtureRequest) -> str:
    return request.param


def test_normal_equations_match_the_twin(scene: PlaneScene, way: str) -> None:
    planes = scene.planes(way)
    left_out = (planes.a == 0).all(axis=1)
    assert left_out.sum() < len(left_out) - 5 and (left_out.any() or scene.folded.all())
    for found, expected in zip(scene.run(way), planes.normal_equations(scene.count), strict=True):
        assert_gradients_close(found, expected)


def test_the_right_hand_side_is_minus_half_the_gradient(scene: PlaneScene, way: str) -> None:
    """At no move, with planes, weights and pairs held."""
    slope = finite_differences(scene.planes(way).energy, np.zeros((scene.count, 3)))
    assert_gradients_close(scene.run(way)[1], -0.5 * slope)


def test_the_matrix_is_half_the_second_derivative(scene: PlaneScene, way: str, rng: np.random.Generator) -> None:
    """The energy is a quadratic: E(d) = E(0) - 2 b . d + d . A d, whatever d is."""
    planes, (matrix, rhs) = scene.planes(way), scene.run(way)
    np.testing.assert_array_equal(matrix, matrix.transpose(0, 2, 1))
    moves = rng.normal(size=(20, scene.count, 3))
    found = [-2 * (rhs * d).sum() + np.einsum("ia,iab,ib->", d, matrix, d) for d in moves]
    expected = [planes.energy(d) - planes.energy(0 * d) for d in moves]
    np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_the_right_hand_side_matches_autodiff(scene: PlaneScene, way: str) -> None:
    planes, on = scene.planes(way), scene.device
    paired = np.flatnonzero(scene.index[way] >= 0)
    other = scene.index[way][paired]
    x, q = (scene.x[paired], scene.q[other]) if way == "met" else (scene.x[other], scene.q[paired])
    move = wp.zeros(scene.count, dtype=wp.vec3, device=on, requires_grad=True)
    loss = wp.zeros(1, dtype=wp.float32, device=on, requires_grad=True)
    held = [put(planes.owner, wp.int32, on), put(x - q, wp.vec3, on)]
    held += [put(planes.a, wp.vec3, on), put(planes.w, wp.float32, on)]
    with wp.Tape() as tape:
        wp.launch(witness_refine.plane_pairs, len(paired), inputs=[move, *held, loss], device=on)
    tape.backward(loss)
    assert_gradients_close(scene.run(way)[1], -0.5 * gradient_of(move))


def test_vertices_write_and_points_add(scene: PlaneScene) -> None:
    for found, fresh in zip(scene.run("met", start=5.0), scene.run("met"), strict=True):
        np.testing.assert_array_equal(found, fresh)
    for found, fresh in zip(scene.run("asked", start=5.0), scene.run("asked"), strict=True):
        np.testing.assert_allclose(found, fresh + 5.0, rtol=0, atol=1e-5)


def test_no_partner_no_plane(scene: PlaneScene, way: str) -> None:
    found = scene.run("met")
    lonely = scene.index["met"] < 0
    assert lonely.any() and not any(a[lonely].any() for a in found)
    scene.index[way][:] = -1
    assert not any(a.any() for a in scene.run(way))


def test_spans_are_the_whole(scene: PlaneScene, way: str) -> None:
    found, whole = scene.run(way, cuts=(0, 1, 30, 44)), scene.run(way)
    for a, b, tolerance in zip(found, whole, scene.any_order(way), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=tolerance)


class Pair:
    """One vertex and one point, each the other's partner; both kernels must say the same."""

    def __init__(self, device: str, x, m, q, n, reach: float = 1.0) -> None:
        scene = self.scene = PlaneScene.__new__(PlaneScene)
        scene.device, scene.count = device, 1
        scene.x, scene.m, scene.q, scene.n = (np.array([a], np.float32) for a in (x, m, q, n))
        scene.frame = scene.index = {"met": np.array([0]), "asked": np.array([0])}
        scene.reach, scene.mutual_reach = np.array([reach], np.float32), None
        scene.folded = np.zeros(1, np.float32)

    def run(self, agreement: float = AGREEMENT, share: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        ways = ("met", "asked")
        (matrix, rhs), asked = (self.scene.run(way, agreement=agreement, share=share) for way in ways)
        np.testing.assert_array_equal(matrix, asked[0])
        np.testing.assert_array_equal(rhs, asked[1])
        return matrix[0], rhs[0]


def test_a_pair_by_hand(device: str) -> None:
    """A point 0.5 above along z pulls up; sideways it pulls nothing, but is farther."""
    up = [0, 0, 1]
    matrix, rhs = Pair(device, [0, 0, 0], up, [2, 0, 0.5], up, reach=3.0).run()
    weight = np.exp(-4.25 / 9)
    np.testing.assert_allclose(rhs, [0, 0, 0.5 * weight], rtol=1e-6)
    np.testing.assert_allclose(matrix, weight * np.diag([0, 0, 1]), rtol=1e-6)


def test_normals_that_disagree_are_left_out(device: str) -> None:
    def plane(cosine: float, agreement: float) -> np.ndarray:
        n = [np.sqrt(1 - cosine**2), 0, cosine]
        return Pair(device, [0, 0, 0], [0, 0, 1], [0, 0, 0.1], n).run(agreement)[0]

    for agreement in (-0.5, 0.0, 0.5):
        assert plane(agreement + 0.01, agreement).any()
        assert not plane(agreement - 0.01, agreement).any()
    assert not plane(-1.0, -1.0).any()  # opposed: their sum is no direction


def test_a_fold_is_drawn_to_the_point_it_disagrees_with(device: str) -> None:
    """A vertex 0.5 below that faces down, towards the plane of the point that faces up; the point asks for nothing."""
    scene = Pair(device, [0.3, 0, -0.5], [0, 0, -1], [0, 0, 0], [0, 0, 1], reach=3.0).scene
    scene.folded[:] = 0.2
    (matrix, rhs), asked = scene.run("met"), scene.run("asked")
    weight = 0.2 * np.exp(-0.34 / 9)
    np.testing.assert_allclose(rhs[0], [0, 0, 0.5 * weight], rtol=1e-6)
    np.testing.assert_allclose(matrix[0], weight * np.diag([0, 0, 1]), rtol=1e-6)
    assert not any(a.any() for a in asked)


def test_unknown_normals_are_left_out(device: str) -> None:
    for m, n in (([0, 0, 0], [0, 0, 1]), ([0, 0, 1], [0, 0, 0]), ([0, 0, 0], [0, 0, 0])):
        assert not any(a.any() for a in Pair(device, [0, 0, 0], m, [0, 0, 0.1], n).run(0.0))


def test_far_pairs_fade(device: str) -> None:
    """At the reach to 1/e, far away to nothing; however near, a pair counts once."""
    up, reach, distances = [0, 0, 1], 0.1, np.array([0, 0.05, 0.1, 0.2, 0.5, 10])
    found = [Pair(device, [0, 0, d], up, [0, 0, 0], up, reach).run() for d in distances]
    weights = np.array([matrix[2, 2] for matrix, _ in found])
    np.testing.assert_allclose(weights, np.exp(-((distances / reach) ** 2)), rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose([rhs[2] for _, rhs in found], -weights * distances, rtol=1e-6)
    assert weights[0] == 1 and weights[-1] == 0
    assert all(np.isfinite(a).all() for pair in found for a in pair)


def test_each_frame_has_its_own_reach(scene: PlaneScene, way: str) -> None:
    before, apart = scene.run(way), scene.any_order(way)
    scene.reach[1] *= 2
    for a, b, tolerance in zip(before, scene.run(way), apart, strict=True):
        np.testing.assert_allclose(a[:30], b[:30], rtol=0, atol=tolerance)
        assert (np.abs(a[30:] - b[30:]).max(axis=0) > 0).all()


def test_a_vertex_that_slides_on_a_sphere_is_not_pulled(device: str, rng: np.random.Generator) -> None:
    """What the common normal is for: a . (x - q) is 0 for any two points of a sphere."""
    for q, n in zip(_units(rng.normal(size=(20, 3))), _units(rng.normal(size=(20, 3))), strict=True):
        x = _units((q + 0.3 * n)[None])[0]
        pair = Pair(device, x, x, q, q, reach=10.0)
        assert np.abs(pair.run()[1]).max() < 1e-6
        # The mesh's normal alone, as for noisy clouds, sees the sphere's curvature.
        assert np.abs(pair.run(share=0.0)[1]).max() > 1e-4
