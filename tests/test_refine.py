"""The vertex stage: a whole round against its twin, same bits for any threads, and surfaces that are known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import reference_refine as twin
from refine_samples import AXES, MovingEllipsoid, Rounds, mean_square, units

from warpdef.config import Config
from warpdef.geometry.triangles import unique_edges


@pytest.fixture
def scene(rng: np.random.Generator) -> MovingEllipsoid:
    return MovingEllipsoid.make(4, 400, rng, subdivisions=1)


@pytest.fixture
def shaken(scene: MovingEllipsoid, rng: np.random.Generator) -> np.ndarray:
    """The scene's vertices displaced in every frame in another way."""
    return scene.posed(scene.waves(len(scene.turn), 0.03, rng))


# The round.


def test_rounds_match_the_twin(scene: MovingEllipsoid, shaken: np.ndarray, device: str) -> None:
    """Two, so that the second sees the shape and the rotations of the first; every constant off its default."""
    values: dict[str, Any] = {
        "rigidity": 0.2,
        "damping": 0.03,
        "reach": 2.5,
        "agreement": 0.4,
        "shape_smoothness": 20.0,
        "momentum": 0.6,
    }
    values |= {"clean_thickness": 8.0, "noisy_thickness": 9.0}  # clean, whatever the clouds
    run = Rounds(scene, shaken, device, 2, keyframe=2, shape_step=1.3, tolerance=1e-6, iterations_max=300, **values)
    c, edges = run.stage.config, unique_edges(scene.faces)
    x = shaken.astype(np.float32).astype(np.float64)
    y = x[2]
    rotation = twin.fit_rotations(x, y, edges)
    earlier = x
    for _ in range(2):
        (begun, rotation), earlier = twin.gone_on(x, earlier, y, rotation, edges, c), x
        x, y, rotation = twin.refine_round(begun, y, rotation, edges, scene.faces, scene.clouds, scene.normals, c)
    moved = np.abs(x - shaken).max()
    assert moved > 0.02
    np.testing.assert_allclose(run.vertices, x, rtol=0, atol=1e-4 * moved)
    np.testing.assert_allclose(run.rotation, rotation, rtol=0, atol=1e-4)
    np.testing.assert_allclose(run.rest, y, rtol=0, atol=1e-3 * np.abs(y - shaken[2]).max())
    assert run.stage.done == 2


@pytest.mark.parametrize("tie", [0.0, 1.0, 4.0])
def test_a_frame_settled_alone_matches_the_twin(
    scene: MovingEllipsoid, shaken: np.ndarray, device: str, tie: float
) -> None:
    """From its own best rotations, then tied as all frames together are; the shape stays the keyframe's."""
    limits = {"tolerance": 1e-6, "iterations_max": 300, "clean_thickness": 8.0, "noisy_thickness": 9.0}
    run = Rounds(scene, shaken, device, 0, keyframe=2, rotation_smoothness=tie, **limits)
    c, edges = run.stage.config, unique_edges(scene.faces)
    x = shaken.astype(np.float32).astype(np.float64)
    y, x = x[2], x[[3]]
    rotation = twin.fit_rotations(x, y, edges)
    for _ in range(2):
        x, _, rotation = twin.refine_round(x, y, rotation, edges, scene.faces, scene.clouds[3:], scene.normals[3:], c)
    run.stage.settle(3, 1, 2)
    p, moved = run.problem, np.abs(x - shaken[3]).max()
    assert moved > 0.02
    np.testing.assert_allclose(run.objective.placed_vertices()[3], x[0], rtol=0, atol=1e-4 * moved)
    np.testing.assert_allclose(run.stage.rotation.numpy()[3, p.place], rotation[0], rtol=0, atol=1e-4)


def test_of_an_open_sheet_frames_alone_are_not_tied(scene: MovingEllipsoid, shaken: np.ndarray, device: str) -> None:
    """Its waves would be held back; all frames together are."""
    sheet = replace(scene, faces=scene.faces[(scene.body[:, 2] < 0.1)[scene.faces].all(axis=1)])
    together = [Rounds(sheet, shaken, device, 2, rotation_smoothness=tie).vertices for tie in (0.0, 4.0)]
    assert np.abs(together[0] - together[1]).max() > 1e-3
    alone = [Rounds(sheet, shaken, device, 0, rotation_smoothness=tie) for tie in (0.0, 4.0)]
    for run in alone:
        run.stage.settle(3, 2, 3)
    free, tied = (run.objective.placed_vertices()[3] for run in alone)
    assert np.abs(free - shaken[3]).max() > 0.02
    np.testing.assert_array_equal(free, tied)


