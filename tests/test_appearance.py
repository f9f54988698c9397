"""Colours and texture coordinates: read, kept through a run folder, split along seams, exported."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from present import look_of, present
from synthetic import icosphere
from trimesh.visual import TextureVisuals

from warpdef.appearance import Appearance, split_seams
from warpdef.apps.main import run
from warpdef.config import Config
from warpdef.errors import InputError
from warpdef.export import export
from warpdef.export.animation import Animation, dress, load_animation
from warpdef.files import read_geometry, read_mesh
from warpdef.files.run_folder import RunFolder
from warpdef.files.saved_run import load_run
from warpdef.mesh import MeshSequence

VERTICES, FACES = icosphere(1)
COUNT = len(VERTICES)
RNG = np.random.default_rng(0)
COLORS = RNG.integers(0, 256, (COUNT, 4), dtype=np.uint8)
UV = RNG.random((COUNT, 2)).astype(np.float32)
CORNER_UV = UV[FACES] + (np.arange(len(FACES)) % 2).astype(np.float32)[:, None, None]
MOVING = np.stack([VERTICES, 1.5 * VERTICES]).astype(np.float32)


def ply(form: str, color: str, names: str = "s t", wedges: bool = False) -> bytes:
    """A PLY of the sphere; ``color`` is the type of red, green, blue."""
    dtype = [(n, "<f4") for n in "xyz"] + [
        (n, {"uchar": "u1", "float": "<f4"}[color]) for n in ("red", "green", "blue")
    ]
    dtype += [(n, "<f4") for n in names.split()]
    rows = np.zeros(COUNT, dtype)
    for k, name in enumerate("xyz"):
        rows[name] = VERTICES[:, k]
    for k, name in enumerate(("red", "green", "blue")):
        rows[name] = COLORS[:, k] if color == "uchar" else COLORS[:, k] / 255
    for k, name in enumerate(names.split()):
        rows[name] = UV[:, k]
    face = [("n", "u1"), ("i", "<i4", (3,))] + ([("m", "u1"), ("w", "<f4", (6,))] if wedges else [])
    faces = np.zeros(len(FACES), face)
    faces["n"], faces["i"] = 3, FACES
    words = {"<f4": "float", "u1": "uchar"}
    head = ["ply", f"format {form} 1.0", f"element vertex {COUNT}"]
    head += [f"property {words[kind]} {name}" for name, kind in dtype]
    head += [f"element face {len(FACES)}", "property list uchar int vertex_indices"]
    if wedges:
        faces["m"], faces["w"] = 6, CORNER_UV.reshape(-1, 6)
        head.append("property list uchar float texcoord")
    text = "\n".join([*head, "end_header", ""]).encode()
    if form == "ascii":
        lines = [" ".join(repr(v.item()) for v in row) for row in rows]
        return text + "\n".join([*lines, *(f"3 {a} {b} {c}" for a, b, c in FACES)]).encode()
    return text + rows.tobytes() + faces.tobytes()


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
@pytest.mark.parametrize("color", ["uchar", "float"])
@pytest.mark.parametrize("names", ["s t", "u v", "texture_u texture_v"])
def test_ply(tmp_path, form, color, names):
    (tmp_path / "a.ply").write_bytes(ply(form, color, names))
    mesh = read_mesh(tmp_path / "a.ply")
    np.testing.assert_array_equal(present(mesh.appearance).colors, COLORS[:, :3])
    np.testing.assert_array_equal(present(mesh.appearance).uv, UV)
    np.testing.assert_array_equal(mesh.faces, FACES)


def test_dark_bytes_in_ascii_are_bytes(tmp_path):
    """Bytes of 0 and 1 alone could be taken for fractions."""
    lines = ["ply", "format ascii 1.0", "element vertex 3", *(f"property float {n}" for n in "xyz")]
    lines += [f"property uchar {n}" for n in ("red", "green", "blue")]
    lines += ["element face 1", "property list uchar int vertex_indices", "end_header"]
    lines += ["0 0 0 1 0 0", "1 0 0 0 1 0", "0 1 0 0 0 1", "3 0 1 2"]
    (tmp_path / "a.ply").write_text("\n".join(lines))
    np.testing.assert_array_equal(look_of(tmp_path / "a.ply").colors, np.eye(3))


def test_ply_with_texture_places_by_corner(tmp_path):
    (tmp_path / "a.ply").write_bytes(ply("binary_little_endian", "uchar", "", wedges=True))
    look = look_of(tmp_path / "a.ply")
    assert look.uv is None
    np.testing.assert_array_equal(look.corner_uv, CORNER_UV)


def test_meshes_of_others(tmp_path):
    mesh = trimesh.Trimesh(VERTICES, FACES, vertex_colors=COLORS, process=False)
    mesh.export(tmp_path / "a.ply")
    np.testing.assert_array_equal(look_of(tmp_path / "a.ply").colors, COLORS)
    trimesh.Trimesh(VERTICES, FACES, process=False).export(tmp_path / "plain.ply")
    assert read_mesh(tmp_path / "plain.ply").appearance is None
    mesh.export(tmp_path / "a.obj")
    np.testing.assert_array_equal(look_of(tmp_path / "a.obj").colors, COLORS[:, :3])
    textured = trimesh.Trimesh(VERTICES, FACES, process=False, visual=TextureVisuals(uv=UV))
    textured.export(tmp_path / "b.obj")
    np.testing.assert_allclose(present(look_of(tmp_path / "b.obj").uv), UV, atol=1e-7)


def test_obj_without_all_texture_places(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nvt 0 0\nf 1/1 2/1 3/1\nf 2 4 3\n")
    look = present(read_mesh(tmp_path / "a.obj").appearance)
    assert look.arrays() == {} and look.notes[0].endswith("3 of the 6 corners of its faces have none")
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/2 3/1\n")
    with pytest.raises(InputError, match="a.obj"):
        read_mesh(tmp_path / "a.obj")


def test_seams():
    source, faces, uv = split_seams(CORNER_UV, FACES, COUNT)
    np.testing.assert_array_equal(source[:COUNT], np.arange(COUNT))
    np.testing.assert_array_equal(source[faces], FACES)
    np.testing.assert_array_equal(uv[faces], CORNER_UV)
    assert len(np.unique(np.column_stack([source, uv]), axis=0)) == len(source) > COUNT
    # Without seams nothing is doubled; a vertex of no face keeps its place.
    source, faces, uv = split_seams(UV[FACES], FACES, COUNT + 1)
    np.testing.assert_array_equal(source, np.arange(COUNT + 1))
    np.testing.assert_array_equal(faces, FACES)
    np.testing.assert_array_equal(uv[:COUNT], UV)


@pytest.fixture
def result(tmp_path) -> Path:
    pytest.importorskip("tomli_w")
    return RunFolder.prepare(tmp_path / "out").save(
        vertices=MOVING, faces=FACES, keyframe=0, config=Config(), report={}, steps=[], names=["a", "b"],
        appearance=Appearance(COLORS, None, CORNER_UV),
    )  # fmt: skip


def test_through_a_run_folder_to_an_export(result, tmp_path):
    look = load_run(result).appearance
    np.testing.assert_array_equal(look.colors, COLORS)
    np.testing.assert_array_equal(look.corner_uv, CORNER_UV)
    animation = load_animation(result)
    np.testing.assert_array_equal(animation.vertices[:, :COUNT], MOVING)
    np.testing.assert_array_equal(present(animation.uv)[animation.faces], CORNER_UV)
    export(animation, tmp_path / "a.ply")
    again = read_geometry(tmp_path / "a.ply" / "0001.ply")
    np.testing.assert_array_equal(present(again.colors)[:COUNT], COLORS)
    np.testing.assert_array_equal(present(again.uv)[present(again.faces)], CORNER_UV)


def test_seams_double_no_vertex_where_corners_have_places_of_their_own(result, tmp_path):
    """Vertices stay the template's, in number and order, in .obj and for the point caches; shading has no crease."""
    animation = load_animation(result)
    assert animation.vertices.shape[1] > COUNT == animation.joined.vertices.shape[1]
    export(animation, tmp_path / "a.obj")
    again = read_geometry(tmp_path / "a.obj" / "0001.obj")
    np.testing.assert_allclose(again.points, MOVING[1], atol=1e-6)
    np.testing.assert_array_equal(again.faces, FACES)
    np.testing.assert_array_equal(present(again.corner_uv).astype(np.float32), CORNER_UV)
    for suffix, start in (("pc2", 32), ("mdd", 8 + 4 * 2)):
        export(animation, tmp_path / f"b.{suffix}")
        assert (tmp_path / f"b.{suffix}").stat().st_size == start + 2 * COUNT * 12
        assert len(read_geometry(tmp_path / f"b_{suffix}.obj").points) == COUNT
    shaded = animation.normals_of(1)
    np.testing.assert_array_equal(shaded[COUNT:], shaded[present(animation.copies)])


