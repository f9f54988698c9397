"""The image of a texture kept byte for byte, in run folders and exports, and shown by readers that are not ours."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from glb_reader import Glb
from present import look_of, present
from texture_samples import COLORS, COUNT, FACES, MOVING, PIXELS, PNG, UV, VERTICES, jpg

from warpdef.appearance import Appearance
from warpdef.apps.main import run
from warpdef.apps.viewer.content import load_content
from warpdef.apps.viewer.texture import shown_colors
from warpdef.config import Config
from warpdef.errors import InputError
from warpdef.export import export
from warpdef.export.animation import Animation, dress, load_animation
from warpdef.files.run_folder import RunFolder
from warpdef.files.saved_run import load_run
from warpdef.mesh import MeshSequence
from warpdef.texture import Texture


def save(place: Path, kind: str = "png", overwrite: bool = False, look: Appearance | None = None) -> Path:
    texture = Texture.from_bytes(PNG if kind == "png" else jpg())
    return RunFolder.prepare(place, overwrite=overwrite).save(
        vertices=MOVING, faces=FACES, keyframe=0, config=Config(), report={}, steps=[], names=["a", "b"],
        appearance=look or Appearance(COLORS, UV, texture=texture),
    )  # fmt: skip


def test_through_a_run_folder(tmp_path):
    pytest.importorskip("tomli_w")
    out = save(tmp_path / "out")
    assert (out / "texture.png").read_bytes() == PNG
    assert load_run(out).appearance.texture == load_animation(out).texture == Texture(PNG, "png")
    out = save(out, "jpg", overwrite=True)
    assert not (out / "texture.png").exists()
    assert load_run(out).appearance.texture == Texture(jpg(), "jpg")
    (out / "texture.jpg").write_bytes(jpg()[:-40])
    with pytest.raises(InputError, match=r"texture\.jpg: expected a whole JPG image"):
        load_run(out)
    out = save(out, overwrite=True, look=Appearance(COLORS))
    (out / "texture.png").write_text("not of this result, which has no texture coordinates")
    assert load_run(out).appearance.texture is None


def animation(kind: str = "png", colors: np.ndarray | None = None) -> Animation:
    texture = Texture.from_bytes(PNG if kind == "png" else jpg())
    return dress(MOVING, FACES, Appearance(colors, UV, texture=texture))


@pytest.mark.parametrize("kind", ["png", "jpg"])
def test_glb_by_its_specification(tmp_path, kind):
    export(animation(kind, COLORS), tmp_path / "a.glb")
    glb = Glb(tmp_path / "a.glb")
    (material,), (image,), (sampler,) = glb.json["materials"], glb.json["images"], glb.json["samplers"]
    assert glb.json["textures"] == [{"source": 0, "sampler": 0}]
    assert material["pbrMetallicRoughness"]["baseColorTexture"] == {"index": 0}
    assert material["pbrMetallicRoughness"]["baseColorFactor"] == [1.0] * 4
    assert set(sampler.values()) == {9729, 9987, 10497}
    assert image["mimeType"] == {"png": "image/png", "jpg": "image/jpeg"}[kind]
    view = glb.json["bufferViews"][image["bufferView"]]
    assert "target" not in view
    data = glb.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
    assert data == present(animation(kind).texture).data
    # Shown as COLOR_0 they would be multiplied with the image.
    attributes = glb.json["meshes"][0]["primitives"][0]["attributes"]
    assert "_COLOR_0" in attributes and "COLOR_0" not in attributes
    for accessor in glb.json["accessors"]:
        assert glb.json["bufferViews"][accessor["bufferView"]]["byteOffset"] % 4 == 0


@pytest.mark.parametrize("suffix", ["glb", "obj", "ply"])
def test_by_trimesh(tmp_path, suffix):
    trimesh, _ = pytest.importorskip("trimesh"), pytest.importorskip("PIL")
    export(animation(), tmp_path / f"a.{suffix}")
    path = tmp_path / f"a.{suffix}"
    loaded = trimesh.load(path if suffix == "glb" else path / f"0001.{suffix}", process=False)
    (mesh,) = loaded.geometry.values() if suffix == "glb" else (loaded,)
    material = mesh.visual.material
    image = material.baseColorTexture if suffix == "glb" else material.image
    np.testing.assert_array_equal(np.asarray(image.convert("RGB")), PIXELS)
    np.testing.assert_array_equal(mesh.faces, FACES)
    np.testing.assert_allclose(mesh.visual.uv, UV, atol=1e-6)


@pytest.mark.parametrize("suffix", ["obj", "ply"])
def test_our_own_way_back(tmp_path, suffix):
    """What was exported is a template or a geometry again."""
    export(animation("jpg", COLORS), tmp_path / f"a.{suffix}")
    look = look_of(tmp_path / f"a.{suffix}" / f"0000.{suffix}")
    assert look.texture == Texture(jpg(), "jpg")
    np.testing.assert_array_equal(look.uv, UV)
    np.testing.assert_array_equal(look.colors, COLORS)


def usd_image(path: Path) -> tuple[str, bytes]:
    """The image on the mesh as USD itself finds it: by the material bound, its surface, its diffuse colour."""
    from pxr import Ar, Usd, UsdShade

    stage = Usd.Stage.Open(str(path))
    material, _ = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath("/warpdef/mesh")).ComputeBoundMaterial()
    surface, _, _ = material.ComputeSurfaceSource()
    assert surface.GetIdAttr().Get() == "UsdPreviewSurface"
    source, output, _ = surface.GetInput("diffuseColor").GetConnectedSource()
    texture = UsdShade.Shader(source)
    assert (texture.GetIdAttr().Get(), output) == ("UsdUVTexture", "rgb")
    reader = UsdShade.Shader(texture.GetInput("st").GetConnectedSource()[0])
    assert (reader.GetIdAttr().Get(), reader.GetInput("varname").Get()) == ("UsdPrimvarReader_float2", "st")
    asset = texture.GetInput("file").Get()
    resolver: Any = Ar.GetResolver()
    return asset.path, bytes(resolver.OpenAsset(Ar.ResolvedPath(asset.resolvedPath)).GetBuffer())


@pytest.mark.parametrize("suffix", ["usd", "usda", "usdc", "usdz"])
def test_usd(tmp_path, suffix):
    pytest.importorskip("pxr")
    path = tmp_path / f"my walk.{suffix}"
    places = export(animation(colors=COLORS), path)
    name, data = usd_image(path)
    assert data == PNG
    if suffix == "usdz":
        assert [p.name for p in tmp_path.iterdir()] == [path.name]
        assert any(entry.endswith(".png") for entry in zipfile.ZipFile(path).namelist())
    else:
        assert name == f"./my walk_{suffix}_warpdef_texture.png"
        assert places == [path, tmp_path / name]
    export(animation("jpg"), path, overwrite=True)
    assert usd_image(path)[1] == jpg()


def test_usd_by_its_validators(tmp_path):
    usd, validation = pytest.importorskip("pxr.Usd"), pytest.importorskip("pxr.UsdValidation")
    export(animation(colors=COLORS), tmp_path / "a.usdz")
    validators = validation.ValidationRegistry().GetOrLoadAllValidators()
    errors = validation.ValidationContext(validators).Validate(usd.Stage.Open(str(tmp_path / "a.usdz")))
    assert len(validators) > 10
    assert [error.GetMessage() for error in errors] == []


def test_images_beside_a_usd_are_not_taken(tmp_path):
    """Whether USD is there or not: the places are looked at first."""
    (tmp_path / "a_usdc_warpdef_texture.png").mkdir()
    with pytest.raises(InputError, match=r"a_usdc_warpdef_texture\.png: already exists"):
        export(animation(), tmp_path / "a.usdc")
    with pytest.raises(InputError, match="expected a file to replace"):
        export(animation(), tmp_path / "a.usdc", overwrite=True)


@pytest.mark.parametrize("suffix", ["obj", "ply"])
def test_folders_are_replaced_only_if_ours(tmp_path, suffix):
    place = tmp_path / f"a.{suffix}"
    export(animation("jpg"), place)
    export(animation("png"), place, overwrite=True)
    assert sorted(p.suffix for p in place.iterdir() if "texture" in p.name) in ([".mtl", ".png"], [".png"])
    (place / "mine.png").write_bytes(PNG)
    with pytest.raises(InputError, match=r"found 'mine\.png'"):
        export(animation(), place, overwrite=True)


@pytest.mark.parametrize("suffix", ["pc2", "mdd", "npz", "anime"])
def test_other_formats_leave_it_out(tmp_path, suffix):
    places = export(animation(), tmp_path / f"a.{suffix}")
    assert {p.name for p in tmp_path.iterdir()} == {p.name for p in places}
    assert not any(b"mtllib" in p.read_bytes() for p in places)


def test_an_image_needs_coordinates_in_an_animation():
    with pytest.raises(InputError, match="expected texture coordinates"):
        Animation(MeshSequence(MOVING, FACES), texture=Texture(PNG, "png"))


def textured_sphere(folder: Path, image: str) -> Path:
    lines = ["mtllib a.mtl", *("v {:.9g} {:.9g} {:.9g}".format(*row) for row in VERTICES)]
    lines += [*("vt {:.9g} {:.9g}".format(*row) for row in UV), "usemtl m"]
    lines += ["f {0}/{0} {1}/{1} {2}/{2}".format(*row) for row in FACES + 1]
    folder.mkdir(exist_ok=True)
    (folder / "a.obj").write_text("\n".join(lines))
    (folder / "a.mtl").write_text(f"newmtl m\nmap_Kd {image}\n")
    (folder / "wood.png").write_bytes(PNG)
    return folder / "a.obj"


def test_the_whole_way(tmp_path, capsys):
    """From a textured template to an export, and a textured geometry carried along; a missing image is a warning."""
    pytest.importorskip("tomli_w")
    rng = np.random.default_rng(3)
    points = rng.normal(size=(3, 300, 3))
    points /= np.linalg.norm(points, axis=2, keepdims=True)
    np.savez(tmp_path / "clouds.npz", points=points * np.array([1.0, 1.02, 1.04])[:, None, None])
    flags = ["--iterations", "3", "--grid.levels", "2", "--refine.iterations", "1", "--threads", "1", "--keyframe", "0"]
    for image, kept in (("wood.png", True), ("gone.png", False)):
        template = textured_sphere(tmp_path / "mesh", image)
        out = tmp_path / f"out {image}"
        assert (
            run(["reconstruct", str(tmp_path / "clouds.npz"), *flags, "--template", str(template), "-o", str(out)]) == 0
        )
        told = capsys.readouterr().err
        result = load_run(out)
        warned = [line for line in result.report["warnings"] if "goes on without its texture image" in line]
        assert (len(warned), "goes on without its texture image" in told) == ((0, False) if kept else (1, True))
        assert (out / "texture.png").is_file() == kept
        assert run(["export", str(out), str(tmp_path / f"{kept}.glb")]) == 0
        assert ("images" in Glb(tmp_path / f"{kept}.glb").json) == kept
        assert run(["deform", str(out), str(template), "-o", str(tmp_path / f"deformed {kept}.obj")]) == 0
        told = capsys.readouterr().err
        assert ("warpdef: warning:" in told and "goes on without its texture image" in told) == (not kept)
        look = look_of(tmp_path / f"deformed {kept}.obj" / "0002.obj")
        assert (look.texture == Texture(PNG, "png")) == kept


def test_a_view_shows_the_image_at_the_vertices(tmp_path):
    pytest.importorskip("tomli_w")
    pytest.importorskip("PIL")
    uv = np.array([[0.5 / 7, 0.5 / 5], [1.0, 1.0], [0.0, 1.0], [1.5 / 7 - 3.0, 2.5 / 5 + 2.0]], dtype=np.float32)
    expected = PIXELS[[4, 0, 0, 2], [0, 6, 0, 1]]  # rows from the top, v from below
    image = Texture(PNG, "png")
    np.testing.assert_array_equal(shown_colors(Appearance(uv=uv, texture=image), FACES[:1], 4), expected)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    np.testing.assert_array_equal(shown_colors(Appearance(corner_uv=uv[faces], texture=image), faces, 4), expected)
    assert shown_colors(Appearance(uv=uv, texture=Texture(PNG[:60], "png")), faces, 4) is None
    out = save(tmp_path / "out", look=Appearance(uv=UV, texture=image))
    assert present(load_content(out).panes[0].colors).shape == (COUNT, 3)
    out = save(tmp_path / "own", look=Appearance(COLORS, UV, texture=image))
    np.testing.assert_array_equal(load_content(out).panes[0].colors, COLORS)
