"""The image of a texture: found only where it may be, and refused where it cannot be used."""

from __future__ import annotations

from pathlib import Path

import pytest
from present import look_of, present
from texture_samples import COUNT, FACES, PIXELS, PNG, jpg, png

import warpdef.files.texture as texture_room
from warpdef.appearance import Appearance
from warpdef.errors import InputError
from warpdef.files import read_geometry, read_mesh
from warpdef.files.mesh_files import read_mesh_frames
from warpdef.texture import Texture

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
FACE = "f 1/1 2/2 3/3\n"


@pytest.fixture
def folder(tmp_path) -> Path:
    """A folder for a mesh, with an image in it and another one outside."""
    (tmp_path / "mesh" / "sub").mkdir(parents=True)
    (tmp_path / "mesh" / "wood.png").write_bytes(PNG)
    (tmp_path / "secret.png").write_bytes(png(PIXELS[::-1]))
    return tmp_path / "mesh"


def write_obj(folder: Path, image: str, library: str = "a.mtl", body: str = "usemtl m\n" + FACE) -> Path:
    (folder / library).write_text(f"newmtl m\nKd 1 1 1\nmap_Kd {image}\n")
    (folder / "a.obj").write_text(f"mtllib {library}\n{TRIANGLE}{body}")
    return folder / "a.obj"


def write_ply(folder: Path, *images: str) -> Path:
    lines = ["ply", "format ascii 1.0", *(f"comment TextureFile {image}" for image in images), "element vertex 3"]
    lines += [f"property float {name}" for name in "xyzst"] + ["element face 1"]
    lines += ["property list uchar int vertex_indices", "end_header", "0 0 0 0 0", "1 0 0 1 0", "0 1 0 0 1", "3 0 1 2"]
    (folder / "a.ply").write_text("\n".join(lines))
    return folder / "a.ply"


FOUND = [
    "wood.png", "./wood.png", "sub/../wood.png", '"wood.png"', "-clamp on wood.png", "-bm 1 -mm 0 1 wood.png",
    "-t 0.1 0.2 wood.png", "C:\\Users\\me\\wood.png", "/home/me/wood.png", "../textures/wood.png",
    "//server/share/wood.png", "http://example.org/wood.png", "-blendu on -imfchan l  wood.png",
]  # fmt: skip


@pytest.mark.parametrize("name", FOUND)
def test_an_obj_finds_its_image(folder, name):
    look = look_of(write_obj(folder, name))
    assert (look.texture, look.notes) == (Texture(PNG, "png"), ())


@pytest.mark.parametrize("name", ["wood.png", "C:\\me\\wood.png", "../wood.png", "sub\\..\\wood.png"])
def test_a_ply_finds_its_image(folder, name):
    assert look_of(write_ply(folder, name)).texture == Texture(PNG, "png")
    given = read_geometry(write_ply(folder, name, name))
    assert (given.texture, given.notes) == (Texture(PNG, "png"), ())


def test_names_with_blanks_and_folders(folder):
    (folder / "sub" / "old oak.png").write_bytes(PNG)
    for image, library in (
        ("sub/old oak.png", "a.mtl"),
        ("sub\\old oak.png", "my materials.mtl"),
        ("old oak.png", "sub/a.mtl"),  # counted from the library
        ("sub/old oak.png", "sub/b.mtl"),  # counted from the mesh
        ("../sub/old oak.png", "sub/c.mtl"),
    ):
        assert look_of(write_obj(folder, image, library)).texture is not None, (image, library)
    (folder / "b.mtl").write_text("newmtl other\n")
    path = write_obj(folder, "wood.png")
    path.write_text(path.read_text().replace("a.mtl", "b.mtl a.mtl"))
    assert present(look_of(path).texture).data == PNG


@pytest.mark.parametrize("name", ["../secret.png", "sub/../../secret.png", "{outside}/secret.png", "..\\secret.png"])
def test_a_name_leads_nowhere_outside(folder, name):
    name = name.format(outside=folder.parent)
    for path in (write_obj(folder, name), write_ply(folder, name), write_obj(folder, name, "sub/a.mtl")):
        look = look_of(path)
        assert look.texture is None
        (note,) = look.notes
        assert note.startswith(f"{path}: goes on without its texture image") and "put the image beside it" in note
    (folder.parent / "a.mtl").write_text("newmtl m\nmap_Kd wood.png\n")
    (folder / "a.obj").write_text(f"mtllib {folder.parent}/a.mtl\nmtllib ../a.mtl\n{TRIANGLE}{FACE}")
    (folder / "a.mtl").unlink()
    (note,) = look_of(folder / "a.obj").notes
    assert "material file" in note


