"""``warpdef deform``: what the given geometry carries arrives, and bad input is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from glb_reader import Glb
from present import present
from synthetic import bending_bar

from warpdef.apps.main import run
from warpdef.config import Config
from warpdef.files import read_clouds, read_geometry
from warpdef.files.run_folder import RunFolder
from warpdef.files.saved_run import load_run
from warpdef.motion.grid_motion import GridMotion
from warpdef.sequence import Similarity

FRAMES, KEYFRAME = 4, 1
BAR = bending_bar(FRAMES, 20, np.random.default_rng(0), subdivisions=1)
DENSE = bending_bar(FRAMES, 20, np.random.default_rng(0), subdivisions=2)
VERTICES = BAR.vertices.astype(np.float32)
NODES = np.random.default_rng(1).normal(scale=0.02, size=(FRAMES - 1, 1 + 27, 8))
MOTION = GridMotion.from_nodes(NODES, (1, 2), KEYFRAME, Similarity(np.zeros(3), 0.9))


def save(path: Path, motion: GridMotion | None = MOTION) -> Path:
    pytest.importorskip("tomli_w")
    names = [f"scan{t}" for t in range(FRAMES)]
    return RunFolder.prepare(path).save(
        vertices=VERTICES, faces=BAR.faces, keyframe=KEYFRAME, config=Config(), report={}, steps=[], names=names,
        motion=motion,
    )  # fmt: skip


@pytest.fixture
def result(tmp_path) -> Path:
    return save(tmp_path / "result")


def write_ply(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The dense bar at the keyframe as ASCII PLY with normals, colours and texture coordinates."""
    rng, points = np.random.default_rng(2), DENSE.vertices[KEYFRAME]
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    colors, uv = rng.integers(0, 256, (len(points), 3)), rng.random((len(points), 2)).round(6)
    fields = [f"float {n}" for n in "x y z nx ny nz".split()] + [f"uchar {n}" for n in ("red", "green", "blue")]
    fields += ["float s", "float t"]
    lines = ["ply", "format ascii 1.0", f"element vertex {len(points)}", *(f"property {f}" for f in fields)]
    lines += [f"element face {len(DENSE.faces)}", "property list uchar int vertex_indices", "end_header"]
    rows = zip(points, normals, colors, uv, strict=True)
    lines += [" ".join(map(repr, [*map(float, (*p, *n)), *map(int, c), *map(float, t)])) for p, n, c, t in rows]
    lines += [f"3 {a} {b} {c}" for a, b, c in DENSE.faces]
    path.write_text("\n".join(lines) + "\n")
    return colors, uv, normals


def test_everything_a_mesh_carries_arrives(result, tmp_path, capfd):
    colors, uv, normals = write_ply(tmp_path / "dense.ply")
    flags = ["--fps", "12", "--frames", "1:4"]
    assert run(["deform", str(result), str(tmp_path / "dense.ply"), "-o", str(tmp_path / "a.npz"), *flags]) == 0
    assert capfd.readouterr().out.startswith(
        f"3 frames, {len(colors)} vertices, {len(DENSE.faces)} faces, moved from frame 1: {tmp_path / 'a.npz'} ("
    )
    moved = load_run(result).follow(DENSE.vertices[KEYFRAME])
    with np.load(tmp_path / "a.npz") as stored:
        np.testing.assert_array_equal(stored["faces"], DENSE.faces)
        np.testing.assert_array_equal(stored["vertex_colors"], colors)
        np.testing.assert_allclose(stored["uv"], uv, atol=1e-6)
        np.testing.assert_allclose(stored["vertices"], moved.points[1:], atol=1e-6)
        np.testing.assert_allclose(stored["normals"][0], normals, atol=1e-6)
        np.testing.assert_allclose(stored["normals"][2], moved.turned(normals)[3], atol=1e-5)
        assert float(stored["fps"]) == 12.0 and list(stored["names"]) == ["scan1", "scan2", "scan3"]
    # In a format of others, read by our readers.
    assert run(["deform", str(result), str(tmp_path / "dense.ply"), "-o", str(tmp_path / "a.ply")]) == 0
    again = read_geometry(tmp_path / "a.ply" / "0003.ply")
    np.testing.assert_array_equal(again.colors, colors)
    np.testing.assert_allclose(present(again.uv), uv, atol=1e-6)
    np.testing.assert_allclose(present(again.normals), moved.turned(normals)[3], atol=1e-5)
    np.testing.assert_allclose(again.points, moved.points[3], atol=1e-6)


