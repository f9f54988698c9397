"""Damaged files: whatever the bytes, a reader gives a result or one ``InputError``, in little memory."""

from __future__ import annotations

import io
import os
import tracemalloc

import numpy as np
import pytest
import trimesh
from mutation_samples import las, pcd
from trimesh.exchange.dae import export_collada
from trimesh.exchange.gltf import export_gltf

from warpdef.errors import InputError
from warpdef.files import read_clouds, read_mesh, read_mesh_sequence, write_ply
from warpdef.files.formats import CLOUD_SUFFIXES, FORMATS, read_surface
from warpdef.files.numpy_files import Npz, read_npy

SCENES = [s for s, form in FORMATS.items() if form.merges]
TABLES = [s for s, form in FORMATS.items() if form.reader == "tables:read_table"]
POINTS = np.random.default_rng(0).normal(size=(40, 3))
FACES = np.random.default_rng(1).integers(0, 40, size=(30, 3))


def binary_ply(tmp_path, normals: bool = False) -> bytes:
    write_ply(tmp_path / "whole.ply", POINTS.astype(np.float32), FACES)
    return (tmp_path / "whole.ply").read_bytes()


def saved(save, *args, **arrays) -> bytes:
    stream = io.BytesIO()
    save(stream, *args, **arrays)
    return stream.getvalue()


def obj() -> bytes:
    return ("\n".join(f"v {x} {y} {z}" for x, y, z in POINTS) + "\nf 1 2 3\n").encode()


def off() -> bytes:
    return ("OFF\n40 1 0\n" + "\n".join(f"{x} {y} {z}" for x, y, z in POINTS) + "\n3 0 1 2").encode()


def ptx() -> bytes:
    head = "8\n5\n0 0 0\n" + "1 0 0\n0 1 0\n0 0 1\n" + "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"
    return (head + "\n".join(f"{x} {y} {z} 0.5" for x, y, z in POINTS)).encode()


def scene(suffix: str) -> bytes:
    mesh = trimesh.Trimesh(POINTS, FACES, process=False)
    if suffix == ".gltf":
        files = export_gltf(trimesh.Scene(mesh), merge_buffers=True, embed_buffers=True)
        return files["model.gltf"]
    if suffix == ".dae":
        return export_collada(mesh)
    made = mesh.export(file_type=suffix[1:])
    assert isinstance(made, bytes)
    return made


def samples(tmp_path) -> dict[str, bytes]:
    return {
        ".ply": binary_ply(tmp_path),
        ".obj": obj(),
        ".off": off(),
        **{s: "\n".join(f"{x} {y} {z}" for x, y, z in POINTS).encode() for s in TABLES},
        ".npy": saved(np.save, POINTS),
        **{s: scene(s) for s in SCENES},
        ".pcd": pcd(POINTS, None, "binary_compressed"),
        ".las": las(POINTS),
        ".ptx": ptx(),
    }


