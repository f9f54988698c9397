"""``warpdef export``: flags, messages, and nothing half done."""

from __future__ import annotations

import re
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from present import present
from synthetic import bending_bar

from warpdef import export as export_module
from warpdef.apps.main import run
from warpdef.config import Config
from warpdef.errors import InputError, MissingPackageError
from warpdef.export import FORMATS, check_place, export
from warpdef.export.animation import Animation, load_animation
from warpdef.export.gltf import quantisation
from warpdef.files.run_folder import RunFolder
from warpdef.mesh import MeshSequence
from warpdef.rig.decompose import fit_rig

BAR = bending_bar(6, 20, np.random.default_rng(0), subdivisions=1)
VERTICES = BAR.vertices.astype(np.float32)
ANIMATION = Animation(MeshSequence(VERTICES, BAR.faces))


@pytest.fixture
def result(tmp_path) -> Path:
    """A run folder of six frames, in a folder of its own."""
    pytest.importorskip("tomli_w")
    names = [f"scan{t}.ply" for t in range(6)]
    return RunFolder.prepare(tmp_path / "result").save(
        vertices=VERTICES, faces=BAR.faces, keyframe=2, config=Config(), report={}, steps=[], names=names
    )


@pytest.fixture
def place(tmp_path) -> Path:
    (tmp_path / "place").mkdir()
    return tmp_path / "place"


