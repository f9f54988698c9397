"""A sequence of clouds: what is cleaned, what becomes a gap, what is told, and how gaps are filled."""

from __future__ import annotations

import numpy as np
import pytest
from mutation_samples import CLOUDS, NORMALS
from present import present
from synthetic import icosphere, turn_about

from warpdef.cloud import FramePoints
from warpdef.config import KeyframeConfig
from warpdef.errors import InputError, MissingPackageError
from warpdef.files import read_clouds
from warpdef.mesh import float32_where_exact
from warpdef.motion.between import mesh_between
from warpdef.motion.gaps import fill_gaps
from warpdef.sequence import PointSequence, Similarity, name_frames
from warpdef.template.keyframe import rank_keyframes

EMPTY = np.zeros((0, 3))


def with_gaps() -> PointSequence:
    """Six frames, of which 0 and 3 cannot be used."""
    return PointSequence.from_arrays([EMPTY, CLOUDS[0], CLOUDS[1], CLOUDS[2][:5], CLOUDS[3], CLOUDS[0] + 9])


def test_gaps_are_numbered_as_in_the_input():
    sequence = with_gaps()
    assert (len(sequence), sequence.frame_count, sequence.numbers) == (4, 6, (1, 2, 4, 5))
    assert [gap.number for gap in sequence.gaps] == [0, 3]
    assert sequence.names == ("frame 1", "frame 2", "frame 4", "frame 5")
    assert sequence.frame_names == tuple(f"frame {t}" for t in range(6))
    assert [len(p) for p in sequence.all_frames()] == [0, 40, 40, 0, 40, 40]
    assert sequence.all_normals() == [None] * 6
    inner, outer = sequence.warnings
    assert inner.startswith(
        "frame 3 of 6 cannot be used; its mesh is interpolated between the neighbours. Why: frame 3:"
    )
    assert outer.startswith("frame 0 of 6 cannot be used; its mesh is that of the nearest frame. Why: frame 0:")
    assert not any("\n" in line for line in sequence.warnings)


@pytest.mark.parametrize(
    ("frames", "numbers", "gaps"),
    [
        (slice(None), (1, 2, 4, 5), (0, 3)),
        (slice(None, None, -1), (0, 1, 3, 4), (2, 5)),
        (slice(1, 5), (0, 1, 3), (2,)),
        (slice(1, None, 3), (0, 1), ()),
        (slice(2, 5), (0, 2), (1,)),
    ],
)
def test_select_counts_gaps(frames, numbers, gaps):
    sequence = with_gaps()
    chosen = sequence.select(frames)
    assert (chosen.numbers, tuple(gap.number for gap in chosen.gaps)) == (numbers, gaps)
    assert chosen.frame_names == sequence.frame_names[frames]
    for cloud, expected in zip(chosen.all_frames(), sequence.all_frames()[frames], strict=True):
        np.testing.assert_array_equal(cloud, expected)


def test_select_needs_two_usable_frames():
    with pytest.raises(InputError, match="at least 2 of 6 frames with usable points, got 1"):
        with_gaps().select(slice(2, 4))
    with pytest.raises(InputError, match="at least 2 of 6 frames, got 1; widen"):
        with_gaps().select(slice(1, 2))


def test_strict_refuses_what_is_skipped_else():
    with pytest.raises(InputError, match="frame 0: expected at least 10 points, got 0"):
        PointSequence.from_arrays([EMPTY, *CLOUDS], strict=True)
    assert len(PointSequence.from_arrays([EMPTY, *CLOUDS])) == 4


def test_more_than_half_unusable_is_refused():
    assert len(PointSequence.from_arrays([*CLOUDS[:2], EMPTY, EMPTY])) == 2
    with pytest.raises(InputError, match=r"frame 2: expected at least 10 points, got 0.* \(3 of 5 frames"):
        PointSequence.from_arrays([*CLOUDS[:2], EMPTY, EMPTY, EMPTY])
    with pytest.raises(InputError, match="frame 1: expected at least 10 points, got 0"):
        PointSequence.from_arrays([CLOUDS[0], EMPTY])
    with pytest.raises(InputError, match="expected at least 2 frames, got 1"):
        PointSequence.from_arrays([CLOUDS[0]])
    with pytest.raises(InputError, match="normals: expected 4 frames as in points, got 3"):
        PointSequence.from_arrays(CLOUDS, NORMALS[:3])


