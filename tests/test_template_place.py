"""A template of the user's own must lie on its keyframe; if not, the message says by how much, or it is placed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import icosphere, sample_surface, turn_about

from warpdef.config import Config
from warpdef.errors import InputError
from warpdef.mesh import TriMesh
from warpdef.template.choose import accept_user_template


@pytest.fixture
def body() -> TriMesh:
    """No symmetry: an egg with a long arm to one side and a short one to another."""
    sphere, faces = icosphere(3)
    parts = [
        sphere * [1, 0.7, 0.5],
        sphere * [0.15, 0.15, 0.8] + [0.5, 0.2, 1.0],
        sphere * [0.2, 0.5, 0.2] + [0, -0.9, 0.1],
    ]
    vertices = np.concatenate(parts) * 0.4
    return TriMesh(vertices, np.concatenate([faces + i * len(sphere) for i in range(3)]))


@pytest.fixture
def cloud(body, rng) -> np.ndarray:
    return sample_surface(body.vertices, body.faces, 1500, rng)[0]


def config(**template) -> Config:
    base = Config()
    return replace(base, keyframe=replace(base.keyframe, choice="0"), template=replace(base.template, **template))


def moved(mesh: TriMesh, scale: float = 1.0, shift: tuple = (0, 0, 0), turn: np.ndarray | None = None) -> TriMesh:
    return TriMesh(scale * mesh.vertices @ (np.eye(3) if turn is None else turn).T + np.array(shift), mesh.faces)


QUARTER, AROUND, ODD = turn_about([0, 0, 1], np.pi / 2), turn_about([1, 0, 0], np.pi), turn_about([1, 2, 3], 1.9)
WRONG = {
    "millimetres": ({"scale": 1000}, "1000 times as large as its points: are the units others"),
    "metres": ({"scale": 0.001}, "1000 times as small"),
    "inches": ({"scale": 1 / 2.54}, "2.54 times as small"),
    "elsewhere": ({"shift": (3, 0, 0)}, "lies elsewhere, .* times its size away"),
    "a quarter": ({"turn": QUARTER}, "turned by 90 degrees"),
    "half": ({"turn": AROUND}, "turned by 180 degrees"),
    "another size": ({"scale": 1.5}, "if moved, scaled by 0.6[67]"),
    "all": ({"scale": 100, "turn": ODD, "shift": (5, -900, 2)}, "100 times as large"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_what_does_not_lie_on_its_keyframe_is_refused_or_placed(body, cloud, wrong):
    how, message = WRONG[wrong]
    mesh = moved(body, **how)
    with pytest.raises(
        InputError, match=f"--template: expected a template on its keyframe.*{message}.*--align-template"
    ):
        accept_user_template(mesh, [cloud] * 2, config())
    placed = accept_user_template(mesh, [cloud] * 2, config(align=True))
    np.testing.assert_allclose(placed.mesh.vertices, body.vertices, atol=0.02)
    np.testing.assert_array_equal(placed.mesh.faces, body.faces)
    assert "the template given was moved, scaled by" in placed.warnings[0] and placed.gate.missed_share < 0.05


def test_what_lies_there_is_taken_as_it_is(body, cloud, rng):
    """Itself; moved a little; seen by a part; in another pose; a part of the body only."""
    half = cloud[cloud[:, 0] > 0]
    bent = TriMesh(body.vertices + 0.4 * np.maximum(body.vertices[:, 2:] - 0.2, 0) * [1, 1, 0], body.faces)
    for mesh, points in ((body, cloud), (moved(body, shift=(0.05, 0, 0)), cloud), (body, half), (bent, cloud)):
        chosen = accept_user_template(mesh, [points] * 2, config())
        np.testing.assert_array_equal(chosen.mesh.vertices, mesh.vertices)
    assert accept_user_template(moved(body, 1.1), [cloud] * 2, config()).keyframe == 0


def test_aligning_needs_a_keyframe(body, cloud):
    with pytest.raises(InputError, match="--align-template: name the frame"):
        accept_user_template(body, [cloud] * 2, replace(config(align=True), keyframe=Config().keyframe))
