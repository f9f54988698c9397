"""File names as time: order, gaps, and what is no single series."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from warpdef.errors import InputError
from warpdef.files import read_clouds
from warpdef.files.frame_numbers import read_names

CLOUDS = np.random.default_rng(0).normal(size=(12, 15, 3))


def save(folder: Path, *names: str) -> Path:
    for t, name in enumerate(names):
        np.save(folder / f"{name}.npy", CLOUDS[t])
    return folder


@pytest.mark.parametrize(
    ("names", "missing"),
    [
        (["f0", "f1", "f2", "f4"], {3: 1}),
        (["0", "1", "3"], {2: 1}),
        (["f000", "f010", "f020", "f050", "f060"], {3: 2}),
        (["f1", "f2", "f3", "f6", "f7"], {3: 2}),
        (["f2", "f10", "f100"], {}),  # uneven: a choice of frames
        (["f1", "f2", "f3", "f5", "f8"], {}),
        (["f0", "f1", "f2", "f500", "f501", "f502"], {}),  # two takes: too long to be filled
        (["1000033", "1000066", "1000100", "1000166", "1000200"], {3: 1}),  # milliseconds
        (["t12.033", "t12.066", "t12.1", "t12.133", "t12.2"], {4: 1}),
        (["a", "b", "c"], {}),
    ],
)
def test_a_gap_in_the_numbers(names, missing):
    found = read_names(names)
    assert found.missing == missing
    assert [names[i] for i in found.order] == names


@pytest.mark.parametrize(
    "names",
    [
        ["2024-03-05_23-59-58", "2024-03-05_23-59-59", "2024-03-06_00-00-00"],
        ["30.01.2024 08.00.00", "31.01.2024 08.00.00", "01.02.2024 08.00.00"],
        ["01-30-2024", "01-31-2024", "02-01-2024"],  # a month cannot be 30
        ["05Feb2024_10-00-00", "06Feb2024_09-00-00", "01Mar2024_08-00-00"],
        ["scan 11-59-58 AM", "scan 11-59-59 AM", "scan 12-00-00 PM", "scan 01-00-00 PM"],
        ["23-59-58", "23-59-59", "00-00-00", "00-00-01"],
        ["20240305_235958", "20240305_235959", "20240306_000000"],
        ["9", "10", "0011", "12"],
        ["take1.1", "take1.2", "take1.10", "take1.100"],  # a counter, no decimals
        ["b_001_x", "b_002_x", "b_003_x"],
        ["t1709683199.5", "t1709683200.25", "t1709683200.375"],
    ],
)
def test_names_sort_as_time(names):
    shuffled = [*names[1::2], *names[0::2][::-1]]
    assert [shuffled[i] for i in read_names(shuffled).order] == names


def test_uneven_numbers_are_told():
    numbering = read_names(["f10", "f12", "f14", "f500", "f503", "f504"])
    (note,) = numbering.notes
    assert note.startswith("the numbers in the file names are uneven, from 14 to 500 at once")
    assert numbering.times == [0.0, 1.0, 2.0, 245.0, 246.5, 247.0] and not numbering.missing
    assert read_names(["f10", "f12", "f14", "f18"]).times is None


def test_times_past_midnight_are_told():
    assert read_names(["23-59-59", "00-00-00", "00-00-01"]).notes[0].endswith("'23-59-59' is taken for the first")
    assert read_names(["10-00-00", "10-00-01", "10-00-02"]).notes == ()


def test_a_date_that_may_be_two_is_refused():
    with pytest.raises(InputError, match="may begin with the day or with the month"):
        read_names(["01-02-2024", "02-01-2024", "02-02-2024"])


@pytest.mark.parametrize(
    ("names", "shown"),
    [
        (["left_0", "left_1", "right_0", "right_1"], "'left_0.npy' and 'right_0.npy'"),
        (["cam0_001", "cam0_002", "cam0_003", "cam1_001", "cam1_002", "cam1_003"], "'cam0_001' and 'cam1_001'"),
        (["001_a", "002_a", "001_b", "002_b"], "'001_a.npy' and '001_b.npy'"),
    ],
)
def test_two_series_are_refused_by_name(tmp_path, names, shown):
    with pytest.raises(InputError, match=f"expected one series of frames, got 2, as {shown}"):
        read_clouds(save(tmp_path, *names))


def test_the_same_number_twice_is_refused(tmp_path):
    with pytest.raises(InputError, match="two files have the number 1: '1' and '01'"):
        read_clouds(save(tmp_path, "0", "1", "01", "2"))


@pytest.mark.parametrize(
    "names", [["f_-2", "f_-1", "f_0", "f_1"], ["-1", "0", "1"], ["a -10 b", "a -9 b", "a 2 b"], ["x-1", "x-2", "x-3"]]
)
def test_a_minus_is_a_sign_where_others_have_none(names):
    found = read_names(names[::-1])
    assert [names[::-1][i] for i in found.order] == names and found.notes[1:] == ()


def test_a_minus_before_all_numbers_is_told(tmp_path):
    sequence = read_clouds(save(tmp_path, "f_-1", "f_-2", "f_-3"))
    np.testing.assert_array_equal(np.stack(sequence.points), CLOUDS[:3])
    assert "taken for a dash: 'f_-1' is the first" in sequence.warnings[0]


def test_negative_numbers_are_one_series(tmp_path):
    sequence = read_clouds(save(tmp_path, "-2", "-1", "1", "2"))
    assert sequence.frame_names[2] == "missing number 0" and len(sequence) == 4


def test_a_missing_number_is_a_gap_with_its_name(tmp_path):
    sequence = read_clouds(save(tmp_path, "scan_000", "scan_001", "scan_002", "scan_004", "scan_005"))
    assert sequence.frame_count == 6 and [gap.number for gap in sequence.gaps] == [3]
    assert sequence.warnings == (
        "frame 3 of 6 cannot be used; its mesh is interpolated between the neighbours. "
        "Why: number 3 is missing between scan_002.npy and scan_004.npy",
    )
    np.testing.assert_array_equal(sequence.points[3], CLOUDS[3])
    assert read_clouds(tmp_path, slice(2, 5)).frame_count == 3
    with pytest.raises(InputError, match="number 3 is missing"):
        read_clouds(tmp_path, strict=True)


def test_a_frame_of_another_kind_leaves_its_place_empty(tmp_path):
    save(tmp_path, "0", "1", "3", "4")
    (tmp_path / "2.xyz").write_text("0 0 0\n")
    sequence = read_clouds(tmp_path)
    assert [gap.number for gap in sequence.gaps] == [2]
    assert "number 2 is missing between 1.npy and 3.npy; '2.xyz' is no .npy file" in " ".join(sequence.warnings)


def test_a_template_beside_the_frames_is_passed_over(tmp_path):
    sequence = read_clouds(save(tmp_path, "scan0", "scan1", "scan2", "mean7"))
    assert len(sequence) == 3 and "passed over" in sequence.warnings[0] and "'mean7.npy'" in sequence.warnings[0]


@pytest.mark.parametrize("extra", [False, True])
def test_a_folder_a_frame(tmp_path, extra):
    for t, name in enumerate(("f0", "f1", "f2", "f10")):
        (tmp_path / name).mkdir()
        np.save(tmp_path / name / "cloud.npy", CLOUDS[t])
        if extra:
            np.save(tmp_path / name / f"mask{t}.npy", CLOUDS[t])
    sequence = read_clouds(tmp_path)
    assert sequence.names == ("f0/cloud.npy", "f1/cloud.npy", "f2/cloud.npy", "f10/cloud.npy")
    np.testing.assert_array_equal(sequence.points[3], CLOUDS[3])
