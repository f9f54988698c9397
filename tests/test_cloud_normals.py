"""Normals: exact on known shapes, all on the outer side, and given ones repaired only where clearly wrong."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import sample_surface

from warpdef.geometry import cloud_normals
from warpdef.geometry.cloud_normals import _confirmed, estimate_normals, repair_normals
from warpdef.geometry.cloud_planes import Neighbourhood, pca_normals
from warpdef.geometry.curl_free import CurlFreeField


def sphere(rng: np.random.Generator, count: int = 1500) -> np.ndarray:
    x = rng.normal(size=(count, 3))
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def clamp(rng: np.random.Generator, count: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    """An extruded U, two close arms on a base with sharp edges: points and true normals."""
    outline = np.array(
        [[-0.3, 0], [0.3, 0], [0.3, 1], [0.1, 1], [0.1, 0.2], [-0.1, 0.2], [-0.1, 1], [-0.3, 1]], dtype=np.float64
    )
    low, high = (np.column_stack([outline, np.full(8, z)]) for z in (-0.4, 0.4))
    vertices = np.concatenate([low, high])
    faces = []
    for i in range(8):
        j = (i + 1) % 8
        faces += [(i, j, j + 8), (i, j + 8, i + 8)]
    for a, b, c, d in ((0, 5, 6, 7), (0, 1, 4, 5), (1, 2, 3, 4)):
        faces += [(a, c, b), (a, d, c), (a + 8, b + 8, c + 8), (a + 8, c + 8, d + 8)]
    return sample_surface(vertices, np.array(faces), count, rng)


def wrong_share(normals: np.ndarray, truth: np.ndarray) -> float:
    return float(((normals * truth).sum(axis=1) < 0).mean())


def test_pca_normals_of_a_plane_are_its_normal_up_to_sign(rng):
    points = np.column_stack([rng.uniform(-1, 1, (200, 2)), np.zeros(200)])
    normals = pca_normals(points)
    np.testing.assert_allclose(np.abs(normals), np.tile([0.0, 0.0, 1.0], (200, 1)), atol=1e-9)


def test_pca_normals_take_no_more_neighbours_than_there_are(rng):
    normals = pca_normals(sphere(rng, 10), neighbours=16)
    assert normals.shape == (10, 3)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)


def test_all_normals_of_a_sphere_point_outwards(rng):
    points = sphere(rng)
    normals = estimate_normals(points)
    assert normals.shape == points.shape
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)
    cosine = (normals * points).sum(axis=1)
    assert cosine.min() > 0.9


def test_scale_and_place_do_not_matter(rng):
    points = sphere(rng)
    moved = estimate_normals(1e4 * points + [1e6, -1e6, 0.0])
    np.testing.assert_allclose(moved, estimate_normals(points), atol=1e-4)


def test_close_arms_with_sharp_edges_keep_their_sides(rng):
    points, truth = clamp(rng)
    assert wrong_share(estimate_normals(points), truth) < 0.005


def test_noise_of_one_percent_of_the_diagonal_turns_few_normals_over(rng):
    points = sphere(rng, 3000)
    noisy = points + rng.normal(size=points.shape) * 0.01 * np.sqrt(12)
    assert wrong_share(estimate_normals(noisy), points) < 0.005


def test_two_bodies_are_both_oriented(rng):
    one = sphere(rng)
    points = np.concatenate([one, 0.3 * one + [2.0, 0, 0]])
    assert wrong_share(estimate_normals(points), np.concatenate([one, one])) == 0


def test_the_same_points_give_the_same_bytes(rng):
    points, _ = clamp(rng)
    assert estimate_normals(points).tobytes() == estimate_normals(points.copy()).tobytes()


def test_true_normals_are_left_alone(rng):
    points, truth = clamp(rng)
    repaired, flipped = repair_normals(points, truth)
    assert flipped == 0
    np.testing.assert_array_equal(repaired, truth)


def test_an_inside_out_cloud_is_turned_as_a_whole(rng):
    points, truth = clamp(rng)
    repaired, flipped = repair_normals(points, -truth)
    assert flipped == len(points)
    np.testing.assert_array_equal(repaired, truth)


def test_a_flipped_region_and_scattered_flips_are_repaired_without_touching_the_input(rng):
    points, truth = clamp(rng)
    given = truth.copy()
    given[points[:, 1] > 0.8] *= -1
    scattered = rng.choice(len(points), 60, replace=False)
    given[scattered] *= -1
    before = given.copy()
    repaired, flipped = repair_normals(points, given)
    wrong = wrong_share(given, truth)
    assert wrong > 0.1
    assert abs(flipped / len(points) - wrong) < 0.01
    assert wrong_share(repaired, truth) < 0.01
    np.testing.assert_array_equal(given, before)


def test_only_right_normals_of_a_whole_body_are_confirmed_by_their_indicator(rng):
    points, truth = clamp(rng)

    def confirmed(points: np.ndarray, normals: np.ndarray) -> bool:
        near = Neighbourhood.of(points, 16)
        return _confirmed(near, CurlFreeField(near.points, near.spacing), normals)

    assert confirmed(points, truth)
    assert not confirmed(points, -truth)
    patch = np.linalg.norm(points - points[0], axis=1).argsort()[:60]
    turned = truth.copy()
    turned[patch] *= -1
    assert not confirmed(points, turned)
    front = points[:, 2] > 0.0
    assert not confirmed(points[front], truth[front])


def test_single_normals_turned_over_are_found_where_the_rest_is_confirmed(rng):
    points, truth = clamp(rng)
    given = truth.copy()
    given[[5, 300, 2000]] *= -1
    near = Neighbourhood.of(points, 16)
    assert _confirmed(near, CurlFreeField(near.points, near.spacing), given)
    repaired, flipped = repair_normals(points, given)
    assert flipped == 3
    np.testing.assert_array_equal(repaired, truth)


def test_some_points_of_a_large_cloud_tell_the_sides_of_all(rng, monkeypatch):
    asked = []
    of_few = Neighbourhood.of

    def noted(points: np.ndarray, neighbours: int) -> Neighbourhood:
        asked.append(len(points))
        return of_few(points, neighbours)

    monkeypatch.setattr(Neighbourhood, "of", noted)
    monkeypatch.setattr(cloud_normals, "SIDED", 4000)
    points, truth = clamp(rng, 12_000)
    assert wrong_share(estimate_normals(points), truth) < 0.01
    assert asked == [4000, 12_000]
    given = truth.copy()
    single = rng.random(len(truth)) < 0.01
    given[single] *= -1.0
    fixed, count = repair_normals(points, given)
    assert asked[2:] == [4000, 12_000]
    assert 0.95 * single.sum() <= count <= single.sum()
    assert wrong_share(fixed, truth) < 0.1 * single.mean()
    assert repair_normals(points, truth)[1] == 0


def test_indicator_and_its_transpose_agree(rng):
    field = CurlFreeField(sphere(rng, 300), 0.2)
    normals, charges = rng.normal(size=(300, 3)), rng.normal(size=300)
    left = field.indicator(normals) @ charges
    right = (normals * field.indicator_adjoint(charges)).sum()
    assert left == pytest.approx(right, rel=1e-4)


def test_indicator_of_a_closed_surface_is_one_half_on_it(rng):
    points = sphere(rng, 20000)
    cell = 0.05
    field = CurlFreeField(points, cell)
    # The grid counts in cells: an area of so many cells squared belongs to each point.
    area = 4 * np.pi / len(points) / cell**2
    assert np.median(field.indicator(area * points)) == pytest.approx(0.5, abs=0.03)


def test_project_keeps_a_gradient_field_and_drops_a_swirl(rng):
    points = sphere(rng, 5000)
    field = CurlFreeField(points, 0.1)
    swirl = np.cross([0.0, 0.0, 1.0], points)
    kept = np.linalg.norm(field.project(points), axis=1).mean()
    dropped = np.linalg.norm(field.project(swirl), axis=1).mean()
    assert kept > 5 * dropped


def test_the_wild_frame_with_given_normals_flipped_in_part(shared_data):
    data = np.load(shared_data / "crane_clouds" / "points.npz")
    _, flipped = repair_normals(data["points"][12], data["normals"][12])
    assert 0.08 * 5000 < flipped < 0.12 * 5000


def test_a_flat_open_sheet_gets_one_side(rng):
    x = rng.uniform(-1, 1, (1200, 2))
    points = np.column_stack([x, 0.15 * np.sin(3 * x[:, 0])])
    up = estimate_normals(points)[:, 2] > 0
    assert up.mean() > 0.99 or up.mean() < 0.01
