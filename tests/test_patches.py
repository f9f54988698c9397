"""Patches go with their best rigid motion; smooth places are the filter's; what holds there is half a gradient."""

from __future__ import annotations

import numpy as np
import pytest
import reference_patches as twin
import synthetic
import warp as wp
import witness_refine
from gradients import assert_gradients_close, finite_differences, gradient_of
from reference_refine import turn_about
from test_planes import put, spans

from warpdef.fit.smoothness import _members, time_filter
from warpdef.geometry.triangles import unique_edges
from warpdef.kernels.fairing import towards_mean
from warpdef.kernels.graphs import mesh_graph
from warpdef.kernels.patches import fit_patches, local_places, smooth_rhs

FRAMES, VERTICES, PATCHES, PER_VERTEX = 5, 42, 4, 3
SHARES = 0.6, 0.3, 0.4, 2.5


class PatchScene:
    """A small sphere in five poses, bent in each, and its vertices' random weights in patches."""

    def __init__(self, device: str, rng: np.random.Generator) -> None:
        self.device = device
        sphere, self.faces = synthetic.icosphere(1)
        self.y = sphere.astype(np.float32).astype(np.float64)
        turn = np.stack([turn_about(rng.normal(size=3), 0.8 * t) for t in range(FRAMES)])
        self.x = np.einsum("tab,vb->tva", turn, self.y) + rng.normal(size=(FRAMES, 1, 3))
        self.x = (self.x + rng.normal(scale=0.05, size=self.x.shape)).astype(np.float32).astype(np.float64)
        self.rotation = np.stack([[turn_about(rng.normal(size=3), 0.3) @ r for _ in self.y] for r in turn])
        self.index = np.stack([rng.permutation(PATCHES)[:PER_VERTEX] for _ in self.y])
        self.weight = rng.uniform(0.1, 1.0, size=self.index.shape)
        self.weight /= self.weight.sum(axis=1, keepdims=True)
        self.w = np.zeros((len(self.y), PATCHES))
        np.put_along_axis(self.w, self.index, self.weight, axis=1)

    def run(self, start: np.ndarray | None = None, cuts=(0,)) -> tuple[np.ndarray, ...]:
        """Turns, shifts, carried and local places."""
        row, member, share = _members(self.index, self.weight)
        on, poses, shape = self.device, (FRAMES, PATCHES), self.x.shape[:2]
        members = put(row, wp.int32, on), put(member, wp.int32, on), put(share, wp.float32, on)
        start = self.rotation if start is None else start
        moving = put(self.y, wp.vec3, on), put(self.x, wp.vec3, on), put(start, wp.mat33, on)
        turn = put(np.full((*poses, 3, 3), np.nan), wp.mat33, on)
        shift = put(np.full((*poses, 3), np.nan), wp.vec3, on)
        for begin, count in spans(cuts, FRAMES * PATCHES):
            fit_patches(begin, count, *members, *moving, turn, shift)
        carried, local = (put(np.full((*shape, 3), np.nan), wp.vec3, on) for _ in range(2))
        patch = wp.array(self.index.astype(np.int32), dtype=wp.int32, ndim=2, device=on)
        weight = wp.array(self.weight.astype(np.float32), dtype=wp.float32, ndim=2, device=on)
        moving = *moving[:2], put(self.rotation, wp.mat33, on)
        for begin, count in spans(cuts, FRAMES * VERTICES):
            local_places(begin, count, patch, weight, *moving, turn, shift, carried, local)
        return tuple(a.numpy().astype(np.float64) for a in (turn, shift, carried, local))

    def hold(self, carried, local, hold=0.7, shares=SHARES, start=0.0, cuts=(0,)) -> tuple[np.ndarray, np.ndarray]:
        """Matrix and right-hand side."""
        starts, rows = time_filter(np.arange(len(carried)))
        on, shape, (own, course, chance, firmer) = self.device, carried.shape, shares
        first, weights = put(starts, wp.int32, on), wp.array(rows.astype(np.float32), dtype=wp.float32, device=on)
        places = put(self.rotation[: len(carried)], wp.mat33, on), put(carried, wp.vec3, on), put(local, wp.vec3, on)
        matrix = put(np.full((*shape, 3), start), wp.mat33, on)
        rhs = put(np.full(shape, np.nan), wp.vec3, on)
        for begin, count in spans(cuts, shape[0] * shape[1]):
            smooth_rhs(begin, count, hold, own, course, chance, firmer, first, weights, *places, matrix, rhs)
        return matrix.numpy(), rhs.numpy()