def test_the_start_takes_the_keyframes_shape_and_moves_nothing(
    scene: MovingEllipsoid, shaken: np.ndarray, device: str
) -> None:
    run = Rounds(scene, shaken, device, 0, keyframe=3)
    np.testing.assert_array_equal(run.vertices, shaken.astype(np.float32))
    np.testing.assert_array_equal(run.rest, shaken[3].astype(np.float32))
    expected = twin.fit_rotations(shaken, shaken[3], unique_edges(scene.faces))
    np.testing.assert_allclose(run.rotation, expected, rtol=0, atol=1e-4)


@pytest.mark.parametrize("seen", [None, lambda t, p: (p[:, 2] < 0.1) & ((p[:, 0] < 0) | (t % 2 == 0))])
def test_any_number_of_threads_gives_the_same_bits(rng: np.random.Generator, seen) -> None:
    """Enough vertices that the phase in which they ask all frames is several tasks as well; then open and partial."""
    scene = MovingEllipsoid.make(5, 300 if seen is None else 900, rng, subdivisions=4, seen=seen)
    if seen is not None:
        scene = replace(scene, faces=scene.faces[(scene.body[:, 2] < 0.1)[scene.faces].all(axis=1)])
    assert len(scene.body) > 2 * 1024
    bodies = np.tile(scene.body, (5, 1, 1)) + 0.01 * rng.normal(size=(5, len(scene.body), 3))
    start = scene.posed(bodies)
    runs = [Rounds(scene, start, "cpu", 4, threads=n) for n in (1, 2, 3)]
    p = runs[0].problem
    assert (p.border is not None) == (not p.measures.complete.all()) == (seen is not None)
    for run in runs[1:]:
        np.testing.assert_array_equal(run.vertices, runs[0].vertices)
        np.testing.assert_array_equal(run.rest, runs[0].rest)
        np.testing.assert_array_equal(run.rotation, runs[0].rotation)
    assert np.abs(runs[0].vertices - start).max() > 0.01


def test_preparing_and_capturing_change_nothing(scene: MovingEllipsoid, shaken: np.ndarray, device: str) -> None:
    """On CUDA the graph is the same launches; their sums come in any order."""
    runs = [
        Rounds(scene, shaken, device, 4, capture=a, prepare=b) for a, b in ((True, False), (False, False), (True, True))
    ]
    tolerance = 0 if device == "cpu" else 1e-4
    for run in runs[1:]:
        np.testing.assert_allclose(run.vertices, runs[0].vertices, rtol=0, atol=tolerance)


def test_the_vertices_keep_the_templates_order(scene: MovingEllipsoid, shaken: np.ndarray, device: str, rng) -> None:
    """Another numbering of the same mesh ends at the same places."""
    order = rng.permutation(len(scene.body))
    other = replace(scene, faces=np.argsort(order)[scene.faces].astype(np.int32))
    found = Rounds(other, shaken[:, order], device, 3).vertices
    np.testing.assert_allclose(found, Rounds(scene, shaken, device, 3).vertices[:, order], rtol=0, atol=1e-4)


# What it is for.


def test_smooth_noise_is_taken_back_to_the_surface(device: str, rng: np.random.Generator) -> None:
    """At most a tenth of the displacement is left, beside what is left of none.

    Where the stage comes to rest, a displacement e of a wave with eigenvalue mu of L is held by the shape with
    rigidity mu e, and drawn back by planes of weight a at each vertex: rigidity mu / (a + rigidity mu) of it is left.
    a: the pairs of a vertex, its own and 500 / 162 that ask for it, times exp(-(d / reach)^2), above 0.7 for d of twice
    the noise and a reach of three spacings, 0.11; so a > 2.8. mu: on a sphere 1.5 h^2 l (l + 1) = 0.8 for the waves
    here, l = 2, and edges of h = 0.3; below 2 with all that is uneven. 0.1 * 2 / (2.8 + 0.1 * 2) < 0.07.
    """
    scene = MovingEllipsoid.make(5, 500, rng)
    start = scene.posed(scene.waves(5, 0.03, rng))
    before, after, floor = (
        mean_square(scene.off_surface(v), axis=1)
        for v in (
            start,
            Rounds(scene, start, device, 20, keyframe=2).vertices,
            Rounds(scene, scene.vertices, device, 20).vertices,
        )
    )
    assert (floor < 0.1 * before).all(), f"{floor} of {before}"
    assert (after < 0.1 * before + floor).all(), f"{after}, before {before}, floor {floor}"


