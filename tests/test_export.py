"""Exports are read back by readers that are not ours, number for number."""

from __future__ import annotations

import struct
import xml.etree.ElementTree as ElementTree
import zipfile
from pathlib import Path

import numpy as np
import pytest
from glb_reader import Glb
from synthetic import bending_bar

from warpdef.export import FORMATS, export
from warpdef.export.animation import Animation, linear_colors
from warpdef.mesh import MeshSequence

BAR = bending_bar(5, 20, np.random.default_rng(0), subdivisions=2)
VERTICES = (BAR.vertices * 137.0 + [1000.0, -3.0, 0.25]).astype(np.float32)
FACES = BAR.faces
COUNT = VERTICES.shape[1]
SRGB = np.random.default_rng(1).integers(0, 256, (COUNT, 4), dtype=np.uint8)
UV = np.random.default_rng(2).random((COUNT, 2)).astype(np.float32)
PLAIN = Animation(MeshSequence(VERTICES, FACES), fps=10.0)
PAINTED = Animation(MeshSequence(VERTICES, FACES), tuple("abcde"), 25.0, "z", 0.01, SRGB, UV)


def srgb(light: np.ndarray) -> np.ndarray:
    """Linear light to 8-bit sRGB, by the standard's own inverse."""
    value = np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.rint(value * 255).astype(np.uint8)


def outward(frame: int) -> np.ndarray:
    """Normals of a frame's vertices by another library: the faces' normals weighted by their areas."""
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.Trimesh(VERTICES[frame].astype(np.float64), FACES, process=False)
    total = mesh.faces_sparse @ (mesh.face_normals * mesh.area_faces[:, None])
    return total / np.linalg.norm(total, axis=1, keepdims=True)


def test_glb_by_its_specification(tmp_path):
    export(PAINTED, tmp_path / "bar.glb", precise=True)
    glb = Glb(tmp_path / "bar.glb")
    (mesh,), (animation,) = glb.json["meshes"], glb.json["animations"]
    (primitive,) = mesh["primitives"]
    np.testing.assert_array_equal(glb.array(primitive["indices"]).reshape(-1, 3), FACES)
    base = glb.array(primitive["attributes"]["POSITION"])
    times = glb.array(animation["samplers"][0]["input"])[:, 0]
    np.testing.assert_allclose(times, np.arange(5) / 25.0, rtol=1e-6)
    weights = glb.array(animation["samplers"][0]["output"]).reshape(5, 4)
    targets = np.stack([glb.array(t["POSITION"]) for t in primitive["targets"]])
    moved = base + np.einsum("tk,kvi->tvi", weights, targets)
    np.testing.assert_allclose(moved, VERTICES, rtol=0, atol=2 * np.spacing(np.float32(np.abs(VERTICES).max())))
    np.testing.assert_array_equal(
        glb.array(primitive["attributes"]["TEXCOORD_0"]), (UV * [1, -1] + [0, 1]).astype("f4")
    )
    light = glb.array(primitive["attributes"]["COLOR_0"]) / 65535
    np.testing.assert_array_equal(srgb(light[:, :3]), SRGB[:, :3])
    np.testing.assert_array_equal(np.rint(light[:, 3] * 255), SRGB[:, 3])
    assert mesh["extras"]["targetNames"] == list("bcde")
    normals = glb.array(primitive["attributes"]["NORMAL"])
    normals = normals + np.einsum("tk,kvi->tvi", weights, [glb.array(t["NORMAL"]) for t in primitive["targets"]])
    np.testing.assert_allclose(np.linalg.norm(normals, axis=2), 1.0, atol=1e-5)
    # Outward, as a rounded bar's are: away from the frame's own middle line, hence mostly away from its middle.
    assert (np.einsum("tvi,tvi->tv", normals, VERTICES - VERTICES.mean(axis=1, keepdims=True)) > 0).mean() > 0.9


