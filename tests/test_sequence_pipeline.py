"""Gaps, units and place through the whole method and the command."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic
from stand_in_method import StandInMethod

import warpdef
from warpdef.apps.main import run
from warpdef.config import Config
from warpdef.errors import InputError
from warpdef.files.saved_run import load_run
from warpdef.mesh import TriMesh
from warpdef.sequence import PointSequence

TRUTH = synthetic.turning_ellipsoid(6, 300, np.random.default_rng(3))
EMPTY = np.zeros((0, 3))


def quick(keyframe: str) -> Config:
    base = Config()
    return replace(
        base,
        keyframe=replace(base.keyframe, choice=keyframe),
        grid=replace(base.grid, levels=3),
        optimiser=replace(base.optimiser, iterations=60, warmup=10),
        refine=replace(base.refine, iterations=3),
    )


def template(frame: int, scale: float = 1.0, shift: float = 0.0) -> TriMesh:
    return TriMesh(TRUTH.vertices[frame] * scale + shift, TRUTH.faces)


def test_a_gap_is_interpolated_and_an_end_is_held(device: str) -> None:
    clouds = [p if t not in (0, 3) else EMPTY for t, p in enumerate(TRUTH.clouds)]
    heard = []
    result = warpdef.reconstruct(clouds, quick("2"), device=device, template=template(2), callback=heard.append)
    assert result.vertices.shape == (6, len(TRUTH.vertices[0]), 3) and result.keyframe == 2
    np.testing.assert_array_equal(result.vertices[0], result.vertices[1])
    # Vertex i is the same material point: halfway between its neighbours it must be near where it truly was.
    extent = np.ptp(TRUTH.vertices[3], axis=0).max()
    wrong = np.linalg.norm(result.vertices[3] - TRUTH.vertices[3], axis=1).mean()
    still = np.linalg.norm(TRUTH.vertices[2] - TRUTH.vertices[3], axis=1).mean()
    assert wrong < 0.5 * still < 0.1 * extent
    report = result.report
    assert (report["frames"], report["frames_missing"], report["points"]) == (6, [0, 3], [0, 300, 300, 0, 300, 300])
    assert [line.split(" cannot")[0] for line in report["warnings"][:2]] == ["frame 3 of 6", "frame 0 of 6"]
    assert set(report["warnings"][:2]) <= {p.message for p in heard}


def test_a_gap_is_no_keyframe(device: str) -> None:
    clouds = [p if t != 3 else EMPTY for t, p in enumerate(TRUTH.clouds)]
    with pytest.raises(InputError, match="--keyframe: frame 3 has no usable points"):
        warpdef.reconstruct(clouds, quick("3"), device=device)


@pytest.mark.parametrize(("scale", "shift"), [(2.0**-20, 0.0), (2.0**20, 0.0), (1.0, 2.0**20)])
def test_units_and_place_cost_nothing(scale: float, shift: float) -> None:
    """Powers of two, so that the only rounding left is that of a far shift, 1e-10. On the CPU, where runs repeat."""
    # Coordinates with few bits, so that the shift itself is exact.
    clouds = [np.rint(p * 2**20) / 2**20 for p in TRUTH.clouds]
    mesh = np.rint(TRUTH.vertices[2] * 2**20) / 2**20
    plain = warpdef.reconstruct(clouds, quick("2"), device="cpu", template=TriMesh(mesh, TRUTH.faces))
    moved = warpdef.reconstruct(
        [p * scale + shift for p in clouds],
        quick("2"),
        device="cpu",
        template=TriMesh(mesh * scale + shift, TRUTH.faces),
    )
    back = (moved.vertices.astype(np.float64) - shift) / scale
    assert moved.vertices.dtype == (np.float64 if shift else np.float32)
    np.testing.assert_allclose(back, plain.vertices, rtol=0, atol=2e-7)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Five clouds, the third broken."""
    path = tmp_path / "scans"
    path.mkdir()
    for t in range(5):
        np.save(path / f"{t}.npy", TRUTH.clouds[t])
    (path / "2.npy").write_bytes(b"noise")
    return path


def test_the_command_keeps_all_frames(monkeypatch, folder: Path, tmp_path: Path) -> None:
    method = StandInMethod.install(monkeypatch)
    assert run(["reconstruct", str(folder), "-o", str(tmp_path / "out"), "--points", "50"]) == 0
    result = load_run(tmp_path / "out")
    assert result.names == tuple(f"{t}.npy" for t in range(5)) and len(result.meshes) == 5
    assert [len(p) for p in method.calls[0]["sequence"].points] == [300] * 4
    arguments = ["reconstruct", str(folder), "-o", str(tmp_path / "fewer"), "--points", "11"]
    assert run(arguments) == 0
    # Of large frames twenty times as many points are held as are asked for; the method draws from them.
    assert [len(p) for p in method.calls[1]["sequence"].points] == [220] * 4


def test_strict_refuses(monkeypatch, folder: Path, tmp_path: Path, capfd) -> None:
    StandInMethod.install(monkeypatch)
    assert run(["reconstruct", str(folder), "-o", str(tmp_path / "out"), "--strict"]) == 2
    assert "2.npy: cannot be read as .npy" in capfd.readouterr().err
    assert not (tmp_path / "out").exists()


def test_far_away_the_run_folder_keeps_the_shape(tmp_path: Path) -> None:
    from warpdef.files.mesh_files import read_mesh
    from warpdef.files.run_folder import RunFolder

    far = TRUTH.vertices + 1e6
    path = RunFolder.prepare(tmp_path / "out").save(
        vertices=far, faces=TRUTH.faces, keyframe=0, config=Config(), report={}, steps=[], names=list("abcdef")
    )
    loaded = load_run(path)
    np.testing.assert_array_equal(loaded.meshes.vertices, far)
    np.testing.assert_array_equal(read_mesh(path / "meshes" / "0003.ply").vertices, far[3])
    assert json.loads((path / "report.json").read_text()) == {}


def test_the_sequence_of_arrays_is_as_lenient_as_the_command() -> None:
    sequence = PointSequence.from_arrays([p if t != 3 else EMPTY for t, p in enumerate(TRUTH.clouds)])
    assert [gap.number for gap in sequence.gaps] == [3]
