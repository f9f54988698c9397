"""PLY as other programs write it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from warpdef.errors import InputError
from warpdef.files.formats import MESH_SUFFIXES, read_surface

RNG = np.random.default_rng(0)
POINTS = np.round(RNG.normal(size=(20, 3)), 3)
NORMALS = RNG.normal(size=(20, 3))
COLORS = RNG.integers(0, 256, size=(20, 3)).astype(np.uint8)


def header(properties: list[str], form: str = "ascii") -> str:
    lines = ["ply", f"format {form} 1.0", "comment TextureFile A b.png", "element vertex 20"]
    return "\n".join([*lines, *(f"property {p}" for p in properties), "end_header", ""])


def text(*blocks: np.ndarray) -> str:
    return "".join(" ".join(str(v) for block in blocks for v in np.atleast_1d(block[i])) + "\n" for i in range(20))


def read(folder: Path, data: str | bytes):
    (folder / "a.ply").write_bytes(data.encode() if isinstance(data, str) else data)
    return read_surface(folder / "a.ply", MESH_SUFFIXES)


XYZ = ["float x", "float y", "float z"]


@pytest.mark.parametrize(
    "names", ["nx ny nz", "normal_x normal_y normal_z", "NX NY NZ", "normalx normaly normalz", "n_x n_y n_z"]
)
@pytest.mark.parametrize("colors", ["red green blue", "diffuse_red diffuse_green diffuse_blue", "r g b"])
def test_names_of_normals_and_colours(tmp_path, names, colors):
    properties = [*XYZ, *(f"double {n}" for n in names.split()), *(f"uchar {c}" for c in colors.split())]
    surface = read(tmp_path, header(properties) + text(POINTS, NORMALS, COLORS))
    np.testing.assert_array_equal(surface.points, POINTS)
    np.testing.assert_array_equal(surface.normals, NORMALS)
    np.testing.assert_array_equal(surface.colors, COLORS)


@pytest.mark.parametrize("order", ["<", ">"])
def test_unknown_properties_are_passed_over_by_their_size(tmp_path, order):
    kinds = {"int64 stamp": "i8", "float x": "f4", "float16 q": "f2", "float y": "f4", "uint64 id": "u8",
             "float z": "f4", "half w": "f2", "bool seen": "u1", "double vx": "f8"}  # fmt: skip
    table = np.zeros(20, [(name.split()[1], order + kind) for name, kind in kinds.items()])
    table["x"], table["y"], table["z"] = POINTS.T
    table["stamp"] = 2**40
    form = "binary_little_endian" if order == "<" else "binary_big_endian"
    surface = read(tmp_path, header(list(kinds), form).encode() + table.tobytes())
    np.testing.assert_array_equal(surface.points, POINTS.astype(np.float32))
    assert surface.normals is None and surface.columns == "x y z; passed over: stamp, q, id, w, seen, vx"


def test_lists_counted_by_64_bits(tmp_path):
    head = header(XYZ, "binary_little_endian")
    head = head.replace("end_header", "element face 2\nproperty list int64 int64 Vertex_Indices\nend_header")
    faces = np.array([[3, 0, 1, 2], [3, 2, 3, 4]], "<i8")
    surface = read(tmp_path, head.encode() + POINTS.astype("<f4").tobytes() + faces.tobytes())
    np.testing.assert_array_equal(surface.faces, faces[:, 1:])


@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("bom", [b"", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("binary", [False, True])
def test_line_ends_capitals_and_byte_order_marks(tmp_path, line_end, bom, binary):
    points = POINTS.astype("<f4")
    points[0, 0] = np.frombuffer(b"\n\r\n\r", "<f4")[0]  # the body may begin with a line end
    head = header(XYZ, "binary_little_endian" if binary else "ascii").replace("\n", line_end)
    head = head.replace("ply", "PLY", 1).replace("element vertex", "ELEMENT Vertex").replace("float x", "Float X")
    head = head.replace("end_header", "END_HEADER")
    body = points.tobytes() if binary else text(points).replace("\n", line_end).encode()
    surface = read(tmp_path, bom + head.encode() + body)
    np.testing.assert_array_equal(surface.points.astype(np.float32), points)
    assert surface.named.images == ("A b.png",)


@pytest.mark.parametrize("word", ["-1.#IND", "1.#QNAN", "-nan(ind)", "nan"])
def test_numbers_that_are_none(tmp_path, word):
    rows = text(POINTS).splitlines()
    rows[3] = f"{word} {word} {word}"
    surface = read(tmp_path, header(XYZ) + "\n".join(rows))
    assert np.isnan(surface.points[3]).all()
    np.testing.assert_array_equal(np.delete(surface.points, 3, 0), np.delete(POINTS, 3, 0))


def test_decimal_commas(tmp_path):
    np.testing.assert_array_equal(read(tmp_path, header(XYZ) + text(POINTS).replace(".", ",")).points, POINTS)


def test_a_type_of_unknown_size_is_refused(tmp_path):
    with pytest.raises(InputError, match="cannot read the line 'property quad q'"):
        read(tmp_path, header([*XYZ, "quad q"]) + text(POINTS, POINTS[:, :1]))
