"""Limbs lost and found: two legs that swing past each other's place between two frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from leg_samples import DEGREE, body, cloud_of

from warpdef.fit.recover import Cloud, ConnectedSurface, Matches, recover
from warpdef.geometry.triangles import unique_edges


@pytest.fixture(scope="module")
def swing() -> tuple[np.ndarray, np.ndarray]:
    """Vertices of two frames, (2, V, 3), and faces: the first leg comes to where the second one was."""
    first, faces = body((0.0, 0.0))
    second, _ = body((-24 * DEGREE, -26 * DEGREE))
    return np.stack([first, second]), faces


@pytest.mark.parametrize("oriented", [True, False])
def test_a_leg_on_the_wrong_leg_is_found(swing, oriented):
    truth, faces = swing
    clouds = [cloud_of(v, faces, seed, oriented) for seed, v in enumerate(truth)]
    edges = unique_edges(faces)
    # What nearest neighbours make of it: the second leg where the first one should be, and the other way round.
    wrong = truth.copy()
    wrong[1], _ = body((0.0, 6 * DEGREE))
    assert Matches(clouds[1], ConnectedSurface.of(faces, edges)).uncovered(wrong[1]) > 0.05
    before = wrong[0].copy()
    assert recover(wrong, clouds, faces, edges, keyframe=0) == ([1], [])
    np.testing.assert_array_equal(wrong[0], before)
    error = np.linalg.norm(wrong[1] - truth[1], axis=1)
    moved = np.linalg.norm(truth[1] - truth[0], axis=1)
    assert moved.max() > 0.5
    assert np.quantile(error, 0.99) < 0.15 * moved.max()
    assert error.mean() < 0.03 * moved.max()


def test_both_directions_from_the_keyframe(swing):
    truth, faces = swing
    frames = truth[[1, 0, 1]]
    clouds = [cloud_of(v, faces, seed) for seed, v in enumerate(frames)]
    still = np.tile(truth[0], (3, 1, 1))
    assert recover(still, clouds, faces, unique_edges(faces), keyframe=1) == ([0, 2], [])


def test_frames_that_fit_stay_bit_for_bit(swing):
    truth, faces = swing
    clouds = [cloud_of(v, faces, seed) for seed, v in enumerate(truth)]
    vertices = truth.copy()
    assert recover(vertices, clouds, faces, unique_edges(faces), keyframe=1) == ([], [])
    np.testing.assert_array_equal(vertices, truth)


def test_what_the_keyframe_does_not_cover_is_not_lost_elsewhere(swing):
    """A twentieth of every cloud belongs to something that the mesh does not have."""
    truth, faces = swing
    clouds = [cloud_of(v, faces, seed) for seed, v in enumerate(truth)]
    extra = np.random.default_rng(3).normal(size=(len(clouds[0].points) // 19, 3))
    sides = extra / np.linalg.norm(extra, axis=1, keepdims=True)
    clouds = [
        replace(c, points=np.concatenate([c.points, sides + [9.0, 0, 0]]), normals=np.concatenate([c.normals, sides]))
        for c in clouds
    ]
    vertices = truth.copy()
    assert recover(vertices, clouds, faces, unique_edges(faces), keyframe=1) == ([], [])
    np.testing.assert_array_equal(vertices, truth)


def test_points_that_no_bending_reaches_are_reported(swing):
    """A cloud far away: the frame and those behind it stay as they are."""
    truth, faces = swing
    away = truth[0] + [9.0, 0, 0]
    clouds = [cloud_of(v, faces, seed) for seed, v in enumerate([truth[0], away, truth[1]])]
    vertices = np.tile(truth[0], (3, 1, 1))
    recovered, lost = recover(vertices, clouds, faces, unique_edges(faces), keyframe=0)
    assert (recovered, lost) == ([], [1, 2])
    np.testing.assert_array_equal(vertices, np.tile(truth[0], (3, 1, 1)))


def test_what_was_found_helps_the_frames_behind_it(swing):
    """All frames stand still: each is found from the one before it, though not the last from the first."""
    _, faces = swing
    frames = np.stack([body((k * -17 * DEGREE, k * -18 * DEGREE))[0] for k in range(4)])
    clouds = [cloud_of(v, faces, seed) for seed, v in enumerate(frames)]
    edges = unique_edges(faces)
    still = np.tile(frames[0], (4, 1, 1))
    assert recover(still, clouds, faces, edges, keyframe=0) == ([1, 2, 3], [])
    error = np.linalg.norm(still - frames, axis=2).mean(axis=1)
    assert error.max() < 0.05 * np.linalg.norm(frames[3] - frames[0], axis=1).max()
    assert recover(still[[0, 0]], [clouds[0], clouds[3]], faces, edges, keyframe=0)[1] == [1]


def swung(*degrees: float) -> tuple[np.ndarray, np.ndarray, list[Cloud]]:
    """Both legs swung ever further: vertices (T, V, 3), faces, and clouds."""
    faces = body((0.0, 0.0))[1]
    frames = np.stack([body((-a * DEGREE, -(a + 2) * DEGREE))[0] for a in degrees])
    return frames, faces, [cloud_of(v, faces, seed) for seed, v in enumerate(frames)]


def test_looser_matches_are_tried_where_something_stays_lost(monkeypatch):
    frames, faces, clouds = swung(0, 34)
    edges = unique_edges(faces)
    found = frames[[0, 0]]
    assert recover(found, clouds, faces, edges, keyframe=0) == ([1], [])
    assert np.linalg.norm(found[1] - frames[1], axis=1).mean() < 0.03
    monkeypatch.setattr("warpdef.fit.recover.LOOSER", ())
    assert recover(frames[[0, 0]], clouds, faces, edges, keyframe=0)[1] == [1]


@pytest.mark.parametrize("backwards", [False, True])
def test_a_lost_frame_is_found_from_a_covered_one_behind_it(backwards):
    frames, faces, clouds = swung(0, 50, 60)
    edges, keyframe = unique_edges(faces), 0
    found = frames[[0, 0, 2]]
    if backwards:
        frames, found, clouds, keyframe = frames[::-1], found[::-1].copy(), clouds[::-1], 2
    assert recover(found, clouds, faces, edges, keyframe) == ([1], [])
    assert np.linalg.norm(found[1] - frames[1], axis=1).mean() < 0.03
    alone = [clouds[keyframe], clouds[1]]
    assert recover(frames[[keyframe, keyframe]], alone, faces, edges, 0)[1] == [1]


def test_a_frame_half_found_does_not_end_the_search(swing):
    """A part of the second frame's points belongs to nothing; the third frame is found all the same."""
    truth, faces = swing
    clouds = [cloud_of(v, faces, seed) for seed, v in enumerate(truth[[0, 1, 1]])]
    rng = np.random.default_rng(5)
    foreign = [2.0, 0.0, 0.0] + 0.1 * rng.normal(size=(300, 3))
    points, normals = (np.concatenate([a, b]) for a, b in ((clouds[1].points, foreign), (clouds[1].normals, foreign)))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    clouds[1] = Cloud(points, normals, True, True)
    vertices = np.tile(truth[0], (3, 1, 1))
    recovered, lost = recover(vertices, clouds, faces, unique_edges(faces), keyframe=0)
    assert (recovered, lost) == ([1, 2], [1])
    np.testing.assert_allclose(vertices[2], truth[1], atol=0.2)


