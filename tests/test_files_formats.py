"""PCD, LZF, LAS and LAZ: every form gives back what was written, and what does not fit is refused."""

from __future__ import annotations

import struct
import sys

import numpy as np
import pytest
from mutation_samples import CLOUDS, NORMALS, las, lzf_compress, pcd, zipped

from warpdef.errors import InputError, MissingPackageError
from warpdef.files import read_clouds
from warpdef.files.las import read_las
from warpdef.files.lzf import lzf_decompress
from warpdef.files.pcd import read_pcd
from warpdef.files.ptx import read_ptx

FORMS = ("ascii", "binary", "binary_compressed")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("with_normals", [False, True])
@pytest.mark.parametrize("real", ["4", "8"])
def test_pcd_forms(tmp_path, form, with_normals, real):
    path = tmp_path / "a.pcd"
    path.write_bytes(pcd(CLOUDS[0], NORMALS[0] if with_normals else None, form, real))
    surface, kind = read_pcd(path), np.dtype(f"f{real}")
    np.testing.assert_array_equal(surface.points, CLOUDS[0].astype(kind))
    if with_normals:
        np.testing.assert_array_equal(surface.normals, NORMALS[0].astype(kind))
    else:
        assert surface.normals is None


def test_pcd_fields_of_other_kinds(tmp_path):
    """Fields of several values, padding, whole numbers and old keywords, with Windows line ends."""
    rows = np.zeros(12, [("pad", "u1", (3,)), ("z", "<i2"), ("x", "<u4"), ("hist", "<f4", (5,)), ("y", "<f8")])
    rows["x"], rows["y"], rows["z"] = np.arange(12), np.arange(12) / 7, -np.arange(12)
    header = (
        "VERSION .6\r\nCOLUMNS _ z x hist y\r\nSIZE 1 2 4 4 8\r\nTYPE U I U F F\r\nCOUNT 3 1 1 5 1\r\n"
        "WIDTH 4\r\nHEIGHT 3\r\nDATA binary\r\n"
    )
    (tmp_path / "a.pcd").write_bytes(header.encode() + rows.tobytes())
    expected = np.stack([rows[axis].astype(np.float64) for axis in "xyz"], axis=1)
    np.testing.assert_array_equal(read_pcd(tmp_path / "a.pcd").points, expected)


def test_pcd_of_a_sensor_has_points_it_did_not_see(tmp_path):
    seen = np.concatenate([CLOUDS[0], np.full((60, 3), np.nan)])
    for t in range(2):
        (tmp_path / f"{t}.pcd").write_bytes(pcd(seen + t, None, FORMS[t]))
    sequence = read_clouds(tmp_path)
    np.testing.assert_array_equal(sequence.points[0], CLOUDS[0])
    assert sequence.warnings == (
        "points left out that are not finite, beyond 1e+30 or all at one place: 120 in frames 0-1",
    )


WHOLE = pcd(CLOUDS[0], None, "ascii")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"ply\n", "expected a PCD header with a line DATA"),
        (WHOLE.replace(b"DATA ascii", b"DATA zip"), "expected DATA ascii, binary or binary_compressed, got zip"),
        (WHOLE.replace(b"POINTS 40", b"POINTS -1"), "header"),
        (WHOLE.replace(b"SIZE 8 8", b"SIZE 3 8"), "header"),
        (WHOLE.replace(b"COUNT 1 1 1 1", b"COUNT 1 1"), "header"),
        (WHOLE.replace(b"COUNT 1 1 1 1", b"COUNT 99999999 1 1 1"), "header"),
        (WHOLE.replace(b"FIELDS x y z", b"FIELDS a b c"), "expected the fields x, y, z, got a, b, c, _"),
        (WHOLE.replace(b"POINTS 40", b"POINTS 41"), "expected 41 points.*truncated"),
        (WHOLE.replace(b"POINTS 40", b"POINTS 4000000000"), "expected 4000000000 points.*truncated"),
        (WHOLE.replace(b"0 0 0 1 0 0 0\nPOINTS", b"x\nPOINTS") + b"a b c", "expected numbers"),
        (pcd(CLOUDS[0], None, "binary")[:-1], "truncated"),
        (pcd(CLOUDS[0], None, "binary_compressed")[:-1], "truncated"),
        (pcd(CLOUDS[0], None, "binary_compressed").replace(b"POINTS 40", b"POINTS 39"), "truncated"),
        (WHOLE[: WHOLE.index(b"DATA")] + b"DATA binary_compressed\n\1\0", "truncated"),
        (
            WHOLE[: WHOLE.index(b"DATA")] + b"DATA binary_compressed\n" + struct.pack("<II", 3, 40 * 32) + b"\0\0\0",
            "do not unpack to the 1280 bytes declared",
        ),
    ],
)
def test_bad_pcd(tmp_path, data, message):
    (tmp_path / "a.pcd").write_bytes(data)
    with pytest.raises(InputError, match=message) as caught:
        read_pcd(tmp_path / "a.pcd")
    assert "\n" not in str(caught.value)