@pytest.mark.parametrize("step", [-1, 1, 5])
def test_every_truncation_of_a_binary_ply(tmp_path, step):
    data = binary_ply(tmp_path)
    body = data.index(b"end_header\n") + 11
    # In the magic, in the header, at its end, in the vertices, between elements, in the faces, one byte short.
    cuts = {1, 2, 3, 10, body // 2, body - 11, body - 1, body, body + 1, body + 40 * 12, len(data) - 1}
    path = tmp_path / "cut.ply"
    for cut in sorted({max(1, min(cut + step, len(data) - 1)) for cut in cuts}):
        path.write_bytes(data[:cut])
        for read in (read_mesh, lambda p: read_surface(p, CLOUD_SUFFIXES)):
            with pytest.raises(InputError, match="truncated|does not start with 'ply'"):
                read(path)


@pytest.mark.parametrize("count", [10**6, 10**10, 10**18, 10**30])
@pytest.mark.parametrize("element", ["vertex", "face"])
@pytest.mark.parametrize("form", ["binary_little_endian", "ascii"])
def test_a_lying_header_allocates_nothing(tmp_path, count, element, form):
    data = binary_ply(tmp_path).replace(b"binary_little_endian", form.encode())
    if form == "ascii":
        data = data[: data.index(b"end_header\n") + 11] + b"1 2 3 " * 50
    true_count = {"vertex": 40, "face": 30}[element]
    path = tmp_path / "lie.ply"
    path.write_bytes(data.replace(f"element {element} {true_count}".encode(), f"element {element} {count}".encode()))
    tracemalloc.start()
    with pytest.raises(InputError, match="truncated"):
        read_mesh(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 4e6


def test_a_lying_list_length_allocates_nothing(tmp_path):
    data = binary_ply(tmp_path).replace(b"list uchar int", b"list uint int")
    (tmp_path / "lie.ply").write_bytes(data[: -30 * 13] + b"\xff\xff\xff\xff" + data[-30 * 13 :])
    with pytest.raises(InputError, match="truncated"):
        read_mesh(tmp_path / "lie.ply")


@pytest.mark.parametrize("shape", [(10**6, 3), (10**12, 3), (10**18, 10**18, 3), (-4, 3)])
@pytest.mark.parametrize("version", [(1, 0), (2, 0)])
def test_a_lying_npy_allocates_nothing(tmp_path, shape, version):
    stream = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": shape}
    writer = np.lib.format.write_array_header_1_0 if version == (1, 0) else np.lib.format.write_array_header_2_0
    writer(stream, header)
    path = tmp_path / "a.npy"
    path.write_bytes(stream.getvalue() + b"\0" * 240)
    tracemalloc.start()
    with pytest.raises(InputError, match=r"a\.npy: (expected shape|cannot be read)"):
        read_npy(path)
    assert tracemalloc.get_traced_memory()[1] < 4e6
    tracemalloc.stop()


NOISE = {
    "empty": b"",
    "blank": b" \n\n",
    "text": b"the quick brown fox\njumps over\n",
    "non-ASCII": "καλημέρα κόσμε\n点云\n".encode(),
    "bytes": bytes(range(256)) * 8,
    "zeros": b"\0" * 500,
    "html": b"<!DOCTYPE html><html><body>404</body></html>",
    "two columns": b"1 2\n3 4\n",
    "ragged": b"1 2 3\n1 2 3 4 5 6\n1 2 3\n",
    "nan": b"nan nan nan\n" * 20,
    "infinity": b"v 1 2 inf\n" * 20,
    "ply": b"ply\n",
    "ply and noise": b"ply\nformat ascii 1.0\nelement vertex 20\nproperty float x\nend_header\n\xff\xfe",
    "off": b"OFF\n",
    "npy": b"\x93NUMPY",
    "npy version": b"\x93NUMPY\x09\x00\x10\x00" + b" " * 30,
    "npy header": b"\x93NUMPY\x01\x00\x76\x00" + b"{'descr': (((((((" + b" " * 101,
    "npy object": saved(np.save, np.array([None] * 12, dtype=object), allow_pickle=True),
    "zip": b"PK\x03\x04",
}


@pytest.mark.parametrize("suffix", [*CLOUD_SUFFIXES, ".npz"])
@pytest.mark.parametrize("noise", list(NOISE))
def test_noise(tmp_path, suffix, noise):
    for frame in (1, 2):
        (tmp_path / f"{frame}{suffix}").write_bytes(NOISE[noise])
    with pytest.raises(InputError) as caught:
        read_clouds(tmp_path / "1.npz" if suffix == ".npz" else tmp_path)
    assert f"1{suffix}" in str(caught.value)
    assert "\n" not in str(caught.value)
    if suffix == ".npz":
        with pytest.raises(InputError, match="1.npz"):
            read_mesh_sequence(tmp_path / "1.npz")


@pytest.mark.parametrize("suffix", [s for s in CLOUD_SUFFIXES if s not in (".laz", ".e57")])
def test_random_damage_never_gives_another_error(tmp_path, rng, suffix):
    data = samples(tmp_path)[suffix]
    path = tmp_path / f"a{suffix}"
    refused = 0
    for _ in range(150):
        broken = bytearray(data)
        for at in rng.integers(0, len(data), size=rng.integers(1, 6)):
            broken[at] = rng.integers(0, 256)
        if rng.random() < 0.5:
            broken = broken[: rng.integers(1, len(data))]
        path.write_bytes(broken)
        try:
            surface = read_surface(path, CLOUD_SUFFIXES)
        except InputError:
            refused += 1
        else:
            assert surface.points.ndim == 2
            assert surface.points.shape[1] == 3
    assert refused > 0


@pytest.mark.parametrize("compressed", [False, True])
def test_random_damage_of_an_npz(tmp_path, rng, compressed):
    save = np.savez_compressed if compressed else np.savez
    data = saved(save, points=np.stack([POINTS, POINTS + 1]), normals=np.stack([POINTS, POINTS]))
    path = tmp_path / "a.npz"
    refused = 0
    for _ in range(150):
        broken = bytearray(data)
        broken[rng.integers(0, len(data))] = rng.integers(0, 256)
        if rng.random() < 0.3:
            broken = broken[: rng.integers(1, len(data))]
        path.write_bytes(broken)
        try:
            assert len(read_clouds(path)) == 2
        except InputError:
            refused += 1
    assert refused > 0


def test_dangling_link_is_not_lost(tmp_path):
    np.save(tmp_path / "1.npy", POINTS)
    np.save(tmp_path / "2.npy", POINTS)
    (tmp_path / "3.npy").symlink_to(tmp_path / "gone.npy")
    with pytest.raises(InputError, match=r"3\.npy"):
        read_clouds(tmp_path, strict=True)
    sequence = read_clouds(tmp_path)
    assert [(gap.number, gap.name) for gap in sequence.gaps] == [(2, "3.npy")]


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "1.ply")
    os.mkfifo(tmp_path / "2.npy")
    for name in ("1.ply", "2.npy"):
        with pytest.raises(InputError, match=name):
            read_surface(tmp_path / name, CLOUD_SUFFIXES)
    os.mkfifo(tmp_path / "a.npz")
    with pytest.raises(InputError, match="a.npz"):
        Npz(tmp_path / "a.npz")


def test_pickled_frames_are_not_read(tmp_path):
    for frame in (1, 2):
        (tmp_path / f"{frame}.npy").write_bytes(NOISE["npy object"])
    with pytest.raises(InputError, match=r"1\.npy: expected numbers, got Python objects, .* can run code"):
        read_clouds(tmp_path)


def test_npz_arrays_are_named_in_errors(tmp_path):
    np.savez(tmp_path / "a.npz", a=np.zeros(3), b=np.array(["x"]))
    archive = Npz(tmp_path / "a.npz")
    assert archive.names == ["a", "b"]
    assert archive.texts("b") == ["x"]
    with pytest.raises(InputError, match="expected an array 'c', got a, b"):
        archive.array("c")
    with pytest.raises(InputError, match="a.npz: b: expected real numbers"):
        archive.array("b")
    with pytest.raises(InputError, match="got nothing there"):
        Npz(tmp_path / "none.npz")