def entries(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def add_arrays(result: Path, **arrays) -> None:
    with np.load(result / "sequence.npz") as stored:
        arrays = {name: stored[name] for name in stored.files} | arrays
    np.savez(result / "sequence.npz", **arrays)


def test_flags_reach_the_file(result, place, capfd):
    colors = np.arange(VERTICES.shape[1] * 3, dtype=np.uint8).reshape(-1, 3)
    uv = np.linspace(0, 1, VERTICES.shape[1] * 2).reshape(-1, 2)
    add_arrays(result, vertex_colors=colors, uv=uv)
    flags = ["--fps", "12.5", "--up", "z", "--frames", "1:6:2", "--metres-per-unit", "0.001"]
    assert run(["export", str(result), str(place / "a.npz"), *flags]) == 0
    out, err = capfd.readouterr()
    assert out.startswith(f"3 frames, {VERTICES.shape[1]} vertices, 80 faces: {place / 'a.npz'} (") and not err
    with np.load(place / "a.npz", allow_pickle=False) as stored:
        np.testing.assert_array_equal(stored["vertices"], VERTICES[1::2])
        np.testing.assert_array_equal(stored["vertex_colors"], colors)
        np.testing.assert_array_equal(stored["uv"], uv.astype(np.float32))
        assert (float(stored["fps"]), str(stored["up"]), float(stored["metres_per_unit"])) == (12.5, "z", 0.001)
        assert list(stored["names"]) == ["scan1.ply", "scan3.ply", "scan5.ply"]


def test_bones_and_precision_are_reported(result, place, capfd):
    assert run(["export", str(result), str(place / "a.glb"), "--bones", "3"]) == 0
    out, err = capfd.readouterr()
    assert out.count("\n") == 1 and err.count("\n") == 1
    assert re.match(r"warpdef: rig of 3 bones: the mesh is [0-9.]+ % of its extent away on average, [0-9.]+ % at", err)
    assert run(["export", str(result), str(place / "b.glb")]) == 0
    out, err = capfd.readouterr()
    step = float(present(re.search(r"positions are multiples of (\S+) \(--precise", out))[1])
    assert step == pytest.approx(quantisation(VERTICES)[1], rel=0.1) and not err
    assert run(["export", str(result), str(place / "c.glb"), "--precise", "--slow", "25"]) == 0
    out, err = capfd.readouterr()
    assert "multiples" not in out and "126 frames" in err and "--bones auto" in err
    assert run(["export", str(result), str(place / "d.bvh")]) == 0
    assert entries(place) == ["a.glb", "b.glb", "c.glb", "d.bvh"]


def test_negative_frames_and_a_named_format(result, place):
    assert run(["export", str(result), str(place / "meshes"), "--format", "obj", "--frames", "-2:"]) == 0
    assert entries(place / "meshes") == ["0000.obj", "0001.obj"]


def test_axis_and_unit_that_a_file_does_not_hold_are_told(result, place, capfd):
    how = ["--up", "z", "--metres-per-unit", "0.01"]
    assert run(["export", str(result), str(place / "a.obj"), *how]) == 0
    assert "a.obj" not in (line := capfd.readouterr().err) and "with Z up and a scale of 0.01" in line
    for name in ("a.glb", "a.npz"):
        assert run(["export", str(result), str(place / name), *how]) == 0
    assert run(["export", str(result), str(place / "b.obj")]) == 0
    assert "import it with" not in capfd.readouterr().err


def without_usd() -> list[str]:
    whole = all(find_spec(name) for name in ("lxml", "networkx"))
    return [name for name in FORMATS if not name.startswith("usd") and (whole or name != "3mf")]


@pytest.mark.parametrize("suffix", without_usd())
def test_twice_only_with_overwrite(result, place, suffix, capfd):
    pytest.importorskip("pyvista")
    target = place / f"a.{suffix}"
    assert run(["export", str(result), str(target)]) == 0
    made = entries(place)
    assert made == sorted(p.name for p in FORMATS[suffix].places(target))
    capfd.readouterr()
    assert run(["export", str(result), str(target)]) == 2
    assert "already exists" in capfd.readouterr().err
    assert run(["export", str(result), str(target), "--overwrite", "--frames", ":3"]) == 0
    assert entries(place) == made
    if target.is_dir():
        assert len(entries(target)) == 3


def test_all_formats_of_one_name_stand_side_by_side(place):
    rig = fit_rig(VERTICES, 2)
    for suffix in without_usd():
        export(ANIMATION, place / f"a.{suffix}", rig=None if FORMATS[suffix].writer else rig)
    assert len(entries(place)) == len(without_usd()) + 3


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["a.foo"], ["a.foo", "unknown suffix '.foo'", *(f".{name}" for name in FORMATS)]),
        (["a"], ["unknown suffix none", ".glb"]),
        (["a.gltf"], ["did you mean .glb?"]),
        (["a.abc"], [".abc is not written", "Alembic", ".usdc"]),
        (["a.fbx"], [".fbx is not written; write .glb", "Blender"]),
        (["a.mp4"], ["warpdef view --movie"]),
        (["a.plyy"], ["did you mean .ply?"]),
        (["a.glb", "--format", "docx"], ["unknown suffix '.docx'"]),
        (["absent/a.glb"], ["absent", "make it first"]),
        (["a.glb", "--bones", "0"], ["--bones", "above 0, or auto, got '0'"]),
        (["a.glb", "--bones", "many"], ["--bones", "'many'"]),
        (["a.glb", "--bones", "15"], ["--bones: expected 1 to 14 for 42 vertices"]),
        (["a.obj", "--bones", "2"], [".glb or .bvh for a rig"]),
        (["a.glb", "--fps", "0"], ["--fps"]),
        (["a.glb", "--fps", "nan"], ["--fps"]),
        (["a.glb", "--up", "x"], ["--up"]),
        (["a.glb", "--metres-per-unit", "-1"], ["--metres-per-unit"]),
        (["a.glb", "--frames", "20:"], ["--frames", "of 6 frames"]),
        (["a.glb", "--frames", "x"], ["frames"]),
        (["a" * 300 + ".glb"], ["cannot be written"]),
    ],
)
def test_bad_arguments(result, place, monkeypatch, capfd, arguments, expected):
    monkeypatch.chdir(place)
    assert run(["export", str(result), *arguments]) == 2
    err = capfd.readouterr().err
    assert err.startswith("warpdef: error: ") and err.count("\n") == 1
    assert [part for part in expected if part not in err] == []
    assert entries(place) == []


def test_not_a_run_folder(place, capfd):
    assert run(["export", str(place), str(place / "a.glb")]) == 2
    assert "expected the folder of a warpdef run" in capfd.readouterr().err


def foreign_folder(place: Path) -> Path:
    (place / "a.ply").mkdir()
    (place / "a.ply" / "thesis.tex").write_text("mine")
    return place / "a.ply"


def foreign_vtp(place: Path) -> Path:
    (place / "a_vtp").mkdir()
    (place / "a_vtp" / "notes.txt").write_text("mine")
    return place / "a.pvd"


def foreign_base(place: Path) -> Path:
    (place / "a_pc2.obj").write_text("v 0 0 0\n")
    return place / "a.pc2"


def folder_for_a_file(place: Path) -> Path:
    (place / "a.glb").mkdir()
    return place / "a.glb"


def file_for_a_folder(place: Path) -> Path:
    (place / "a.obj").write_text("v 0 0 0\n")
    return place / "a.obj"


