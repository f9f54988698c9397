"""Colours of clouds on the mesh that follows them, and in every file that can hold them."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
import synthetic
from glb_reader import Glb
from present import present

import warpdef
from warpdef.appearance import Appearance
from warpdef.config import Config
from warpdef.export import export
from warpdef.export.animation import linear_colors, load_animation
from warpdef.files.ply import read_ply
from warpdef.files.run_folder import RunFolder
from warpdef.files.saved_run import load_run
from warpdef.geometry.surface_colors import surface_colors
from warpdef.mesh import TriMesh
from warpdef.sequence import PointSequence

SPHERE, FACES = synthetic.icosphere(3)
EARTH = np.rint(127.5 * (1.0 + SPHERE)).astype(np.uint8)
"""A colour for each place of the sphere."""


def turning(frames: int = 5, points: int = 3000) -> tuple[np.ndarray, list, list, list]:
    """A sphere that turns in itself: places of the vertices, clouds, their normals and colours."""
    rng = np.random.default_rng(1)
    vertices, clouds, normals, colors = [], [], [], []
    for t in range(frames):
        turn = synthetic.turn_about([0, 0, 1], 0.3 * t)
        place = rng.normal(size=(points, 3))
        place /= np.linalg.norm(place, axis=1, keepdims=True)
        vertices.append(SPHERE @ turn.T)
        clouds.append(place @ turn.T)
        normals.append(clouds[-1])
        colors.append(np.rint(127.5 * (1.0 + place)).astype(np.uint8))
    return np.stack(vertices), clouds, normals, colors


def test_colours_stay_with_the_material_whatever_one_frame_says():
    vertices, clouds, normals, colors = turning()
    colors[2][:] = 255
    found = present(surface_colors(vertices, FACES, clouds, normals, colors, moving=True))
    off = np.abs(found.still.astype(int) - EARTH)
    assert off.max() <= 10 and off.mean() < 2 and found.unseen == 0.0
    moving = present(found.moving)
    assert (moving[2] == 255).all() and np.abs(moving[3].astype(int) - EARTH).max() <= 12


@pytest.mark.parametrize("given", [True, False])
def test_the_two_sides_of_a_thin_sheet_do_not_mix(given):
    """Half a spacing thick: the nearest points of a side are as often those of the other."""
    vertices, faces = SPHERE * [1.0, 1.0, 0.012], FACES
    cloud, normals, *_ = (a for a in synthetic.sample_surface(vertices, faces, 6000, np.random.default_rng(0)))
    colors = np.where(cloud[:, 2:] > 0, [200, 0, 0], [0, 0, 200]).astype(np.uint8)
    seen = [normals if given else None]
    found = present(surface_colors(vertices[None], faces, [cloud], seen, [colors])).still
    inner = np.linalg.norm(vertices[:, :2], axis=1) < 0.9
    top = vertices[:, 2] > 0
    red = found[:, 0].astype(int) - found[:, 2]
    assert (red[inner & top] > 0).mean() > 0.95 and (red[inner & ~top] < 0).mean() > 0.95


def test_what_no_frame_shows_has_the_colour_of_its_neighbours_and_is_counted():
    vertices, clouds, normals, colors = turning(2)
    shown = [c[:, 2] > 0 for c in clouds]
    clouds = [c[s] for c, s in zip(clouds, shown, strict=True)]
    green = [np.tile(np.array([10, 200, 30], dtype=np.uint8), (len(c), 1)) for c in clouds]
    found = present(surface_colors(vertices, FACES, clouds, [None, None], green))
    assert (found.still == [10, 200, 30]).all() and 0.3 < found.unseen < 0.5
    assert surface_colors(vertices, FACES, [c + 9 for c in clouds], [None, None], green) is None


def test_between_frames_that_show_a_vertex_its_colour_is_linear():
    vertices, clouds, _, colors = turning(4)
    shades = [np.full_like(c, 30 * (t + 1)) for t, c in enumerate(colors)]
    clouds[1], shades[1] = np.zeros((0, 3)), None
    clouds[3], shades[3] = np.zeros((0, 3)), None
    moving = present(present(surface_colors(vertices, FACES, clouds, [None] * 4, shades, moving=True)).moving)
    assert [int(frame.min()) for frame in moving] == [30, 60, 90, 90] == [int(frame.max()) for frame in moving]


def quick(colours: Literal["still", "moving", "off"]) -> Config:
    base = Config(colours=colours)
    return replace(
        base,
        keyframe=replace(base.keyframe, choice="1"),
        grid=replace(base.grid, levels=2),
        optimiser=replace(base.optimiser, iterations=4, warmup=2),
        refine=replace(base.refine, iterations=0),
    )


@pytest.fixture(scope="module")
def sequence() -> PointSequence:
    _, clouds, normals, colors = turning(3, 600)
    return PointSequence.from_arrays(clouds, normals, colors=[c / 255.0 for c in colors])


def run_once(sequence: PointSequence, colours: Literal["still", "moving", "off"], template: TriMesh):
    """On the CPU, which alone promises the same bits."""
    return warpdef.reconstruct(sequence, quick(colours), template=template, device="cpu")


@pytest.mark.parametrize(("shade", "taken"), [(0, False), (255, False), (1, True)])
def test_colours_that_were_never_filled_are_taken_for_none(sequence, shade, taken):
    blank = replace(sequence, colors=tuple(np.full_like(present(c), shade) for c in sequence.colors))
    result = run_once(blank, "still", TriMesh(SPHERE, FACES))
    assert (result.appearance is not None) == taken
    assert any("taken for none" in w for w in result.report["warnings"]) != taken


def test_a_run_takes_colours_over_and_its_bits_do_not_depend_on_them(sequence):
    template = TriMesh(SPHERE, FACES)
    results = {c: run_once(sequence, c, template) for c in ("still", "moving", "off")}
    plain = run_once(replace(sequence, colors=()), "still", template)
    for result in results.values():
        np.testing.assert_array_equal(result.vertices, plain.vertices)
    assert plain.appearance is None is results["off"].appearance and plain.report["colours"] is None
    still, moving = results["still"].appearance, results["moving"].appearance
    assert still.frame_colors is None and moving.frame_colors.shape == plain.vertices.shape
    np.testing.assert_array_equal(still.colors, moving.colors)
    assert results["still"].report["colours"] == {"mode": "still", "frames": 3, "unseen": 0.0}
    own = replace(template, appearance=Appearance(colors=EARTH))
    told = warpdef.reconstruct(sequence, quick("still"), template=own)
    assert told.appearance.colors is EARTH and any("left behind" in w for w in told.report["warnings"])


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run with colours of every frame."""
    vertices = np.stack([SPHERE + 0.1 * t for t in range(3)]).astype(np.float32)
    frames = np.stack([EARTH, EARTH[::-1], 255 - EARTH])
    folder = RunFolder.prepare(tmp_path_factory.mktemp("run") / "out")
    look = Appearance(colors=EARTH, frame_colors=frames)
    names = ["a", "b", "c"]
    path = folder.save(
        vertices=vertices, faces=FACES, keyframe=0, config=Config(), report={}, steps=[], names=names, appearance=look
    )
    return path, frames


