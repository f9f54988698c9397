"""A result's motion on other geometry: landing on the mesh, going rigidly, following the grids, bad input."""

from __future__ import annotations

import numpy as np
import pytest
import reference
from synthetic import bending_bar, turn_about

from warpdef.config import Config
from warpdef.errors import InputError
from warpdef.motion.attach import attach
from warpdef.motion.deform import deform
from warpdef.motion.grid_motion import GridMotion
from warpdef.result import Reconstruction
from warpdef.sequence import Similarity

FRAMES, KEYFRAME, LEVELS = 5, 2, [1, 2, 3]
BAR = bending_bar(FRAMES, 20, np.random.default_rng(0), subdivisions=2)
VERTICES, FACES = BAR.vertices.astype(np.float32), BAR.faces
INTO = Similarity(np.array([0.1, -0.2, 0.3]), 0.6)
NODES = sum((2 * level - 1) ** 3 for level in LEVELS)


def motion(nodes: np.ndarray | None = None, **others) -> GridMotion:
    nodes = np.zeros((FRAMES - 1, NODES, 8)) if nodes is None else nodes
    return GridMotion.from_nodes(nodes, (1, 3), KEYFRAME, INTO, **others)


def some_nodes(seed: int = 0) -> np.ndarray:
    nodes = np.random.default_rng(seed).normal(scale=0.05, size=(FRAMES - 1, NODES, 8)).astype(np.float32)
    nodes[..., 6:] = 0.0
    return nodes