def test_a_missing_package_is_no_gap():
    def read():
        raise MissingPackageError("install it")

    with pytest.raises(MissingPackageError):
        PointSequence.from_frames(
            [("a", read), *((str(t), lambda p=p: FramePoints(p, None)) for t, p in enumerate(CLOUDS))]
        )


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e31])
def test_points_that_are_no_numbers_are_left_out(bad):
    broken = CLOUDS[1].copy()
    broken[[3, 7], [0, 2]] = bad
    sequence = PointSequence.from_arrays([CLOUDS[0], broken], NORMALS[:2])
    rest = np.delete(np.arange(40), [3, 7])
    np.testing.assert_array_equal(sequence.points[1], CLOUDS[1][rest])
    np.testing.assert_allclose(present(sequence.normals[1]), NORMALS[1][rest], rtol=0, atol=1e-15)
    assert sequence.dropped == (0, 2)
    assert sequence.warnings == ("points left out that are not finite, beyond 1e+30 or all at one place: 2 in frame 1",)


def test_duplicates_are_merged_and_told():
    doubled = np.concatenate([CLOUDS[1], CLOUDS[1][5:8], [[0.0, -0.0, 0.0], [-0.0, 0.0, 0.0]]])
    sequence = PointSequence.from_arrays([CLOUDS[0], doubled, CLOUDS[2], doubled])
    np.testing.assert_array_equal(sequence.points[1], np.concatenate([CLOUDS[1], [[0.0, 0.0, 0.0]]]))
    assert sequence.merged == (0, 4, 0, 4)
    assert sequence.warnings == ("duplicate points merged: 8 in frames 1, 3",)


def test_one_place_of_many_points_is_a_mark_of_nothing_seen():
    """As the zeros of an organised cloud; not where others are repeated as often, nor where nothing else is there."""
    seen = np.concatenate([np.zeros((30, 3)), CLOUDS[1], np.zeros((3, 3))])
    sequence = PointSequence.from_arrays([CLOUDS[0], seen, np.repeat(CLOUDS[2], 12, axis=0)], [None, -seen, None])
    np.testing.assert_array_equal(sequence.points[1], CLOUDS[1])
    np.testing.assert_array_equal(sequence.points[2], CLOUDS[2])
    assert (sequence.dropped, sequence.merged) == ((0, 33, 0), (0, 0, 11 * 40))
    with pytest.raises(InputError, match="all points are equal"):
        PointSequence.from_arrays([np.ones((40, 3))] * 2)


def test_duplicates_are_those_that_unique_finds(rng):
    points = rng.integers(0, 6, size=(500, 3)).astype(np.float64)
    _, first = np.unique(points, axis=0, return_index=True)
    sequence = PointSequence.from_arrays([points, points[::-1]])
    np.testing.assert_array_equal(sequence.points[0], points[np.sort(first)])
    assert sequence.merged[1] == 500 - len(first)


@pytest.mark.parametrize("factor", [1.0, 1e-300, 1e300, 17.0])
def test_normals_of_any_length(factor):
    sequence = PointSequence.from_arrays(CLOUDS, [n * factor for n in NORMALS])
    for found, expected in zip(sequence.normals, NORMALS, strict=True):
        np.testing.assert_allclose(present(found), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("bad", [0.0, np.nan, np.inf])
def test_normals_that_say_nothing_are_disowned(bad):
    broken = NORMALS[2].copy()
    broken[4] = bad
    sequence = PointSequence.from_arrays(CLOUDS, [*NORMALS[:2], broken, NORMALS[3]])
    assert [n is None for n in sequence.normals] == [False, False, True, False]
    assert sequence.warnings == ("normals of length 0 or not finite: those of frame 2 are estimated instead",)


@pytest.mark.parametrize(
    ("normals", "message"),
    [
        (np.ones((39, 3)), r"normals: expected shape \(40, 3\) as the points have, got \(39, 3\)"),
        ("up", r"normals: expected numbers of shape \(N, 3\), got something else"),
    ],
)
def test_normals_that_do_not_fit(normals, message):
    with pytest.raises(InputError, match=message):
        PointSequence.from_arrays(CLOUDS[:2], [NORMALS[0], normals])


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (["a"] * 12, "got something else"),
        (np.ones((12, 4)), "drop the columns after the third"),
        (np.ones(12), r"got \(12,\)"),
        (np.ones((12, 3)), "all points are equal"),
        (np.repeat(CLOUDS[0][:4], 5, axis=0), "at least 10 different points, got 4"),
    ],
)
def test_frames_that_cannot_be_used(points, message):
    with pytest.raises(InputError, match=message):
        PointSequence.from_arrays([points, CLOUDS[0]])


