"""Finding true sequences in folders of every format, and reading them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from present import present
from true_sets import FACES, moving, write_anime, write_dynosurf, write_obj, write_objs, write_registrations

from warpdef.datasets import find_sequences
from warpdef.datasets.find import survey
from warpdef.datasets.truth import read_truth
from warpdef.errors import InputError, MissingPackageError
from warpdef.files import read_clouds
from warpdef.mesh import MeshSequence


def facts(path: Path) -> list[tuple]:
    return [(s.name, s.kind, s.frames, s.vertices, s.faces) for s in find_sequences(path)]


def assert_reads(path: Path, expected: np.ndarray, **tolerance) -> None:
    """All frames, some, and one, from the only sequence in ``path``, by itself and by its path alone."""
    (sequence,) = find_sequences(path)
    for chosen in (None, slice(1, 3), slice(None, None, 2), slice(-1, None), slice(None, None, -1)):
        found = sequence.load(chosen)
        np.testing.assert_allclose(found.vertices, expected[chosen or slice(None)], **{"atol": 0, **tolerance})
        np.testing.assert_array_equal(found.faces, FACES)
        again = read_truth(sequence.path, chosen)
        np.testing.assert_array_equal([again[t].vertices for t in range(len(again))], found.vertices)
    with pytest.raises(InputError, match="--frames: expected at least 1 of 4 frames, got 0"):
        sequence.load(slice(9, 12))


def test_our_own_archives(tmp_path: Path) -> None:
    (tmp_path / "crane").mkdir()
    np.savez(tmp_path / "crane" / "gt.npz", vertices=moving(), faces=FACES)
    assert facts(tmp_path) == [("crane", "npz", 4, 4, 4)]
    assert find_sequences(tmp_path)[0].clouds is None
    assert_reads(tmp_path, moving())
    points = np.random.default_rng(0).normal(size=(4, 20, 3))
    np.savez(tmp_path / "crane" / "points.npz", points=points)
    (sequence,) = find_sequences(tmp_path)
    np.testing.assert_array_equal(read_clouds(present(sequence.clouds)).points, points)


def test_plain_folders_with_unpadded_numbers(tmp_path: Path) -> None:
    write_objs(tmp_path / "crane" / "meshes", moving(12), "mesh_{}.obj")
    assert facts(tmp_path) == [("crane", "meshes", 12, 4, 4)]
    found = find_sequences(tmp_path)[0].load()
    np.testing.assert_allclose(found.vertices, moving(12), atol=1e-6)  # mesh_2 before mesh_10
    np.testing.assert_array_equal(found.faces, FACES)


def test_a_plain_folder_by_itself(tmp_path: Path) -> None:
    write_objs(tmp_path / "samba", moving())
    assert facts(tmp_path / "samba") == [("samba", "meshes", 4, 4, 4)]
    assert_reads(tmp_path / "samba", moving(), rtol=1e-6)


@pytest.mark.parametrize("clouds", ["point_clouds", "points_clouds", "pcl_seqs"])
def test_dynosurfs_layout(tmp_path: Path, clouds: str) -> None:
    write_dynosurf(tmp_path / "AMA" / "crane_0010", moving(), clouds)
    assert facts(tmp_path) == facts(tmp_path / "AMA" / "crane_0010") == [("crane_0010", "dynosurf", 4, 4, 4)]
    (sequence,) = find_sequences(tmp_path)
    assert sequence.clouds == tmp_path / "AMA" / "crane_0010" / clouds  # the input before the dense samples
    assert len(read_clouds(present(sequence.clouds))) == 4
    assert_reads(tmp_path, moving(), rtol=1e-6)
    assert survey(tmp_path).passed == []  # clouds beside gt are no puzzle


def test_dynosurfs_layout_without_clouds(tmp_path: Path) -> None:
    write_objs(tmp_path / "crane" / "gt", moving())
    (sequence,) = find_sequences(tmp_path)
    assert (sequence.name, sequence.kind, sequence.clouds) == ("crane", "dynosurf", None)
    # The very folder is a plain one.
    assert facts(tmp_path / "crane" / "gt") == [("crane", "meshes", 4, 4, 4)]


def test_anime_files(tmp_path: Path) -> None:
    write_anime(tmp_path / "animals" / "bear3EP_Agression" / "bear3EP_Agression.anime", moving())
    assert facts(tmp_path) == [("bear3EP_Agression", "anime", 4, 4, 4)]
    assert_reads(tmp_path, moving())
    assert find_sequences(tmp_path)[0].load().vertices.dtype == np.float32


@pytest.mark.parametrize("options", [{}, {"chunks": (4, 3, 1)}, {"chunks": True, "compression": "gzip"}])
def test_registrations(tmp_path: Path, options: dict) -> None:
    pytest.importorskip("h5py")
    sequences = {"50004_punching": moving(5, 1.0), "50002_chicken_wings": moving()}
    write_registrations(tmp_path / "registrations_m.hdf5", sequences, **options)
    assert facts(tmp_path) == [("50002_chicken_wings", "hdf5", 4, 4, 4), ("50004_punching", "hdf5", 5, 4, 4)]
    first, second = find_sequences(tmp_path)
    assert first.path == tmp_path / "registrations_m.hdf5" / "50002_chicken_wings"
    np.testing.assert_array_equal(second.load().vertices, moving(5, 1.0))
    assert_reads(first.path, moving())
    with pytest.raises(InputError, match=r"one of its 2 sequences \(50002_chicken_wings, 50004_punching\), got 'none'"):
        read_truth(tmp_path / "registrations_m.hdf5")
    with pytest.raises(InputError, match="got 'hips'"):
        read_truth(tmp_path / "registrations_m.hdf5" / "hips")
    with pytest.raises(InputError, match="one of its 2 sequences, got 'hips'"):
        find_sequences(tmp_path / "registrations_m.hdf5" / "hips")


def test_an_hdf5_file_with_one_sequence_needs_no_name(tmp_path: Path) -> None:
    pytest.importorskip("h5py")
    write_registrations(tmp_path / "a.h5", {"only": moving().astype(np.float64)})
    found = read_truth(tmp_path / "a.h5")
    assert isinstance(found, MeshSequence)
    np.testing.assert_array_equal(found.vertices, moving())
    assert found.vertices.dtype == np.float64


def test_without_h5py_the_message_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "registrations_m.hdf5").write_bytes(b"\x89HDF\r\n\x1a\n")
    monkeypatch.setitem(sys.modules, "h5py", None)
    for read in (find_sequences, read_truth):
        with pytest.raises(MissingPackageError, match=r"pip install 'warpdef\[hdf5\]'"):
            read(tmp_path / "registrations_m.hdf5")


def test_a_set_of_everything_in_natural_order(tmp_path: Path) -> None:
    write_anime(tmp_path / "bear10.anime", moving())
    write_anime(tmp_path / "bear9.anime", moving())
    write_dynosurf(tmp_path / "AMA" / "crane", moving())
    write_objs(tmp_path / "horse", moving(2))
    write_anime(tmp_path / ".hidden" / "no.anime", moving())
    (tmp_path / "notes.txt").write_text("one")
    write_obj(tmp_path / "props" / "chair.obj", moving()[0])
    write_obj(tmp_path / "pair" / "left.obj", moving()[0])
    write_obj(tmp_path / "pair" / "right.obj", moving()[0])
    np.savez(tmp_path / "points.npz", points=np.zeros((2, 20, 3)))
    clouds = tmp_path / "scan"
    clouds.mkdir()
    for frame in range(3):
        (clouds / f"{frame}.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    assert [s.name for s in find_sequences(tmp_path)] == ["crane", "bear9", "bear10", "horse"]
    passed = "\n".join(survey(tmp_path).passed)
    for reason in ("one mesh is no sequence", "meshes without numbers", "but points", "points without faces"):
        assert reason in passed


def test_names_are_told_apart_by_the_folders_above(tmp_path: Path) -> None:
    for place in ("one/a/walk", "one/b/walk", "two/b/walk", "two/b/run"):
        write_objs(tmp_path / place, moving(2))
    assert [s.name for s in find_sequences(tmp_path)] == ["a-walk", "one-b-walk", "run", "two-b-walk"]


def test_folders_of_the_same_name_tell_nothing(tmp_path: Path) -> None:
    write_anime(tmp_path / "animals" / "walk" / "walk.anime", moving())
    write_objs(tmp_path / "humans" / "walk", moving())
    assert [s.name for s in find_sequences(tmp_path)] == ["animals-walk", "humans-walk"]


def test_names_in_two_files_of_registrations(tmp_path: Path) -> None:
    pytest.importorskip("h5py")
    for name in ("m", "f"):
        write_registrations(tmp_path / f"{name}.hdf5", {"hips": moving()})
    found = find_sequences(tmp_path)
    assert [s.name for s in found] == ["f-hips", "m-hips"]
    np.testing.assert_array_equal(found[1].load().vertices, moving())


def test_links_are_followed_once(tmp_path: Path) -> None:
    write_objs(tmp_path / "elsewhere" / "walk", moving(2))
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "linked").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere" / "round").symlink_to(tmp_path / "set")
    assert [s.name for s in find_sequences(tmp_path / "set")] == ["walk"]


def test_results_of_this_program_are_no_truth(tmp_path: Path) -> None:
    np.savez(tmp_path / "sequence.npz", vertices=moving(), faces=FACES)
    assert len(find_sequences(tmp_path)) == 1
    for name in ("config.toml", "report.json"):
        (tmp_path / name).touch()
    with pytest.raises(InputError, match=r"expected true mesh sequences .*, got none; check the path"):
        find_sequences(tmp_path)


def test_nothing_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="got nothing there"):
        find_sequences(tmp_path / "no")
    (tmp_path / "a.txt").write_text("x")
    with pytest.raises(InputError, match="got another"):
        find_sequences(tmp_path / "a.txt")
    write_obj(tmp_path / "one" / "0.obj", moving()[0])
    with pytest.raises(InputError, match="got none .*one mesh is no sequence"):
        find_sequences(tmp_path)


def test_a_damaged_sequence_is_not_dropped_in_silence(tmp_path: Path) -> None:
    write_anime(tmp_path / "a.anime", moving())
    for name in ("b", "c"):
        (tmp_path / f"{name}.anime").write_bytes(write_anime(tmp_path / f"{name}.anime", moving())[:-1])
    with pytest.raises(InputError, match=r"b\.anime: .*truncated.*`warpdef datasets check` lists 1 more"):
        find_sequences(tmp_path)
    assert [s.name for s in survey(tmp_path).sequences] == ["a"]


def test_triangles_that_change_are_read_where_they_may(tmp_path: Path) -> None:
    write_objs(tmp_path / "scan", moving(2))
    write_obj(tmp_path / "scan" / "0002.obj", moving()[0], FACES[::-1])
    (sequence,) = find_sequences(tmp_path)
    with pytest.raises(InputError, match=r"0002\.obj: expected the triangles of 0000\.obj"):
        sequence.load()
    assert [m.faces[0].tolist() for m in read_truth(sequence.path)] == [[0, 2, 1], [0, 2, 1], [1, 2, 3]]


def test_real_sequences(shared_data: Path) -> None:
    found = {s.name: s for s in find_sequences(shared_data)}
    assert {"ama_crane", "horse_gallop"} <= set(found)
    crane = found["ama_crane"]
    with np.load(crane.path) as archive:
        np.testing.assert_array_equal(crane.load(slice(3, 5)).vertices, archive["vertices"][3:5])
