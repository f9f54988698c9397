"""The direction of the one camera that saw all clouds, and the sides that it gives to normals."""

import numpy as np
import pytest

from warpdef.config import TemplateConfig
from warpdef.geometry.viewpoint import Picture, layered_share, seen_normals, viewing_direction
from warpdef.template.build import build

EYES = [(0.0, 0.0, 1.0), (1.0, 0.2, -0.3), (-0.5, -0.7, 0.5)]
AXES = np.array([1.0, 0.6, 0.4])


def whole(rng, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points of an ellipsoid and their outward normals."""
    d = rng.normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    normals = d / AXES
    return d * AXES, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def seen(eye, rng, count: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    """The part of the ellipsoid, moved away, that looks towards ``eye``, a point a pixel."""
    points, normals = whole(rng, 4 * count)
    shown = normals @ np.asarray(eye) > rng.random(len(points))
    return points[shown] + [3.0, -2.0, 5.0], normals[shown]


@pytest.mark.parametrize("eye", EYES)
def test_one_camera_is_found_and_gives_normals_their_outward_side(eye):
    rng = np.random.default_rng(0)
    eye = np.asarray(eye) / np.linalg.norm(eye)
    frames = [seen(eye, rng) for _ in range(3)]
    view = viewing_direction([points for points, _ in frames])
    assert view is not None and view @ eye > np.cos(np.deg2rad(20.0))
    for points, normals in frames:
        assert ((seen_normals(points, view, 16) * normals).sum(axis=1) > 0).mean() > 0.97


def test_a_whole_body_was_seen_by_no_single_camera():
    rng = np.random.default_rng(0)
    assert viewing_direction([whole(rng, 2000)[0] for _ in range(3)]) is None


def test_one_frame_from_all_around_is_enough_to_deny_the_camera():
    rng = np.random.default_rng(0)
    frames = [seen(EYES[0], rng)[0] for _ in range(4)]
    assert viewing_direction([*frames, whole(rng, 2000)[0]]) is None


def test_a_flat_sheet_has_no_outside():
    rng = np.random.default_rng(0)
    flat = [np.column_stack([rng.random((2000, 2)), 1e-3 * rng.normal(size=2000)]) for _ in range(3)]
    assert viewing_direction(flat) is None


def test_share_of_layers():
    """Two sheets one behind the other: half of a point's neighbours in the picture lie on the other one."""
    rng = np.random.default_rng(0)
    sheet = np.column_stack([rng.random((1000, 2)), np.zeros(1000)])
    behind = np.column_stack([rng.random((1000, 2)), np.ones(1000)])
    ahead = np.array([0.0, 0.0, 1.0])
    assert layered_share(sheet, ahead) == 0.0
    assert layered_share(np.concatenate([sheet, behind]), ahead) == pytest.approx(0.5, abs=0.05)


def test_seen_normals_are_not_repaired():
    """The field of closed bodies would turn some of a half shell's over."""
    pytest.importorskip("gpytoolbox")
    points, normals = seen(EYES[0], np.random.default_rng(0))
    built = build(points, normals, TemplateConfig(), source="seen")
    assert built.report.normals == "seen" and built.report.flipped == 0
    assert built.report.surface == "open"
    inwards = build(points, -normals, TemplateConfig(), source="seen")
    assert inwards.report.flipped == 0
    a, b, c = np.moveaxis(inwards.mesh.vertices[inwards.mesh.faces], 1, 0)
    assert np.cross(b - a, c - a)[:, 2].mean() < 0


def test_a_picture_is_contradicted_beside_its_points_and_before_them():
    x, y = np.meshgrid(np.linspace(0.0, 1.0, 21), np.linspace(0.0, 1.0, 21))
    picture = Picture.of(np.column_stack([x.ravel(), y.ravel(), np.zeros(441)]), np.array([0.0, 0.0, 1.0]))
    places = np.array([[0.5, 0.5, 0.0], [0.5, 0.5, -0.7], [0.5, 0.5, 0.6], [1.4, 0.5, -0.3]])
    which, allowed, way = picture.contradicts(places, 0.1)
    np.testing.assert_array_equal(which, [2, 3])
    np.testing.assert_allclose(allowed, [[0.5, 0.5, 0.0], [1.0, 0.5, -0.3]], atol=1e-12)
    np.testing.assert_allclose(way, [[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]], atol=1e-12)