def test_unequal_counts_need_no_warning():
    assert PointSequence.from_arrays([CLOUDS[0], CLOUDS[1][:11], CLOUDS[2][:30]]).warnings == ()


def test_reading_fewer_points_is_reading_and_drawing(tmp_path):
    np.savez(tmp_path / "a.npz", points=np.stack(CLOUDS), normals=np.stack(NORMALS))
    whole, drawn = read_clouds(tmp_path / "a.npz"), read_clouds(tmp_path / "a.npz", points=12, seed=3)
    for found, expected in zip(
        drawn.points + drawn.normals, (s := whole.subsample(12, 3)).points + s.normals, strict=True
    ):
        np.testing.assert_array_equal(found, expected)
    with pytest.raises(InputError, match="--points: expected at least 10, got 9"):
        read_clouds(tmp_path / "a.npz", points=9)
    # A frame's draw depends on its number in the input, not on what is missing before it.
    apart = PointSequence.from_arrays([EMPTY, *CLOUDS[1:]]).subsample(12, 3)
    np.testing.assert_array_equal(apart.points[0], s.points[1])


def test_frames_are_named_in_runs():
    assert name_frames([4]) == "frame 4"
    assert name_frames([9, 3, 4, 5]) == "frames 3-5, 9"
    assert name_frames(range(0, 40, 2)) == "frames 0, 2, 4, 6, 8, 10, 12, ... 38"


def test_gaps_are_filled(rng):
    fitted = rng.normal(size=(3, 5, 3)).astype(np.float32)
    filled = fill_gaps(fitted, (1, 2, 6), 8)
    assert filled.dtype == np.float32
    np.testing.assert_array_equal(filled[[1, 2, 6]], fitted)
    np.testing.assert_array_equal(filled[[0, 7]], fitted[[0, 2]])
    np.testing.assert_allclose(filled[3], 0.75 * fitted[1] + 0.25 * fitted[2], rtol=0, atol=1e-6)
    np.testing.assert_allclose(filled[5], 0.25 * fitted[1] + 0.75 * fitted[2], rtol=0, atol=1e-6)
    assert fill_gaps(fitted, (0, 1, 2), 3) is fitted


def test_gaps_are_filled_at_their_times(rng) -> None:
    fitted = rng.normal(size=(3, 5, 3))
    filled = fill_gaps(fitted, (0, 1, 3), 4, times=(0.0, 1.0, 10.0, 11.0))
    np.testing.assert_allclose(filled[2], 0.1 * fitted[1] + 0.9 * fitted[2], rtol=0, atol=1e-12)
    sphere, faces = icosphere(1)
    way = np.array([1.0, 0.0, 0.0])
    filled = fill_gaps(
        np.stack([sphere + t * way for t in (0.0, 1.0, 11.0)]), (0, 1, 3), 4, faces, (0.0, 1.0, 10.0, 11.0)
    )
    np.testing.assert_allclose(filled[2], sphere + 10.0 * way, rtol=0, atol=1e-9)


def test_a_mesh_turns_through_its_gaps():
    """Halfway of a turn by 80 degrees the sphere keeps its size; straight ways would shrink it to 0.77."""
    sphere, faces = icosphere(2)
    turned = np.stack([sphere @ turn_about([0, 0, 1], angle).T for angle in np.deg2rad([0, 40, 80])])
    filled = fill_gaps(turned[[0, 2]], (1, 3), 4, faces)
    np.testing.assert_array_equal(filled[[0, 1, 3]], turned[[0, 0, 2]])
    np.testing.assert_allclose(filled[2], turned[1], rtol=0, atol=1e-3)