def test_lzf_by_hand():
    # "abc", then 9 bytes from 3 back (they overlap), then 2 + 7 + 1 bytes from 1 back, then a literal.
    packed = b"\2abc" + bytes([7 << 5, 0, 2]) + bytes([7 << 5, 1, 0]) + b"\0z"
    assert lzf_decompress(packed, 23) == b"abcabcabcabc" + b"c" * 10 + b"z"
    assert lzf_decompress(b"", 0) == b""


def test_lzf_back_and_forth(rng):
    for values in (1, 2, 256):
        data = rng.integers(0, values, size=5000).astype(np.uint8).tobytes()
        assert lzf_decompress(lzf_compress(data), len(data)) == data


@pytest.mark.parametrize("packed", [b"\5ab", b"\x20", b"\x20\0", b"\xe0", b"\0a\xff", b"\0a\0b\0c", b"\0a\xe0\xff\0"])
def test_bad_lzf(packed):
    with pytest.raises(ValueError, match="do not unpack to the 2 bytes declared"):
        lzf_decompress(packed, 2)


@pytest.mark.parametrize("minor", [2, 4])
@pytest.mark.parametrize("compressed", [False, True])
def test_las_keeps_map_coordinates(tmp_path, compressed, minor):
    if compressed:
        pytest.importorskip("lazrs")
    path = tmp_path / ("a.laz" if compressed else "a.las")
    far = CLOUDS[0] + 5_600_000.0
    path.write_bytes(las(far, 1e-4, 5_600_000.0, compressed=compressed, minor=minor))
    points = read_las(path).points
    assert points.dtype == np.float64
    np.testing.assert_allclose(points, far, rtol=0, atol=0.51e-4)


def test_las_frames(tmp_path):
    for t, cloud in enumerate(CLOUDS):
        (tmp_path / f"scan{t + 9}.las").write_bytes(las(cloud))
    sequence = read_clouds(tmp_path)
    assert sequence.names == ("scan9.las", "scan10.las", "scan11.las", "scan12.las")
    np.testing.assert_allclose(sequence.points[3], CLOUDS[3], rtol=0, atol=0.51e-4)


def test_laz_without_its_package_says_what_to_install(tmp_path, monkeypatch):
    data = bytearray(las(CLOUDS[0]))
    data[104] |= 128  # what marks a compressed file
    for t in range(2):
        (tmp_path / f"{t}.laz").write_bytes(data)
    monkeypatch.setitem(sys.modules, "lazrs", None)
    with pytest.raises(MissingPackageError, match=r"0\.laz: \.laz needs lazrs .*pip install 'warpdef\[las\]'"):
        read_clouds(tmp_path)


def patched(data: bytes, kind: str, at: int, *values) -> bytes:
    changed = bytearray(data)
    struct.pack_into(kind, changed, at, *values)
    return bytes(changed)


LAS = las(CLOUDS[0])


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"LASF", "does not start as one"),
        (b"x" * 400, "does not start as one"),
        (LAS[:-1], "expected 40 points .*truncated"),
        (patched(LAS, "<I", 107, 4_000_000_000), "expected 4000000000 points .*truncated"),
        (patched(LAS, "<I", 96, 2**31), "header is damaged"),
        (patched(LAS, "<I", 100, 2**32 - 1), "header is damaged"),
        (patched(LAS, "<B", 104, 11), "header is damaged"),
        (patched(LAS, "<H", 105, 19), "header is damaged"),
        (patched(LAS, "<d", 131, np.nan), "header is damaged"),
        (patched(LAS, "<d", 155, np.inf), "header is damaged"),
    ],
)
def test_bad_las(tmp_path, data, message):
    (tmp_path / "a.las").write_bytes(data)
    with pytest.raises(InputError, match=message):
        read_las(tmp_path / "a.las")