def test_the_frames_fill_in_one_shape(device: str, rng: np.random.Generator) -> None:
    """A template squashed across; odd frames see one end only, even ones the other: what one misses, the others know.

    Without the common shape's step what is unseen gets what reaches over the rim, and the shape stays as it was.
    Time is off, through which frames tell each other as well.
    """
    ends = [lambda p: p[:, 0] < 0.05, lambda p: p[:, 0] > -0.05]
    scene = MovingEllipsoid.make(6, 600, rng, seen=lambda t, p: ends[t % 2](p))
    _, y, z = (scene.body / AXES).T
    wrong = scene.body + 0.04 * (y * y - z * z)[:, None] * scene.axis
    start = scene.posed(np.tile(wrong, (6, 1, 1)))
    unseen = np.stack([~ends[t % 2](scene.body) & (np.abs(scene.body[:, 0]) > 0.2) for t in range(6)])
    steps = (0.0, Config().refine.shape_step)
    runs = [Rounds(scene, start, device, 20, keyframe=2, shape_step=s, time=0.0) for s in steps]
    before, alone, together = (
        mean_square(scene.off_surface(v)[unseen]) for v in (start, *(run.vertices for run in runs))
    )
    assert alone > 0.25 * before and together < 0.25 * alone, f"{before} before, {alone} alone, {together} together"
    np.testing.assert_array_equal(runs[0].rest, start[2].astype(np.float32))
    shapes = [shape_error(scene, run.rest) for run in runs]
    assert shapes[1] < 0.25 * shapes[0], f"{shapes[1]} of {shapes[0]}"


def shape_error(scene: MovingEllipsoid, rest: np.ndarray) -> float:
    """Distance of a rest shape to the ellipsoid, wherever it lies: it is moved rigidly onto the true vertices first."""
    a, b = (v - v.mean(axis=0) for v in (rest.astype(np.float64), scene.body))
    turn = twin.nearest_rotation(b.T @ a)
    placed = a @ turn.T + scene.body.mean(axis=0)
    upright = replace(scene, turn=np.eye(3)[None], shift=np.zeros((1, 3)))
    return float(mean_square(upright.off_surface(placed[None])))


def test_a_true_start_stays_and_is_rigid(scene: MovingEllipsoid, device: str) -> None:
    """The surface is exact and the motion rigid: next to nothing is left to do, and R is the true turn."""
    run = Rounds(scene, scene.vertices, device, 10, keyframe=0)
    np.testing.assert_allclose(run.rotation, np.repeat(scene.turn[:, None], len(scene.body), axis=1), rtol=0, atol=0.05)
    edge = np.linalg.norm(np.subtract(*scene.body[unique_edges(scene.faces).T]), axis=1).mean()
    assert mean_square(scene.off_surface(run.vertices)) < 0.03 * edge


# Sides.


def test_normals_of_unknown_side_get_the_meshs(scene: MovingEllipsoid, shaken: np.ndarray, device: str, rng) -> None:
    """Frames 0 and 2 come with sides by chance. Turned right, they are the normals that were given."""
    known = [False, True, False, True]
    sides = [
        np.ones(len(n)) if k else rng.choice([-1.0, 1.0], len(n)) for n, k in zip(scene.normals, known, strict=True)
    ]
    mixed = [n * s[:, None] for n, s in zip(scene.normals, sides, strict=True)]
    run = Rounds(scene, shaken, device, 3, normals=mixed, oriented=known)
    expected = Rounds(scene, shaken, device, 3)
    np.testing.assert_array_equal(run.problem.normals.numpy(), expected.problem.normals.numpy())
    np.testing.assert_allclose(run.vertices, expected.vertices, rtol=0, atol=0 if device == "cpu" else 1e-4)


def test_given_sides_are_doubted_only_where_many_oppose_the_mesh(
    scene: MovingEllipsoid, shaken: np.ndarray, device: str
) -> None:
    """Frame 1 has every tenth normal turned over, frame 2 all of them, frame 3 a single one: contact, as it may be."""
    turned = [n.copy() for n in scene.normals]
    turned[1][::10] *= -1.0
    turned[2] *= -1.0
    turned[3][7] *= -1.0
    assert 1 / len(turned[3]) < 0.01
    p = Rounds(scene, shaken, device, 0, normals=turned).problem
    found = np.split(p.normals.numpy(), p.cloud_offsets[1:-1])
    right = Rounds(scene, shaken, device, 0).problem
    expected = np.split(right.normals.numpy(), right.cloud_offsets[1:-1])
    for frame in (0, 1, 2):
        np.testing.assert_array_equal(found[frame], expected[frame])
    assert int((found[3] != expected[3]).any(axis=1).sum()) == 1