@pytest.mark.parametrize("missing", [(2,), (3, 4), (1,), (5,), (1, 2, 3)])
def test_what_speeds_up_arrives_in_time_for_its_gaps(missing: tuple[int, ...]) -> None:
    """A sphere that turns and flies off ever faster: five times nearer than at even speed."""
    sphere, faces = icosphere(2)
    times = list(range(7))
    angles, ways = np.deg2rad(1.0) * np.square(times), 0.05 * np.square(times)[:, None] * [1.0, 0.5, 0.0]
    true = np.stack([sphere @ turn_about([0, 0, 1], a).T + w for a, w in zip(angles, ways, strict=True)])
    left = [t for t in times if t not in missing]
    filled = fill_gaps(true[left], left, 7, faces)
    before, after = missing[0] - 1, missing[-1] + 1
    share = (np.array(missing) - before) / (after - before)
    off, even = (
        np.linalg.norm(found - true[list(missing)], axis=-1).mean()
        for found in (filled[list(missing)], mesh_between(true[[before, after]], faces, share))
    )
    assert off < 0.2 * even
    np.testing.assert_array_equal(filled[left], true[left])


def test_fast_limbs_and_long_gaps_turn_evenly() -> None:
    """A rod that turns by 100 degrees a frame would shrink on a cubic; speeds are not believed over four frames."""
    sphere, faces = icosphere(2)
    rod = sphere * [1.0, 0.1, 0.1] + [1.0, 0.0, 0.0]
    for step, frames, count in ((50.0, (0, 2, 4), 5), (4.0, (0, 1, 6, 7), 8)):
        true = np.stack([rod @ turn_about([0, 0, 1], np.deg2rad(step) * t).T for t in frames])
        filled = fill_gaps(true, frames, count, faces)
        at = 1 if count == 8 else 0
        even = mesh_between(
            true[at : at + 2], faces, np.arange(1, frames[at + 1] - frames[at]) / (frames[at + 1] - frames[at])
        )
        np.testing.assert_array_equal(filled[frames[at] + 1 : frames[at + 1]], even)


def test_a_gap_is_no_keyframe():
    unit = [EMPTY, *(0.1 * c for c in CLOUDS)]
    assert 0 not in [candidate.frame for candidate in rank_keyframes(unit, KeyframeConfig())]
    assert rank_keyframes(unit, KeyframeConfig(choice="2"))[0].frame == 2
    with pytest.raises(InputError, match="--keyframe: frame 0 has no usable points"):
        rank_keyframes(unit, KeyframeConfig(choice="first"))


@pytest.mark.parametrize("size", [1e-25, 1e-6, 1.0, 1e6, 1e25])
@pytest.mark.parametrize("away", [0.0, 3.0, 1e3, 1e6])
def test_floats_keep_a_millionth_of_the_shape(rng, size, away):
    vertices = size * (rng.uniform(-0.5, 0.5, size=(2, 50, 3)) + away)
    kept = float32_where_exact(vertices)
    assert np.abs(kept - vertices).max() <= 1e-6 * size
    assert (kept.dtype == np.float32) == (away < 10)


def test_a_sequence_without_extent_is_refused():
    with pytest.raises(InputError, match="expected an extent above 1e-30, got 3e-40"):
        Similarity.into_cube([np.zeros((10, 3)), np.full((10, 3), 3e-40)], 0.95)


@pytest.mark.parametrize("shift", [0.0, 1e6])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_the_cube_is_the_same_for_any_units(scale, shift):
    plain = Similarity.into_cube(CLOUDS, 0.95)
    moved = [c * scale + shift * scale for c in CLOUDS]
    into = Similarity.into_cube(moved, 0.95)
    for a, b in zip(CLOUDS, moved, strict=True):
        # Float64 far out resolves 1e-16 of the shift.
        np.testing.assert_allclose(into.to_cube(b), plain.to_cube(a), rtol=0, atol=1e-14 + 1e-16 * shift)
