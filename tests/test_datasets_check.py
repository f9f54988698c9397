"""``warpdef datasets check``: topology, names, problems; and truth from any of these sources in other commands."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from true_sets import FACES, moving, write_anime, write_dynosurf, write_obj, write_objs, write_registrations

from warpdef.apps.main import run
from warpdef.config import Config
from warpdef.datasets import find_sequences
from warpdef.datasets.check import SequenceReport, check_sequence
from warpdef.datasets.mesh_folders import name_problems
from warpdef.files.run_folder import RunFolder


def report(path: Path) -> SequenceReport:
    (sequence,) = find_sequences(path)
    return check_sequence(sequence)


def archive(path: Path, vertices: np.ndarray, faces: np.ndarray) -> Path:
    np.savez(path, vertices=vertices, faces=faces)
    return path


def test_a_closed_surface(tmp_path: Path) -> None:
    found = report(archive(tmp_path / "a.npz", moving(), FACES))
    assert (found.watertight, found.surface, found.components, found.unused) == (True, "watertight", 1, 0)
    assert found.same_triangles and found.problems == ()


@pytest.mark.parametrize(
    ("faces", "surface"),
    [
        (FACES[:3], "open: 3 boundary edges"),
        (np.concatenate([FACES, FACES[:1]]), "open: 3 edges of 3 or more faces"),
        (np.concatenate([FACES[:3], FACES[3:, ::-1]]), "closed, faces turned both ways"),
    ],
)
def test_other_surfaces(tmp_path: Path, faces: np.ndarray, surface: str) -> None:
    assert report(archive(tmp_path / "a.npz", moving(), faces)).surface == surface


def test_pieces_and_unused_vertices(tmp_path: Path) -> None:
    vertices = np.concatenate([moving(), moving(shift=3.0), moving(shift=6.0)], axis=1)
    found = report(archive(tmp_path / "a.npz", vertices, np.concatenate([FACES, FACES + 4])))
    assert (found.watertight, found.components, found.unused) == (True, 2, 4)


def test_frames_that_differ_stand_still_or_are_flat(tmp_path: Path) -> None:
    vertices = moving(5)
    vertices[2] = vertices[1]
    write_objs(tmp_path / "walk", vertices)
    write_obj(tmp_path / "walk" / "0004.obj", vertices[4], FACES[::-1])
    write_obj(tmp_path / "walk" / "0005.obj", np.zeros((4, 3)))
    found = report(tmp_path)
    assert not found.same_triangles
    assert found.problems == (
        "other vertices or faces than the first frame in frame 4",
        "no area in frame 5",
        "nothing moves before frame 2",
    )


@pytest.mark.parametrize(
    ("names", "problems"),
    [
        (["0000.obj", "0001.obj", "0002.obj"], []),
        (["f1.obj", "f9.obj", "f17.obj"], []),  # every eighth frame
        (["f9.obj", "f10.obj", "f11.obj"], []),
        (["a_01_x.obj", "a_02_x.obj"], []),
        (["0.obj", "1.obj", "4.obj", "5.obj"], ["numbers missing: 2, 3 (2 in all)"]),
        (["0.obj", "1.obj", "90.obj"], ["numbers missing: 2, 3, 4, 5, 6, ... (88 in all)"]),
        (["0.obj", "2.obj", "5.obj"], ["numbers missing: 4 (1 in all)"]),
        (["0.obj", "1.obj", "9999999999.obj"], ["uneven steps between the numbers 0 and 9999999999"]),
        (["1.obj", "01.obj", "2.obj"], ["the same number twice (01.obj)", "numbers padded to several widths"]),
        (["08.obj", "09.obj", "010.obj"], ["numbers padded to several widths"]),
        (["a1.obj", "b2.obj"], ["names of several patterns ('a1.obj', 'b2.obj'): the order may not be that of time"]),
        (
            ["a1.obj", "a1_2.obj"],
            ["names of several patterns ('a1.obj', 'a1_2.obj'): the order may not be that of time"],
        ),
        (["1_1.obj", "1_2.obj", "2_1.obj"], ["2 numbers change from name to name ('1_1.obj', '2_1.obj')"]),
    ],
)
def test_what_file_names_give_away(names: list[str], problems: list[str]) -> None:
    assert name_problems(names) == problems


def test_what_is_no_frame_is_told(tmp_path: Path) -> None:
    write_objs(tmp_path / "walk", moving())
    write_obj(tmp_path / "walk" / "template.obj", moving()[0])
    found = report(tmp_path)
    assert found.frames == 4
    assert "passed over" in found.problems[0] and "'template.obj'" in found.problems[0]


def test_clouds_beside_dynosurfs_meshes(tmp_path: Path) -> None:
    write_dynosurf(tmp_path / "crane", moving())
    assert report(tmp_path).problems == ()
    (tmp_path / "crane" / "point_clouds" / "0002.ply").unlink()
    assert report(tmp_path).problems == ("3 clouds in point_clouds, 4 meshes",)
    write_objs(tmp_path / "bare" / "gt", moving())
    assert report(tmp_path / "bare").problems == ("no clouds beside gt",)


def test_the_command_shows_a_table(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    write_dynosurf(tmp_path / "AMA" / "crane", moving(), "pcl_seqs")
    write_anime(tmp_path / "bear.anime", moving(), FACES[:3])
    write_objs(tmp_path / "walk", moving()[[0, 1, 3]], "f{}.obj")
    (tmp_path / "walk" / "f1.obj").rename(tmp_path / "walk" / "f7.obj")
    write_obj(tmp_path / "chair.obj", moving()[0])
    assert run(["datasets", "check", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    for text in ("crane", "dynosurf", "pcl_seqs", "watertight", "bear", "open: 3 boundary edges", "3 sequences"):
        assert text in out
    assert "walk: numbers missing: 4, 6 (2 in all)" in out
    assert "passed over" in out and "one mesh is no sequence" in out


def test_the_command_as_json(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    pytest.importorskip("h5py")
    write_registrations(tmp_path / "registrations_f.hdf5", {"50004_hips": moving()})
    (tmp_path / "bad.anime").write_bytes(write_anime(tmp_path / "bad.anime", moving())[:-5])
    write_objs(tmp_path / "walk", moving())
    (tmp_path / "walk" / "0003.obj").write_text("v 0 0\n")
    assert run(["datasets", "check", str(tmp_path), "--json"]) == 2
    found = json.loads(capsys.readouterr().out)
    (sequence,) = found["sequences"]
    assert (sequence["name"], sequence["kind"], sequence["frames"]) == ("50004_hips", "hdf5", 4)
    assert sequence["watertight"] and sequence["same_triangles"] and sequence["problems"] == []
    assert "bad.anime" in found["problems"][0] and "0003.obj" in found["problems"][1]


def test_the_command_says_what_cannot_be_read(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    (tmp_path / "bad.anime").write_bytes(b"12")
    assert run(["datasets", "check", str(tmp_path)]) == 2
    assert "cannot be read:" in capsys.readouterr().err
    (tmp_path / "bad.anime").unlink()
    np.savez(tmp_path / "points.npz", points=np.zeros((2, 20, 3)))
    assert run(["datasets", "check", str(tmp_path)]) == 2
    assert "expected true mesh sequences, got none (" in capsys.readouterr().err
    assert run(["datasets", "look", str(tmp_path)]) == 2


def test_any_source_can_be_sampled(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    pytest.importorskip("h5py")
    write_registrations(tmp_path / "registrations_m.hdf5", {"50002_hips": moving(), "50004_hips": moving()})
    write_dynosurf(tmp_path / "crane", moving())
    write_anime(tmp_path / "bear.anime", moving())
    sources = [tmp_path / "registrations_m.hdf5" / "50002_hips", tmp_path / "crane", tmp_path / "bear.anime"]
    found = []
    for number, source in enumerate(sources):
        place = tmp_path / f"clouds{number}.npz"
        assert run(["sample", str(source), "--frames", "1:4", "--points", "20", "-o", str(place)]) == 0
        found.append(np.load(place)["points"])
        np.testing.assert_allclose(found[-1], found[0], atol=1e-5)
    assert found[0].shape == (3, 20, 3)
    assert run(["sample", str(tmp_path / "registrations_m.hdf5"), "-o", str(tmp_path / "x.npz")]) == 2
    assert "write it behind the path" in capsys.readouterr().err


def test_any_source_is_a_truth(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """A result that is the truth itself, against an .anime file and a folder with gt."""
    RunFolder.prepare(tmp_path / "out").save(
        vertices=moving()[1:3], faces=FACES, keyframe=0, config=Config(), report={}, steps=[], names=["1", "2"]
    )
    write_anime(tmp_path / "bear.anime", moving())
    write_dynosurf(tmp_path / "crane", moving())
    for source in ("bear.anime", "crane"):
        arguments = ["evaluate", str(tmp_path / "out"), str(tmp_path / source), "--frames", "1:3", "--samples", "500"]
        assert run([*arguments, "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["mean"]["tracking"] < 1e-5
