"""Data a million units from its origin keeps its shape in every format, by readers not ours, and in the view."""

from __future__ import annotations

import numpy as np
import pytest
from glb_reader import Glb
from present import present
from synthetic import bending_bar
from view_samples import BAR as VIEWED
from view_samples import save_run

from warpdef.apps.viewer.content import load_content
from warpdef.errors import InputError
from warpdef.export import export
from warpdef.export.animation import Animation, load_animation
from warpdef.export.origin import choose_origin
from warpdef.export.points import MovingPoints
from warpdef.files import write_clouds_npz
from warpdef.mesh import MeshSequence
from warpdef.sequence import PointSequence

BAR = bending_bar(4, 20, np.random.default_rng(0), subdivisions=1)
AWAY = np.array([1e6, -3e6, 250.0])
PLACES = BAR.vertices + AWAY
FAR = Animation(MeshSequence(PLACES, BAR.faces))
CLOSE = 3e-7  # what float32 resolves of the bar, which is about 2 long
EXACT = 1e-9  # what float64 resolves at 3e6


def kept(local: np.ndarray) -> None:
    """Positions that count from the animation's origin."""
    np.testing.assert_allclose(np.asarray(local, dtype=np.float64) + FAR.origin, PLACES[: len(local)], atol=CLOSE)


def test_an_origin_only_where_it_is_needed():
    assert not choose_origin(BAR.vertices).any() and not Animation(MeshSequence(BAR.vertices, BAR.faces)).is_far
    origin = choose_origin(PLACES)
    assert np.abs(origin - PLACES.reshape(-1, 3).mean(axis=0)).max() < 2.0
    np.testing.assert_array_equal(origin, np.round(origin))
    # float32 alone would lose it.
    assert np.abs(PLACES.astype(np.float32) - PLACES).max() > 0.05
    # Small shapes get small steps; one place has no extent at all.
    tiny = 1e-6 * BAR.vertices + 1.0
    assert np.abs(choose_origin(tiny) - 1.0).max() < 1e-5 and choose_origin(tiny).any()
    np.testing.assert_array_equal(choose_origin(np.full((2, 3, 3), 1e6)), np.full(3, 1e6))


def test_an_origin_given_is_kept():
    local = (PLACES - AWAY).astype(np.float32)
    given = Animation(MeshSequence(local, BAR.faces), origin=AWAY)
    np.testing.assert_array_equal(given.vertices, local)
    np.testing.assert_array_equal(given.places, local + AWAY)


@pytest.mark.parametrize("up", ["y", "z"])
def test_glb_stands_there_by_its_node(tmp_path, up):
    far = Animation(FAR.meshes, up=up, metres_per_unit=0.01, origin=FAR.origin)
    export(far, tmp_path / "bar.glb", precise=True)
    glb = Glb(tmp_path / "bar.glb")
    (primitive,) = glb.json["meshes"][0]["primitives"]
    base = glb.array(primitive["attributes"]["POSITION"])
    kept(base[None])
    kept(base + np.stack([np.zeros_like(base), *(glb.array(t["POSITION"]) for t in primitive["targets"])]))
    node = glb.json["nodes"][0]
    x, y, z = (0.01 * FAR.origin).tolist()
    np.testing.assert_allclose(node["translation"], [x, z, -y] if up == "z" else [x, y, z])
    if up == "z":
        trimesh = pytest.importorskip("trimesh")
        scene = trimesh.load(tmp_path / "bar.glb", process=False)
        (mesh,) = scene.geometry.values()
        whole = scene.graph[scene.graph.nodes_geometry[0]][0]
        placed = mesh.vertices @ whole[:3, :3].T + whole[:3, 3]
        x, y, z = 0.01 * PLACES[0].T
        np.testing.assert_allclose(placed, np.column_stack([x, z, -y]), atol=0.01 * CLOSE)


