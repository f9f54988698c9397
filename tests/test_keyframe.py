"""Keyframe ranking: coverage, the temporal middle, and the user's word."""

from __future__ import annotations

import re

import numpy as np
import pytest

from warpdef.config import KeyframeConfig
from warpdef.errors import InputError
from warpdef.template.keyframe import compare_frames, doubt_of_asked, occupied_voxels, rank_keyframes, spread_out


def clouds_of(counts: list[int]) -> list[np.ndarray]:
    """Clouds that occupy exactly so many voxels of 8^3, one point each."""
    cells = np.stack(np.unravel_index(np.arange(512), (8, 8, 8)), axis=1)
    return [(cells[:count] + 0.5) / 4 - 1 for count in counts]


def test_occupied_voxels_counts_each_cell_once_and_keeps_the_border_inside():
    points = np.array([[-1.0, -1, -1], [-0.9, -0.9, -0.9], [1.0, 1, 1], [0.99, 0.99, 0.99], [1.2, 0.99, 0.99]])
    assert occupied_voxels(points, 8) == 2
    assert occupied_voxels(points, 1) == 1


def test_occupied_voxels_matches_brute_force(rng):
    points = rng.uniform(-1, 1, (500, 3))
    cells = {tuple(np.floor((p + 1) * 4).astype(int)) for p in points}
    assert occupied_voxels(points, 8) == len(cells)


def test_most_covered_frame_wins_without_a_weight():
    ranked = rank_keyframes(clouds_of([10, 40, 20, 30]), KeyframeConfig(voxels=8, gamma=0))
    assert [c.frame for c in ranked] == [1, 3, 2, 0]
    assert [c.occupied_voxels for c in ranked] == [40, 30, 20, 10]


def test_the_gaussian_is_centred_on_half_the_last_frame_index():
    ranked = rank_keyframes(clouds_of([10] * 5), KeyframeConfig(voxels=8, gamma=0.1))
    assert [c.frame for c in ranked] == [2, 1, 3, 0, 4]
    weight = {c.frame: c.weight for c in ranked}
    assert weight[2] == 1.0
    assert weight[0] == weight[4] == pytest.approx(np.exp(-0.1 * 4))
    assert all(c.score == c.occupied_voxels * c.weight for c in ranked)


def test_the_middle_beats_better_coverage_only_when_gamma_says_so():
    clouds = clouds_of([10, 10, 10, 10, 12])
    assert rank_keyframes(clouds, KeyframeConfig(voxels=8, gamma=0.001))[0].frame == 4
    assert rank_keyframes(clouds, KeyframeConfig(voxels=8, gamma=0.1))[0].frame == 2


@pytest.mark.parametrize(("choice", "frame"), [("first", 0), ("middle", 2), ("4", 4), ("0", 0)])
def test_the_users_frame_is_the_only_candidate(choice, frame):
    ranked = rank_keyframes(clouds_of([10, 90, 10, 10, 10]), KeyframeConfig(choice=choice, voxels=8))
    assert [c.frame for c in ranked] == [frame]
    assert ranked[0].why


def test_the_middle_of_an_even_number_of_frames_is_the_earlier_one():
    assert rank_keyframes(clouds_of([10] * 4), KeyframeConfig(choice="middle", voxels=8))[0].frame == 1


def test_an_index_beyond_the_sequence_names_the_range():
    with pytest.raises(InputError, match=r"0\.\.4, got 5"):
        rank_keyframes(clouds_of([10] * 5), KeyframeConfig(choice="5", voxels=8))


def ball(rng: np.random.Generator, count: int, radius: float = 0.4) -> np.ndarray:
    x = rng.normal(size=(count, 3))
    return radius * x / np.linalg.norm(x, axis=1, keepdims=True)


def test_frames_that_show_half_of_the_surface_come_last(rng):
    clouds = [ball(rng, 1500) for _ in range(7)]
    # As many points as the others have, so that fine voxels see no difference.
    clouds[3] = ball(rng, 3000)
    clouds[3] = clouds[3][clouds[3][:, 2] > 0]
    ranked = rank_keyframes(clouds, KeyframeConfig(voxels=512))
    assert ranked[-1].frame == 3 and not ranked[-1].full and ranked[-1].coverage < 0.7
    assert ranked[0].full and "1 frames show less than 87%" in ranked[0].why
    assert rank_keyframes(clouds, KeyframeConfig(voxels=512, coverage_min=0))[-1].frame != 3