def on_surface(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points of the keyframe's surface, and where the triangles take them."""
    rng = np.random.default_rng(1)
    face, corner = rng.integers(0, len(FACES), count), rng.dirichlet([1, 1, 1], count)
    places = np.einsum("nc,tnci->tni", corner, VERTICES.astype(np.float64)[:, FACES[face]])
    return places[KEYFRAME], places


def test_the_chain_is_that_of_the_twin():
    nodes, points = some_nodes(), np.random.default_rng(2).uniform(-0.8, 0.8, (40, 3))
    kept = motion(nodes)
    stored = np.moveaxis(kept.nodes * kept.step, 1, -1)
    # Half a step, and float32's own rounding of the values.
    assert np.abs(stored - nodes[..., :6]).max() <= 0.5 * kept.step + 1e-7 * np.abs(nodes).max()
    placed = kept.carry(points)
    expected = {KEYFRAME: INTO.to_cube(points)}
    for target, source, s in ((3, 2, 2), (4, 3, 3), (1, 2, 1), (0, 1, 0)):
        expected[target] = reference.move(stored[s], reference.resolutions(1, 3), expected[source])
    for t, places in expected.items():
        np.testing.assert_allclose(INTO.to_cube(placed[t]), places, atol=2e-6)
    np.testing.assert_array_equal(placed[KEYFRAME], points)


def test_vertices_of_the_mesh_become_those_of_the_result():
    moved = deform(VERTICES[KEYFRAME], VERTICES, FACES, motion(some_nodes()))
    np.testing.assert_array_equal(moved.points.astype(np.float32), VERTICES)
    assert not moved.distance.any()


def test_points_of_the_surface_stay_on_it():
    start, places = on_surface(200)
    moved = deform(start, VERTICES, FACES, motion(some_nodes()))
    np.testing.assert_allclose(moved.points, places, atol=1e-6)
    np.testing.assert_allclose(moved.points[KEYFRAME], start, atol=1e-14)


def test_a_rigid_motion_takes_everything_along():
    rotations = [turn_about(np.array([1.0, 2.0, 0.5]), 0.9 * (t - KEYFRAME)) for t in range(FRAMES)]
    shifts = np.random.default_rng(3).normal(size=(FRAMES, 3))
    shifts[KEYFRAME] = 0.0
    rest = BAR.vertices[0]
    meshes = np.stack([rest @ r.T + s for r, s in zip(rotations, shifts, strict=True)])
    # Near the surface, by the mesh alone: no grid knows of this motion.
    side = np.ptp(rest, axis=0).max()
    outward = rest - rest.mean(axis=0)
    near = rest + 0.015 * side * outward / np.linalg.norm(outward, axis=1, keepdims=True)
    moved = deform(near, meshes, FACES, motion())
    for t in range(FRAMES):
        np.testing.assert_allclose(moved.points[t], near @ rotations[t].T + shifts[t], atol=1e-6)
        np.testing.assert_allclose(moved.turned(outward)[t], outward @ rotations[t].T, atol=1e-5)


def test_far_points_go_with_the_grids():
    nodes = some_nodes()
    kept = motion(nodes)
    # A mesh that is where the grids put it: nothing is added to them.
    meshes = kept.carry(VERTICES[KEYFRAME].astype(np.float64))
    far = np.array([[0.1, 0.9, 0.3], [0.1, -0.9, 0.8]])
    moved = deform(far, meshes, FACES, kept)
    np.testing.assert_allclose(moved.points, kept.carry(far), atol=1e-5)


def test_nothing_tears_off_the_surface():
    """Neighbours stay neighbours, from the surface outwards and around it."""
    kept, rng = motion(some_nodes()), np.random.default_rng(4)
    start = rng.uniform(-1.0, 1.0, (2000, 3))
    step = 1e-4 * rng.normal(size=start.shape)
    there, beside = (deform(p, VERTICES, FACES, kept).points for p in (start, start + step))
    stretch = np.linalg.norm(beside - there, axis=2) / np.linalg.norm(step, axis=1)
    assert stretch.max() < 30.0


def test_weights_of_an_attachment():
    points = np.random.default_rng(5).uniform(-1.2, 1.2, (300, 3))
    held = attach(points, VERTICES[KEYFRAME], FACES)
    np.testing.assert_allclose(held.weights.sum(axis=1), 1.0, atol=1e-12)
    assert held.weights.min() >= 0.0
    np.testing.assert_allclose(held.spread.sum(axis=1), 1.0 - held.on, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(points - held.foot, axis=1), held.distance, atol=1e-12)
    assert {0.0, 1.0} <= {*held.on.tolist(), attach(held.foot, VERTICES[KEYFRAME], FACES).on.min()}


def test_frames_without_points_are_in_between():
    nodes = some_nodes()[:2]
    kept = GridMotion.from_nodes(nodes, (1, 3), 2, INTO, (0, 2, 4), FRAMES)
    placed = kept.carry(np.array([[0.2, 0.1, 0.0]]))
    np.testing.assert_allclose(placed[3], (placed[2] + placed[4]) / 2)
    moved = deform(VERTICES[2], VERTICES, FACES, kept)
    np.testing.assert_array_equal(moved.points.astype(np.float32), VERTICES)


def test_a_motion_is_stored_and_read():
    kept = motion(some_nodes())
    again = GridMotion.from_arrays(kept.arrays())
    np.testing.assert_array_equal(again.carry(VERTICES[2]), kept.carry(VERTICES[2]))
    assert again.frames == (0, 1, 2, 3, 4) and len(again) == FRAMES


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"nodes": np.zeros((4, 6, 7), dtype=np.int16)}, "expected int16 of shape"),
        ({"nodes": np.zeros((4, 6, NODES), dtype=np.float32)}, "expected int16 of shape"),
        ({"step": np.float64(0.0)}, "a step and a scale above 0"),
        ({"scale": np.float64(np.nan)}, "a step and a scale above 0"),
        ({"centre": np.zeros(2)}, "a finite centre"),
        ({"frames": np.array([0, 1, 2, 4, 4])}, "different frames"),
        ({"frames": np.array([0, 1, 2, 3])}, "expected 5 different frames"),
        ({"keyframe": np.array(7)}, "the keyframe among them"),
        ({"frame_count": np.array(4)}, "below 4"),
        ({"levels": np.array([1])}, "something is missing"),
        ({"frames": None}, "something is missing"),
    ],
)
def test_damaged_motions(changes, message):
    arrays = {name: array for name, array in (motion().arrays() | changes).items() if array is not None}
    with pytest.raises(InputError, match=message):
        GridMotion.from_arrays(arrays)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((3, 2)), r"shape \(N, 3\)"),
        (np.zeros((0, 3)), "at least one point"),
        (np.array([[0.0, 0.0, 0.0], [0.0, np.nan, 0.0]]), "in point 1"),
    ],
)
def test_points_that_cannot_be_moved(points, message):
    with pytest.raises(InputError, match=message):
        deform(points, VERTICES, FACES, motion())


def test_a_motion_of_other_frames():
    with pytest.raises(InputError, match="expected 4 frames as the result has, got 5"):
        deform(VERTICES[0], VERTICES[:4], FACES, motion())


def test_from_python():
    result = Reconstruction(VERTICES, FACES, KEYFRAME, Config(), motion=motion(some_nodes()))
    start, places = on_surface(20)
    np.testing.assert_allclose(result.deform(start), places, atol=1e-6)
    times = [0.0, 1.5, 4.0]
    np.testing.assert_allclose(result.deform(VERTICES[KEYFRAME], times), result.at(times), atol=1e-6)
    with pytest.raises(InputError, match="reconstruct again"):
        Reconstruction(VERTICES, FACES, KEYFRAME, Config()).deform(start)
