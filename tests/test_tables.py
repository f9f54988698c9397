"""Tables of text as programs write them: columns are what they are, or the reader says that it cannot tell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from warpdef.errors import InputError
from warpdef.files import read_clouds
from warpdef.files.columns import parse_columns, role_of
from warpdef.files.formats import CLOUD_SUFFIXES, read_surface

RNG = np.random.default_rng(0)
POINTS = np.round(RNG.normal(size=(30, 3)) * 3, 4)
NORMALS = RNG.normal(size=(30, 3))
NORMALS = np.round(NORMALS / np.linalg.norm(NORMALS, axis=1, keepdims=True), 6)
COLORS = RNG.integers(0, 256, size=(30, 3))
OTHER = np.round(RNG.normal(size=(30, 1)) * 40, 2)


def rows(*blocks: np.ndarray, between: str = " ", head: str = "", end: str = "\n") -> str:
    table = [np.asarray(b).tolist() for b in blocks]
    lines = [between.join(str(v) for block in table for v in block[i]) for i in range(len(POINTS))]
    return head + end.join(lines) + end


def read(folder: Path, text: str | bytes, name: str = "a.txt", columns: str = ""):
    (folder / name).write_bytes(text.encode() if isinstance(text, str) else text)
    return read_surface(folder / name, CLOUD_SUFFIXES, parse_columns(columns))


def assert_points(surface, normals: bool = False, colors: bool = False) -> None:
    np.testing.assert_array_equal(surface.points, POINTS)
    assert (surface.normals is not None) == normals and (surface.colors is not None) == colors
    if normals:
        np.testing.assert_array_equal(surface.normals, NORMALS)
    if colors:
        np.testing.assert_array_equal(surface.colors, COLORS)


@pytest.mark.parametrize("suffix", [".txt", ".csv", ".asc", ".pts", ".xyz", ".xyzn", ".xyzrgb", ".tsv"])
@pytest.mark.parametrize("between", [" ", "\t\t", ",", ", ", ";", " ; "])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_every_suffix_and_separator(tmp_path, suffix, between, end):
    assert_points(read(tmp_path, rows(POINTS, NORMALS, between=between, end=end), "a" + suffix), normals=True)


HEADS = {
    "CloudCompare": ("//X Y Z R G B Nx Ny Nz\n30\n", (POINTS, COLORS, NORMALS), " ", True, True),
    "csv": ("x,y,z,nx,ny,nz\n", (POINTS, NORMALS), ",", True, False),
    "other order": ('"id";"Normals:0";"Normals:1";"Normals:2";"Points:0";"Points:1";"Points:2"\n',
                    (np.arange(30)[:, None], NORMALS, POINTS), ";", True, False),
    "units": ("X [m],Y [m],Z [m],Intensity\n", (POINTS, OTHER), ",", False, False),
    "comment": ("# a scan\n# x y z normal_x normal_y normal_z r g b\n", (POINTS, NORMALS, COLORS), " ", True, True),
    "tabs": ("time\tX\tY\tZ\n", (OTHER, POINTS), "\t", False, False),
    "count": ("30\n", (POINTS,), " ", False, False),
    "pts": ("30\n", (POINTS, np.rint(OTHER), COLORS), " ", False, True),
    "words that say nothing": ("first second third\n", (POINTS,), " ", False, False),
}  # fmt: skip


@pytest.mark.parametrize("kind", HEADS)
def test_headings(tmp_path, kind):
    head, blocks, between, normals, colors = HEADS[kind]
    assert_points(read(tmp_path, rows(*blocks, between=between, head=head)), normals, colors)


@pytest.mark.parametrize(
    ("blocks", "normals", "colors", "line"),
    [
        ((POINTS,), False, False, "x y z"),
        ((POINTS, OTHER), False, False, "x y z; passed over: column 4"),
        ((POINTS, NORMALS, COLORS), True, True, "x y z nx ny nz red green blue"),
        ((POINTS, COLORS, NORMALS), True, True, "x y z nx ny nz red green blue"),
        ((POINTS, OTHER, COLORS), False, True, "x y z red green blue; passed over: column 4"),
        ((POINTS, COLORS[:, :1], COLORS), False, True, "x y z red green blue; passed over: column 4"),
        ((POINTS, COLORS, OTHER), False, True, "x y z red green blue; passed over: column 7"),
        ((POINTS, NORMALS, OTHER), True, False, "x y z nx ny nz; passed over: column 7"),
        ((np.arange(30)[:, None], POINTS, NORMALS), True, False, "x y z nx ny nz; passed over: column 1"),
    ],
)
def test_columns_without_names_are_told_by_their_values(tmp_path, blocks, normals, colors, line):
    surface = read(tmp_path, rows(*blocks))
    assert_points(surface, normals, colors)
    assert surface.columns == line


def test_columns_may_be_said(tmp_path):
    text = rows(OTHER, POINTS[:, ::-1], NORMALS, OTHER, head="a b c d e f g h\n")
    assert_points(read(tmp_path, text, columns="_,z,y,x,nx,ny,nz"), normals=True)
    with pytest.raises(InputError, match="--columns names 9 columns, the file has 8"):
        read(tmp_path, text, columns="_,z,y,x,nx,ny,nz,_,_")
    with pytest.raises(InputError, match="--columns is for tables without names"):
        read(tmp_path, b"ply\n", "a.ply", columns="x,y,z")
    for wrong in ("x,y", "x,y,z,x", "x,y,z,q"):
        with pytest.raises(InputError, match="--columns: expected"):
            parse_columns(wrong)


def comma(text: str) -> str:
    return text.replace(".", ",")


@pytest.mark.parametrize("between", [" ", "\t", ";", "; "])
def test_decimal_commas_are_read(tmp_path, between):
    assert_points(read(tmp_path, comma(rows(POINTS, NORMALS, between=between))), normals=True)


@pytest.mark.parametrize("letter", ["D", "d"])
def test_exponents_of_fortran_are_read(tmp_path, letter):
    text = "".join(" ".join(f"{v:.12e}" for v in row).replace("e", letter) + "\n" for row in POINTS)
    assert_points(read(tmp_path, text))


@pytest.mark.parametrize("between", [";", "\t"])
@pytest.mark.parametrize("marks", [",.", ".,"])
def test_marks_between_thousands_are_refused_by_name(tmp_path, between, marks):
    """1.234,56 was read as two columns, 1.234 and 56."""
    swapped = str.maketrans(",.", marks)
    lines = [between.join(f"{v:,.3f}".translate(swapped) for v in row) for row in POINTS * 1e5]
    with pytest.raises(InputError, match="which has marks between its thousands"):
        read(tmp_path, "\n".join(lines) + "\n", "a.csv")


@pytest.mark.parametrize("decimal", [".", ","])
def test_quotes_around_fields(tmp_path, decimal):
    lines = [",".join(f'"{v!r}"'.replace(".", decimal) for v in row.tolist()) for row in POINTS]
    assert_points(read(tmp_path, "\n".join(['"x","y","z"', *lines]) + "\n", "a.csv"))


def test_decimal_commas_between_commas_are_refused_by_name(tmp_path):
    text = "".join(",".join(f"{v:.4f}".replace(".", ",") for v in row) + "\n" for row in POINTS)
    with pytest.raises(InputError, match="commas stand between the columns and, it seems, before the decimals"):
        read(tmp_path, text, "a.csv")
    whole = rows(np.rint(POINTS * 1000).astype(int), COLORS, between=",")
    np.testing.assert_array_equal(read(tmp_path, whole).points, np.rint(POINTS * 1000))


@pytest.mark.parametrize("word", ["-1.#IND", "1.#QNAN", "-1.#QNAN0", "nan", "NaN", "-nan(ind)", "NULL", "inf"])
def test_numbers_that_are_none(tmp_path, word):
    text = rows(POINTS) + f"{word} {word} {word}\n"
    surface = read(tmp_path, text)
    np.testing.assert_array_equal(surface.points[:-1], POINTS)
    assert not np.isfinite(surface.points[-1]).any()


def test_an_empty_field_shifts_nothing(tmp_path):
    lines = rows(POINTS, OTHER, COLORS, between=",", head="x,y,z,depth,r,g,b\n").splitlines()
    cells = lines[3].split(",")
    lines[3] = ",".join([*cells[:3], "", *cells[4:]])
    lines[5] = "," + lines[5].split(",", 1)[1]
    surface = read(tmp_path, "\n".join(lines))
    assert np.isnan(surface.points[4, 0])
    np.testing.assert_array_equal(np.delete(surface.points, 4, axis=0), np.delete(POINTS, 4, axis=0))
    np.testing.assert_array_equal(surface.colors, COLORS)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_encodings_of_a_window(tmp_path, encoding):
    assert_points(read(tmp_path, rows(POINTS, head="x y z\n").encode(encoding)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (rows(POINTS, head="31\n"), "expected 31 points as the first line says, got 30"),
        (rows(POINTS) + "1 2\n", "line 31: expected 3 columns as before, got 2"),
        (rows(POINTS) + "1 2 up\n", "line 31: expected numbers, got 'up'"),
        (rows(POINTS[:, :2]), "expected at least 3 columns"),
        ("3\nwater\nO 0 0 0\nH 0 0 1\nH 0 1 0\n", "expected rows of numbers"),
        ("ncols 4\nnrows 4\ncellsize 1\n1 2 3 4\n", "expected rows of numbers"),
    ],
)
def test_what_is_no_table_of_points(tmp_path, text, message):
    with pytest.raises(InputError, match=message) as caught:
        read(tmp_path, text, "a.xyz")
    assert "\n" not in str(caught.value) and "a.xyz" in str(caught.value)


@pytest.mark.parametrize(
    ("name", "role"),
    [("X", "x"), ("//x", "x"), ("Points:2", "z"), ("n_y", "ny"), ("NormalZ", "nz"), ("normal_x", "nx"), ("R", "red"),
     ("diffuse_green", "green"), ("Y (m)", "y"), ("intensity", ""), ("index", "")],
)  # fmt: skip
def test_names(name, role):
    assert role_of(name) == role


def test_texts_beside_frames_are_no_frames(tmp_path):
    for t in range(3):
        np.save(tmp_path / f"{t}.npy", POINTS + t)
        (tmp_path / f"{t}.txt").write_text("1 0 0 0\n")
    sequence = read_clouds(tmp_path)
    assert sequence.names == ("0.npy", "1.npy", "2.npy") and sequence.warnings == ()
    for t in range(3):
        (tmp_path / f"{t}.npy").unlink()
        (tmp_path / f"{t}.txt").write_text(rows(POINTS + t))
    np.testing.assert_array_equal(read_clouds(tmp_path).points[2], POINTS + 2)


def test_frames_of_other_columns_are_told(tmp_path):
    for t in range(3):
        (tmp_path / f"{t}.xyz").write_text(rows(POINTS + t, NORMALS) if t != 1 else rows(POINTS + t))
    sequence = read_clouds(tmp_path)
    assert sequence.columns == "x y z nx ny nz"
    assert sequence.warnings == ("the columns differ: 'x y z nx ny nz' in the first frame, 'x y z' in 1.xyz",)
    assert read_clouds(tmp_path, columns="x,y,z").columns == "x y z; passed over: column 4, column 5, column 6"


@pytest.mark.parametrize(("name", "start"), [("a.obj", "v "), ("a.off", "")])
def test_decimal_commas_in_other_texts(tmp_path, name, start):
    lines = [start + " ".join(map(str, row)).replace(".", ",") for row in POINTS.tolist()]
    assert_points(read(tmp_path, ("" if start else "OFF\n30 0 0\n") + "\n".join(lines), name))
