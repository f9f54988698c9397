"""Open templates: the border lies where the points end, sampling gaps are closed, closed bodies stay closed."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import icosphere, sample_surface

from warpdef.config import TemplateConfig
from warpdef.geometry import triangles
from warpdef.geometry.borders import border_points
from warpdef.geometry.coverage import objects_of, point_areas
from warpdef.template import build as building
from warpdef.template.cut import cut_at_zero
from warpdef.template.quality import judge
from warpdef.template.support import Support
from warpdef.template.trim import find_trimming

SMALL = TemplateConfig(faces_max=2500)


def bowl(rng: np.random.Generator, count: int = 1500, height: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals of the unit sphere below a height."""
    z = rng.uniform(-1, height, count)
    angle = rng.uniform(0, 2 * np.pi, count)
    flat = np.sqrt(1 - z**2)
    points = np.column_stack([flat * np.cos(angle), flat * np.sin(angle), z])
    return points, points


def tube(rng: np.random.Generator, count: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    """A sleeve: open at both ends."""
    angle, z = rng.uniform(0, 2 * np.pi, count), rng.uniform(-1, 1, count)
    normals = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])
    return 0.4 * normals + np.column_stack([np.zeros((count, 2)), z]), normals


# --- the cut ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("height", [-0.3, 0.0, 0.123])
def test_a_cut_follows_the_contour_without_slivers(height):
    vertices, faces = icosphere(4)
    kept, kept_faces = cut_at_zero(vertices, faces, vertices[:, 2] - height)
    ends = kept[np.unique(triangles.boundary_edges(kept_faces))]
    assert np.abs(ends[:, 2] - height).max() < 0.002
    assert kept[:, 2].min() > height - 0.002
    assert triangles.boundary_loops(kept_faces) == 1 and triangles.euler_number(kept_faces) == 1
    assert triangles.face_areas(kept, kept_faces).sum() == pytest.approx(2 * np.pi * (1 - height), rel=0.01)
    areas = triangles.face_areas(kept, kept_faces)
    assert areas.min() > 0.05 * np.median(areas)
    # Faces keep their side.
    assert (triangles.vertex_normals(kept, kept_faces) * kept).sum(axis=1).min() > 0.9


def test_a_cut_through_vertices_and_of_everything_or_nothing():
    grid = np.array([[x, y, 0.0] for y in range(3) for x in range(3)])
    faces = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [3, 4, 7], [3, 7, 6], [4, 5, 8], [4, 8, 7]])
    half, half_faces = cut_at_zero(grid, faces, 1.0 - grid[:, 0])
    assert triangles.face_areas(half, half_faces).sum() == pytest.approx(2.0)
    third, third_faces = cut_at_zero(grid, faces, 0.5 - grid[:, 0])
    assert triangles.face_areas(third, third_faces).sum() == pytest.approx(1.0)
    assert cut_at_zero(grid, faces, np.full(9, -1.0))[1].shape == (0, 3)
    assert len(cut_at_zero(grid, faces, np.ones(9))[1]) == 8


def test_a_random_level_leaves_a_manifold(rng):
    vertices, faces = icosphere(3)
    for _ in range(20):
        kept, kept_faces = cut_at_zero(vertices, faces, rng.normal(size=len(vertices)))
        assert triangles.edge_use(kept_faces).max() <= 2
        again, _ = triangles.separate_touching(kept, kept_faces)
        assert len(again) == len(kept)


# --- support and openings ---------------------------------------------------------------------------------------------


def test_support_is_one_inside_a_half_on_the_border_and_nothing_beyond(rng):
    points, normals = bowl(rng, 6000)
    support = Support.of(points, normals)
    ring = np.column_stack([np.cos(a := np.linspace(0, 6.28, 100)), np.sin(a), 0 * a])
    assert support.at(ring, ring).mean() == pytest.approx(0.5, abs=0.07)
    low = points[points[:, 2] < -0.3]
    assert support.at(low, low).mean() == pytest.approx(1.0, abs=0.1)
    assert support.at(low, -low).max() == 0.0
    assert support.at(-low, -low).max() < 1e-3
    assert support.distance(points).max() == 0.0


def test_areas_add_up_to_the_surface_at_any_density(rng):
    for count in (500, 4000):
        assert point_areas(bowl(rng, count)[0]).sum() == pytest.approx(2 * np.pi, rel=0.2)


