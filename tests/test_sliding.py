"""A mesh that hangs over the end of its cloud goes back along itself; the sides of an open sheet are the mesh's."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import synthetic
import warp as wp

from warpdef.fit import follow
from warpdef.fit.bending import Bending, SeenCloud
from warpdef.fit.recover import Cloud
from warpdef.fit.sliding import END, GAIN, Hanging, far_share, slide
from warpdef.geometry.closest import closest_on_surface
from warpdef.geometry.triangles import unique_edges

LONG, WIDE = 81, 21


def wavy_strip(shift: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A strip of 4 by 1, open, waved along x and moved along its own wave by ``shift``."""
    along, across = np.meshgrid(np.linspace(0.0, 4.0, LONG) + shift, np.linspace(0.0, 1.0, WIDE), indexing="ij")
    i = np.arange(LONG * WIDE).reshape(LONG, WIDE)
    a, b, c, d = (j.ravel() for j in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    return np.stack([along, across, 0.25 * np.sin(2.5 * along)], axis=-1).reshape(-1, 3), faces


@pytest.fixture(scope="module")
def there() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The strip where it is, points on it and their normals."""
    vertices, faces = wavy_strip()
    points, normals = synthetic.sample_surface(vertices, faces, 1500, np.random.default_rng(0))
    return vertices, points, normals


def test_a_strip_that_slid_along_its_wave_is_slid_back(there) -> None:
    """At both ends: one hangs over, at the other points are left; nearest points with planes see neither."""
    vertices, points, normals = there
    over, faces = wavy_strip(0.4)
    bending = Bending(over, faces, unique_edges(faces))
    cloud = SeenCloud.of(points, normals)
    assert far_share(points, over) > 0.03
    placed = bending.place(slide(bending, cloud, bending.still()))
    assert far_share(points, placed) < 0.003
    assert np.quantile(closest_on_surface(points, placed, faces)[0], 0.99) < END * cloud.spacing
    moved_by = np.linalg.norm(placed - vertices, axis=1)
    assert np.median(moved_by) < 0.12 and moved_by.max() < 0.2, "0.4 before"


def test_what_hangs_over_is_told_and_what_lies_on_its_points_is_not(there) -> None:
    vertices = there[0]
    (over, faces), (less, _) = wavy_strip(0.2), wavy_strip(0.01)
    points, _ = synthetic.sample_surface(vertices, faces, 3000, np.random.default_rng(0))
    hanging = Hanging(points, vertices, faces)
    assert hanging.told(points, over, faces) and not hanging.told(points, less, faces)
    # Half of the strip was seen: the mesh goes on where the cloud does not, and is not told to be wrong.
    assert not hanging.told(points[points[:, 0] < 2.0], vertices, faces)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_an_open_sheet_has_the_side_of_the_mesh_nearby(there, side: float) -> None:
    """An estimate alone cannot know it."""
    vertices, points, normals = there
    _, faces = wavy_strip()
    found = Cloud(points, normals, given=False, oriented=False).turned_outwards(vertices, faces[:, :: int(side)])
    assert ((side * normals * found.normals).sum(axis=1) > 0.0).mean() > 0.99 and found.oriented


@pytest.mark.parametrize("gain", [-0.1, 0.0, 0.9 * GAIN, 1.1 * GAIN, 0.1])
def test_a_slide_is_kept_only_where_it_is_worth_it(there, monkeypatch: pytest.MonkeyPatch, gain: float) -> None:
    """A frame that hangs over by a hair, and slides for less than that is worth, goes back to the bit."""
    vertices, points, normals = there
    over, faces = wavy_strip(0.4)
    far = [0.2]
    walk: Any = object.__new__(follow._Walk)  # put together from what a slide asks for

    def settle(frame: int, neighbour: int) -> None:
        far[0] = 0.2 - gain

    monkeypatch.setattr(follow, "slide", lambda bending, cloud, start: start)
    walk.problem = SimpleNamespace(noise_of=lambda frame: 0.0, faces=faces)
    walk.objective = SimpleNamespace(vertices=[wp.array(over, dtype=wp.vec3, device="cpu")])
    walk.search = SimpleNamespace(
        vertices=[over], far=lambda *asked: far[0], uncovered=lambda frame: 0.0, place=lambda *placed: None
    )
    walk._clouds, walk.bent, walk._settle = [Cloud(points, normals, True, True)], set(), settle
    walk._edges, walk._lengths = (
        (edges := unique_edges(faces)),
        np.linalg.norm(np.diff(over[edges], axis=1)[:, 0], axis=1),
    )
    walk._hanging = SimpleNamespace(told=lambda *asked: True)
    walk.bending = SimpleNamespace(pose_of=lambda at: at, place=lambda pose: vertices)
    walk._slide(0, 0)
    kept = gain > GAIN
    assert walk.bent == ({0} if kept else set())
    expected = (vertices if kept else over).astype(np.float32)
    np.testing.assert_array_equal(walk.objective.vertices[0].numpy(), expected)