def test_a_mesh_is_rigged_or_kept_precise(result, tmp_path, capfd):
    write_ply(tmp_path / "dense.ply")
    arguments = ["deform", str(result), str(tmp_path / "dense.ply"), "-o"]
    assert run([*arguments, str(tmp_path / "rig.glb"), "--bones", "2"]) == 0
    assert "rig of 2 bones" in capfd.readouterr().err
    assert "JOINTS_0" in Glb(tmp_path / "rig.glb").json["meshes"][0]["primitives"][0]["attributes"]
    assert run([*arguments, str(tmp_path / "bones.bvh"), "--bones", "2"]) == 0
    assert (tmp_path / "bones.bvh").read_text().startswith("HIERARCHY")
    capfd.readouterr()
    kinds = []
    for flags in ([], ["--precise"]):
        assert run([*arguments, str(tmp_path / f"{len(flags)}.glb"), *flags]) == 0
        assert ("positions are multiples of" in capfd.readouterr().out) == (not flags)
        glb = Glb(tmp_path / f"{len(flags)}.glb").json
        kinds.append(glb["accessors"][glb["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]["componentType"])
    assert kinds == [5122, 5126]
    np.save(tmp_path / "points.npy", DENSE.vertices[KEYFRAME])
    assert (
        run(["deform", str(result), str(tmp_path / "points.npy"), "-o", str(tmp_path / "a.npz"), "--bones", "2"]) == 2
    )
    assert "leave --bones out" in capfd.readouterr().err


def test_a_texture_with_seams_is_split(result, tmp_path):
    """A cube net's corner has several texture places: the vertex is doubled, and each copy moves alike."""
    points = "v 0 0 0\nv 0.3 0 0\nv 0 0.1 0\nv 0.3 0.1 0\n"
    places = "vt 0 0\nvt 1 0\nvt 0 1\nvt 0.5 0.5\nvt 1 1\n"
    (tmp_path / "a.obj").write_text(points + places + "f 1/1 2/2 3/3\nf 2/4 4/5 3/3\n")
    assert run(["deform", str(result), str(tmp_path / "a.obj"), "-o", str(tmp_path / "a.npz")]) == 0
    with np.load(tmp_path / "a.npz") as stored:
        vertices, faces, uv = stored["vertices"], stored["faces"], stored["uv"]
    assert faces.tolist() == [[0, 1, 2], [4, 3, 2]]
    np.testing.assert_array_equal(vertices[:, 4], vertices[:, 1])
    np.testing.assert_array_equal(uv[faces], [[[0, 0], [1, 0], [0, 1]], [[0.5, 0.5], [1, 1], [0, 1]]])


def test_points_in_slow_motion(result, tmp_path):
    points = DENSE.vertices[KEYFRAME][::7]
    np.save(tmp_path / "landmarks.npy", points)
    target = tmp_path / "landmarks.npz"
    flags = ["--slow", "2", "--frames", "::-1"]
    assert run(["deform", str(result), str(tmp_path / "landmarks.npy"), "-o", str(target), *flags]) == 0
    with np.load(target) as stored:
        places, names = stored["points"], list(stored["names"])
    assert names == ["scan3", "scan2 + 0.5", "scan2", "scan1 + 0.5", "scan1", "scan0 + 0.5", "scan0"]
    expected = load_run(result).deform(points, [3, 2.5, 2, 1.5, 1, 0.5, 0])
    np.testing.assert_allclose(places, expected, atol=1e-6)
    np.testing.assert_allclose(np.stack(read_clouds(target).points), places, atol=1e-6)
    folder = tmp_path / "landmarks.ply"
    assert run(["deform", str(result), str(tmp_path / "landmarks.npy"), "-o", str(folder)]) == 0
    assert sorted(p.name for p in folder.iterdir()) == [f"{t:04d}.ply" for t in range(FRAMES)]
    np.testing.assert_allclose(read_geometry(folder / "0002.ply").points, expected[2], atol=1e-6)


def test_a_result_with_its_motion_can_be_replaced(result):
    assert (result / "motion.npz").stat().st_size > 0
    names = [f"scan{t}" for t in range(FRAMES)]
    RunFolder.prepare(result, overwrite=True).save(
        vertices=VERTICES, faces=BAR.faces, keyframe=KEYFRAME, config=Config(), report={}, steps=[], names=names
    )
    assert not (result / "motion.npz").exists()


def test_its_own_mesh_becomes_the_result(result, tmp_path):
    own = result / "meshes" / f"{KEYFRAME:04d}.ply"
    assert run(["deform", str(result), str(own), "-o", str(tmp_path / "own.npz")]) == 0
    with np.load(tmp_path / "own.npz") as stored:
        np.testing.assert_array_equal(stored["vertices"], VERTICES)


def test_geometry_in_another_place_is_warned_of(result, tmp_path, capfd):
    np.save(tmp_path / "far.npy", DENSE.vertices[KEYFRAME] + 3.0)
    assert run(["deform", str(result), str(tmp_path / "far.npy"), "-o", str(tmp_path / "far.npz")]) == 0
    err = capfd.readouterr().err
    assert "warning: half of" in err and "keyframe 1" in err and "scan1" in err


def test_bad_input(result, tmp_path, capfd):
    np.save(tmp_path / "points.npy", np.zeros((5, 3)))
    np.save(tmp_path / "empty.npy", np.zeros((0, 3)))
    np.save(tmp_path / "nan.npy", np.full((5, 3), np.nan))
    old = save(tmp_path / "old", motion=None)
    (tmp_path / "taken.npz").touch()
    for arguments, expected in (
        ([result, "absent.ply", "-o", "a.npz"], ["absent.ply", "nothing there"]),
        ([result, "points.npy", "-o", "a.glb"], ["a.glb", ".ply or .npz for points without faces"]),
        ([result, "points.npy", "-o", "a.docx"], ["unknown suffix '.docx'"]),
        ([result, "empty.npy", "-o", "a.npz"], ["empty.npy", "got none"]),
        ([result, "nan.npy", "-o", "a.npz"], ["nan.npy", "NaN"]),
        ([result, ".", "-o", "a.npz"], ["got a folder"]),
        ([old, "points.npy", "-o", "a.npz"], ["motion.npz", "reconstruct again with --config"]),
        ([result, "points.npy", "-o", "taken.npz"], ["already exists"]),
        ([result, "points.npy", "-o", "a.npz", "--slow", "0"], ["--slow"]),
        ([result, "points.npy", "-o", "a.npz", "--slow", "1e9"], ["--slow", "at most"]),
        ([result, "points.npy"], ["--file"]),
    ):
        words = [str(tmp_path / a) if isinstance(a, str) and "." in a and a[0] != "-" else str(a) for a in arguments]
        assert run(["deform", *words]) == 2, arguments
        err = capfd.readouterr().err
        assert [part for part in expected if part not in err] == [], err
    assert sorted(p.name for p in tmp_path.iterdir() if p.name.startswith("a.")) == []


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"frame_count": np.array(9)}, "it belongs to another run"),
        ({"step": np.float64(-1)}, "reconstruct again"),
        ({"nodes": None}, "reconstruct again"),
    ],
)
def test_damaged_motion_files(result, tmp_path, capfd, arrays, message):
    changed = {name: array for name, array in (MOTION.arrays() | arrays).items() if array is not None}
    np.savez(result / "motion.npz", **changed)
    np.save(tmp_path / "points.npy", np.zeros((5, 3)))
    assert run(["deform", str(result), str(tmp_path / "points.npy"), "-o", str(tmp_path / "a.npz")]) == 2
    err = capfd.readouterr().err
    assert "motion.npz" in err and message in err
