"""Sampling: uniform by area, repeatable, noise of the promised size, the promised normals."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from present import present

from warpdef.errors import InputError
from warpdef.geometry.sampling import sample_surface, spread_evenly
from warpdef.mesh import MeshSequence, TriMesh
from warpdef.truth.sample import sample_sequence

# Two right triangles in the plane z = 0, of areas 1/2 and 3/2, and one without area.
VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [8, 0, 0], [5, 1, 0]], dtype=float)
FACES = np.array([[0, 0, 1], [0, 1, 2], [3, 5, 4], [3, 3, 3]])


def cube(scale: float = 1.0) -> TriMesh:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float) * scale
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return TriMesh(corners, np.array(faces))


def moving_cube() -> MeshSequence:
    mesh = cube()
    return MeshSequence(np.stack([mesh.vertices, mesh.vertices + 1.0, mesh.vertices * 2.0]), mesh.faces)


def test_samples_are_uniform_by_area(rng: np.random.Generator) -> None:
    points, normals, face, barycentric = sample_surface(VERTICES, FACES, 40_000, rng)
    assert points.dtype == np.float64
    assert set(np.unique(face)) == {1, 2}  # never a face without area
    assert abs(np.mean(face == 2) - 0.75) < 5.0 * np.sqrt(0.75 * 0.25 / 40_000)
    inside = points[face == 1]
    # Uniform in the unit triangle: mean 1/3, variance 1/18 in each coordinate.
    np.testing.assert_allclose(inside[:, :2].mean(axis=0), 1 / 3, atol=5.0 * np.sqrt(1 / 18 / len(inside)))
    np.testing.assert_allclose(inside[:, :2].var(axis=0), 1 / 18, rtol=0.05)
    np.testing.assert_array_equal(normals[face == 1], [[0.0, 0.0, 1.0]] * len(inside))
    np.testing.assert_array_equal(normals[face == 2, 2], -1.0)
    assert barycentric.min() >= 0.0
    np.testing.assert_allclose(barycentric.sum(axis=1), 1.0)
    np.testing.assert_allclose(np.einsum("nk,nki->ni", barycentric, VERTICES[FACES[face]]), points, atol=1e-12)


def test_a_surface_without_area_is_refused(rng: np.random.Generator) -> None:
    with pytest.raises(InputError, match="degenerate"):
        sample_surface(VERTICES, FACES[[0, 3]], 10, rng)


def test_no_points_are_refused(rng: np.random.Generator) -> None:
    with pytest.raises(InputError, match="at least 1 point, got 0"):
        sample_surface(VERTICES, FACES, 0, rng)


def test_a_sequence_has_independent_repeatable_frames() -> None:
    truth = moving_cube()
    first, again, other = (sample_sequence(truth, 50, seed=seed) for seed in (3, 3, 4))
    assert len(first) == 3
    for frame in range(3):
        assert first.points[frame].shape == (50, 3)
        np.testing.assert_array_equal(first.points[frame], again.points[frame])
        assert not np.array_equal(first.points[frame], other.points[frame])
    # Frame 1 is frame 0 moved by 1: the same draws would show the same points.
    assert not np.allclose(first.points[1] - 1.0, first.points[0])
    listed = sample_sequence([truth[0], truth[1], truth[2]], 50, seed=3)
    np.testing.assert_array_equal(listed.points[2], first.points[2])


def test_noise_is_a_fraction_of_each_frames_own_diagonal() -> None:
    truth = moving_cube()
    clean, noisy = (sample_sequence(truth, 4_000, noise=noise, normals="none") for noise in (0.0, 0.02))
    for frame, diagonal in enumerate(np.sqrt(3.0) * np.array([1.0, 1.0, 2.0])):
        error = noisy.points[frame] - clean.points[frame]
        np.testing.assert_allclose(error.std(axis=0), 0.02 * diagonal, rtol=0.06)


def test_clean_clouds_have_the_faces_normals() -> None:
    normals = sample_sequence(moving_cube(), 200).normals[0]
    assert normals is not None
    np.testing.assert_allclose(np.sort(np.abs(normals), axis=1), [[0.0, 0.0, 1.0]] * 200)


@pytest.mark.parametrize(("noise", "normals"), [(0.001, "auto"), (0.0, "estimated")])
def test_normals_are_estimated_from_the_cloud(noise: float, normals: Literal["auto", "estimated"]) -> None:
    from warpdef.geometry.cloud_normals import estimate_normals

    cloud = sample_sequence(moving_cube(), 300, noise=noise, normals=normals)
    np.testing.assert_allclose(present(cloud.normals[1]), estimate_normals(cloud.points[1], neighbours=16))
    assert np.abs(present(cloud.normals[1])).max(axis=1).min() < 1.0 - 1e-6  # not the faces' own


def test_true_normals_may_be_kept_under_noise_and_left_out() -> None:
    noisy = sample_sequence(moving_cube(), 200, noise=0.01, normals="true").normals[0]
    assert noisy is not None
    np.testing.assert_allclose(np.abs(noisy).max(axis=1), 1.0)
    assert sample_sequence(moving_cube(), 200, normals="none").normals == (None, None, None)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"points": 9}, "at least 10 points a frame, got 9"),
        ({"points": 20, "noise": -0.1}, "--noise"),
        ({"points": 20, "noise": float("nan")}, "--noise"),
        ({"points": 20, "seed": -1}, "--seed"),
        ({"points": 20, "normals": "some"}, "auto, true, estimated or none"),
    ],
)
def test_bad_arguments_are_refused(arguments: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        sample_sequence(moving_cube(), **arguments)


def test_a_frame_without_area_is_named() -> None:
    flat = TriMesh(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    with pytest.raises(InputError, match="frame 1: .*degenerate"):
        sample_sequence([cube(), flat], 20)


def test_one_frame_is_refused() -> None:
    with pytest.raises(InputError, match="at least 2 frames"):
        sample_sequence([cube()], 20)


def test_points_are_spread_evenly_whatever_their_density(rng: np.random.Generator) -> None:
    """A square, one half of which has 20 times the points of the other."""
    dense, sparse = rng.random((20000, 2)) * [0.5, 1.0], rng.random((1000, 2)) * [0.5, 1.0] + [0.5, 0.0]
    points = np.column_stack([np.concatenate([dense, sparse]), np.zeros(21000)])
    chosen = spread_evenly(points, 500)
    assert 400 <= len(chosen) <= 500 and len(np.unique(chosen)) == len(chosen)
    np.testing.assert_array_equal(chosen, np.sort(chosen))
    np.testing.assert_array_equal(chosen, spread_evenly(points, 500))
    share = (points[chosen, 0] < 0.5).mean()
    assert 0.4 < share < 0.6
    nearest = np.sort(np.linalg.norm(points[chosen, None, :2] - points[chosen, :2], axis=2), axis=1)[:, 1]
    # On a square 500 points stand 1 / sqrt(500) apart; drawn by chance from all, a fifth are five times as close.
    assert nearest.mean() > 0.5 / np.sqrt(500)
    np.testing.assert_array_equal(spread_evenly(points[:10], 10), np.arange(10))
    assert len(spread_evenly(np.zeros((50, 3)), 10)) >= 1


@pytest.mark.parametrize("count", [1, 2, 7, 99])
@pytest.mark.parametrize("shape", ["surface", "line", "point", "far away", "huge", "tiny", "one stray"])
def test_as_many_points_as_asked_for_at_most(shape: str, count: int, rng: np.random.Generator) -> None:
    points = rng.random((300, 3)) * [1.0, 1.0, 0.0]
    points = {
        "surface": points,
        "line": points * [1.0, 0.0, 0.0],
        "point": points * 0.0,
        "far away": points + 1e6,
        "huge": points * 1e8,
        "tiny": points * 1e-12,
        "one stray": np.concatenate([points, [[1e4, 0.0, 0.0]]]),
    }[shape]
    chosen = spread_evenly(points, count)
    assert 1 <= len(chosen) <= count and len(np.unique(chosen)) == len(chosen)
    assert chosen.min() >= 0 and chosen.max() < len(points)
    if count == 99 and shape in ("surface", "far away", "huge", "tiny"):  # fewer voxels than that cannot be told apart
        assert len(chosen) >= 0.7 * count
