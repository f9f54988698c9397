"""Limbs of a sheet with fingers, of a bar, and of next to nothing; and their surface in a frame."""

from __future__ import annotations

import numpy as np
import pytest
from hand_samples import EDGES, FACES, FINGERS, VERTICES, finger
from judged import assess, frames, names

from warpdef.geometry.limbs import find_limbs
from warpdef.geometry.sampling import sample_surface
from warpdef.geometry.triangles import face_areas, unique_edges
from warpdef.quality.swollen import LimbAreas


def widened(by: float) -> np.ndarray:
    """The second finger, wider."""
    found, middle = VERTICES.copy(), 0.5 * sum(FINGERS[1])
    found[finger(1), 0] = middle + by * (found[finger(1), 0] - middle)
    return found


def test_every_finger_is_a_limb_from_where_it_begins_to_its_tip() -> None:
    limbs = find_limbs(VERTICES, EDGES)
    of = [[limb for limb in limbs if finger(k)[limb.tip]] for k in range(4)]
    assert [len(found) for found in of] == [1, 1, 1, 1]
    for k, (limb,) in enumerate(of):
        assert VERTICES[limb.tip, 1] > 1.1 and 0.8 < limb.length < 1.5
        assert np.mean(finger(k)[limb.vertex]) > 0.9 and len(limb.vertex) > 0.7 * finger(k).sum()
        assert 0.0 < limb.along.min() < 0.15 and limb.along[limb.vertex == limb.tip] == 1.0 == limb.along.max()


def test_the_same_limbs_wherever_and_however_large() -> None:
    turned = 40.0 * VERTICES[:, [2, 0, 1]] - 7.0
    for one, other in zip(find_limbs(VERTICES, EDGES), find_limbs(turned, EDGES), strict=True):
        assert one.tip == other.tip and np.array_equal(one.vertex, other.vertex)
        assert other.length == pytest.approx(40.0 * one.length)


def test_a_bar_is_two_limbs_that_meet_in_its_middle() -> None:
    bar = np.stack([np.arange(11.0), np.zeros(11), np.zeros(11)], axis=1)
    steps = np.stack([np.arange(10), np.arange(1, 11)], axis=1)
    limbs = find_limbs(bar, steps)
    assert [(limb.tip, limb.vertex.tolist(), limb.length) for limb in limbs] == [
        (0, [0, 1, 2, 3, 4], 5.0),
        (10, [6, 7, 8, 9, 10], 5.0),
    ]
    # A twig of a twentieth of it is a bump.
    bump = np.concatenate([bar, [[2.0, 0.4, 0.0]]]), np.concatenate([steps, [[2, 11]]])
    assert [limb.tip for limb in find_limbs(*bump)] == [0, 10]


def test_only_the_largest_part_has_limbs_and_nothing_has_none() -> None:
    more = np.concatenate([VERTICES, [[9.0, 9.0, 9.0], [19.0, 9.0, 9.0], [5.0, 5.0, 5.0]]])
    beside = np.concatenate([EDGES, [[len(VERTICES), len(VERTICES) + 1]]])
    assert [limb.tip for limb in find_limbs(more, beside)] == [limb.tip for limb in find_limbs(VERTICES, EDGES)]
    assert find_limbs(VERTICES, EDGES[:0]) == [] and find_limbs(np.zeros((3, 3)), np.array([[0, 1], [1, 2]])) == []


def test_how_much_the_limb_has_grown_that_has_grown_most() -> None:
    limbs = LimbAreas(VERTICES, FACES, EDGES)
    assert limbs.most_grown(face_areas(1.2 * widened(1.3), FACES), 1.2) == pytest.approx(0.3, abs=0.05)
    assert limbs.most_grown(face_areas(widened(0.7), FACES), 1.0) == pytest.approx(0.0, abs=1e-9)
    triangle = np.eye(3), np.array([[0, 1, 2]])
    assert LimbAreas(*triangle, unique_edges(triangle[1])).most_grown(np.ones(1), 1.0) == 0.0


@pytest.mark.parametrize(("by", "verdict"), [(1.08, "good"), (1.25, "doubtful")])
def test_a_finger_that_has_grown_over_what_is_beside_it_is_told_of_what_one_camera_saw(by: float, verdict: str) -> None:
    """Every point is covered, and no edge is longer by half; bent alone it has not grown."""
    pytest.importorskip("gpytoolbox")
    bent = VERTICES.copy()
    beyond = np.where(finger(2), VERTICES[:, 1], 0.0)
    bent[:, 1] += np.sin(beyond) - beyond
    bent[:, 2] += 1.0 - np.cos(beyond)
    meshes = np.stack([VERTICES, bent, widened(by)])
    clouds = [sample_surface(v, FACES, 4000, np.random.default_rng(t))[0] for t, v in enumerate(meshes)]
    found = assess(clouds, meshes, FACES, 0, eye=np.array([1.0, 0.0, 12.0]))
    assert names(found) == ["good", "good", verdict]
    assert frames(found)[1].swollen < 0.02 and frames(found)[2].swollen == pytest.approx(by - 1.0, abs=0.04)
    assert verdict == "good" or "the surface of a limb" in found.verdicts[2].reasons[0]
    assert assess(clouds, meshes, FACES, 0).frames[2].swollen is None