@pytest.mark.parametrize(
    ("image", "message"),
    [
        ("gone.png", "'gone.png', which is not in its folder"),
        ("..", "not in its folder"),
        ("sub", "not in its folder"),
        ("x" * 5000, r"x\.\.\.', which is not in its folder"),
        ("a\x1b[2Jb.png", r"'a\?\[2Jb\.png'"),
        ("-s 2 2 1 wood.png", "by -o or -s"),
        ("-clamp on -o 0.5 wood.png", "by -o or -s"),
        ("text.png", r"text\.png: expected a PNG or JPEG image, got something else"),
        ("empty.png", "expected a PNG or JPEG"),
        ("cut.png", "expected a whole PNG image, got one damaged or cut off"),
    ],
)
def test_what_cannot_be_used_is_told_in_a_line(folder, image, message):
    (folder / "text.png").write_text("hello")
    (folder / "empty.png").touch()
    (folder / "cut.png").write_bytes(PNG[:-9])
    mesh = read_mesh(write_obj(folder, image))
    assert present(mesh.appearance).texture is None
    assert present(present(mesh.appearance).uv).shape == (3, 2)
    with pytest.raises(InputError, match=message):
        raise InputError(*present(mesh.appearance).notes)
    assert "\n" not in present(mesh.appearance).notes[0]


def test_too_large(folder, monkeypatch):
    monkeypatch.setattr(texture_room, "TEXTURE_MAX", len(PNG) - 1)
    (note,) = look_of(write_ply(folder, "wood.png")).notes
    assert "expected at most 0 MiB, got more" in note
    monkeypatch.setattr(texture_room, "_LIBRARY_MAX", 5)
    (note,) = look_of(write_obj(folder, "wood.png")).notes
    assert "material file 'a.mtl': expected at most" in note


def test_an_image_that_may_not_be_read(folder, monkeypatch):
    def refuse(*_: object) -> bytes:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(texture_room, "_read", refuse)
    (note,) = look_of(write_ply(folder, "wood.png")).notes
    assert "wood.png: cannot be read (Permission denied)" in note


def test_materials_that_faces_use_count(folder):
    (folder / "iron.png").write_bytes(PNG)
    library = "newmtl a\nmap_Kd wood.png\nnewmtl b\nmap_Kd iron.png\nnewmtl c\nmap_Kd wood.png\nnewmtl d\nKd 1 0 0\n"
    for body, count in (
        ("usemtl a\n" + FACE, 1),
        ("usemtl b\nusemtl a\n" + FACE + "usemtl b\n", 1),
        ("usemtl a\n" + FACE + "usemtl c\n" + FACE, 1),  # two materials of one image
        ("usemtl a\n" + FACE + "usemtl b\n" + FACE, 2),
        (FACE, 2),  # none is named: all of the library
        ("usemtl d\n" + FACE, 0),
        ("usemtl nowhere\n" + FACE, 0),
    ):
        path = write_obj(folder, "", body=body)
        (folder / "a.mtl").write_text(library)
        look = look_of(path)
        assert (look.texture is not None, len(look.notes)) == {0: (False, 0), 1: (True, 0), 2: (False, 1)}[count], body
    (note,) = look_of(write_ply(folder, "wood.png", "iron.png")).notes
    assert "names 2 images ('wood.png', 'iron.png')" in note


def test_without_coordinates_there_is_no_image(folder):
    path = write_obj(folder, "gone.png", body="f 1 2 3\n")
    assert read_mesh(path).appearance is None
    given = read_geometry(path)
    assert (given.texture, given.notes) == (None, ())
    with pytest.raises(InputError, match="expected texture coordinates with it"):
        Appearance.checked(COUNT, len(FACES), texture=Texture(PNG, "png"))


def test_frames_of_meshes_leave_images_closed(folder, monkeypatch):
    write_obj(folder, "wood.png").rename(folder / "0.obj")
    monkeypatch.setattr(texture_room, "_read", None)
    (mesh,) = read_mesh_frames(folder)
    assert (present(mesh.appearance).texture, present(mesh.appearance).notes) == (None, ())


def test_kinds_of_jpeg():
    for how in ({}, {"progressive": True}, {"comment": b"\xff\xda\xff\xd9 in a comment"}):
        data = jpg(**how)
        assert Texture.from_bytes(data) == Texture(data, "jpg")
        for end in (3, 4, 20, data.rfind(b"\xff\xda"), len(data) - 2):
            with pytest.raises(InputError, match="whole JPG"):
                Texture.from_bytes(data[:end])
    assert Texture.from_bytes(data[:2] + b"\xff\xff" + data[2:]).kind == "jpg"  # filling


@pytest.mark.parametrize("end", [8, 20, 33, -12, -1])
def test_png_cut_off(end):
    with pytest.raises(InputError, match="whole PNG"):
        Texture.from_bytes(PNG[:end] if end != -1 else PNG[:33] + PNG[-12:])
