"""``warpdef export --color``: measures as colours or as numbers, in the formats that hold them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from glb_reader import Glb
from view_samples import BAR, FRAMES, VERTICES, save_clouds, save_run, save_truth

from warpdef.apps.export_options import unit_name
from warpdef.apps.main import run
from warpdef.errors import InputError
from warpdef.export.animation import linear_colors
from warpdef.export.measured import UNKNOWN, VertexValues, measure_vertices
from warpdef.mesh import MeshSequence
from warpdef.vertex_measures import VertexMeasures

COUNT = VERTICES.shape[1]
AWAY = np.linalg.norm(VERTICES - VERTICES[0], axis=2)


@pytest.fixture
def result(tmp_path) -> Path:
    """A run folder that knows a confidence, and has colours of its own, which a measure takes the place of."""
    folder = save_run(tmp_path / "result")
    with np.load(folder / "sequence.npz") as stored:
        arrays = {name: stored[name] for name in stored.files}
    confidence = np.arange(FRAMES * COUNT, dtype=np.int64).reshape(FRAMES, COUNT) % 256
    arrays |= {"confidence": confidence.astype(np.uint8), "vertex_colors": np.full((COUNT, 3), 7, dtype=np.uint8)}
    np.savez(folder / "sequence.npz", **arrays)
    return folder


def displaced(result: Path) -> np.ndarray:
    with np.load(result / "sequence.npz") as stored:
        keyframe = int(stored["keyframe"])
    return np.linalg.norm(VERTICES.astype(np.float64) - VERTICES[keyframe], axis=2)


def test_numbers_in_npz_ply_and_pvd(result, tmp_path, capfd):
    trimesh, pyvista = pytest.importorskip("trimesh"), pytest.importorskip("pyvista")
    flags = ["--color", "displacement", "--metres-per-unit", "0.001"]
    for name in ("a.npz", "a.ply", "a.pvd"):
        assert run(["export", str(result), str(tmp_path / name), *flags]) == 0
    assert "displacement, mm: colours from 0 to" in capfd.readouterr().out
    expected = displaced(result)
    with np.load(tmp_path / "a.npz") as stored:
        np.testing.assert_allclose(stored["displacement"], expected, atol=1e-6)
        assert "vertex_colors" not in stored.files
    reader = pyvista.get_reader(tmp_path / "a.pvd")
    for t, file in enumerate(sorted((tmp_path / "a.ply").iterdir())):
        mesh = trimesh.load(file, process=False)
        np.testing.assert_allclose(mesh.metadata["_ply_raw"]["vertex"]["data"]["displacement"], expected[t], atol=1e-6)
        assert b"comment displacement: displacement, mm\n" in file.read_bytes()
        reader.set_active_time_value(reader.time_values[t])
        shown = reader.read()[0]
        assert shown.active_scalars_name == "displacement (mm)"
        np.testing.assert_allclose(shown.active_scalars, expected[t], atol=1e-6)


def test_colours_in_glb(result, tmp_path, capfd):
    for precise in (False, True):
        flags = ["--color", "confidence", "--overwrite", *(["--precise"] if precise else [])]
        assert run(["export", str(result), str(tmp_path / "a.glb"), *flags]) == 0
        out, err = capfd.readouterr()
        assert "confidence, 0 to 1: colours from 0 to 1\n" in out and "Blender shows the first frame's" in err
        with np.load(result / "sequence.npz") as stored:
            values = stored["confidence"] / 255.0
        colors = VertexValues("confidence", "", "", values.astype(np.float32), (0.0, 1.0)).colors()
        glb = Glb(tmp_path / "a.glb")
        primitive = glb.json["meshes"][0]["primitives"][0]
        base = glb.numbers(primitive["attributes"]["COLOR_0"])
        np.testing.assert_allclose(base[:, :3], linear_colors(colors[0]), atol=1e-5)
        for target, shades in zip(primitive["targets"], colors[1:], strict=True):
            shown = base + glb.numbers(target["COLOR_0"])
            np.testing.assert_allclose(shown[:, :3], linear_colors(shades), atol=5e-5)
            np.testing.assert_array_equal(shown[:, 3], 1.0)


def test_a_rig_shows_the_mean(result, tmp_path, capfd):
    assert run(["export", str(result), str(tmp_path / "a.glb"), "--color", "displacement", "--bones", "2"]) == 0
    assert "mean over the frames" in capfd.readouterr().err
    glb = Glb(tmp_path / "a.glb")
    light = glb.numbers(glb.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"])[:, :3]
    mean = displaced(result).mean(axis=0)
    # Violet to yellow: the more, the lighter.
    order = np.argsort(mean)
    assert light[order[-5:]].sum() > light[order[:5]].sum() + 1.0


def test_colours_in_usd_are_samples(result, tmp_path):
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom, UsdShade

    assert run(["export", str(result), str(tmp_path / "a.usdc"), "--color", "confidence"]) == 0
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    primvar = UsdGeom.Mesh(stage.GetPrimAtPath("/warpdef/mesh")).GetDisplayColorPrimvar()
    with np.load(result / "sequence.npz") as stored:
        values = (stored["confidence"] / 255.0).astype(np.float32)
    colors = VertexValues("confidence", "", "", values, (0.0, 1.0)).colors()
    assert primvar.GetTimeSamples() == list(range(FRAMES)) and primvar.GetInterpolation() == "vertex"
    for t in range(FRAMES):
        np.testing.assert_allclose(np.array(primvar.Get(t)), linear_colors(colors[t]), atol=1e-6)
    shader = UsdShade.Shader(stage.GetPrimAtPath("/warpdef/material/surface"))
    assert shader.GetInput("diffuseColor").HasConnectedSource()


def test_error_against_clouds_and_truth(result, tmp_path, capfd):
    target = tmp_path / "a.npz"
    assert run(["export", str(result), str(target), "--color", "error"]) == 2
    assert "expected the clouds or a truth" in capfd.readouterr().err and not target.exists()
    sources = (["--input", str(save_clouds(tmp_path / "c.npz"))], ["--truth", str(save_truth(tmp_path / "t.npz"))])
    for source in sources:
        assert run(["export", str(result), str(target), "--color", "error", "--overwrite", *source]) == 0
        with np.load(target) as stored:
            assert stored["error"].shape == (FRAMES, COUNT) and np.nanmax(stored["error"]) < 0.2
            assert np.nanmin(stored["error"]) >= 0.0


def test_formats_without_measures_refuse(result, tmp_path, capfd):
    for name in ("a.obj", "a.pc2", "a.bvh"):
        assert run(["export", str(result), str(tmp_path / name), "--color", "stretch"]) == 2
        assert "for a measure" in capfd.readouterr().err and not (tmp_path / name).exists()


def test_between_frames_numbers_are_between():
    measures = VertexMeasures(MeshSequence(VERTICES, BAR.faces))
    values = measure_vertices(measures, "displacement", np.array([1.0, 1.25, FRAMES - 1.0])).values
    np.testing.assert_allclose(values[1], 0.75 * AWAY[1] + 0.25 * AWAY[2], atol=1e-6)
    np.testing.assert_allclose(values[[0, 2]], AWAY[[1, -1]], atol=1e-6)
    with pytest.raises(InputError, match="--color confidence: expected a result that knows"):
        measure_vertices(measures, "confidence", np.array([0.0]))


def test_unknown_numbers_are_grey_and_count_for_no_mean():
    values = VertexValues("error", "", "", np.array([[np.nan, 1.0, np.nan], [2.0, 3.0, np.nan]], "f4"), (0.0, 4.0))
    assert (values.colors()[0, 0] == UNKNOWN).all() and not (values.colors()[1] == UNKNOWN).all(axis=1)[:2].any()
    np.testing.assert_array_equal(values.over_time().values, np.array([[2.0, 2.0, np.nan]], "f4"))


def test_units_have_names():
    assert [unit_name(x) for x in (0.001, 0.01, 1.0, 0.5)] == ["mm", "cm", "input units", "input units"]
