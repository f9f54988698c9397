"""Surface drawn out by patches, what has grown as a whole, and what no points show."""

from __future__ import annotations

import numpy as np
import pytest
from judged import assess, frames, names

from warpdef.geometry.sampling import sample_surface
from warpdef.geometry.triangles import unique_edges
from warpdef.quality.drawn import Patches

pytest.importorskip("gpytoolbox")
SIDE = 41


def sheet() -> tuple[np.ndarray, np.ndarray]:
    """A square of length 2, a vertex every twentieth."""
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, SIDE), np.linspace(-1.0, 1.0, SIDE), indexing="ij")
    i = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    a, b, c, d = (k.ravel() for k in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]).astype(np.int32)
    return np.stack([x, y, 0.0 * x], axis=2).reshape(-1, 3), faces


VERTICES, FACES = sheet()
PATCHES = Patches(VERTICES, FACES, unique_edges(FACES))


def drawn(by: float) -> np.ndarray:
    """The strip of a fifth of the sheet at one end drawn out along x."""
    beyond = np.maximum(VERTICES[:, :1] - 0.6, 0.0)
    return VERTICES + (by - 1.0) * beyond * [1.0, 0.0, 0.0]


@pytest.mark.parametrize(("by", "share"), [(1.6, 0.0), (2.2, 0.2), (3.0, 0.2)])
def test_the_share_of_a_strip_that_is_drawn_out(by: float, share: float) -> None:
    """Patches of two rings reach over its border by a twentieth of the sheet."""
    assert PATCHES.drawn_share(drawn(by)) == pytest.approx(share, abs=0.05)


def test_bent_turned_and_grown_is_not_drawn_out() -> None:
    bent = np.stack([np.sin(VERTICES[:, 0]), VERTICES[:, 1], np.cos(VERTICES[:, 0])], axis=1)
    for frame in (VERTICES, bent, 2.5 * bent[:, [1, 2, 0]] + 7.0):
        assert PATCHES.drawn_share(frame) == 0.0


def test_noise_draws_nothing_out() -> None:
    """As much of it as every fifth edge is changed by half."""
    noisy = VERTICES + np.random.default_rng(0).normal(scale=0.012, size=VERTICES.shape)
    edges = unique_edges(FACES)
    ratio = np.linalg.norm(np.diff(noisy[edges], axis=1)[:, 0], axis=1)
    ratio /= np.linalg.norm(np.diff(VERTICES[edges], axis=1)[:, 0], axis=1)
    assert np.mean(np.abs(np.log(ratio)) > np.log(1.5)) > 0.1
    assert PATCHES.drawn_share(noisy) < 0.005


def test_collapsed_and_unused_vertices_count_nothing() -> None:
    more = np.concatenate([VERTICES, [[9.0, 9.0, 9.0], [3.0, 0.0, 0.0]]])
    sliver = np.array([[0, len(VERTICES) + 1, len(VERTICES) + 1]])
    faces = np.concatenate([FACES, sliver])
    patches = Patches(more, faces, unique_edges(faces))
    assert patches.drawn_share(more) == 0.0
    point = np.zeros((3, 3))
    assert Patches(point, np.array([[0, 1, 2]]), np.array([[0, 1], [1, 2], [0, 2]])).drawn_share(point) == 0.0


def test_a_frame_that_has_drawn_the_surface_over_more_is_doubtful() -> None:
    """Its points are all covered: something was picked up that the shape has not."""
    meshes = np.stack([VERTICES, VERTICES, drawn(2.5)])
    clouds = [sample_surface(v, FACES, 1500, np.random.default_rng(t))[0] for t, v in enumerate(meshes)]
    found = assess(clouds, meshes, FACES, 0)
    assert names(found) == ["good", "good", "doubtful"] and frames(found)[2].uncovered == 0.0
    assert "drawn out" in found.verdicts[2].reasons[0]


def test_what_has_grown_has_grown_apart() -> None:
    """In a frame of a fifth of the size nothing lies nearer than in the shape: there is no second layer."""
    two = np.concatenate([VERTICES, VERTICES + [0.0, 0.0, 0.4]])
    faces = np.concatenate([FACES, FACES + len(VERTICES)])
    meshes = np.stack([two, 0.2 * two])
    clouds = [0.2**t * sample_surface(two, faces, 1500, np.random.default_rng(t))[0] for t in range(2)]
    found = assess(clouds, meshes, faces, 0)
    assert names(found) == ["good"] * 2 and frames(found)[1].layered == 0.0


def test_what_has_no_points_is_told_but_not_of_one_camera() -> None:
    meshes = np.stack([VERTICES] * 3)
    clouds = [sample_surface(v, FACES, 1500, np.random.default_rng(t))[0] for t, v in enumerate(meshes)]
    clouds[1] = clouds[1][clouds[1][:, 0] < 0.4]
    found = assess(clouds, meshes, FACES, 0)
    (line,) = found.warnings()
    assert names(found) == ["good"] * 3 and "near it in frame 1: there it is a guess" in line
    assert line.startswith(f"{frames(found)[1].far:.0%} of the mesh has no points") and 0.1 < frames(found)[1].far < 0.3
    one_camera = assess(clouds, meshes, FACES, 0, eye=np.array([0.0, 0.0, 9.0])).warnings()
    assert not any("it is a guess" in line for line in one_camera)
