"""Known correspondences: read, placed on the mesh, and able to say what no cloud says."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic
import warp as wp
from test_planes import put

import warpdef
from warpdef.config import Config
from warpdef.errors import ConfigError, InputError
from warpdef.files.landmarks import read_landmarks
from warpdef.fit.landmarks import bent_by
from warpdef.fit.saving import Saved
from warpdef.kernels.landmarks import draw_to_landmarks
from warpdef.mesh import TriMesh
from warpdef.prepare import Safeguards
from warpdef.sequence import PointSequence

SPHERE, FACES = synthetic.icosphere(2)
TURNS = [synthetic.turn_about([0.3, 1.0, 0.2], 0.5 * t) for t in range(4)]
TRUTH = np.stack([SPHERE @ turn.T for turn in TURNS])
KNOWN = (0, 5, 40, 77, 120, 160)


@pytest.fixture(scope="module")
def sequence() -> PointSequence:
    """A sphere without features: nothing in its clouds says that it turns."""
    rng = np.random.default_rng(0)
    clouds = rng.normal(size=(4, 500, 3))
    clouds /= np.linalg.norm(clouds, axis=2, keepdims=True)
    return PointSequence.from_arrays(clouds, clouds.copy())


def quick(landmarks: Path | str = "") -> Config:
    base = Config(landmarks=str(landmarks))
    return replace(
        base,
        keyframe=replace(base.keyframe, choice="0"),
        grid=replace(base.grid, levels=3),
        optimiser=replace(base.optimiser, iterations=10, warmup=5),
        refine=replace(base.refine, iterations=4),
    )


def written(path: Path, by_vertex: bool = True, frames: range = range(1, 4)) -> Path:
    rows = []
    for t in frames:
        for i in KNOWN:
            at = {"vertex": i} if by_vertex else {"at": (1.01 * SPHERE[i]).tolist()}
            rows.append({**at, "frame": t, "place": TRUTH[t, i].tolist()})
    if path.suffix == ".json":
        path.write_text(json.dumps(rows))
        return path
    lines = ["kx,ky,kz,frame,x,y,z"] if not by_vertex else ["frame;vertex;x;y;z"]
    for row in rows:
        start = [row["frame"], row["vertex"]] if by_vertex else [*row["at"], row["frame"]]
        lines.append((";" if by_vertex else ",").join(str(v) for v in [*start, *row["place"]]))
    path.write_text("\n".join(lines) + "\n# the end\n")
    return path


def off(result) -> np.ndarray:
    """Mean distance of the vertices from where they have gone, over the sphere's diameter, (T,)."""
    return np.linalg.norm(result.vertices - TRUTH, axis=2).mean(axis=1) / 2


@pytest.mark.parametrize(
    ("name", "by_vertex"), [("a.csv", True), ("a.json", True), ("a.csv", False), ("a.json", False)]
)
def test_six_landmarks_say_that_a_sphere_turns(sequence, tmp_path, name, by_vertex):
    path = written(tmp_path / name, by_vertex)
    template = TriMesh(SPHERE, FACES)
    result = warpdef.reconstruct(sequence, quick(path), template=template)
    assert off(result).max() < 0.02
    told = result.report["landmarks"]
    assert told["count"] == 18 and told["error_max"] < 0.01 and not result.report["warnings"]


def test_without_them_it_seems_at_rest(sequence):
    result = warpdef.reconstruct(sequence, quick(), template=TriMesh(SPHERE, FACES))
    assert off(result)[1:].min() > 0.15 and result.report["landmarks"] is None


def test_landmarks_that_contradict_the_clouds_are_told(sequence, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("17,2,1.6,0.0,0.0\n")
    result = warpdef.reconstruct(sequence, quick(path), template=TriMesh(SPHERE, FACES))
    assert any("1 of 1 landmarks lie up to 29%" in w and "line 1" in w for w in result.report["warnings"])
    path.write_text("17,2,0,0,1\n17,2,0,0,-1\n")
    result = warpdef.reconstruct(sequence, quick(path), template=TriMesh(SPHERE, FACES))
    assert any("of 2 landmarks end up to" in w and "contradict" in w for w in result.report["warnings"])


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("162,1,0,0,1", "line 1: expected a vertex from 0 to 161, as the template has, got 162"),
        ("3,4,0,0,1", "expected a frame from 0 to 3, got 4"),
        ("3,1,0,0,1000", "expected a place near the cloud of frame 1, got one .* times the sequence's size outside"),
        ("0,0,1.5,1,0,0,1", "expected a place on the mesh at keyframe 0, got one .*%.*fix the keyframe"),
        ("3,1,0,0", "line 1: expected a line as 'vertex,frame,x,y,z'"),
        ("3,1,0,0,east", "expected a vertex .* got 3, 1, "),
        ("3.5,1,0,0,1", "expected a vertex .* got 3.5"),
        ("3,-1,0,0,1", "expected a vertex .* a frame"),
        ("3,1,0,0,nan", "expected a vertex .* a place"),
        ("", "expected landmarks, a line as"),
    ],
)
def test_what_is_no_landmark_is_named(sequence, tmp_path, row, message):
    (tmp_path / "a.csv").write_text(row + "\n")
    with pytest.raises(InputError, match=message):
        warpdef.reconstruct(sequence, quick(tmp_path / "a.csv"), template=TriMesh(SPHERE, FACES))