def test_seams_in_usd(result, tmp_path):
    usd = pytest.importorskip("pxr.Usd")
    from pxr import UsdGeom

    export(load_animation(result), tmp_path / "a.usdc")
    stage = usd.Stage.Open(str(tmp_path / "a.usdc"))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/warpdef/mesh"))
    np.testing.assert_array_equal(np.array(mesh.GetPointsAttr().Get(1)), MOVING[1].astype(np.float32))
    np.testing.assert_array_equal(np.array(mesh.GetFaceVertexIndicesAttr().Get()), FACES.ravel())
    st = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
    assert st.GetInterpolation() == "faceVarying"
    np.testing.assert_array_equal(np.array(st.Get()).reshape(-1, 3, 2), CORNER_UV)


def test_normals_given_are_written(tmp_path):
    normals = np.stack([VERTICES, -VERTICES]).astype(np.float32)
    look = Appearance(COLORS, UV)
    animation = dress(MOVING, FACES, look, normals, up="z")
    export(animation, tmp_path / "a.ply")
    np.testing.assert_allclose(present(read_geometry(tmp_path / "a.ply" / "0001.ply").normals), -VERTICES, atol=1e-6)
    for uv in (UV, None):
        export(dress(MOVING, FACES, Appearance(None, uv), normals), tmp_path / "a.obj", overwrite=True)
        mesh = read_geometry(tmp_path / "a.obj" / "0001.obj")
        np.testing.assert_allclose(present(mesh.normals), -VERTICES, atol=1e-6)
        np.testing.assert_array_equal(mesh.faces, FACES)
        assert uv is None or np.array_equal(present(mesh.uv), UV)
    export(animation, tmp_path / "a.glb", precise=True)  # trimesh leaves the scale of others out
    loaded = trimesh.load_scene(tmp_path / "a.glb", process=False)
    (mesh,) = loaded.geometry.values()
    np.testing.assert_allclose(mesh.vertex_normals, VERTICES, atol=1e-6)
    pyvista = pytest.importorskip("pyvista")
    export(animation, tmp_path / "a.pvd")
    vtp = pyvista.read(tmp_path / "a_vtp" / "0001.vtp")
    np.testing.assert_array_equal(vtp.point_data["Normals"], normals[1])


