"""The quality gate: a good mesh passes, and each fault is found and named."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import icosphere

from warpdef.config import TemplateConfig
from warpdef.mesh import TriMesh
from warpdef.template import quality


def gate_of(vertices, faces, points) -> quality.GateReport:
    return quality.judge(TriMesh(vertices, faces), points, TemplateConfig(), seed=0)


@pytest.fixture
def dense_sphere(rng) -> np.ndarray:
    x = rng.normal(size=(3000, 3))
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def test_the_gate_passes_a_good_mesh(dense_sphere):
    gate = gate_of(*icosphere(4), dense_sphere)
    assert gate.passed and gate.failures == ()
    assert (gate.watertight, gate.components, gate.euler) == (True, 1, 2)
    assert gate.volume == pytest.approx(4 / 3 * np.pi, rel=0.02)
    assert gate.score == gate.far_share == gate.missed_share == 0
    assert gate.as_dict()["passed"] is True


def test_the_gate_finds_each_fault(dense_sphere):
    vertices, faces = icosphere(4)
    half = dense_sphere[dense_sphere[:, 2] > 0]
    count = len(vertices)
    faults = {
        "not watertight": gate_of(vertices, faces[1:], dense_sphere),
        "inside out": gate_of(vertices, faces[:, ::-1], dense_sphere),
        "2 pieces": gate_of(
            np.concatenate([vertices, vertices * 1.01]), np.concatenate([faces, faces + count]), dense_sphere
        ),
        "surface is far from every point": gate_of(vertices, faces, half),
        "points are far from its surface": gate_of(
            vertices, faces, np.concatenate([dense_sphere, dense_sphere[:200] * 2])
        ),
    }
    for words, gate in faults.items():
        assert not gate.passed
        assert any(words in failure for failure in gate.failures), (words, gate.failures)
        assert gate.score > 0.02
    assert 0.3 < faults["surface is far from every point"].far_share < 0.5


def test_an_open_mesh_is_judged_by_rules_of_its_own(dense_sphere):
    vertices, faces = icosphere(4)
    half = faces[vertices[faces].mean(axis=1)[:, 2] > 0]
    points = dense_sphere[dense_sphere[:, 2] > 0]
    gate = quality.judge(TriMesh(vertices, half), points, TemplateConfig(), 0, is_open=True)
    assert gate.passed and not gate.watertight
    assert (gate.loops, gate.euler, gate.handles) == (1, 1, 0)
    assert not quality.judge(TriMesh(vertices, half), points, TemplateConfig(), 0).passed
    assert not quality.judge(TriMesh(vertices, faces), points, TemplateConfig(), 0, is_open=True).passed
    top = half[vertices[half][:, :, 2].min(axis=1).argmax()]
    fin = np.concatenate([half, [[top[0], top[1], half[0, 0]]]])
    gate = quality.judge(TriMesh(vertices, fin), points, TemplateConfig(), 0, is_open=True)
    assert gate.failures == ("it has edges in more than two faces",)


def test_as_many_pieces_as_objects_pass(dense_sphere):
    vertices, faces = icosphere(3)
    two = TriMesh(np.concatenate([vertices, vertices + 3]), np.concatenate([faces, faces + len(vertices)]))
    gate = quality.judge(two, np.concatenate([dense_sphere, dense_sphere + 3]), TemplateConfig(), 0)
    assert gate.passed and (gate.components, gate.objects, gate.handles) == (2, 2, 0)


def test_a_cloud_far_denser_than_the_samples_is_not_missed(rng):
    vertices, faces = icosphere(4)
    points = rng.normal(size=(80_000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    gate = gate_of(vertices, faces, points)
    assert gate.passed and gate.missed_share == gate.far_share == 0
    bare = gate_of(vertices, faces[vertices[faces].mean(axis=1)[:, 2] > 0], points)
    assert 0.2 < bare.missed_share < 0.5


def test_a_mesh_without_area_is_far_everywhere(dense_sphere):
    gate = gate_of(np.zeros((4, 3)), np.array([[0, 1, 2], [0, 2, 3]]), dense_sphere)
    assert gate.far_share == gate.missed_share == 1.0
