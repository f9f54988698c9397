"""What no point shows of a closed template: flat behind a steep rim, round where the rim turns in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import icosphere

from warpdef.config import TemplateConfig
from warpdef.template import build as building
from warpdef.template.build import build
from warpdef.template.closing import FLATTER, closed_flatter, spanned_smallest
from warpdef.template.support import Support
from warpdef.template.trim import find_trimming

CLOSED = TemplateConfig(surface="closed", faces_max=3000)
RADIUS = 0.4


def boot(rng: np.random.Generator, count: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals of an upright cylinder with a half ball on top, whose flat base no point shows."""
    side = rng.random(count) < 1.5 / (1.5 + RADIUS)
    z = np.where(side, rng.uniform(-1.5, 0, count), RADIUS * rng.random(count))
    angle = rng.uniform(0, 2 * np.pi, count)
    up = np.maximum(z, 0) / RADIUS
    normals = np.column_stack([*(np.sqrt(1 - up**2) * [np.cos(angle), np.sin(angle)]), up])
    return RADIUS * normals + np.column_stack([np.zeros((count, 2)), np.minimum(z, 0)]), normals


def without_pole(rng: np.random.Generator, count: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals of the unit ball without what lies within 45 degrees of its lower pole."""
    points = rng.normal(size=(2 * count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points = points[points[:, 2] > -np.sqrt(0.5)][:count]
    return points, points


def test_a_base_that_no_point_shows_is_half_as_round(monkeypatch):
    points, normals = boot(np.random.default_rng(0))
    flatter = build(points, normals, CLOSED, source="trusted").mesh
    monkeypatch.setattr(building, "closed_flatter", lambda vertices, *_: vertices)
    round_ = build(points, normals, CLOSED, source="trusted").mesh
    below, before = (float(-1.5 - mesh.vertices[:, 2].min()) for mesh in (flatter, round_))
    assert before > 0.4 * RADIUS
    assert 0.3 * before < below < 0.65 * before
    # What the points show stays where they are.
    assert np.abs(np.linalg.norm(flatter.vertices[_middle(flatter.vertices), :2], axis=1) - RADIUS).max() < 0.02


def _middle(vertices: np.ndarray) -> np.ndarray:
    return (vertices[:, 2] > -1.2) & (vertices[:, 2] < -0.2)


def test_a_ball_without_its_pole_stays_a_ball(monkeypatch):
    points, normals = without_pole(np.random.default_rng(1))
    seen: list[float] = []

    def watched(vertices, faces, opening, support):
        moved = closed_flatter(vertices, faces, opening, support)
        seen.append(float(np.abs(moved - vertices).max()))
        return moved

    monkeypatch.setattr(building, "closed_flatter", watched)
    mesh = build(points, normals, CLOSED, source="trusted").mesh
    assert seen[0] < 0.005
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - 1).max() < 0.06


@pytest.mark.parametrize("surface", ["auto", "closed"])
def test_clouds_that_show_all_are_closed_as_ever(surface):
    vertices, faces = icosphere(4)
    support = Support.of(vertices, vertices)
    opening = find_trimming(vertices, faces, support).opening
    assert (opening < 0).all()
    assert closed_flatter(vertices, faces, opening, support) is vertices
    asked = replace(CLOSED, surface=surface)
    assert build(vertices, vertices, asked, source="trusted").report.surface == "closed"


def test_the_smallest_surface_in_a_plane_rim_is_the_plane():
    vertices, faces = icosphere(4)
    cap = vertices[:, 2] > 0.6
    spanned = spanned_smallest(vertices, faces, cap)
    assert np.array_equal(spanned[~cap], vertices[~cap])
    assert spanned[cap, 2].max() < 0.6 and spanned[cap, 2].min() > 0.5
    # Each free vertex is the mean of its neighbours.
    i = int(np.flatnonzero(cap)[np.argmax(vertices[cap, 2])])
    beside = np.setdiff1d(np.unique(faces[(faces == i).any(axis=1)]), [i])
    assert np.allclose(spanned[i], spanned[beside].mean(axis=0))


def test_half_the_way_and_not_more_is_gone():
    vertices, faces = icosphere(4)
    cap = vertices[:, 2] > 0.0  # the rim of a half ball is as steep as can be
    opening = np.where(cap, 0, -1)
    shown = vertices[~cap]
    moved = closed_flatter(vertices, faces, opening, Support.of(shown, shown))
    smallest = spanned_smallest(vertices, faces, cap)
    assert np.array_equal(moved[~cap], vertices[~cap])
    assert np.allclose(moved[cap], (1 - FLATTER) * vertices[cap] + FLATTER * smallest[cap], atol=1e-12)


def test_a_part_that_hangs_together_with_nothing_held_stays():
    """A second ball, no vertex of which is held, beside one with a cap that is free; then alone."""
    vertices, faces = icosphere(2)
    count = len(vertices)
    both = np.concatenate([vertices, vertices + 5.0]), np.concatenate([faces, faces + count])
    other = np.arange(2 * count) >= count
    cap = both[0][:, 2] < -0.5
    spanned = spanned_smallest(*both, cap | other)
    np.testing.assert_array_equal(spanned[other], both[0][other])
    np.testing.assert_allclose(spanned[~other], spanned_smallest(vertices, faces, cap[:count]))
    np.testing.assert_array_equal(spanned_smallest(*both, other), both[0])