def test_bad_laz(tmp_path):
    pytest.importorskip("lazrs")
    whole, path = las(CLOUDS[0], compressed=True), tmp_path / "a.laz"
    start = struct.unpack_from("<I", whole, 96)[0]
    cases = [
        (patched(whole, "<I", 107, 4_000_000_000), "at most 64 MiB .*convert it to .las"),
        (patched(whole, "<I", 107, 1_000_000), "cannot be unpacked"),
        (patched(whole, "<I", 100, 0), "record of LASzip"),
        (patched(whole, "<q", start, 3), "table of chunks is damaged"),
        (patched(whole, "<q", start, -1), "table of chunks is damaged"),
        (whole[: start + 4], "table of chunks is damaged"),
        (patched(whole, "<H", 105, 21), "cannot be unpacked .*sizes of a point differ"),
    ]
    for data, message in cases:
        path.write_bytes(data)
        with pytest.raises(InputError, match=message):
            read_las(path)


def test_what_else_a_folder_holds_is_told(tmp_path):
    for t, cloud in enumerate(CLOUDS):
        (tmp_path / f"{t}.pcd").write_bytes(pcd(cloud, None, "binary"))
    (tmp_path / "mean.pcd").write_bytes(b"x")
    np.save(tmp_path / "7.npy", CLOUDS[0])
    (tmp_path / "all.zip").write_bytes(zipped({"0.pcd": b"x"}))
    sequence = read_clouds(tmp_path)
    assert sequence.names == ("0.pcd", "1.pcd", "2.pcd", "3.pcd")
    assert sequence.warnings == (
        f"passed over in {tmp_path}: '7.npy', 'mean.pcd', as the frames are its 4 numbered .pcd files",
    )


def ptx_scan(points: np.ndarray, matrix: np.ndarray, rest: str, size: tuple[int, int]) -> str:
    axes = "1 2 3\n" + "1 0 0\n0 1 0\n0 0 1\n"
    rows = "".join(f"{' '.join(map(repr, map(float, p)))} {rest}\n" for p in points)
    return f"{size[0]}\n{size[1]}\n{axes}" + "".join(" ".join(map(str, row)) + "\n" for row in matrix.tolist()) + rows


def test_ptx_scans_stand_in_the_world_without_what_they_did_not_see(tmp_path):
    turned = np.array([[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [10, 20, 30, 1.0]])  # [x y z 1] M
    blind = CLOUDS[0].copy()
    blind[::4] = 0.0
    both = ptx_scan(blind, np.eye(4), "0.5 9 8 7", (8, 5)) + ptx_scan(CLOUDS[1], turned, "0.5 1 2 300", (20, 2))
    (tmp_path / "a.ptx").write_text(both, newline="\r\n")
    surface = read_ptx(tmp_path / "a.ptx")
    x, y, z = CLOUDS[1].T
    second = np.stack([10 - y, 20 + x, 30 + z], axis=1)
    np.testing.assert_allclose(surface.points, np.concatenate([blind[np.arange(40) % 4 > 0], second]), atol=1e-14)
    (tmp_path / "b.ptx").write_text(ptx_scan(CLOUDS[0], np.eye(4), "0.5 9 8 7", (8, 5)) + "\n")
    assert (read_ptx(tmp_path / "b.ptx").colors == [9, 8, 7]).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: s.replace("8\n5\n", "8\n6\n"), "expected 48 points, got 40; it is truncated"),
        (lambda s: s.replace("8\n5\n", "8 5\n"), "line 1: expected the head of a PTX scan"),
        (lambda s: s.replace("0.5", "half", 1), "from line 11 on: expected points"),
        (lambda s: s.replace(" 0.5\n", "\n"), r"expected 40 rows of 4 or 7 numbers, got \(40, 3\)"),
        (lambda s: s + "1 2 3 4\n", "line 51: expected the head"),
    ],
)
def test_ptx_that_is_damaged(tmp_path, change, message):
    (tmp_path / "a.ptx").write_text(change(ptx_scan(CLOUDS[0], np.eye(4), "0.5", (8, 5))))
    with pytest.raises(InputError, match=message):
        read_ptx(tmp_path / "a.ptx")