# Degenerate input.


def test_two_frames(device: str, rng: np.random.Generator) -> None:
    scene = MovingEllipsoid.make(2, 500, rng)
    start = scene.posed(scene.waves(2, 0.03, rng))
    found = Rounds(scene, start, device, 20, keyframe=0).vertices
    before, after = (mean_square(scene.off_surface(v), axis=1) for v in (start, found))
    assert (after < 0.5 * before).all()


def test_a_vertex_without_edges_stays(scene: MovingEllipsoid, shaken: np.ndarray, device: str) -> None:
    """It has no normal, hence no partner; nothing holds it, nothing pulls it, and the others do not notice."""
    lonely = np.concatenate([shaken, np.tile([0.1, 0.9, 0.2], (4, 1, 1))], axis=1)
    run = Rounds(scene, lonely, device, 5)
    assert np.isfinite(run.vertices).all() and np.isfinite(run.rest).all()
    np.testing.assert_array_equal(run.vertices[:, -1], lonely[:, -1].astype(np.float32))
    np.testing.assert_array_equal(run.rotation[:, -1], np.tile(np.eye(3), (4, 1, 1)))
    np.testing.assert_allclose(run.vertices[:, :-1], Rounds(scene, shaken, device, 5).vertices, rtol=0, atol=1e-4)


def test_vertices_in_one_place_stay_finite(scene: MovingEllipsoid, device: str) -> None:
    """A template that has shrunk to a point, and clouds far out of reach."""
    start = np.tile(scene.vertices[:, :1], (1, len(scene.body), 1))
    run = Rounds(scene, start, device, 5, reach=1e-3)
    for found in (run.vertices, run.rest, run.rotation):
        assert np.isfinite(found).all()


def test_the_spacing_is_each_frames_own(rng: np.random.Generator) -> None:
    sparse, dense = MovingEllipsoid.make(2, 60, rng), MovingEllipsoid.make(2, 500, rng)
    mixed = replace(sparse, clouds=[sparse.clouds[0], dense.clouds[1]], normals=[sparse.normals[0], dense.normals[1]])
    found = Rounds(mixed, mixed.vertices, "cpu", 0).problem.measures.spacing
    np.testing.assert_allclose(found, [twin.spacing(c) for c in mixed.clouds], rtol=1e-5)
    assert found[0] > 2 * found[1]


def test_normals_of_noisy_clouds_say_nothing(scene: MovingEllipsoid, shaken: np.ndarray, device: str, rng) -> None:
    """Leaning by 78 degrees they are left out where clouds are clean; in noise the mesh's own normals are enough."""
    across = [np.cross(n, rng.normal(size=n.shape)) for n in scene.normals]
    leaning = [0.2 * n + np.sqrt(0.96) * units(a) for n, a in zip(scene.normals, across, strict=True)]
    left = []
    for clean, noisy in ((8.0, 9.0), (1e-4, 2e-4)):
        limits: dict[str, Any] = {"clean_thickness": clean, "noisy_thickness": noisy, "agreement": 0.8}
        run = Rounds(scene, shaken, device, 3, normals=leaning, rigidity=0.1, rigidity_noisy=0.1, **limits)
        left.append(mean_square(scene.off_surface(run.vertices)))
    assert left[1] < 0.5 * left[0]


def test_noisy_clouds_make_the_stage_stiffer(device: str, rng: np.random.Generator) -> None:
    """Thickness grows with noise; rigidity goes from the clean to the noisy value by the logarithm, and is capped."""
    scene = MovingEllipsoid.make(3, 1500, rng, subdivisions=1)
    found = []
    for noise in (0.0, 0.006, 0.012, 0.4):
        clouds = [c + rng.normal(size=c.shape) * noise for c in scene.clouds]
        found.append(Rounds(replace(scene, clouds=clouds), scene.vertices, device, 0).stage)
    thickness = [stage.problem.measures.thickness for stage in found]
    assert thickness == sorted(thickness) and thickness[0] < 0.3 < thickness[2]
    assert found[0].noise == 0.0 and found[0].rigidity == found[0].config.rigidity
    assert 0.0 < found[2].noise < found[3].noise == 1.25
    c = found[2].config
    middle = (thickness[2] - c.clean_thickness) / (c.noisy_thickness - c.clean_thickness)
    assert np.log(found[2].rigidity / c.rigidity) == pytest.approx(middle * np.log(c.rigidity_noisy / c.rigidity))
    assert found[3].rigidity == pytest.approx(c.rigidity * (c.rigidity_noisy / c.rigidity) ** 1.25)