@pytest.fixture
def scene(device: str, rng: np.random.Generator) -> PatchScene:
    return PatchScene(device, rng)


def dense(first: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The filter as a matrix (T, T)."""
    whole = np.zeros((len(first), len(first)))
    for t, (a, row) in enumerate(zip(first, weights, strict=True)):
        whole[t, a : a + len(row)] = row
    return whole


def test_patches_and_places_match_the_twin(scene: PatchScene) -> None:
    turn, shift = twin.fit_patches(scene.x, scene.y, scene.w)
    carried, local = twin.places(scene.x, scene.y, scene.w, scene.rotation, turn, shift)
    for found, expected in zip(scene.run(), (turn, shift, carried, local), strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize("start", ["nothing", "another", "mirrored"])
def test_patches_are_found_from_any_start_and_in_spans(scene: PatchScene, start: str) -> None:
    starts = {"nothing": np.nan, "another": turn_about([0, 1, 0], 3.0), "mirrored": -np.eye(3)}
    turn, shift = twin.fit_patches(scene.x, scene.y, scene.w)
    found = scene.run(np.broadcast_to(starts[start], scene.rotation.shape), cuts=(0, 3, 11))
    np.testing.assert_allclose(found[0], turn, rtol=0, atol=1e-5)
    np.testing.assert_allclose(found[1], shift, rtol=0, atol=1e-5)


def test_a_patch_without_extent_goes_with_its_place(scene: PatchScene) -> None:
    """All members in one point: no rotation is known, the shift still takes the point where it is."""
    scene.y[:], scene.x[:] = scene.y[0], scene.x[:, :1]
    turn, _, carried, local = scene.run()
    np.testing.assert_allclose(np.linalg.det(turn), 1.0, atol=1e-4)
    np.testing.assert_allclose(carried, scene.x, rtol=0, atol=1e-5)
    np.testing.assert_allclose(local, 0.0, atol=1e-5)


def test_what_holds_matches_the_twin_and_adds_to_the_matrix(scene: PatchScene, rng: np.random.Generator) -> None:
    carried, local = rng.normal(size=(2, *scene.x.shape))
    whole = scene.hold(carried, local, start=0.2)
    f = dense(*time_filter(np.arange(FRAMES)))
    smooth, firm = twin.smooth_places(carried, local, scene.rotation, f, SHARES)
    at = carried + np.einsum("tvab,tvb->tva", scene.rotation, local)
    np.testing.assert_allclose(whole[1], 0.7 * firm * (smooth - at), rtol=0, atol=5e-6)
    np.testing.assert_allclose(whole[0], 0.2 + 0.7 * firm[..., None] * np.eye(3), rtol=1e-5)
    for found, expected in zip(scene.hold(carried, local, start=0.2, cuts=(0, 50, 51)), whole, strict=True):
        np.testing.assert_array_equal(found, expected)


def test_what_holds_is_minus_half_the_gradient(scene: PatchScene, rng: np.random.Generator) -> None:
    """Of h |x - e|^2, e as it is: by finite differences and by Warp's autodiff (a place is three planes)."""
    carried, local = rng.normal(size=(2, *scene.x.shape))
    rhs = scene.hold(carried, local)[1]
    f, turned = dense(*time_filter(np.arange(FRAMES))), np.einsum("tvab,tvb->tva", scene.rotation, local)
    smooth, firm = twin.smooth_places(carried, local, scene.rotation, f, SHARES)
    off, weight = (carried + turned - smooth).reshape(-1, 3), 0.7 * firm.ravel()
    near = off[:VERTICES]

    def energy(move: np.ndarray) -> float:
        return float((weight[:VERTICES, None] * (near + move) ** 2).sum())

    assert_gradients_close(rhs[0], -0.5 * finite_differences(energy, np.zeros_like(near)))
    on, count = scene.device, len(off)
    move = wp.zeros(count, dtype=wp.vec3, device=on, requires_grad=True)
    loss = wp.zeros(1, dtype=wp.float32, device=on, requires_grad=True)
    planes = [put(np.repeat(np.arange(count), 3), wp.int32, on), put(np.repeat(off, 3, axis=0), wp.vec3, on)]
    planes += [put(np.tile(np.eye(3), (count, 1)), wp.vec3, on), put(np.repeat(weight, 3), wp.float32, on)]
    with wp.Tape() as tape:
        wp.launch(witness_refine.plane_pairs, 3 * count, inputs=[move, *planes, loss], device=on)
    tape.backward(loss)
    assert_gradients_close(rhs.reshape(-1, 3), -0.5 * gradient_of(move))


def test_even_motion_is_left_alone_and_a_kick_of_the_whole_is_no_noise(scene: PatchScene) -> None:
    """A body that jumps as a whole asks for nothing; one vertex that jumps in one frame is drawn back."""
    turn = np.stack([turn_about([1, 2, 3], a) for a in (0.0, 0.1, 2.0, 2.1, 0.3)])
    scene.x = np.einsum("tab,vb->tva", turn, scene.y) + [[[0, 0, 9.0 * (t == 2)]] for t in range(FRAMES)]
    scene.rotation = np.repeat(turn[:, None], VERTICES, axis=1)
    *_, carried, local = scene.run()
    assert np.abs(scene.hold(carried, local, shares=(1.0, 0.0, 0.0, 0.0))[1]).max() < 1e-4
    scene.x[2, 7] += [0.0, 0.0, 0.5]
    *_, carried, local = scene.run()
    rhs = scene.hold(carried, local, hold=1.0, shares=(1.0, 0.0, 0.0, 0.0))[1]
    assert rhs[2, 7, 2] < -0.1 and np.abs(rhs[2, 7]).max() == np.abs(rhs).max()


def test_a_course_off_by_chance_is_smoothed_and_a_kick_is_not(scene: PatchScene) -> None:
    """Where the parabola through five frames is off by k it is half believed, by a tenth of it nearly all."""
    carried = np.zeros((FRAMES, 2, 3))
    carried[2] = [[0.0, 0.0, 0.2], [0.0, 0.0, 0.02]]
    scene.rotation = np.broadcast_to(np.eye(3), (FRAMES, 2, 3, 3))
    even = time_filter(np.arange(FRAMES))[1][2, 2]
    chance = 0.2 * (1 - even)
    rhs = scene.hold(carried, np.zeros_like(carried), hold=1.0, shares=(1.0, 0.0, chance, 3.0))[1]
    given_up = np.array([0.5, 1 / 1.01])
    np.testing.assert_allclose(rhs[2, :, 2] / (carried[2, :, 2] * (even - 1)), given_up * (1 + 3 * given_up), rtol=1e-4)


def test_fairing_matches_the_twin_and_leaves_what_is_still(device: str, rng: np.random.Generator) -> None:
    sphere, faces = synthetic.icosphere(1)
    y = (sphere + rng.normal(scale=0.1, size=sphere.shape)).astype(np.float32)
    y = np.concatenate([y, [[3.0, 3.0, 3.0]]]).astype(np.float32)  # a vertex without neighbours stays
    edges, still = unique_edges(faces), rng.random(len(y)) < 0.2
    graph = mesh_graph(edges, len(y), 1.0)
    row, column, stays = (put(a, wp.int32, device) for a in (graph.row, graph.column, still))
    at = put(y, wp.vec3, device)
    out = put(np.full(y.shape, np.nan), wp.vec3, device)
    for begin, count in spans((0, 10), len(y)):
        towards_mean(begin, count, -0.53, row, column, stays, at, out)
    expected = twin.towards_mean(y.astype(np.float64), edges, -0.53, still)
    np.testing.assert_allclose(out.numpy(), expected, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(out.numpy()[still], y[still])