def test_what_speaks_against_the_frame_asked_for_is_told(rng):
    """Half of the surface, or few points beside the others; nothing of a frame like them, nor where none was named."""
    clouds = [ball(rng, 1500) for _ in range(7)]
    clouds[3], clouds[5] = ball(rng, 3000), ball(rng, 500)
    clouds[3] = clouds[3][clouds[3][:, 2] > 0]
    said = {c: doubt_of_asked(clouds, KeyframeConfig(choice=c)) for c in ("auto", "first", "middle", "2", "3", "5")}
    assert said["auto"] == said["first"] == said["2"] == "" and said["middle"] == said["3"]
    assert re.match(r"frame 3, the keyframe asked for, shows (5|6)\d% of the surface", said["3"])
    assert "has 500 points, where frames have 1,500" in said["5"]
    best = rank_keyframes(clouds, KeyframeConfig())[0].frame
    assert all(said[c].endswith(f"--keyframe auto would take frame {best}") for c in ("3", "5"))


def test_the_frame_in_which_objects_lie_apart_is_taken(rng):
    def pair(gap: float) -> np.ndarray:
        return np.concatenate([ball(rng, 800, 0.2), ball(rng, 800, 0.2) + [0.4 + gap, 0, 0]])

    clouds = [pair(0.0), pair(0.0), pair(0.0), pair(0.01), pair(0.3)]
    assert list(compare_frames(clouds)[2]) == [1, 1, 1, 1, 2]
    ranked = rank_keyframes(clouds, KeyframeConfig())
    assert ranked[0].frame == 4 and ranked[0].objects == 2
    assert "2 objects lie apart there, which touch in other frames" in ranked[0].why


def test_a_part_before_another_is_no_object_of_its_own_for_one_camera(rng):
    clouds = [np.concatenate([ball(rng, 800, 0.3), ball(rng, 400, 0.1) + [0, 0, away]]) for away in (0.2, 0.8, 0.2)]
    assert list(compare_frames(clouds)[2]) == [1, 2, 1]
    assert list(compare_frames(clouds, np.array([0.0, 0, 1]))[2]) == [1, 1, 1]
    assert list(compare_frames(clouds, np.array([1.0, 0, 0]))[2]) == [1, 2, 1]
    assert rank_keyframes(clouds, KeyframeConfig(), None, np.array([0.0, 0, 1]))[0].objects == 1


def test_a_foot_that_is_cut_off_in_the_picture_is_no_object(rng):
    foot, away = ball(rng, 60, 0.1), np.array([0.0, 0, 1])
    body, second = ball(rng, 1000, 0.4), ball(rng, 400, 0.25) + [1.0, 0, 0]
    clouds = [np.concatenate([body, foot + [1.0, 0, 0]]), np.concatenate([body, second])]
    assert list(compare_frames(clouds)[2]) == [2, 2]
    assert list(compare_frames(clouds, away)[2]) == [1, 2]


def test_further_candidates_are_no_neighbours_of_the_first(rng):
    ranked = rank_keyframes([ball(rng, 600) for _ in range(33)], KeyframeConfig())
    chosen = spread_out(ranked, 4)
    assert chosen[0] is ranked[0] and len(chosen) == 4
    assert np.diff(sorted(c.frame for c in chosen)).min() >= 3
    assert spread_out(ranked[:2], 4)[1] is ranked[1]


def test_empty_frames_are_no_keyframes(rng):
    clouds = [ball(rng, 200), np.zeros((0, 3)), ball(rng, 200)]
    assert sorted(c.frame for c in rank_keyframes(clouds, KeyframeConfig())) == [0, 2]
    with pytest.raises(InputError, match="frame 1 has no usable points"):
        rank_keyframes(clouds, KeyframeConfig(choice="1"))


def test_the_middle_is_as_wide_a_share_of_a_long_film_and_of_scans_in_no_order() -> None:
    config = KeyframeConfig(voxels=8, gamma=0.01)
    weight = {c.frame: c.weight for c in rank_keyframes(clouds_of([10] * 85), config)}
    assert weight[0] == weight[84] == pytest.approx(np.exp(-0.01 * 42**2 / 25))
    alone = rank_keyframes(clouds_of([10] * 85), KeyframeConfig(voxels=8, gamma=0.01, gamma_fall=0.0))
    assert {c.frame: c.weight for c in alone}[0] == pytest.approx(np.exp(-0.01 * 42**2))
    ranked = rank_keyframes(clouds_of([10] * 5), config, np.array([3, 0, 4, 2, 1]))
    assert [c.frame for c in ranked] == [3, 0, 4, 1, 2]
