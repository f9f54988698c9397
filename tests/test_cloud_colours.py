"""Colours of clouds: every format gives the same, beside normals, through cleaning and drawing; the rest is named."""

from __future__ import annotations

import struct

import numpy as np
import pytest
import synthetic
from present import present

from warpdef.cleaning.crop import crop
from warpdef.errors import InputError
from warpdef.files import read_clouds
from warpdef.files.cloud_files import write_clouds_npz
from warpdef.files.formats import read_surface
from warpdef.sequence import PointSequence

COUNT = 60
RNG = np.random.default_rng(5)
POINTS = RNG.normal(size=(3, COUNT, 3)).round(3).astype(np.float32)
NORMALS = POINTS / np.linalg.norm(POINTS, axis=2, keepdims=True)
COLORS = RNG.integers(0, 256, size=(3, COUNT, 3)).astype(np.uint8)
LEVEL = RNG.normal(size=COUNT)
PACKED = (COLORS.astype(np.uint32) << np.array([16, 8, 0], dtype=np.uint32)).sum(axis=2, dtype=np.uint32)


def ply(t: int, names: str, kind: str = "u1") -> bytes:
    words = {"u1": "uchar", "f4": "float", "u2": "ushort"}
    rows = np.zeros(COUNT, [(a, "<f4") for a in "xyz"] + [(n, f"<{kind}") for n in names.split()] + [("label", "<i4")])
    scale = {"u1": 1, "f4": 1 / 255, "u2": 257}[kind]
    for i, axis in enumerate("xyz"):
        rows[axis] = POINTS[t][:, i]
    for i, name in enumerate(names.split()):
        rows[name] = COLORS[t][:, i].astype(float) * scale
    head = "".join(f"property float {a}\n" for a in "xyz") + "".join(
        f"property {words[kind]} {n}\n" for n in names.split()
    )
    start = f"ply\nformat binary_little_endian 1.0\nelement vertex {COUNT}\n{head}property int label\nend_header\n"
    return start.encode() + rows.tobytes()


def table(t: int, columns: list[np.ndarray], form: str = "%.9g", head: str = "", mark: str = "") -> bytes:
    rows = np.column_stack([POINTS[t], *columns])
    return (head + "\n".join(mark + " ".join(form % v for v in row) for row in rows) + "\n").encode()


def pcd(t: int, kind: str, form: str) -> bytes:
    head = f"FIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F {kind}\nCOUNT 1 1 1 1\nWIDTH {COUNT}\nHEIGHT 1\n"
    head += f"POINTS {COUNT}\nDATA {form}\n"
    packed = PACKED[t] if kind == "U" else PACKED[t].view(np.float32)
    if form == "ascii":
        lines = [
            f"{x:.9g} {y:.9g} {z:.9g} {c:.9g}" for (x, y, z), c in zip(POINTS[t], packed.astype(float), strict=True)
        ]
        return (head + "\n".join(lines) + "\n").encode()
    rows = np.zeros(COUNT, [(a, "<f4") for a in "xyz"] + [("rgb", packed.dtype)])
    for i, axis in enumerate("xyz"):
        rows[axis] = POINTS[t][:, i]
    rows["rgb"] = packed
    return head.encode() + rows.tobytes()


def las(t: int) -> bytes:
    rows = np.zeros(COUNT, np.dtype([("xyz", "<i4", 3), ("intensity", "<u2"), ("rest", "u1", 6), ("rgb", "<u2", 3)]))
    rows["xyz"], rows["intensity"], rows["rgb"] = np.rint(POINTS[t] * 1000), 7, COLORS[t].astype(np.uint16) * 257
    head = bytearray(227)
    head[:4], head[24:26] = b"LASF", b"\1\2"
    struct.pack_into("<HII", head, 94, 227, 227, 0)
    struct.pack_into("<BHI", head, 104, 2, rows.itemsize, COUNT)
    struct.pack_into("<6d", head, 131, 0.001, 0.001, 0.001, 0, 0, 0)
    return bytes(head) + rows.tobytes()


FORMATS = {
    "ply": (".ply", lambda t: ply(t, "red green blue"), "label"),
    "ply of scanners": (".ply", lambda t: ply(t, "diffuse_red diffuse_green diffuse_blue"), "label"),
    "ply of fractions": (".ply", lambda t: ply(t, "r g b", "f4"), "label"),
    "ply of 16 bits": (".ply", lambda t: ply(t, "red green blue", "u2"), "label"),
    "off": (".off", lambda t: table(t, [COLORS[t]], head=f"COFF\n{COUNT} 0 0\n"), ""),
    "off of fractions": (".off", lambda t: table(t, [COLORS[t] / 255], head=f"COFF\n{COUNT} 0 0\n"), ""),
    "off with normals": (".off", lambda t: table(t, [NORMALS[t], COLORS[t]], head=f"CNOFF\n{COUNT} 0 0\n"), ""),
    "obj": (".obj", lambda t: table(t, [COLORS[t] / 255], mark="v "), ""),
    "txt by values": (".txt", lambda t: table(t, [COLORS[t]]), ""),
    "txt by names": (".txt", lambda t: table(t, [LEVEL, COLORS[t]], head="x y z level r g b\n"), "level"),
    "pcd": (".pcd", lambda t: pcd(t, "F", "binary"), ""),
    "pcd of whole numbers": (".pcd", lambda t: pcd(t, "U", "binary"), ""),
    "pcd as text": (".pcd", lambda t: pcd(t, "F", "ascii"), ""),
    "pcd as text of whole numbers": (".pcd", lambda t: pcd(t, "U", "ascii"), ""),
    "las": (".las", las, "intensity"),
}  # fmt: skip


