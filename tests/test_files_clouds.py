"""Sequences of clouds: every format gives back what was written, in the right order, and errors say what to do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from present import present

from warpdef.errors import InputError
from warpdef.files import read_clouds, write_clouds_npz
from warpdef.files.frame_numbers import natural_key
from warpdef.sequence import PointSequence

N = 12


@pytest.fixture
def clouds(rng: np.random.Generator) -> list[np.ndarray]:
    return [rng.normal(size=(N, 3)) + frame for frame in range(3)]


@pytest.fixture
def normals(rng: np.random.Generator) -> list[np.ndarray]:
    raw = rng.normal(size=(3, N, 3))
    return list(raw / np.linalg.norm(raw, axis=2, keepdims=True))


def ply(points: np.ndarray, normals: np.ndarray | None, form: str, real: str = "double") -> bytes:
    """A PLY cloud with a colour between position and normal, and an element in front, to be passed over."""
    axes = ["x", "y", "z"] + (["nx", "ny", "nz"] if normals is not None else [])
    header = ["ply", f"format {form} 1.0", "comment made by hand é", "element sensor 2", "property short id"]
    header += [f"element vertex {len(points)}", *(f"property {real} {a}" for a in axes[:3]), "property uchar red"]
    header += [*(f"property {real} {a}" for a in axes[3:]), "end_header", ""]
    order = ">" if "big" in form else "<"
    kind = order + {"double": "f8", "float": "f4"}[real]
    table = np.zeros(len(points), [(a, kind) for a in axes[:3]] + [("red", "u1")] + [(a, kind) for a in axes[3:]])
    table["red"] = 7
    for i, axis in enumerate(axes):
        table[axis] = points[:, i] if i < 3 else present(normals)[:, i - 3]
    head = "\n".join(header).encode("utf-8")
    if form == "ascii":
        rows = [" ".join(repr(value.item()) for value in row) for row in table]
        return head + ("1\n2\n" + "\n".join(rows) + "\n").encode()
    return head + np.array([1, 2], order + "i2").tobytes() + table.tobytes()


def write_frame(path: Path, points: np.ndarray, normals: np.ndarray | None) -> None:
    rows = points if normals is None else np.hstack([points, normals])
    if path.suffix == ".npy":
        np.save(path, rows)
    elif path.suffix == ".xyz":
        lines = [" ".join(map(repr, row)) for row in rows.tolist()]
        path.write_text("# x y z\n" + lines[0] + " // first, naïve\n\n" + "\n".join(lines[1:]) + "\n; end", "utf-8")
    elif path.suffix == ".obj":
        lines = ["v " + " ".join(map(repr, p)) + " 0.5 0.5 0.5" for p in points.tolist()]
        lines += [] if normals is None else ["vn " + " ".join(map(repr, n)) for n in normals.tolist()]
        path.write_text("# OBJ\nmtllib a.mtl\no cloud\n" + "\n".join(lines))
    elif path.suffix == ".off":
        lines = [" ".join(map(repr, row)) for row in rows.tolist()]
        path.write_text(("OFF" if normals is None else "NOFF") + f"\n{len(points)} 0 0\n" + "\n".join(lines))
    else:
        path.write_bytes(ply(points, normals, "binary_little_endian"))


def assert_same(sequence: PointSequence, clouds, normals) -> None:
    assert len(sequence) == len(clouds)
    for frame in range(len(clouds)):
        np.testing.assert_array_equal(sequence.points[frame], clouds[frame])
        if normals is None:
            assert sequence.normals[frame] is None
        else:
            np.testing.assert_allclose(present(sequence.normals[frame]), normals[frame], rtol=0, atol=1e-15)


def test_uneven_numbers_are_the_times_of_their_frames(tmp_path, clouds):
    for number, cloud in zip((5, 6, 7, 107, 108), [*clouds, *clouds], strict=False):
        write_frame(tmp_path / f"scan{number}.xyz", cloud, None)
    assert read_clouds(tmp_path).times == (0.0, 1.0, 2.0, 102.0, 103.0)
    some = read_clouds(tmp_path, slice(4, 0, -2))
    assert some.times == (0.0, 101.0) and read_clouds(tmp_path).select(slice(4, 0, -2)).times == some.times
    (tmp_path / "scan5.xyz").unlink()
    (tmp_path / "scan7.xyz").unlink()
    assert read_clouds(tmp_path).times == (0.0, 101.0, 102.0)


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off", ".xyz", ".npy"])
@pytest.mark.parametrize("with_normals", [False, True])
def test_folder_of_each_suffix(tmp_path, clouds, normals, suffix, with_normals):
    used = normals if with_normals else [None] * 3
    # Unpadded, so that alphabetical order would be wrong; and what a folder also holds.
    for frame, number in enumerate((2, 10, 100)):
        write_frame(tmp_path / f"scan{number}{suffix}", clouds[frame], used[frame])
    (tmp_path / "README.md").write_text("no frame")
    (tmp_path / f"._scan2{suffix}").write_text("hidden")
    (tmp_path / "preview7.png").write_bytes(b"x")
    (tmp_path / f"5{suffix}").mkdir()
    sequence = read_clouds(tmp_path)
    assert sequence.names == (f"scan2{suffix}", f"scan10{suffix}", f"scan100{suffix}")
    assert_same(sequence, clouds, normals if with_normals else None)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize("line_end", [b"\n", b"\r\n"])
def test_ply_forms(tmp_path, clouds, normals, form, real, line_end):
    kind = {"double": np.float64, "float": np.float32}[real]
    for frame in range(3):
        head, mark, body = ply(clouds[frame], normals[frame], form, real).partition(b"end_header\n")
        (tmp_path / f"{frame}.PLY").write_bytes((head + mark).replace(b"\n", line_end) + body)
    sequence = read_clouds(tmp_path)
    for frame in range(3):
        np.testing.assert_array_equal(sequence.points[frame], clouds[frame].astype(kind))
        np.testing.assert_allclose(
            present(sequence.normals[frame]), normals[frame], rtol=0, atol=1e-15 if real == "double" else 1e-7
        )


@pytest.mark.parametrize(
    "names", [("1", "2", "10"), ("f9b2", "f10b1", "f10b12"), ("a", "b", "c"), ("0099", "0100", "0101")]
)
def test_natural_order(names):
    assert sorted(reversed(names), key=natural_key) == list(names)


def test_unselected_files_are_not_opened(tmp_path, clouds):
    for frame in range(3):
        np.save(tmp_path / f"{frame}.npy", clouds[frame])
    (tmp_path / "3.npy").write_bytes(b"noise")
    assert read_clouds(tmp_path, slice(0, 3, 2)).names == ("0.npy", "2.npy")
    assert read_clouds(tmp_path, slice(-2, None, -1)).names == ("2.npy", "1.npy", "0.npy")
    with pytest.raises(InputError, match=r"3\.npy: cannot be read as \.npy"):
        read_clouds(tmp_path, strict=True)


def test_npz_equal_frames(tmp_path, clouds, normals):
    np.savez(tmp_path / "c.npz", points=np.stack(clouds), normals=np.stack(normals), fps=24)
    assert_same(read_clouds(tmp_path / "c.npz"), clouds, normals)
    chosen = read_clouds(tmp_path / "c.npz", slice(1, None))
    assert_same(chosen, clouds[1:], normals[1:])
    assert chosen.names == ("points[1] of c.npz", "points[2] of c.npz")


def test_npz_unequal_frames(tmp_path, clouds, normals):
    frames = {"points_10": clouds[2], "points_9": clouds[1][:11], "points_1": clouds[0], "normals_9": normals[1][:11]}
    np.savez(tmp_path / "c.npz", **frames)
    sequence = read_clouds(tmp_path / "c.npz")
    assert sequence.names == ("points_1 of c.npz", "points_9 of c.npz", "points_10 of c.npz")
    assert [len(p) for p in sequence.points] == [12, 11, 12]
    assert [n is None for n in sequence.normals] == [True, False, True]
    assert read_clouds(tmp_path / "c.npz", slice(1, 3)).names[0] == "points_9 of c.npz"


@pytest.mark.parametrize("counts", [(N, N, N), (N, 10, 11)])
@pytest.mark.parametrize("missing", [(), (1,), (0, 1, 2)])
def test_written_clouds_are_read_back(tmp_path, clouds, normals, counts, missing):
    points = [c[:k] for c, k in zip(clouds, counts, strict=True)]
    given = [None if t in missing else normals[t][:k] for t, k in enumerate(counts)]
    sequence = PointSequence.from_arrays(points, given)
    write_clouds_npz(tmp_path / "c.npz", sequence)
    with np.load(tmp_path / "c.npz", allow_pickle=False) as archive:
        equal = len(set(counts)) == 1 and len(missing) in (0, 3)
        assert ("points" in archive.files) == equal
    again = read_clouds(tmp_path / "c.npz")
    for frame in range(3):
        np.testing.assert_array_equal(again.points[frame], sequence.points[frame])
        if given[frame] is None:
            assert again.normals[frame] is None
        else:
            np.testing.assert_allclose(
                present(again.normals[frame]), present(sequence.normals[frame]), rtol=0, atol=1e-15
            )
    assert [p.name for p in tmp_path.iterdir()] == ["c.npz"]


def test_write_needs_npz(tmp_path, clouds):
    with pytest.raises(InputError, match="unknown suffix '.txt'; expected .npz"):
        write_clouds_npz(tmp_path / "c.txt", PointSequence.from_arrays(clouds))
    with pytest.raises(InputError, match="cannot be written"):
        write_clouds_npz(tmp_path / "not there" / "c.npz", PointSequence.from_arrays(clouds))


def save_frames(folder: Path, *names: str) -> None:
    for seed, name in enumerate(names):
        np.save(folder / name, np.random.default_rng(seed).normal(size=(N, 3)))


def one_frame(p: Path) -> Path:
    save_frames(p, "1.npy")
    return p


def mixed_suffixes(p: Path) -> Path:
    save_frames(p, "1.npy", "2.npy")
    (p / "1.obj").write_text("v 0 0 0")
    (p / "2.obj").write_text("v 0 0 0")
    return p


def unnumbered_among_numbered(p: Path) -> Path:
    save_frames(p, "1.npy", "mean.npy", "least.npy")
    return p


def frames_in_subfolder(p: Path) -> Path:
    (p / "clouds").mkdir()
    save_frames(p / "clouds", "1.npy", "2.npy")
    return p


def cameras_in_subfolders(p: Path) -> Path:
    for camera in ("cam0", "cam1"):
        (p / camera).mkdir()
        save_frames(p / camera, "1.npy", "2.npy")
    return p


def archive_in_folder(p: Path) -> Path:
    np.savez(p / "all.npz", points=np.zeros((2, N, 3)))
    return p


def other_suffixes(p: Path) -> Path:
    (p / "1.docx").write_text("x")
    return p


def single_file(p: Path) -> Path:
    save_frames(p, "1.npy")
    return p / "1.npy"


def unknown_suffix(p: Path) -> Path:
    (p / "a.docx").write_text("x")
    return p / "a.docx"


def written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def npz_of(**arrays: Any):
    def make(p: Path) -> Path:
        made: dict[str, Any] = {key: value() if callable(value) else value for key, value in arrays.items()}
        np.savez(p / "a.npz", **made)
        return p / "a.npz"

    return make


def ragged() -> np.ndarray:
    made = np.empty(2, dtype=object)
    made[:] = [np.zeros((N, 3)), np.zeros((N + 1, 3))]
    return made


FRAMES = np.random.default_rng(0).normal(size=(2, N, 3))
BAD_SEQUENCES = [
    (lambda p: p / "nowhere", "got nothing there"),
    (lambda p: Path(r"C:\scans\take 2"), r"got nothing there; write / between folders, not \\; under WSL C: is"),
    (lambda p: p / "a\0b", "cannot be opened|got nothing there"),
    (lambda p: p, "expected numbered files .*got none"),
    (one_frame, "expected at least 2 frames, got 1"),
    (mixed_suffixes, "files of one kind, got 2 .(npy|obj) and 2 .(npy|obj)"),
    (unnumbered_among_numbered, "a number in every file name, got 'least.npy' and one file with a number"),
    (frames_in_subfolder, "folder 'clouds' has some: give that"),
    (cameras_in_subfolders, "folders 'cam0' and 'cam1' have files of the same names: .* into one file"),
    (archive_in_folder, "give the file 'all.npz' itself"),
    (other_suffixes, r"\.npy \.pcd .* \.npz\), got other suffixes \(\.docx\)"),
    (single_file, "got one file; give the folder"),
    (unknown_suffix, r"unknown suffix '\.docx'; expected an \.npz, or a folder .*\.xyz"),
    (lambda p: written(p / "a.zip", b"PK"), r"unknown suffix '\.zip'; .*; unpack it"),
    (lambda p: written(p / "0.png", b"\x89PNG").parent, r"got other suffixes \(\.png\); images are no points"),
    (lambda p: written(p / "a.npz", b"version https://git-lfs.github.com/spec/v1\n"), "a pointer of Git LFS"),
    (npz_of(points=ragged), "got objects.*could run code.*np.savez"),
    (npz_of(points=np.zeros((N, 3))), r"expected shape \(T, N, 3\), got \(12, 3\)"),
    (npz_of(points=FRAMES[:1]), "expected at least 2 frames, got 1"),
    (npz_of(points=FRAMES, normals=FRAMES[:, 1:]), r"normals: expected shape \(2, 12, 3\).*got \(2, 11, 3\)"),
    (npz_of(points=FRAMES + 1j), "expected real numbers, got complex128"),
    (npz_of(points=np.full((2, N, 3), "a")), "expected real numbers, got <U1"),
    (npz_of(points=np.full((2, N, 3), np.nan)), r"points\[0\] of a\.npz: .*NaN or infinity"),
    (npz_of(points=np.ones((2, N, 3))), "all points are equal"),
    (npz_of(points=FRAMES[:, :9]), "at least 10 points, got 9"),
    (
        npz_of(points_0=FRAMES[0], points_1=FRAMES[1], normals_1=FRAMES[0, 1:]),
        r"points_1 of a.npz: normals: .*\(11, 3\)",
    ),
    (npz_of(points_0=FRAMES[0]), "expected at least 2 frames, got 1"),
    (npz_of(vertices=FRAMES, faces=np.zeros((1, 3), int)), "got vertices, faces; it holds meshes"),
    (npz_of(), "got no arrays"),
]


@pytest.mark.parametrize(("make", "message"), BAD_SEQUENCES)
def test_bad_sequences(tmp_path, make, message):
    with pytest.raises(InputError, match=message) as caught:
        read_clouds(make(tmp_path))
    assert "\n" not in str(caught.value)


def test_frames_that_leave_too_few(tmp_path):
    save_frames(tmp_path, "1.npy", "2.npy", "3.npy")
    with pytest.raises(InputError, match="--frames: expected at least 2 of 3 frames, got 1; widen"):
        read_clouds(tmp_path, slice(2, None))


def test_colours_are_not_taken_for_normals(tmp_path):
    save_frames(tmp_path, "1.npy", "2.npy")
    np.save(tmp_path / "2.npy", np.hstack([FRAMES[0], np.full((N, 3), 200.0)]))
    assert read_clouds(tmp_path).normals == (None, None)
    np.save(tmp_path / "2.npy", np.hstack([FRAMES[0], np.full((N, 3), 2000.5)]))
    with pytest.raises(InputError, match=r"2\.npy: expected normals or colours in columns 4 to 6.*--columns"):
        read_clouds(tmp_path, strict=True)


def test_obj_normals_of_other_vertices_are_left_out(tmp_path, clouds, normals):
    for frame in range(2):
        write_frame(tmp_path / f"{frame}.obj", clouds[frame], normals[frame])
    with open(tmp_path / "1.obj", "a") as stream:
        stream.write("\nf 1//1 2//2 3//4\n")
    sequence = read_clouds(tmp_path)
    assert sequence.normals[0] is not None
    assert sequence.normals[1] is None


def test_real_clouds(shared_data):
    sequence = read_clouds(shared_data / "crane_clouds" / "points.npz")
    with np.load(shared_data / "crane_clouds" / "points.npz") as archive:
        stored = archive["points"]
    assert len(sequence) == len(stored)
    assert all(len(p) + m == stored.shape[1] for p, m in zip(sequence.points, sequence.merged, strict=True))
    assert all(n is not None and n.shape == p.shape for p, n in zip(sequence.points, sequence.normals, strict=True))