def test_other_files_and_stages_are_refused(sequence, tmp_path):
    for name, text, message in (
        ("a.json", "{}", "expected a list"),
        ("b.json", "[", "not valid JSON"),
        ("c.json", '[{"frame": 1, "place": [0, 0, 1]}]', "entry 0: expected a vertex"),
        ("d.npz", "x", "expected .csv or .json"),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(InputError, match=message):
            read_landmarks(tmp_path / name)
    (tmp_path / "a.csv").write_text("3,1,0,0,1\n")
    with pytest.raises(InputError, match="the template is yet to be built"):
        warpdef.reconstruct(sequence, quick(tmp_path / "a.csv"))
    with pytest.raises(ConfigError, match=r"refine\.iterations"):
        replace(quick("a.csv"), refine=replace(Config().refine, iterations=0))


def test_a_run_goes_on_with_its_own_landmarks_only(sequence, tmp_path):
    path, kept = written(tmp_path / "a.csv"), tmp_path / "kept"
    template = TriMesh(SPHERE, FACES)
    guarded = Safeguards(checkpoint=kept, checkpoint_seconds=0.0)
    whole = warpdef.reconstruct(sequence, quick(path), template=template, device="cpu", safeguards=guarded)
    kept_run = Safeguards(resume=Saved(kept))
    again = warpdef.reconstruct(sequence, template=template, device="cpu", safeguards=kept_run)
    np.testing.assert_array_equal(again.vertices, whole.vertices)
    written(path, frames=range(1, 3))
    with pytest.raises(InputError, match="expected the landmarks of the run to continue"):
        warpdef.reconstruct(sequence, template=template, safeguards=Safeguards(resume=Saved(kept)))


@pytest.mark.parametrize("count", [1, 2, 3, 6])
def test_a_start_is_bent_through_its_landmarks(count):
    rng = np.random.default_rng(count)
    source, turn = rng.normal(size=(count, 3)), synthetic.turn_about([1.0, 2.0, 0.5], 0.7)
    rigid = source @ turn.T + [0.1, -0.2, 0.3]
    np.testing.assert_allclose(bent_by(source, rigid, source), rigid, atol=1e-5)
    if count >= 3:
        np.testing.assert_allclose(bent_by(source, rigid, SPHERE), SPHERE @ turn.T + [0.1, -0.2, 0.3], atol=1e-5)
    bent = rigid + 0.1 * rng.normal(size=(count, 3))
    np.testing.assert_allclose(bent_by(source, bent, source), bent, atol=1e-4)


def test_equations_against_numpy(device: str, rng: np.random.Generator):
    """Two landmarks on one triangle and one on a vertex of it; written beside what is there, in spans."""
    vertices, places = rng.normal(size=(8, 3)), rng.normal(size=(3, 3))
    corners, parts = (
        np.array([[1, 2, 5], [1, 2, 5], [5, 5, 5]]),
        np.array([[0.2, 0.3, 0.5], [0.6, 0.4, 0.0], [1, 0, 0]]),
    )
    matrix, rhs = rng.normal(size=(8, 3, 3)), rng.normal(size=(8, 3))
    entries = [(1, 0, 0.2), (1, 1, 0.6), (2, 0, 0.3), (2, 1, 0.4), (5, 0, 0.5), (5, 2, 1.0)]
    slot, row = [1, 2, 5], [0, 2, 4, 6]
    arrays = [put(np.array(a), wp.int32, device) for a in (slot, row, [k for _, k, _ in entries])]
    share = put(np.array([b for _, _, b in entries]), wp.float32, device)
    table = [wp.array(a, dtype=kind, device=device) for a, kind in ((corners, wp.int32), (parts, wp.float32))]
    out = put(matrix, wp.mat33, device), put(rhs, wp.vec3, device)
    for begin, count in ((0, 1), (1, 2)):
        where = put(places, wp.vec3, device), put(vertices, wp.vec3, device)
        draw_to_landmarks(begin, count, 2.5, *(*arrays, share, *table, *where, *out))
    for i, k, b in entries:
        matrix[i] += 2.5 * b * np.eye(3)
        rhs[i] += 2.5 * b * (places[k] - parts[k] @ vertices[corners[k]])
    np.testing.assert_allclose(out[0].numpy(), matrix, atol=1e-5)
    np.testing.assert_allclose(out[1].numpy(), rhs, atol=1e-5)