@pytest.mark.parametrize("kind", FORMATS)
def test_every_format_gives_the_same_colours(tmp_path, kind):
    suffix, write, passed = FORMATS[kind]
    for t in range(3):
        (tmp_path / f"{t}{suffix}").write_bytes(write(t))
    sequence = read_clouds(tmp_path)
    np.testing.assert_array_equal(np.stack([present(c) for c in sequence.colors]), COLORS)
    assert all(present(c).dtype == np.uint8 for c in sequence.colors)
    told = [w for w in sequence.warnings if "left behind" in w]
    assert told == ([f"of the points {passed} left behind: no place on a mesh"] if passed else [])


@pytest.mark.parametrize(
    ("arrays", "passed"),
    [
        ({"points": POINTS, "colors": COLORS}, ""),
        ({"points": POINTS, "colours": COLORS / 255.0, "normals": NORMALS, "labels": PACKED}, "labels"),
        ({"points": np.concatenate([POINTS, COLORS], axis=2)}, ""),
        (
            {f"points_{t:04d}": p for t, p in enumerate(POINTS)} | {f"colors_{t:04d}": c for t, c in enumerate(COLORS)},
            "",
        ),
    ],
)
def test_layouts_of_an_npz(tmp_path, arrays, passed):
    np.savez(tmp_path / "a.npz", **arrays)
    sequence = read_clouds(tmp_path / "a.npz")
    np.testing.assert_array_equal(np.stack([present(c) for c in sequence.colors]), COLORS)
    assert ("labels" in " ".join(sequence.warnings)) == bool(passed)


def test_colours_of_vertices_in_a_scene(tmp_path):
    """Of a mesh in .glb, each at its place, though vertices at one place are merged; a cloud's in the same way."""
    trimesh = pytest.importorskip("trimesh")
    vertices, faces = synthetic.icosphere(1)
    colors = np.rint(127.5 * (1 + vertices)).astype(np.uint8)
    trimesh.Trimesh(vertices, faces, vertex_colors=colors, process=False).export(tmp_path / "0.glb")
    trimesh.Scene([trimesh.PointCloud(vertices, colors=colors)]).export(tmp_path / "1.glb")
    for t in range(2):
        surface = read_surface(tmp_path / f"{t}.glb", (".glb",))
        np.testing.assert_allclose(present(surface.colors), np.rint(127.5 * (1 + surface.points)), atol=1)


def test_colours_of_another_length_are_refused(tmp_path):
    np.savez(tmp_path / "a.npz", points=POINTS, colors=COLORS[:, 1:])
    with pytest.raises(InputError, match=r"colours: expected shape \(3, 60, 3\)"):
        read_clouds(tmp_path / "a.npz")
    with pytest.raises(InputError, match="colours: expected 3 frames"):
        PointSequence.from_arrays(POINTS, colors=COLORS[1:])


def test_colours_go_with_their_points():
    """Through merging, leaving out, cutting, drawing and choosing: each point keeps the colour that says its place."""
    points = np.concatenate([POINTS, POINTS[:, :5], np.full((3, 2, 3), np.nan)], axis=1)
    colors = np.concatenate([COLORS, COLORS[:, :5], COLORS[:, :2]], axis=1)
    sequence = PointSequence.from_arrays(points, [NORMALS[0][[*range(60), *range(5), 0, 0]], None, None], colors=colors)
    sequence = crop(sequence, "-1:1,:,:").subsample(20, 3).select(slice(2, None, -1))
    for cloud, t in zip(sequence.clouds, (2, 1, 0), strict=True):
        place = [int(np.flatnonzero((POINTS[t] == p).all(axis=1))[0]) for p in cloud.points]
        np.testing.assert_array_equal(cloud.colors, COLORS[t][place])
        assert (cloud.normals is None) == (t > 0) and len(cloud.points) == 20


def test_a_sequence_is_written_with_its_colours(tmp_path):
    for clouds in (list(POINTS), [POINTS[0], POINTS[1][:50], POINTS[2]]):
        sequence = PointSequence.from_arrays(clouds, colors=[c[: len(p)] for c, p in zip(COLORS, clouds, strict=True)])
        write_clouds_npz(tmp_path / "a.npz", sequence)
        again = read_clouds(tmp_path / "a.npz")
        assert all((a == b).all() for a, b in zip(again.colors, sequence.colors, strict=True))


def test_points_without_colours_have_none():
    sequence = PointSequence.from_arrays(POINTS)
    assert sequence.colors == () and sequence.all_colors() == [None] * 3