def test_glb_by_trimesh(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    export(PAINTED, tmp_path / "bar.glb", precise=True)
    scene = trimesh.load(tmp_path / "bar.glb", process=False)
    (mesh,) = scene.geometry.values()
    np.testing.assert_array_equal(mesh.vertices.astype(np.float32), VERTICES[0])
    np.testing.assert_array_equal(mesh.faces, FACES)
    np.testing.assert_allclose(mesh.visual.uv, UV, atol=1e-7)
    # z up becomes y up, and hundredths of a metre become metres, on the node alone.
    transform = scene.graph[scene.graph.nodes_geometry[0]][0]
    np.testing.assert_allclose(transform[:3, :3] @ [0, 0, 1], [0, 0.01, 0], atol=1e-9)
    np.testing.assert_allclose(transform[:3, :3] @ [0, 1, 0], [0, 0, -0.01], atol=1e-9)


def test_glb_without_extras_stands_as_it_is(tmp_path):
    export(PLAIN, tmp_path / "bar.glb", precise=True)
    glb = Glb(tmp_path / "bar.glb")
    assert set(glb.json["nodes"][0]) == {"mesh", "name"}
    assert set(glb.json["meshes"][0]["primitives"][0]["attributes"]) == {"POSITION", "NORMAL"}


def test_glb_of_one_frame_has_no_animation(tmp_path):
    export(Animation(PLAIN.meshes.select(slice(2, 3))), tmp_path / "bar.glb", precise=True)
    glb = Glb(tmp_path / "bar.glb")
    assert "animations" not in glb.json and "targets" not in glb.json["meshes"][0]["primitives"][0]
    np.testing.assert_array_equal(glb.array(0), VERTICES[2])


@pytest.mark.parametrize("suffix", ["usd", "usda", "usdc", "usdz"])
def test_usd(tmp_path, suffix):
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom

    path = tmp_path / f"bar.{suffix}"
    export(PAINTED, path)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    stage = Usd.Stage.Open(str(path))
    assert UsdGeom.GetStageUpAxis(stage) == "Z" and UsdGeom.GetStageMetersPerUnit(stage) == 0.01
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode(), stage.GetTimeCodesPerSecond()) == (0, 4, 25)
    mesh = UsdGeom.Mesh(stage.GetDefaultPrim().GetChildren()[0])
    assert mesh.GetSubdivisionSchemeAttr().Get() == "none"
    np.testing.assert_array_equal(np.array(mesh.GetFaceVertexCountsAttr().Get()), np.full(len(FACES), 3))
    np.testing.assert_array_equal(np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3), FACES)
    assert mesh.GetPointsAttr().GetTimeSamples() == [0, 1, 2, 3, 4] == mesh.GetExtentAttr().GetTimeSamples()
    for t in range(5):
        np.testing.assert_array_equal(np.array(mesh.GetPointsAttr().Get(t)), VERTICES[t])
        box = [VERTICES[t].min(axis=0), VERTICES[t].max(axis=0)]
        np.testing.assert_array_equal(np.array(mesh.GetExtentAttr().Get(t)), box)
        np.testing.assert_allclose(np.array(mesh.GetNormalsAttr().Get(t)), outward(t), atol=1e-6)
    assert mesh.GetNormalsInterpolation() == "vertex"
    light = np.array(mesh.GetDisplayColorPrimvar().Get())
    np.testing.assert_array_equal(srgb(light), SRGB[:, :3])
    np.testing.assert_allclose(np.array(mesh.GetDisplayOpacityPrimvar().Get()), SRGB[:, 3] / 255, rtol=1e-6)
    np.testing.assert_array_equal(np.array(UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st").Get()), UV)
    assert mesh.GetDisplayColorPrimvar().GetInterpolation() == "vertex"


@pytest.mark.parametrize("animation", [PLAIN, PAINTED], ids=["plain", "painted"])
def test_usd_material_reads_the_colours(tmp_path, animation):
    pytest.importorskip("pxr")
    from pxr import Usd, UsdShade

    export(animation, tmp_path / "bar.usda")
    stage = Usd.Stage.Open(str(tmp_path / "bar.usda"))
    material, _ = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath("/warpdef/mesh")).ComputeBoundMaterial()
    surface, _, _ = material.ComputeSurfaceSource()
    assert surface.GetShaderId() == "UsdPreviewSurface"
    assert (surface.GetInput("metallic").Get(), surface.GetInput("roughness").Get()) == pytest.approx((0.0, 0.7))
    color = surface.GetInput("diffuseColor")
    if animation.colors is None:
        export(animation, tmp_path / "bar.glb")
        factor = Glb(tmp_path / "bar.glb").json["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"]
        np.testing.assert_allclose(color.Get(), factor[:3], rtol=1e-6)
        return
    source, name, _ = color.GetConnectedSource()
    reader = UsdShade.Shader(source.GetPrim())
    assert (reader.GetShaderId(), name) == ("UsdPrimvarReader_float3", "result")
    assert reader.GetInput("varname").Get() == "displayColor"


def test_pc2_by_its_layout(tmp_path):
    export(PAINTED, tmp_path / "bar.pc2")
    data = (tmp_path / "bar.pc2").read_bytes()
    assert data[:12] == b"POINTCACHE2\0"
    assert struct.unpack_from("<iiffi", data, 12) == (1, COUNT, 0.0, 1.0, 5)
    values = struct.unpack_from(f"<{5 * COUNT * 3}f", data, 32)
    assert len(data) == 32 + 4 * len(values)
    np.testing.assert_array_equal(np.reshape(values, VERTICES.shape), VERTICES)
    check_obj(tmp_path / "bar_pc2.obj", 0)


def test_mdd_by_its_layout(tmp_path):
    export(PAINTED, tmp_path / "bar.mdd")
    data = (tmp_path / "bar.mdd").read_bytes()
    assert struct.unpack_from(">ii", data) == (5, COUNT)
    np.testing.assert_allclose(struct.unpack_from(">5f", data, 8), np.arange(5) / 25, rtol=1e-6)
    values = struct.unpack_from(f">{5 * COUNT * 3}f", data, 28)
    assert len(data) == 28 + 4 * len(values)
    np.testing.assert_array_equal(np.reshape(values, VERTICES.shape), VERTICES)
    check_obj(tmp_path / "bar_mdd.obj", 0)


def check_obj(path: Path, frame: int) -> None:
    lines = [line.split() for line in path.read_text().splitlines()]
    v = np.array([line[1:] for line in lines if line[0] == "v"], dtype=np.float64)
    np.testing.assert_array_equal(v[:, :3].astype(np.float32), VERTICES[frame])
    np.testing.assert_array_equal(np.rint(v[:, 3:] * 255), SRGB[:, :3])
    vt = np.array([line[1:] for line in lines if line[0] == "vt"], dtype=np.float64)
    np.testing.assert_array_equal(vt.astype(np.float32), UV)
    corners = np.array([[c.split("/") for c in line[1:]] for line in lines if line[0] == "f"], dtype=int)
    for column in range(corners.shape[2]):
        np.testing.assert_array_equal(corners[:, :, column] - 1, FACES)
    # Smooth shading is on before the first face, or programs show facets.
    kinds = [line[0] for line in lines]
    assert lines[kinds.index("s")] == ["s", "1"] and kinds.index("s") < kinds.index("f")
    vn = np.array([line[1:] for line in lines if line[0] == "vn"], dtype=np.float64)
    assert corners.shape[2] == (3 if len(vn) else 2)
    if len(vn):
        np.testing.assert_allclose(vn, outward(frame), atol=1e-6)


def test_obj_folder(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    export(PAINTED, tmp_path / "bar.obj")
    files = sorted((tmp_path / "bar.obj").iterdir())
    assert [p.name for p in files] == [f"{t:04d}.obj" for t in range(5)]
    for t, file in enumerate(files):
        check_obj(file, t)
        assert "\nvn " in file.read_text()
        # trimesh splits vertices by texture coordinate; ours are one a vertex, so nothing is to split.
        mesh = trimesh.load(file, process=False, maintain_order=True)
        np.testing.assert_array_equal(mesh.vertices.astype(np.float32)[mesh.faces], VERTICES[t][FACES])


@pytest.mark.parametrize("animation", [PLAIN, PAINTED])
def test_ply_folder(tmp_path, animation):
    trimesh = pytest.importorskip("trimesh")
    export(animation, tmp_path / "bar", format="ply")
    files = sorted((tmp_path / "bar").iterdir())
    assert [p.name for p in files] == [f"{t:04d}.ply" for t in range(5)]
    for t, file in enumerate(files):
        mesh = trimesh.load(file, process=False)
        np.testing.assert_array_equal(mesh.vertices.astype(np.float32), VERTICES[t])
        np.testing.assert_array_equal(mesh.faces, FACES)
        rows = mesh.metadata["_ply_raw"]["vertex"]["data"]
        if animation.colors is not None:
            np.testing.assert_array_equal(np.column_stack([rows[c] for c in ("red", "green", "blue", "alpha")]), SRGB)
            np.testing.assert_array_equal(np.column_stack([rows["s"], rows["t"]]), UV)
        else:
            assert set(rows.dtype.names) == {"x", "y", "z", "nx", "ny", "nz"}
        normals = np.column_stack([rows[f"n{axis}"] for axis in "xyz"])
        np.testing.assert_allclose(normals, outward(t), atol=1e-6)


def test_stl_folder(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    export(PAINTED, tmp_path / "bar.stl")
    files = sorted((tmp_path / "bar.stl").iterdir())
    assert [p.name for p in files] == [f"{t:04d}.stl" for t in range(5)]
    for t, file in enumerate(files):
        np.testing.assert_array_equal(trimesh.load(file, process=False).triangles, VERTICES[t][FACES])


def test_3mf_folder(tmp_path):
    pytest.importorskip("lxml")
    pytest.importorskip("networkx")
    export(PAINTED, tmp_path / "bar.3mf")
    files = sorted((tmp_path / "bar.3mf").iterdir())
    assert [p.name for p in files] == [f"{t:04d}.3mf" for t in range(5)]
    core = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
    for t, file in enumerate(files):
        with zipfile.ZipFile(file) as archive:
            model = ElementTree.fromstring(archive.read("3D/3dmodel.model"))
        # Hundredths of a metre become the format's millimetres.
        assert model.get("unit") == "millimeter"
        vertices = [[float(v.attrib[axis]) for axis in "xyz"] for v in model.iter(f"{core}vertex")]
        np.testing.assert_allclose(vertices, VERTICES[t] * 10.0, rtol=1e-6)
        triangles = [[int(f.attrib[f"v{k}"]) for k in "123"] for f in model.iter(f"{core}triangle")]
        np.testing.assert_array_equal(triangles, FACES)


def test_pvd(tmp_path):
    pyvista = pytest.importorskip("pyvista")
    export(PAINTED, tmp_path / "bar & co.pvd")
    reader = pyvista.get_reader(tmp_path / "bar & co.pvd")
    np.testing.assert_allclose(reader.time_values, np.arange(5) / 25)
    for t, time in enumerate(reader.time_values):
        reader.set_active_time_value(time)
        mesh = reader.read()[0]
        np.testing.assert_array_equal(mesh.points, VERTICES[t])
        np.testing.assert_allclose(mesh.point_data.active_normals, outward(t), atol=1e-6)
        np.testing.assert_array_equal(mesh.regular_faces, FACES)
        np.testing.assert_array_equal(mesh.point_data["colors"], SRGB)
        np.testing.assert_array_equal(mesh.active_texture_coordinates, UV)
    files = [e.get("file") for e in ElementTree.parse(tmp_path / "bar & co.pvd").iter("DataSet")]
    assert files == [f"bar & co_vtp/{t:04d}.vtp" for t in range(5)]


def test_npz(tmp_path):
    export(PAINTED, tmp_path / "bar.npz")
    with np.load(tmp_path / "bar.npz", allow_pickle=False) as stored:
        np.testing.assert_array_equal(stored["vertices"], VERTICES)
        np.testing.assert_array_equal(stored["faces"], FACES)
        np.testing.assert_array_equal(stored["vertex_colors"], SRGB)
        np.testing.assert_array_equal(stored["uv"], UV)
        assert (float(stored["fps"]), str(stored["up"]), list(stored["names"])) == (25.0, "z", list("abcde"))
    export(PLAIN, tmp_path / "plain.npz")
    with np.load(tmp_path / "plain.npz", allow_pickle=False) as stored:
        assert sorted(stored.files) == ["faces", "fps", "metres_per_unit", "names", "up", "vertices"]


def test_anime_by_its_layout(tmp_path):
    export(PAINTED, tmp_path / "bar.anime")
    with open(tmp_path / "bar.anime", "rb") as stream:
        frames, vertices, faces = np.fromfile(stream, "<i4", 3)
        assert (frames, vertices, faces) == (5, COUNT, len(FACES))
        first = np.fromfile(stream, "<f4", COUNT * 3).reshape(-1, 3)
        np.testing.assert_array_equal(np.fromfile(stream, "<i4", faces * 3).reshape(-1, 3), FACES)
        offsets = np.fromfile(stream, "<f4", -1).reshape(4, COUNT, 3)
    np.testing.assert_array_equal(first, VERTICES[0])
    exact = np.spacing(np.float32(np.abs(VERTICES).max()))
    np.testing.assert_allclose(first + offsets, VERTICES[1:], rtol=0, atol=exact)


def test_linear_colors_at_known_values():
    light = linear_colors(np.array([[0, 10, 188, 128], [255, 11, 127, 255]], dtype=np.uint8))
    np.testing.assert_allclose(light[0], [0, 10 / 255 / 12.92, 0.5028865, 128 / 255], atol=1e-6)
    np.testing.assert_allclose(light[1, [0, 3]], [1, 1])


def test_every_format_has_a_test_here():
    text = Path(__file__).read_text()
    text += (Path(__file__).parent / "test_export_rig.py").read_text()
    assert [name for name in FORMATS if f"bar.{name}" not in text and f'"{name}"' not in text and name != "pvd"] == []