def test_normals_in_usd(tmp_path):
    usd = pytest.importorskip("pxr.Usd")
    from pxr import UsdGeom

    normals = np.stack([VERTICES, -VERTICES]).astype(np.float32)
    export(dress(MOVING, FACES, Appearance(), normals), tmp_path / "a.usdc")
    stage = usd.Stage.Open(str(tmp_path / "a.usdc"))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/warpdef/mesh"))
    np.testing.assert_array_equal(np.array(mesh.GetNormalsAttr().Get(1)), normals[1])
    assert mesh.GetNormalsInterpolation() == "vertex"


def test_what_does_not_fit():
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"colors": COLORS[1:]}, "one colour a vertex"),
        ({"colors": COLORS.astype(float)}, "expected uint8"),
        ({"uv": UV[1:]}, "one pair a vertex"),
        ({"corner_uv": CORNER_UV[1:]}, "one pair a corner"),
        ({"uv": UV * np.nan}, "finite"),
    ]
    for given, message in wrong:
        with pytest.raises(InputError, match=message):
            Appearance.checked(COUNT, len(FACES), **given)
    with pytest.raises(InputError, match="normals: expected finite numbers"):
        Animation(MeshSequence(MOVING, FACES), normals=MOVING[:1])


def test_a_damaged_run_folder(result):
    with np.load(result / "sequence.npz") as stored:
        arrays: dict[str, Any] = dict(stored) | {"vertex_colors": COLORS[1:]}
    np.savez(result / "sequence.npz", **arrays)
    with pytest.raises(InputError, match=r"sequence\.npz: vertex colours"):
        load_run(result)


def test_a_template_keeps_its_looks(tmp_path):
    """The whole way: a coloured, textured template through `reconstruct` into the run folder and an export."""
    pytest.importorskip("tomli_w")
    points = RNG.normal(size=(3, 300, 3))
    points /= np.linalg.norm(points, axis=2, keepdims=True)
    np.savez(tmp_path / "clouds.npz", points=points * np.array([1.0, 1.02, 1.04])[:, None, None])
    (tmp_path / "template.ply").write_bytes(ply("ascii", "uchar"))
    flags = ["--iterations", "3", "--grid.levels", "2", "--refine.iterations", "1", "--threads", "1"]
    flags += ["--keyframe", "0", "--template", str(tmp_path / "template.ply"), "-o", str(tmp_path / "out")]
    assert run(["reconstruct", str(tmp_path / "clouds.npz"), *flags]) == 0
    animation = load_animation(tmp_path / "out")
    np.testing.assert_array_equal(animation.colors, COLORS[:, :3])
    np.testing.assert_array_equal(animation.uv, UV)
    np.testing.assert_array_equal(animation.faces, FACES)
    result = load_run(tmp_path / "out")
    moved = result.deform(result.vertices[result.keyframe])
    np.testing.assert_array_equal(moved.astype(result.vertices.dtype), result.vertices)