def test_border_points_lie_on_the_border(rng):
    points, normals = bowl(rng, 4000)
    border = border_points(points, normals)
    assert (np.abs(points[border, 2]) < 0.1).mean() > 0.9 and border.mean() > 0.015
    sphere = rng.normal(size=(4000, 3))
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    assert border_points(sphere, sphere).mean() < 0.003


def test_only_openings_that_the_points_confirm_are_openings(rng):
    vertices, faces = icosphere(4)
    below, _ = bowl(rng, 3000)
    trimming = find_trimming(vertices, faces, Support.of(below, below))
    assert trimming.openings == 1 and trimming.share == pytest.approx(1.0, abs=0.1)
    every = rng.normal(size=(3000, 3))
    every /= np.linalg.norm(every, axis=1, keepdims=True)
    whole = find_trimming(vertices, faces, Support.of(every, every))
    assert whole.openings == 0 and whole.share == 0.0
    # A gap of a few points is closed, and a surface that no point supports is not an opening.
    gap = every[every[:, 2] < 0.997]
    assert find_trimming(vertices, faces, Support.of(gap, gap)).share == 0.0
    assert find_trimming(vertices * 3, faces, Support.of(every, every)).openings == 0


# --- templates --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("given", [True, False])
@pytest.mark.parametrize(("shape", "area", "loops"), [(bowl, 2 * np.pi, 1), (tube, 1.6 * np.pi, 2)])
def test_an_open_surface_gets_an_open_template(rng, shape, area, loops, given):
    points, normals = shape(rng)
    built = building.build(points, normals if given else None, SMALL)
    vertices, faces = built.mesh.vertices, built.mesh.faces
    assert built.report.surface == "open" and built.report.trimmed > 0.05
    assert (triangles.boundary_loops(faces), triangles.edge_use(faces).max()) == (loops, 2)
    assert triangles.face_areas(vertices, faces).sum() == pytest.approx(area, rel=0.03)
    assert triangles.triangle_quality(vertices, faces) > 0.95
    assert 0.85 * 2500 <= len(faces) <= 2500
    # The border is as smooth as its triangles are small.
    ends = vertices[triangles.boundary_edges(faces)]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum()
    true_length = {bowl: 2 * np.pi, tube: 1.6 * np.pi}[shape]
    assert 0.95 * true_length < length < 1.1 * true_length


def test_closed_stays_closed_and_the_users_word_counts(rng):
    points, normals = bowl(rng, height=0.97)  # its opening is smaller than far_share_max
    assert building.build(points, normals, SMALL).report.surface == "closed"
    opened = building.build(points, normals, TemplateConfig(faces_max=2500, surface="open"))
    assert opened.report.surface == "open" and triangles.boundary_loops(opened.mesh.faces) == 1
    points, normals = bowl(rng)
    closed = building.build(points, normals, TemplateConfig(faces_max=2500, surface="closed"))
    assert closed.report.surface == "closed" and triangles.is_watertight(closed.mesh.faces)


# --- several objects --------------------------------------------------------------------------------------------------


def test_objects_are_clusters_with_enough_points(rng):
    vertices, faces = icosphere(3)
    large, small = sample_surface(vertices, faces, 1500, rng)[0], sample_surface(vertices, faces, 300, rng)[0]
    cloud = np.concatenate([small * 0.3 + [2, 0, 0], large, large[:10] * 0.05 + [0, 3, 0]])
    labels = objects_of(cloud)
    assert (labels[:300] == 1).all() and (labels[300:1800] == 0).all() and (labels[1800:] == -1).all()
    assert (objects_of(large) == 0).all()
    assert objects_of(rng.normal(size=(12, 3))).max() == 0


@pytest.mark.parametrize(("height", "axis"), [(0.0, 2), (1e-3, 1), (0.02, 0)])
def test_a_flat_cloud_makes_a_sheet(rng, height, axis):
    """Flat to the last bit, or within a cell of the lattice, in whose own plane contours would tear."""
    points = np.insert(rng.uniform(-1, 1, (800, 2)), axis, 0.0, axis=1)
    points[:, axis] = height * np.sin(3.0 * points[:, axis - 1])
    made = building.build(points, None, SMALL)
    gate = judge(made.mesh, points, SMALL, 0, made.report.surface == "open")
    assert gate.passed and (gate.loops, gate.components, gate.handles) == (1, 1, 0)
    assert triangles.face_areas(made.mesh.vertices, made.mesh.faces).sum() == pytest.approx(4.0, rel=0.06)
    assert np.abs(made.mesh.vertices[:, axis]).max() < height + 0.1 * np.sqrt(4.0 / 800)
    assert building.sheet_note(made.report) == "; the mesh is an open sheet"