@pytest.mark.parametrize(
    "spoil", [foreign_folder, foreign_vtp, foreign_base, folder_for_a_file, file_for_a_folder], ids=lambda f: f.__name__
)
def test_foreign_things_are_never_replaced(place, spoil):
    target = spoil(place)
    before = sorted(place.rglob("*"))
    for overwrite in (False, True):
        with pytest.raises(InputError, match="already exists|choose another place"):
            export(ANIMATION, target, overwrite=overwrite)
    assert sorted(place.rglob("*")) == before


@pytest.mark.parametrize("failure", [OSError(28, "No space left on device"), KeyboardInterrupt(), MemoryError()])
@pytest.mark.parametrize("suffix", ["glb", "pc2", "ply"])
def test_failure_leaves_the_older_export(place, monkeypatch, suffix, failure):
    target = place / f"a.{suffix}"
    export(ANIMATION, target)
    before = {p: p.read_bytes() for p in place.rglob("*") if p.is_file()}

    def fails(*_arguments) -> None:
        raise failure

    monkeypatch.setattr(export_module, "_move", fails)
    with pytest.raises(InputError if isinstance(failure, OSError) else type(failure)):
        export(ANIMATION, target, overwrite=True)
    assert {p: p.read_bytes() for p in place.rglob("*") if p.is_file()} == before
    assert sorted(p for p in place.rglob("*") if p.is_file()) == sorted(before)


def test_a_failing_rename_puts_the_old_folder_back(place, monkeypatch):
    export(ANIMATION, place / "a.ply")
    rename = export_module.os.rename

    def second_fails(source, target):
        if "partial" in str(source):
            raise OSError(5, "Input/output error")
        rename(source, target)

    monkeypatch.setattr(export_module.os, "rename", second_fails)
    with pytest.raises(InputError, match="Input/output error"):
        export(ANIMATION, place / "a.ply", overwrite=True)
    assert entries(place) == ["a.ply"] and len(entries(place / "a.ply")) == 6


def test_missing_packages_are_named(place, monkeypatch):
    import sys

    missing = (("pxr", "usdc", "warpdef\\[usd\\]"), ("pyvista", "pvd", "pip install pyvista"))
    for module, suffix, words in (*missing, ("lxml", "3mf", "pip install lxml")):
        monkeypatch.setitem(sys.modules, module, None)
        with pytest.raises(MissingPackageError, match=words):
            export(ANIMATION, place / f"a.{suffix}")
    assert entries(place) == []


def test_a_glb_over_4_gib_is_refused(place, monkeypatch):
    from warpdef.export import gltf_buffer

    monkeypatch.setattr(
        gltf_buffer.Buffer, "size", property(lambda self: 2**32, lambda self, value: None), raising=False
    )
    with pytest.raises(InputError, match="4 GiB.*fewer frames"):
        export(ANIMATION, place / "a.glb")
    assert entries(place) == []


def test_wrong_attributes(result):
    count = VERTICES.shape[1]
    for name, array, words in (
        ("vertex_colors", np.zeros((count, 3), dtype=np.float32), "uint8"),
        ("vertex_colors", np.zeros((count + 1, 3), dtype=np.uint8), "one colour a vertex"),
        ("uv", np.zeros((count, 3)), "one pair a vertex"),
        ("uv", np.full((count, 2), np.nan), "finite"),
    ):
        good = {"vertex_colors": np.zeros((count, 4), dtype=np.uint8), "uv": np.zeros((count, 2))}
        add_arrays(result, **good)
        load_animation(result)
        add_arrays(result, **(good | {name: array}))
        with pytest.raises(InputError, match=words):
            load_animation(result)


def test_wrong_animations():
    with pytest.raises(InputError, match="names: expected 6, got 1"):
        Animation(ANIMATION.meshes, ("a",))
    with pytest.raises(InputError, match="--up: expected y or z"):
        Animation(ANIMATION.meshes, up="x")
    with pytest.raises(InputError, match="--metres-per-unit"):
        Animation(ANIMATION.meshes, metres_per_unit=0.0)
    with pytest.raises(InputError, match="float32.*scale it down"):
        Animation(MeshSequence(VERTICES.astype(np.float64) * 1e300, BAR.faces))


def test_a_place_that_is_no_file_name():
    with pytest.raises(InputError, match="expected a file"):
        check_place(Path("/"), FORMATS["glb"])
    with pytest.raises(InputError, match="expected a file"):
        check_place("a\0.glb", FORMATS["glb"])