def test_usd_stands_there_by_its_transform(tmp_path):
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom

    export(FAR, tmp_path / "bar.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "bar.usdc"))
    mesh = UsdGeom.Mesh(stage.GetDefaultPrim().GetChildren()[0])
    matrix = np.array(UsdGeom.XformCache(2).GetLocalToWorldTransform(mesh.GetPrim()))
    placed = np.array(mesh.GetPointsAttr().Get(2), dtype=np.float64) @ matrix[:3, :3] + matrix[3, :3]
    np.testing.assert_allclose(placed, PLACES[2], atol=CLOSE)
    assert not UsdGeom.Xformable(stage.GetDefaultPrim()).GetOrderedXformOps()[0].GetAttr().GetTimeSamples()


@pytest.mark.parametrize("suffix", ["ply", "obj"])
def test_folders_hold_all_digits(tmp_path, suffix):
    trimesh = pytest.importorskip("trimesh")
    export(FAR, tmp_path / f"bar.{suffix}")
    for file, places in zip(sorted((tmp_path / f"bar.{suffix}").iterdir()), PLACES, strict=True):
        mesh = trimesh.load(file, process=False, maintain_order=True)
        np.testing.assert_allclose(mesh.vertices, places, rtol=0, atol=CLOSE)
        np.testing.assert_array_equal(mesh.faces, BAR.faces)


def test_pvd_holds_all_digits(tmp_path):
    pyvista = pytest.importorskip("pyvista")
    export(FAR, tmp_path / "bar.pvd")
    reader = pyvista.get_reader(tmp_path / "bar.pvd")
    reader.set_active_time_value(reader.time_values[3])
    np.testing.assert_allclose(reader.read()[0].points, PLACES[3], rtol=0, atol=CLOSE)


def test_npz_holds_all_digits(tmp_path):
    export(FAR, tmp_path / "bar.npz")
    with np.load(tmp_path / "bar.npz") as stored:
        assert stored["vertices"].dtype == np.float64
        np.testing.assert_allclose(stored["vertices"], PLACES, rtol=0, atol=CLOSE)


@pytest.mark.parametrize(("suffix", "kind", "head"), [("pc2", "<f4", 32), ("mdd", ">f4", 8 + 4 * 4)])
def test_caches_count_from_where_their_base_mesh_says(tmp_path, suffix, kind, head):
    export(FAR, tmp_path / f"bar.{suffix}")
    data = (tmp_path / f"bar.{suffix}").read_bytes()
    local = np.frombuffer(data, kind, offset=head).reshape(PLACES.shape)
    kept(local)
    lines = [line.split() for line in (tmp_path / f"bar_{suffix}.obj").read_text().splitlines()]
    (origin,) = [line[2:] for line in lines if line[:2] == ["#", "origin"]]
    np.testing.assert_array_equal(np.array(origin, dtype=float), FAR.origin)
    base = np.array([line[1:] for line in lines if line[0] == "v"], dtype=float)
    np.testing.assert_array_equal(base.astype(np.float32), local[0])


def test_anime_says_that_it_cannot(tmp_path):
    with pytest.raises(InputError, match=r"anime holds float32 alone, got one around \(1e\+06, -3e\+06, 250\)"):
        export(FAR, tmp_path / "bar.anime")
    assert not list(tmp_path.iterdir())


def test_moving_points_hold_all_digits(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    moving = MovingPoints(PLACES, tuple("abcd"), 24.0)
    export(moving, tmp_path / "points.npz")
    with np.load(tmp_path / "points.npz") as stored:
        np.testing.assert_array_equal(stored["points"], PLACES)
    export(moving, tmp_path / "points.ply")
    cloud = trimesh.load(tmp_path / "points.ply" / "0001.ply", process=False)
    np.testing.assert_allclose(cloud.vertices, PLACES[1], rtol=0, atol=EXACT)


def test_a_run_is_exported_and_viewed_near_its_origin(tmp_path):
    places = VIEWED.vertices + AWAY
    run = save_run(tmp_path / "out", places)
    animation = load_animation(run)
    np.testing.assert_allclose(animation.places, places, rtol=0, atol=CLOSE)
    write_clouds_npz(tmp_path / "c.npz", PointSequence.from_arrays([cloud + AWAY for cloud in VIEWED.clouds]))
    np.savez(tmp_path / "t.npz", vertices=places, faces=VIEWED.faces)
    content = load_content(run, clouds=tmp_path / "c.npz", truth=tmp_path / "t.npz", side_by_side=True)
    assert np.abs(content.bounds).max() < 10.0
    shown = {pane.title: pane for pane in content.panes}
    here = animation.origin - AWAY
    for title in ("reconstruction", "truth"):
        drawn = present(shown[title].surface(3))[0].astype(np.float32)
        np.testing.assert_allclose(drawn, VIEWED.vertices[3] - here, atol=CLOSE)
    np.testing.assert_allclose(
        present(shown["input"].clouds)[2].astype(np.float32), VIEWED.clouds[2] - here, atol=CLOSE
    )
    # Of points to the mesh, not the steps of float32.
    assert np.nanmax(present(shown["reconstruction"].colouring).values("error", 1)) < 1e-3
