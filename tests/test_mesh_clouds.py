"""Meshes of other programs as frames and as templates, and points drawn from those whose vertices are uneven."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from present import present
from scipy.spatial import cKDTree
from synthetic import icosphere
from texture_samples import png
from trimesh.exchange.dae import export_collada
from trimesh.exchange.gltf import export_gltf
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from warpdef.errors import InputError
from warpdef.files import read_clouds, read_mesh, write_ply
from warpdef.files.formats import CLOUD_SUFFIXES, FORMATS, read_surface
from warpdef.geometry.triangles import is_watertight

SPHERE, FACES = icosphere(4)  # 2,562 vertices
SCENES = [suffix for suffix, form in FORMATS.items() if form.merges]


def write(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    if path.suffix == ".gltf":
        for name, data in export_gltf(trimesh.Scene(mesh)).items():
            (path.parent / (path.name if name == "model.gltf" else name)).write_bytes(data)
    elif path.suffix == ".dae":
        path.write_bytes(export_collada(mesh))
    else:
        mesh.export(path)


@pytest.mark.parametrize("suffix", SCENES)
def test_a_template_of_another_program(tmp_path, suffix):
    shape = SPHERE * [1, 2, 3] + 5
    write(tmp_path / f"a{suffix}", shape, FACES)
    mesh = read_mesh(tmp_path / f"a{suffix}")
    assert mesh.vertices.shape == SPHERE.shape and is_watertight(mesh.faces)
    distance, index = cKDTree(shape).query(mesh.vertices)
    assert distance.max() < 1e-5 and len(set(index)) == len(shape)


@pytest.mark.parametrize("suffix", [".stl", ".glb", ".dae"])
def test_meshes_as_frames(tmp_path, suffix):
    for t in range(3):
        write(tmp_path / f"{t}{suffix}", SPHERE + [0, 0, t], FACES)
    sequence = read_clouds(tmp_path)
    assert [p.shape for p in sequence.points] == [SPHERE.shape] * 3 and sequence.warnings == ()


def test_the_parts_of_a_scene_are_put_where_they_stand(tmp_path):
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.Trimesh(SPHERE, FACES), transform=trimesh.transformations.translation_matrix([5, 0, 0]))
    scene.add_geometry(trimesh.Trimesh(SPHERE, FACES), transform=trimesh.transformations.translation_matrix([0, 9, 0]))
    scene.export(tmp_path / "a.glb")
    mesh = read_mesh(tmp_path / "a.glb")
    assert len(mesh.vertices) == 2 * len(SPHERE)
    np.testing.assert_allclose(mesh.vertices.max(axis=0), [6, 10, 1], atol=1e-5)


@pytest.mark.parametrize("suffix", [".stl", ".ply"])
def test_points_are_drawn_from_uneven_meshes(tmp_path, suffix):
    """A box of two triangles a side."""
    box = trimesh.creation.box([1.0, 2.0, 4.0])
    for t in range(3):
        write(tmp_path / f"{t}{suffix}", np.asarray(box.vertices) + t, np.asarray(box.faces))
    sequence = read_clouds(tmp_path)
    assert [len(p) for p in sequence.points] == [5000] * 3
    assert sequence.warnings[0].startswith("3 frames are meshes of few or uneven vertices")
    for t in range(3):
        points, normals = sequence.points[t] - t, present(sequence.normals[t])
        assert np.abs(np.abs(points) / [0.5, 1.0, 2.0]).max() <= 1 + 1e-6
        side = np.abs(points / [0.5, 1.0, 2.0]).argmax(axis=1)
        shares = np.bincount(side) / 5000
        np.testing.assert_allclose(shares, np.array([8, 4, 2]) / 14, atol=0.03)  # 2 x 4, 1 x 4 and 1 x 2
        assert (np.einsum("ni,ni->n", points, normals) > 0).all()
    assert len({tuple(p[0]) for p in sequence.points}) == 3  # frames share no places


def test_a_mesh_dense_on_one_side_is_drawn_from(tmp_path):
    pinched = SPHERE / (1.02 - SPHERE[:, 2:] * 0.98) * [1, 1, 0] + SPHERE * [0, 0, 1]  # wide at the top
    for t in range(2):
        write_ply(tmp_path / f"{t}.ply", pinched + t, FACES)
    drawn = read_clouds(tmp_path)
    assert [len(p) for p in drawn.points] == [5000, 5000]


def test_a_cloud_with_a_few_faces_stays_a_cloud(tmp_path):
    for t in range(2):
        write_ply(tmp_path / f"{t}.ply", SPHERE + t, FACES[:20])
    np.testing.assert_allclose(read_clouds(tmp_path).points[1], SPHERE + 1, atol=1e-12)


def test_an_open_mesh_gives_no_normals(tmp_path):
    top = FACES[(SPHERE[FACES][:, :, 2] > 0).all(axis=1)]
    used, faces = np.unique(top, return_inverse=True)
    for t in range(2):
        write(tmp_path / f"{t}.stl", SPHERE[used] + t, faces.reshape(-1, 3)[:300])
    assert read_clouds(tmp_path).normals == (None, None)


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_a_lying_count_allocates_nothing(tmp_path, suffix):
    write(tmp_path / f"a{suffix}", SPHERE, FACES)
    data = (tmp_path / f"a{suffix}").read_bytes()
    (tmp_path / f"a{suffix}").write_bytes(data.replace(b'"count":2562', b'"count":9999999999'))
    with pytest.raises(InputError, match="declares more data than there are"):
        read_mesh(tmp_path / f"a{suffix}")


def test_e57(tmp_path):
    pye57 = pytest.importorskip("pye57")
    path = tmp_path / "0.e57"
    file = pye57.E57(str(path), mode="w")
    shades = np.arange(3 * len(SPHERE)).reshape(-1, 3).astype(np.uint8)
    for part in (slice(None, 1000), slice(1000, None)):
        scan = {f"cartesian{a}": np.ascontiguousarray(SPHERE[part, i]) for i, a in enumerate("XYZ")}
        scan |= {f"color{c}": np.ascontiguousarray(shades[part, i]) for i, c in enumerate(("Red", "Green", "Blue"))}
        file.write_scan_raw(scan | {"intensity": np.ones(len(SPHERE[part]), dtype=np.float32)})
    file.close()
    surface = read_surface(path, CLOUD_SUFFIXES)
    np.testing.assert_allclose(surface.points, SPHERE, atol=1e-9)
    np.testing.assert_array_equal(surface.colors, shades)
    assert surface.passed == ("intensity",)
    data = bytearray(path.read_bytes())
    for at in (10, 60, len(data) // 2):
        data[at] ^= 0xFF
        (tmp_path / "1.e57").write_bytes(data)
        with pytest.raises(InputError, match=r"1\.e57"):
            read_surface(tmp_path / "1.e57", CLOUD_SUFFIXES)


@pytest.mark.parametrize("wrong", [-4, 2562])
def test_a_face_that_names_no_point_is_refused(tmp_path: Path, wrong: int) -> None:
    faces = FACES.copy()
    faces[7, 1] = wrong
    lines = [" ".join(map(repr, row)) for row in SPHERE.tolist()]
    lines += [f"3 {a} {b} {c}" for a, b, c in faces]
    head = ["ply", "format ascii 1.0", f"element vertex {len(SPHERE)}", *(f"property double {axis}" for axis in "xyz")]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    for t in range(2):
        (tmp_path / f"{t}.ply").write_text("\n".join([*head, *lines]))
    with pytest.raises(InputError, match=r"expected vertex indices in 0\.\.2561, got .*damaged"):
        read_clouds(tmp_path)


RAMP = np.stack(np.broadcast_arrays(np.arange(256), np.arange(256)[::-1, None], 7), axis=2).astype(np.uint8)
"""An image whose red is 255 u and whose green is 255 v."""


def textured(path: Path, vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray) -> None:
    lines = ["mtllib a.mtl", "usemtl skin", *(f"v {x} {y} {z}" for x, y, z in vertices.tolist())]
    lines += [f"vt {u} {v}" for u, v in uv.tolist()]
    lines += ["f " + " ".join(f"{i}/{i}" for i in face) for face in (faces + 1).tolist()]
    path.write_text("\n".join(lines))
    (path.parent / "a.mtl").write_text("newmtl skin\nmap_Kd skin.png\n")


@pytest.mark.parametrize("rounds", [1, 4])
def test_points_of_textured_meshes_have_the_colours_of_the_image(tmp_path, rounds):
    """Vertices where there are enough of them, and points drawn from the faces."""
    vertices, faces = icosphere(rounds)
    for t in range(3):
        textured(tmp_path / f"{t}.obj", vertices, faces, 0.5 + 0.49 * vertices[:, :2])
    (tmp_path / "skin.png").write_bytes(png(RAMP))
    sequence = read_clouds(tmp_path)
    points, colors = sequence.points[1], present(present(sequence.colors)[1])
    expected = 255.0 * (0.5 + 0.49 * points[:, :2])
    assert len(points) >= 2562 and np.abs(colors[:, :2] - expected).max() < 2.0 and (colors[:, 2] == 7).all()
    (tmp_path / "skin.png").unlink()
    bare = read_clouds(tmp_path)
    assert not bare.colors
    (line,) = [w for w in bare.warnings if "without its texture image" in w]
    assert "'skin.png', which is not in its folder; put the image beside it (and 2 frames more)" in line


def test_vertices_of_a_textured_scene_have_the_colours_of_the_image(tmp_path):
    image = pytest.importorskip("PIL.Image").fromarray(RAMP)
    material = PBRMaterial(baseColorTexture=image)
    look = TextureVisuals(uv=0.5 + 0.49 * SPHERE[:, :2], material=material)
    trimesh.Trimesh(SPHERE, FACES, visual=look, process=False).export(tmp_path / "a.glb")
    surface = read_surface(tmp_path / "a.glb", CLOUD_SUFFIXES)
    expected = 255.0 * (0.5 + 0.49 * surface.points[:, :2])
    assert np.abs(present(surface.colors)[:, :2] - expected).max() < 2.0