def test_a_run_folder_keeps_both(run):
    path, frames = run
    look = load_run(path).appearance
    np.testing.assert_array_equal(look.frame_colors, frames)
    np.testing.assert_array_equal(look.colors, EARTH)
    for t, shades in enumerate(frames):
        surface = read_ply(path / "meshes" / f"{t:04d}.ply")
        np.testing.assert_array_equal(surface.colors, shades)
        np.testing.assert_allclose(surface.points, SPHERE + 0.1 * t, atol=1e-6)


def test_every_format_shows_each_frame_in_its_colours(run, tmp_path):
    path, frames = run
    animation = load_animation(path)
    export(animation, tmp_path / "a.ply")
    export(animation, tmp_path / "a.npz")
    export(animation, tmp_path / "a.glb")
    for t in range(3):
        np.testing.assert_array_equal(read_ply(tmp_path / "a.ply" / f"{t:04d}.ply").colors, frames[t])
    with np.load(tmp_path / "a.npz") as archive:
        np.testing.assert_array_equal(archive["frame_colors"], frames)
    pyvista = pytest.importorskip("pyvista")
    export(animation, tmp_path / "a.pvd")
    np.testing.assert_array_equal(pyvista.read(tmp_path / "a_vtp" / "0002.vtp").point_data["colors"], frames[2])
    half = present(load_animation(path, slow=2.0).frame_colors)
    np.testing.assert_array_equal(half[1], np.rint((frames[0].astype(float) + frames[1]) / 2))


def test_a_glb_adds_to_the_first_frame_what_makes_the_others(run, tmp_path):
    path, frames = run
    export(load_animation(path), tmp_path / "a.glb", precise=True)
    file = Glb(tmp_path / "a.glb")
    primitive = file.json["meshes"][0]["primitives"][0]
    base = file.numbers(primitive["attributes"]["COLOR_0"])
    for target, shades in zip(primitive["targets"], frames[1:], strict=True):
        light = base[:, :3] + file.numbers(target["COLOR_0"])[:, :3]
        np.testing.assert_allclose(light, linear_colors(shades), atol=1e-4)


def test_usd_has_a_sample_of_its_colours_at_every_frame(run, tmp_path):
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom

    path, frames = run
    export(load_animation(path), tmp_path / "a.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    mesh = UsdGeom.Mesh(stage.GetDefaultPrim().GetChildren()[0])
    for t in range(3):
        np.testing.assert_allclose(np.array(mesh.GetDisplayColorPrimvar().Get(t)), linear_colors(frames[t]), atol=1e-6)


def test_the_viewer_shows_the_colours_of_the_frames(run):
    from warpdef.apps.viewer.content import load_content

    path, frames = run
    pane = load_content(path, frames=slice(1, None)).panes[0]
    np.testing.assert_array_equal(pane.colors, frames[1:])
