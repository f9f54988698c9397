"""Arrays as people save them: every layout gives the same clouds, or a sentence that says what to do."""

from __future__ import annotations

import numpy as np
import pytest

from warpdef.errors import InputError
from warpdef.files import read_clouds

POINTS = np.random.default_rng(0).normal(size=(4, 20, 3))
NORMALS = POINTS / np.linalg.norm(POINTS, axis=2, keepdims=True)
BOTH = np.concatenate([POINTS, NORMALS], axis=2)


@pytest.mark.parametrize(
    ("arrays", "normals"),
    [
        ({"points": POINTS}, False),
        ({"points": np.asfortranarray(POINTS)}, False),
        ({"points": BOTH}, True),
        ({"points": POINTS, "normals": NORMALS}, True),
        ({"arr_0": POINTS}, False),
        ({"xyz": BOTH, "fps": np.array(24)}, True),
        ({f"arr_{t}": p for t, p in enumerate(POINTS)}, False),
        ({f"frame{t}": p for t, p in enumerate(BOTH)}, True),
        ({f"points_{t}": p for t, p in enumerate(BOTH)}, True),
    ],
)
def test_layouts_of_an_npz(tmp_path, arrays, normals):
    np.savez(tmp_path / "a.npz", **arrays)
    assert_read(read_clouds(tmp_path / "a.npz"), normals)


@pytest.mark.parametrize("rows", [POINTS, BOTH])
def test_an_npy_of_all_frames(tmp_path, rows):
    np.save(tmp_path / "a.npy", rows)
    assert_read(read_clouds(tmp_path / "a.npy"), rows is BOTH)


@pytest.mark.parametrize("name", ["points", "arr_0"])
def test_an_npz_a_frame(tmp_path, name):
    for t in range(4):
        np.savez(tmp_path / f"{t:03d}.npz", **{name: POINTS[t], "normals": NORMALS[t]})
    (tmp_path / "notes.txt").write_text("to be passed over")
    assert_read(read_clouds(tmp_path), True)


def assert_read(sequence, normals: bool) -> None:
    np.testing.assert_array_equal(np.stack(sequence.points), POINTS)
    if normals:
        np.testing.assert_allclose(np.stack(sequence.normals), NORMALS, atol=1e-15)
    else:
        assert sequence.normals == (None,) * 4


def test_another_name_is_told(tmp_path):
    np.savez(tmp_path / "a.npz", POINTS)
    assert read_clouds(tmp_path / "a.npz").warnings == ("the array 'arr_0' is taken for the points",)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (POINTS.transpose(0, 2, 1), r"got \(4, 3, 20\); transpose it: points.transpose\(0, 2, 1\)"),
        (POINTS.transpose(2, 0, 1), r"got \(3, 4, 20\); transpose it: points.transpose\(1, 2, 0\)"),
        (POINTS.transpose(1, 0, 2), r"got \(20, 4, 3\); transpose it: points.transpose\(1, 0, 2\)"),
        (POINTS[0], r"expected shape \(T, N, 3\), got \(20, 3\); that is one cloud"),
        (POINTS.reshape(4, 5, 4, 3), r"got \(4, 5, 4, 3\); .*points.reshape\(len\(points\), -1, 3\)"),
        (BOTH[..., :4], r"got \(4, 20, 4\); leave out what is no coordinate"),
        (np.concatenate([POINTS, POINTS * 0 + 2000.5], axis=2), "expected normals or colours in columns 4 to 6"),
    ],
)
def test_another_shape_says_what_to_do(tmp_path, points, message):
    np.savez(tmp_path / "a.npz", points=points)
    with pytest.raises(InputError, match=message):
        read_clouds(tmp_path / "a.npz")


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (POINTS[0].T, r"got \(3, 20\); transpose it: points.T"),
        (POINTS[0].reshape(4, 5, 3), r"got \(4, 5, 3\); an image of points becomes a list by points.reshape\(-1, 3\)"),
        (np.random.default_rng(0).random((48, 64)), "at most 16 columns without names .*got 64: depth images"),
    ],
)
def test_a_frame_of_another_shape_says_what_to_do(tmp_path, table, message):
    for t in range(3):
        np.save(tmp_path / f"{t}.npy", table)
    with pytest.raises(InputError, match=message):
        read_clouds(tmp_path)


def test_a_wide_table_is_read_where_people_say_what_it_holds(tmp_path):
    for t in range(3):
        np.save(tmp_path / f"{t}.npy", np.concatenate([POINTS[t], np.zeros((20, 30))], axis=1))
    np.testing.assert_array_equal(read_clouds(tmp_path, columns="x,y,z").points, POINTS[:3])


def test_numbers_of_arrays_are_time(tmp_path):
    np.savez(tmp_path / "a.npz", **{f"points_{n}": p for n, p in zip((12, 9, 8, 10), POINTS, strict=True)})
    sequence = read_clouds(tmp_path / "a.npz")
    np.testing.assert_array_equal(np.stack(sequence.points), POINTS[[2, 1, 3, 0]])
    assert [gap.number for gap in sequence.gaps] == [3]
    assert "number 11 is missing between points_10 and points_12" in sequence.warnings[0]
    np.savez(tmp_path / "b.npz", **{f"points_{n}": p for n, p in zip((0, 1, 2, 50), POINTS, strict=True)})
    uneven = read_clouds(tmp_path / "b.npz")
    assert uneven.times == (0.0, 1.0, 2.0, 50.0) and "uneven, from 2 to 50 at once" in uneven.warnings[0]
    np.savez(tmp_path / "c.npz", points_1=POINTS[0], points_01=POINTS[1], points_2=POINTS[2])
    with pytest.raises(InputError, match="have the number 1: 'points_1' and 'points_01'; keep one of them"):
        read_clouds(tmp_path / "c.npz")


def test_two_arrays_that_could_be_meant_are_not_guessed(tmp_path):
    np.savez(tmp_path / "a.npz", left=POINTS, right=POINTS)
    with pytest.raises(InputError, match="expected an array 'points' .*got left, right"):
        read_clouds(tmp_path / "a.npz")
