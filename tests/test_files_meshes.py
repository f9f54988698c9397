"""Meshes: vertex order kept exactly in every format, polygons as fans, sequences with and without shared triangles."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from present import present

from warpdef.errors import InputError
from warpdef.files import read_mesh, read_mesh_frames, read_mesh_sequence, same_triangles, write_ply
from warpdef.files.formats import MESH_SUFFIXES, read_surface
from warpdef.files.surface import fan_triangles

# Two vertices at one place and one without a face: what a reader that "cleans" would lose.
VERTICES = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0.1], [0, 1, 0], [0, 0, 0], [5, 5, 5], [-1, 0.5, 1e-3]], float)
POLYGONS = [[0, 1, 2, 3], [4, 3, 6], [0, 1, 2, 3, 6]]
TRIANGLES = [[0, 1, 2], [0, 2, 3], [4, 3, 6], [0, 1, 2], [0, 2, 3], [0, 3, 6]]


def obj(polygons) -> str:
    lines = ["v " + " ".join(map(repr, v)) for v in VERTICES.tolist()] + ["vt 0 0", "vn 0 0 1", "s off", "usemtl a"]
    lines += ["f " + " ".join(f"{i + 1}/1/1" for i in p) + " # seen" for p in polygons[:1]]
    lines += ["f " + " ".join(str(i - len(VERTICES)) for i in p) for p in polygons[1:2]]
    return "\n".join(lines + ["f \\\n" + " ".join(f"{i + 1}//1" for i in p) for p in polygons[2:]]) + "\n"


def off(polygons, head="OFF\n") -> str:
    lines = [" ".join(map(repr, v)) + " 255 0 0" for v in VERTICES.tolist()] + ["# faces"]
    lines += [f"{len(p)} " + " ".join(map(str, p)) + " 0.1 0.2 0.3" for p in polygons]
    return f"{head}{len(VERTICES)} {len(polygons)} 0\n" + "\n".join(lines)


def ply(polygons, form: str, name="vertex_indices", length="uchar", index="int") -> bytes:
    header = f"ply\nformat {form} 1.0\nelement vertex {len(VERTICES)}\n"
    header += "property double x\nproperty double y\nproperty double z\n"
    header += f"element face {len(polygons)}\nproperty uchar flag\nproperty list {length} {index} {name}\n"
    header += "property list uchar float texcoord\nend_header\n"
    if form == "ascii":
        rows = [" ".join(map(repr, v)) for v in VERTICES.tolist()]
        rows += [f"0 {len(p)} " + " ".join(map(str, p)) + " 2 0.5 0.5" for p in polygons]
        return (header + "\n".join(rows)).encode()
    order = ">" if "big" in form else "<"
    kinds = {"uchar": "u1", "int": "i4", "uint": "u4", "ushort": "u2"}
    body = VERTICES.astype(order + "f8").tobytes()
    for p in polygons:
        body += b"\0" + np.array(len(p), order + kinds[length]).tobytes() + np.array(p, order + kinds[index]).tobytes()
        body += b"\2" + np.array([0.5, 0.5], order + "f4").tobytes()
    return header.encode() + body


def files(polygons) -> dict[str, bytes]:
    return {
        "a.obj": obj(polygons).encode(),
        "crlf.obj": obj(polygons).replace("\n", "\r\n").encode(),
        "a.off": off(polygons).encode(),
        "one_line.off": off(polygons, "OFF ").encode(),
        "glued.off": off(polygons, "OFF").encode(),
        "bare.off": off(polygons, "").encode(),
        "coloured.off": off(polygons, "COFF\n").encode(),
        "ascii.ply": ply(polygons, "ascii"),
        "little.ply": ply(polygons, "binary_little_endian"),
        "big.ply": ply(polygons, "binary_big_endian", "vertex_index", "int", "uint"),
        "short.ply": ply(polygons, "binary_little_endian", "vertex_index", "ushort", "ushort"),
    }


@pytest.mark.parametrize("name", list(files([])))
def test_every_format_keeps_order(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(files(POLYGONS)[name])
    mesh = read_mesh(path)
    np.testing.assert_array_equal(mesh.vertices, VERTICES)
    np.testing.assert_array_equal(mesh.faces, TRIANGLES)
    # Polygons of one size take a quicker way.
    path.write_bytes(files(TRIANGLES)[name])
    np.testing.assert_array_equal(read_mesh(path).faces, TRIANGLES)


def test_fan_triangles_keeps_order():
    made = fan_triangles(np.arange(12), np.array([3, 5, 4]), "here")
    np.testing.assert_array_equal(made, [[0, 1, 2], [3, 4, 5], [3, 5, 6], [3, 6, 7], [8, 9, 10], [8, 10, 11]])
    with pytest.raises(InputError, match="here: face 1: expected at least 3 vertices, got 2"):
        fan_triangles(np.arange(5), np.array([3, 2]), "here")


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_written_ply_is_read_back(tmp_path, kind):
    write_ply(tmp_path / "m.ply", VERTICES.astype(kind), np.array(TRIANGLES))
    mesh = read_mesh(tmp_path / "m.ply")
    np.testing.assert_array_equal(mesh.vertices, VERTICES.astype(kind))
    np.testing.assert_array_equal(mesh.faces, TRIANGLES)
    assert [p.name for p in tmp_path.iterdir()] == ["m.ply"]


def test_written_ply_is_read_by_others(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    write_ply(tmp_path / "m.ply", VERTICES.astype(np.float32), np.array(TRIANGLES))
    mesh = trimesh.load_mesh(tmp_path / "m.ply", process=False)
    np.testing.assert_array_equal(mesh.vertices, VERTICES.astype(np.float32))
    np.testing.assert_array_equal(mesh.faces, TRIANGLES)


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_ply_of_others_is_read(tmp_path, encoding):
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere(subdivisions=1)
    ball.export(tmp_path / "b.ply", encoding=encoding, vertex_normal=True)
    mesh = read_mesh(tmp_path / "b.ply")
    np.testing.assert_allclose(mesh.vertices, ball.vertices, rtol=0, atol=1e-7)
    np.testing.assert_array_equal(mesh.faces, ball.faces)
    normals = present(read_surface(tmp_path / "b.ply", MESH_SUFFIXES).normals)
    np.testing.assert_allclose(normals, ball.vertex_normals, rtol=0, atol=1e-7)


def test_write_ply_refuses(tmp_path):
    with pytest.raises(InputError, match=r"m\.ply: vertices: expected shape \(V, 3\), got \(7, 2\)"):
        write_ply(tmp_path / "m.ply", VERTICES[:, :2], np.array(TRIANGLES))
    with pytest.raises(InputError, match=r"expected vertex indices in 0\.\.2"):
        write_ply(tmp_path / "m.ply", VERTICES[:3], np.array(TRIANGLES))
    with pytest.raises(InputError, match="cannot be written"):
        write_ply(tmp_path / "none" / "m.ply", VERTICES, np.array(TRIANGLES))
    assert not list(tmp_path.iterdir())


@pytest.fixture
def moving(rng) -> np.ndarray:
    return (VERTICES + rng.normal(size=(11, 1, 3))).astype(np.float32)


def write_meshes(folder: Path, moving: np.ndarray) -> Path:
    folder.mkdir()
    for frame, vertices in enumerate(moving):
        write_ply(folder / f"{frame}.ply", vertices, np.array(TRIANGLES))
    return folder


def test_sequences_from_npz_and_folder(tmp_path, moving):
    np.savez(tmp_path / "gt.npz", vertices=moving, faces=np.array(TRIANGLES, np.uint16), fps=30)
    for path in (tmp_path / "gt.npz", write_meshes(tmp_path / "meshes", moving)):
        sequence = read_mesh_sequence(path)
        np.testing.assert_array_equal(sequence.vertices, moving)
        np.testing.assert_array_equal(sequence.faces, TRIANGLES)
        np.testing.assert_array_equal(read_mesh_sequence(path, slice(2, 9, 3)).vertices, moving[2:9:3])
        frames = read_mesh_frames(path, slice(9, None))
        np.testing.assert_array_equal([mesh.vertices for mesh in frames], moving[9:])


def test_unselected_meshes_are_not_opened(tmp_path, moving):
    folder = write_meshes(tmp_path / "meshes", moving)
    (folder / "5.ply").write_bytes(b"noise")
    assert len(read_mesh_sequence(folder, slice(5))) == 5
    with pytest.raises(InputError, match=r"5\.ply: expected a PLY file"):
        read_mesh_sequence(folder)


def test_changing_triangles(tmp_path, moving):
    folder = write_meshes(tmp_path / "meshes", moving)
    write_ply(folder / "10.ply", moving[0], np.array(TRIANGLES)[:, [1, 2, 0]])
    with pytest.raises(InputError, match=r"10\.ply: expected the triangles of 0\.ply .*got others"):
        read_mesh_sequence(folder)
    frames = read_mesh_frames(folder)
    assert len(frames) == 11
    assert same_triangles(frames) is None
    assert same_triangles(frames[:10]) is not None


GOOD_PLY = ply(TRIANGLES, "ascii")
BAD_MESHES = [
    ("a.stl", b"solid", "cannot be read as .stl|expected a mesh or points"),
    ("a.obj", obj([]).encode(), "a mesh without faces"),
    ("a.off", off([]).encode(), "a mesh without faces"),
    ("a.ply", ply([], "ascii"), "a mesh without faces"),
    ("a.ply", GOOD_PLY.replace(b"vertex_indices", b"numbers"), "a mesh without faces"),
    ("a.obj", b"v 0 0 0\nv 1 0 0\nf 1 2 3\n", "names a vertex that is not there"),
    ("a.obj", b"v 0 0 0\nv 1 0 0\nf 1 2 99999999999999999999999\n", "names a vertex that is not there"),
    ("a.obj", b"v 0 0 0\nv 1 0 0\nf 1 2 0\n", "names a vertex that is not there"),
    ("a.obj", b"v 0 0 0\nv 1 0 0\nf 1 2\n", "face 0: expected at least 3 vertices, got 2"),
    ("a.obj", b"v 0 0 0\nv 1 0 0\nf 1 two 1\n", "line 3: expected a face"),
    ("a.obj", b"v 0 0 0\nv 1 0\nf 1 2 1\n", "vertex 1: expected 3 numbers, got '1 0'"),
    ("a.obj", b"v 0 0 0\nv 1 0 \xe9\nf 1 2 1\n", "vertex 1: expected 3 numbers"),
    ("a.obj", b"f 1 2 3\n", "expected lines 'v x y z', got none"),
    ("a.obj", b"v 0 0 0\nv 1 0 nan\nf 1 2 1\n", "finite numbers"),
    ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1\n", "face 0: expected a count and as many indices"),
    ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", "names a vertex that is not there"),
    ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\nx 0 1 3\n", "face 0: expected a count"),
    ("a.off", b"OFF\n-3 1 0\n", "its counts"),
    ("a.off", b"OFF BINARY\n3 1 0\n", "expected ASCII OFF"),
    ("a.off", b"4OFF\n3 1 0\n", "expected ASCII OFF"),
    ("a.off", b"NOFF\n3 0 0\n0 0 0\n1 0 0\n0 1 0\n", "6 columns in a NOFF"),
    ("a.off", b"# only a comment\n", "its counts"),
    ("a.off", b"OFF\n1000000000000 0 0\n", "truncated"),
    ("a.ply", GOOD_PLY.replace(b"0 3 4 3 6", b"0 3 4 3 7"), r"a\.ply: mesh: faces: expected vertex indices in 0\.\.6"),
    ("a.ply", GOOD_PLY.replace(b"0 3 4 3 6", b"0 3 4 3 5.5"), "whole vertex indices"),
    ("a.ply", GOOD_PLY.replace(b"0 3 4 3 6", b"0 3 4 3 nan"), "whole vertex indices"),
    ("a.ply", GOOD_PLY.replace(b"0 3 4 3 6", b"0 -3 4 3 6"), "list lengths from 0"),
    ("a.ply", GOOD_PLY.replace(b"0 3 4 3 6", b"0 1e300 4 3 6"), "truncated"),
    ("a.ply", GOOD_PLY.replace(b"0 3 4 3 6", b"0 nan 4 3 6"), "list lengths from 0"),
    ("a.ply", GOOD_PLY.replace(b"0 3 4 3 6", b"0 3 4 3 six"), "expected numbers after the PLY header"),
    ("a.ply", GOOD_PLY.replace(b"property double z\n", b""), "expected vertex properties x, y, z, got x, y"),
    ("a.ply", GOOD_PLY.replace(b"element vertex 7", b"element vertex -7"), "counts from 0, got -7"),
    (
        "a.ply",
        GOOD_PLY.replace(b"element vertex 7", b"element vertex many"),
        "cannot read the line 'element vertex many'",
    ),
    ("a.ply", GOOD_PLY.replace(b"double x", b"quad x"), "cannot read the line"),
    ("a.ply", GOOD_PLY.replace(b"double y", b"double x"), "a.ply"),
    ("a.ply", GOOD_PLY.replace(b"ascii", b"gzip"), "cannot read the line"),
    ("a.ply", GOOD_PLY.replace(b"format ascii 1.0\n", b""), "expected a 'format' line"),
    ("a.ply", GOOD_PLY.replace(b"element vertex", b"element verts"), "expected an element 'vertex'"),
]


@pytest.mark.parametrize(("name", "data", "message"), BAD_MESHES)
def test_bad_meshes(tmp_path, name, data, message):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match=message) as caught:
        read_mesh(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_bad_places(tmp_path):
    with pytest.raises(InputError, match="got nothing there"):
        read_mesh(tmp_path / "a.ply")
    with pytest.raises(InputError, match="expected one mesh file, got a folder"):
        read_mesh(tmp_path)
    for read in (read_mesh_sequence, read_mesh_frames):
        with pytest.raises(InputError, match="got nothing there"):
            read(tmp_path / "a.npz")
        with pytest.raises(InputError, match=r"expected numbered files \(\.ply \.obj \.off\), got none"):
            read(tmp_path)
    for name, message in (("a.ply", "got one mesh"), ("a.abc", "got the unknown suffix '.abc'")):
        (tmp_path / name).write_bytes(b"x")
        with pytest.raises(InputError, match=message):
            read_mesh_sequence(tmp_path / name)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"vertices": np.zeros((2, 3, 3))}, "expected an array 'faces', got vertices"),
        ({"points": np.zeros((2, 3, 3))}, "expected an array 'vertices'.*point clouds, not meshes"),
        ({"vertices": np.zeros((3, 3)), "faces": [[0, 1, 2]]}, r"\(T, V, 3\), got \(3, 3\)"),
        ({"vertices": np.zeros((2, 3, 3)), "faces": [[0, 1, 3]]}, r"vertex indices in 0\.\.2, got 0\.\.3"),
        ({"vertices": np.zeros((2, 3, 3)), "faces": [[0.0, 1, 2]]}, "integer indices"),
        ({"vertices": np.full((2, 3, 3), np.inf), "faces": [[0, 1, 2]]}, "NaN or infinity in frame 0"),
        ({"vertices": np.zeros((0, 3, 3)), "faces": [[0, 1, 2]]}, "at least 1 frames, got 0"),
    ],
)
def test_bad_archives(tmp_path, arrays, message):
    np.savez(tmp_path / "gt.npz", **arrays)
    with pytest.raises(InputError, match=message) as caught:
        read_mesh_sequence(tmp_path / "gt.npz")
    assert re.match(re.escape(str(tmp_path / "gt.npz")), str(caught.value))


def test_frames_that_leave_none(tmp_path, moving):
    np.savez(tmp_path / "gt.npz", vertices=moving, faces=TRIANGLES)
    with pytest.raises(InputError, match="--frames: expected at least 1 of 11 frames, got 0"):
        read_mesh_sequence(tmp_path / "gt.npz", slice(20, 30))


def test_real_meshes(shared_data):
    for path in sorted(shared_data.glob("*/gt.npz")):
        sequence = read_mesh_sequence(path, slice(0, 4, 3))
        with np.load(path) as archive:
            np.testing.assert_array_equal(sequence.vertices, archive["vertices"][0:4:3])
            np.testing.assert_array_equal(sequence.faces, archive["faces"])
