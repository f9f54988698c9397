"""The direction of the one camera that saw all clouds, and the sides that it gives to normals."""

import numpy as np
import pytest

from warpdef.config import TemplateConfig
from warpdef.geometry.viewpoint import Picture, camera_place, layered_share, seen_normals, viewing_direction
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
    """A square of 1, seen from 2 above its middle: what is nearer to the eye covers more of it."""
    x, y = np.meshgrid(np.linspace(0.0, 1.0, 21), np.linspace(0.0, 1.0, 21))
    eye = np.array([0.5, 0.5, 2.0])
    picture = Picture.of(np.column_stack([x.ravel(), y.ravel(), np.zeros(441)]), eye)
    places = np.array([[0.5, 0.5, 0.0], [0.5, 0.5, -0.7], [0.5, 0.5, 0.6], [1.4, 0.5, -0.3], [1.6, 0.5, 0.0]])
    which, allowed, way = picture.contradicts(places, 0.1)
    np.testing.assert_array_equal(which, [2, 3, 4])
    # Behind the square by half of the room; what is behind it already, to its rim: at a depth of 2.3 that is
    # 0.5 x 2.3 / 2 from the middle.
    expected = [[0.5, 0.5, -0.05], [1.075, 0.5, -0.3], [0.5 + 0.5 * 2.05 / 2.0, 0.5, -0.05]]
    np.testing.assert_allclose(allowed, expected, atol=1e-12)
    np.testing.assert_allclose(way[:2], [[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]], atol=1e-12)
    # Down a ray that is aslant.
    aside = picture.contradicts(np.array([[0.75, 0.5, 1.0]]), 0.1)[1]
    np.testing.assert_allclose(aside, [[0.5 + 0.25 * 2.05, 0.5, -0.05]], atol=1e-12)


def seen_from(eye: np.ndarray, rng: np.random.Generator, pixels: int = 70) -> np.ndarray:
    """The ellipsoid in the middle, a point a pixel of a camera at ``eye``."""
    distance = np.linalg.norm(eye)
    view = eye / distance
    u = np.cross(view, [0.3, 1.0, 0.2])
    u /= np.linalg.norm(u)
    i, j = np.meshgrid(*2 * (np.linspace(-1.1, 1.1, pixels),), indexing="ij")
    ray = i[..., None] * u + j[..., None] * np.cross(view, u) - distance * view
    ray = ray.reshape(-1, 3) / np.linalg.norm(ray.reshape(-1, 3), axis=1, keepdims=True)
    a, b, c = ((ray / AXES) ** 2).sum(1), (ray * eye / AXES**2).sum(1), ((eye / AXES) ** 2).sum() - 1.0
    hit = b * b > a * c
    depth = (-b[hit] - np.sqrt(b[hit] ** 2 - a[hit] * c)) / a[hit]
    points = eye + depth[:, None] * ray[hit]
    return points[rng.random(len(points)) < 0.7]


@pytest.mark.parametrize("distance", [3.0, 6.0])
def test_a_camera_is_found_where_points_lie_equally_dense(distance: float, rng):
    """Within an angle of six degrees and a third of its distance."""
    for towards in EYES:
        eye = distance * np.array(towards) / np.linalg.norm(towards)
        shift = rng.normal(size=3)
        clouds = [seen_from(eye, rng) + shift for _ in range(3)]
        rough = viewing_direction(clouds)
        assert rough is not None
        found = camera_place(clouds, rough) - shift
        cosine = found @ eye / np.linalg.norm(found) / distance
        assert cosine > np.cos(np.radians(6.0)), np.degrees(np.arccos(cosine))
        assert 0.67 < np.linalg.norm(found) / distance < 1.5, np.linalg.norm(found)
