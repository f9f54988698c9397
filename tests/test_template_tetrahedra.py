"""The template by a deforming tetrahedral grid."""

from __future__ import annotations

import numpy as np
import pytest

from warpdef.config import Config, TemplateConfig
from warpdef.errors import InputError
from warpdef.geometry import triangles
from warpdef.template import signed_distance, tetrahedra
from warpdef.template.build import build
from warpdef.template.choose import choose_template
from warpdef.template.signed_distance import OrientedCloud
from warpdef.template.tetrahedra import fit_surface

AXES = np.array([0.9, 0.6, 0.5])


def ball(rng: np.random.Generator, count: int = 600) -> tuple[np.ndarray, np.ndarray]:
    """An ellipsoid's points and outward normals."""
    x = rng.normal(size=(count, 3))
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    normals = x / AXES
    return x * AXES, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def ring(rng: np.random.Generator, count: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    """A torus of radii 0.7 and 0.15; a little denser on the inner side."""
    u, v = rng.uniform(0, 2 * np.pi, (2, count))
    out = np.column_stack([np.cos(u), np.sin(u), np.zeros(count)])
    normals = np.cos(v)[:, None] * out + np.sin(v)[:, None] * np.array([0, 0, 1])
    return 0.7 * out + 0.15 * normals, normals


def error(vertices: np.ndarray) -> np.ndarray:
    """Distance of places to the ellipsoid, to first order."""
    level = ((vertices / AXES) ** 2).sum(axis=1)
    return np.abs(level - 1) / (2 * np.linalg.norm(vertices / AXES**2, axis=1))


def test_a_ball(rng: np.random.Generator) -> None:
    points, normals = ball(rng)
    vertices, faces = fit_surface(points, normals)
    assert triangles.is_watertight(faces) and triangles.euler_number(faces) == 2
    assert triangles.signed_volume(vertices, faces) == pytest.approx(4 / 3 * np.pi * AXES.prod(), rel=0.02)
    assert error(vertices).mean() < 0.005 and error(vertices).max() < 0.04


def test_the_fit_improves_on_its_start(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    points, normals = ball(rng)
    fitted = error(fit_surface(points, normals)[0]).mean()
    monkeypatch.setattr(tetrahedra, "ITERATIONS", 0)
    assert fitted < 0.7 * error(fit_surface(points, normals)[0]).mean()


def test_the_loss_falls_and_offsets_are_used(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    runs = []
    run = tetrahedra._Fit.run

    def watched(fit, *arguments):
        found = run(fit, *arguments)
        runs.append((fit.losses, found))
        return found

    monkeypatch.setattr(tetrahedra._Fit, "run", watched)
    fit_surface(*ball(rng))
    assert len(runs) == tetrahedra.LEVELS
    for losses, found in runs:
        assert losses[-1] < losses[0]
        assert np.abs(found[:, 1:]).max() > 0.01


def test_a_ring_keeps_its_hole(rng: np.random.Generator) -> None:
    vertices, faces = fit_surface(*ring(rng))
    assert triangles.is_watertight(faces) and triangles.euler_number(faces) == 0
    assert np.abs(np.hypot(np.hypot(*vertices.T[:2]) - 0.7, vertices[:, 2]) - 0.15).max() < 0.04


def test_a_hole_in_the_points_is_closed_over(rng: np.random.Generator) -> None:
    points, normals = ball(rng, 1500)
    seen = points[:, 2] < 0.35
    vertices, faces = fit_surface(points[seen], normals[seen])
    assert triangles.is_watertight(faces) and triangles.euler_number(faces) == 2
    assert vertices[:, 2].max() < 0.6
    assert error(vertices[vertices[:, 2] < 0.3]).max() < 0.05


def test_units_and_place_do_not_matter_and_bytes_repeat(rng: np.random.Generator) -> None:
    points, normals = ball(rng, 300)
    one, again, far = (fit_surface(p, normals) for p in (points, points.copy(), points * 1000.0 + 5000.0))
    assert one[0].tobytes() == again[0].tobytes() and one[1].tobytes() == again[1].tobytes()
    volume = triangles.signed_volume(*one)
    assert triangles.signed_volume(*far) == pytest.approx(volume * 1e9, rel=1e-2)


def test_a_coarse_cell_is_kept(rng: np.random.Generator) -> None:
    points, normals = ball(rng)
    fine, coarse = (len(fit_surface(points, normals, cell)[1]) for cell in (0.08, 0.16))
    assert fine == pytest.approx(4 * coarse, rel=0.2)


def test_few_points(rng: np.random.Generator) -> None:
    for count in (4, 10, 30):
        vertices, faces = fit_surface(*ball(rng, count))
        assert np.isfinite(vertices).all()
        if len(faces):
            assert triangles.is_watertight(faces)


def test_signed_distance_near_and_far(rng: np.random.Generator) -> None:
    points, normals = ball(rng, 2000)
    cloud = OrientedCloud(points, normals)
    direction = ball(rng, 200)[0] / AXES
    for factor, where in ((0.2, -1), (0.9, -1), (0.99, -1), (1.01, 1), (1.1, 1), (2.0, 1), (50.0, 1)):
        found = cloud.signed_distance(factor * direction * AXES)
        assert (np.sign(found) == where).mean() > (0.9 if abs(factor - 1) < 0.05 else 0.999)
    assert np.abs(cloud.signed_distance(points)).mean() < 0.1 * cloud.spacing
    # The same in any units, and from a part of the points.
    far = OrientedCloud(1e4 * points + 1e6, normals)
    np.testing.assert_allclose(
        far.signed_distance(1.1e4 * points + 1e6) / 1e4, cloud.signed_distance(1.1 * points), atol=1e-6
    )


def test_more_points_than_the_winding_number_takes(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    points, normals = ball(rng, 2000)
    monkeypatch.setattr(signed_distance, "WINDING_POINTS", 300)
    cloud = OrientedCloud(points, normals)
    assert len(cloud.sources) == 286
    assert (cloud.signed_distance(0.6 * points) < 0).all() and (cloud.signed_distance(1.6 * points) > 0).all()


def test_noise_makes_a_cloud_thick(rng: np.random.Generator) -> None:
    points, normals = ball(rng, 2000)
    clean, noisy = (OrientedCloud(points + s * rng.normal(size=points.shape), normals).thickness() for s in (0.0, 0.03))
    assert clean < tetrahedra.THIN and noisy > clean + 0.1


@pytest.mark.parametrize("inward", [False, True])
def test_as_a_template(rng: np.random.Generator, inward: bool) -> None:
    points, normals = ball(rng)
    config = TemplateConfig(method="tetrahedra", faces_max=1500)
    built = build(points, -normals if inward else normals, config)
    assert built.report.method == "tetrahedra"
    assert triangles.is_watertight(built.mesh.faces) and triangles.euler_number(built.mesh.faces) == 2
    assert triangles.signed_volume(built.mesh.vertices, built.mesh.faces) > 0
    assert 0.9 * 1500 <= len(built.mesh.faces) <= 1500
    assert triangles.triangle_quality(built.mesh.vertices, built.mesh.faces) > 0.9
    assert error(built.mesh.vertices).mean() < 0.01


def test_chosen_for_a_sequence_without_normals(rng: np.random.Generator) -> None:
    clouds = [ball(rng, 400)[0] for _ in range(3)]
    chosen = choose_template(clouds, [None] * 3, Config(template=TemplateConfig(method="tetrahedra", faces_max=1500)))
    assert chosen.report.method == "tetrahedra" and chosen.report.normals == "estimated"
    assert chosen.gate.passed


def test_a_surface_without_faces_is_an_input_error(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    points, normals = ball(rng)
    monkeypatch.setattr("warpdef.template.build.fit_surface", lambda *_: (np.zeros((0, 3)), np.zeros((0, 3), np.int32)))
    with pytest.raises(InputError, match="tetrahedra.* made 0 faces from 600 points"):
        build(points, normals, TemplateConfig(method="tetrahedra"))


def test_odd_clouds_end_in_a_surface_or_an_input_error(rng: np.random.Generator) -> None:
    line = np.column_stack([np.linspace(-1, 1, 50), np.zeros(50), np.zeros(50)])
    for points in (line, line + [[0, 1e-9, 0]] * rng.random((50, 1)), np.append(line * 1e-6, [[1, 1, 1]], axis=0)):
        try:
            built = build(points, None, TemplateConfig(method="tetrahedra", surface="closed", faces_max=500))
        except InputError:
            continue
        assert np.isfinite(built.mesh.vertices).all()