def test_every_object_counts_by_itself(swing):
    """Two objects are two components of the mesh; the smaller one is no lost limb."""
    truth, faces = swing
    small = 0.5 * truth[0] + [3.0, 0, 0]
    both = np.concatenate([truth[0], small])
    both_faces = np.concatenate([faces, faces + len(small)])
    cloud = cloud_of(both, both_faces, 0)
    matches = Matches(cloud, ConnectedSurface.of(both_faces, unique_edges(both_faces)))
    trusted, goal, normal = matches.find(both)
    assert len(trusted) == len(goal) == len(normal)
    assert (trusted >= len(small)).sum() > 0.8 * len(small)
    assert matches.uncovered(both) < 0.01
    # Nor do vertices that no face uses count, wherever they stand in a template given.
    loose = np.concatenate([both, both[:3]])
    np.testing.assert_array_equal(matches.find(loose)[0], trusted)


def test_matches_of_a_flat_patch_keep_their_sides(swing):
    """Against the normals there is no match, unless their side is unknown."""
    truth, faces = swing
    right = cloud_of(truth[0], faces, 0)
    turned = Cloud(right.points, -right.normals, True, True)
    surface = ConnectedSurface.of(faces, unique_edges(faces))
    assert len(Matches(turned, surface).find(truth[0])[0]) < 0.05 * len(truth[0])
    assert Matches(turned, surface).uncovered(truth[0]) > 0.9
    unknown = Cloud(right.points, -right.normals, False, False)
    assert Matches(unknown, surface).uncovered(truth[0]) < 0.01
