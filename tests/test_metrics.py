"""The evaluation protocol against cases whose answers are known."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from scipy.spatial import cKDTree

from warpdef.errors import InputError, MissingPackageError
from warpdef.mesh import MeshSequence, TriMesh
from warpdef.truth.metrics import METRICS, UnitBox, compare_surfaces, edge_distortion, evaluate, f_score, nearest

pytest.importorskip("gpytoolbox")
SAMPLES = 20_000


def sphere(radius: float, rings: int = 40) -> TriMesh:
    """A fine closed sphere about the origin, outward."""
    polar, around = np.linspace(0.0, np.pi, rings + 1)[1:-1], np.arange(2 * rings) * np.pi / rings
    ring = np.stack(
        [
            np.outer(np.sin(polar), np.cos(around)),
            np.outer(np.sin(polar), np.sin(around)),
            np.outer(np.cos(polar), np.ones_like(around)),
        ],
        axis=2,
    )
    vertices = np.concatenate([[[0, 0, 1]], ring.reshape(-1, 3), [[0, 0, -1]]])
    n, last = 2 * rings, len(vertices) - 1
    a = np.arange(n)
    b = (a + 1) % n
    faces = [np.stack([np.zeros_like(a), 1 + a, 1 + b], axis=1)]
    for r in range(rings - 2):
        i, j = 1 + r * n, 1 + (r + 1) * n
        faces += [np.stack([i + a, j + a, j + b], axis=1), np.stack([i + a, j + b, i + b], axis=1)]
    i = 1 + (rings - 2) * n
    faces.append(np.stack([i + a, np.full_like(a, last), i + b], axis=1))
    return TriMesh(radius * vertices, np.concatenate(faces))


def plane(height: float, cells: int = 1) -> TriMesh:
    """The unit square at z = ``height``, upward, with ``cells`` squares a side."""
    x, y = np.meshgrid(*[np.linspace(0.0, 1.0, cells + 1)] * 2, indexing="ij")
    i = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    faces = np.concatenate(
        [np.stack([i, i + cells + 1, i + 1], axis=1), np.stack([i + 1, i + cells + 1, i + cells + 2], axis=1)]
    )
    return TriMesh(np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height)]), faces)


def rotation(degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


@dataclass(frozen=True)
class Result:
    vertices: np.ndarray
    faces: np.ndarray
    keyframe: int = 0


def turning_sphere(frames: int = 3) -> MeshSequence:
    mesh = sphere(1.0, 16)
    return MeshSequence(np.stack([mesh.vertices @ rotation(20.0 * t).T + t for t in range(frames)]), mesh.faces)


# One frame ----------------------------------------------------------------------------------------------------


def test_parallel_planes() -> None:
    gap = 0.02
    values = compare_surfaces(plane(gap), plane(0.0), SAMPLES)
    assert values["point_to_surface"] == pytest.approx(gap, abs=1e-12)
    assert values["normal_consistency"] == pytest.approx(1.0)
    # Nearest samples are the gap and the spacing of the samples away: the floor comes on top.
    assert values["chamfer_l2"] == pytest.approx(gap**2 + values["chamfer_floor"], rel=0.01)
    assert values["f_score_1"] == 0.0


def test_the_floor_is_that_of_random_samples() -> None:
    """Mean squared distance to the nearest of N uniform samples of area A: A / (pi N), a little more at a rim."""
    values = compare_surfaces(sphere(0.5), sphere(0.5), SAMPLES)
    floor = np.pi / (np.pi * SAMPLES)  # A = 4 pi 0.5^2
    assert values["chamfer_floor"] == pytest.approx(floor, rel=0.03)
    assert values["chamfer_l2"] == pytest.approx(floor, rel=0.03)
    assert values["chamfer_l2"] != values["chamfer_floor"]  # other samples
    assert values["point_to_surface"] < 1e-12
    assert values["normal_consistency"] > 0.99


def test_spheres_of_different_radius() -> None:
    values = compare_surfaces(sphere(0.47), sphere(0.5), SAMPLES)
    # Distance 0.03 both ways, up to the facets' sagitta of about 0.0004.
    assert values["point_to_surface"] == pytest.approx(0.03, abs=5e-4)
    assert values["chamfer_l2"] == pytest.approx(0.03**2 + values["chamfer_floor"], rel=0.05)


def test_normal_consistency_of_crossing_planes_is_the_cosine() -> None:
    tilted = TriMesh(plane(0.0).vertices @ rotation(60.0).T, plane(0.0).faces)
    assert compare_surfaces(tilted, plane(0.0), 2_000)["normal_consistency"] == pytest.approx(0.5)
    turned_over = TriMesh(plane(0.0).vertices, plane(0.0).faces[:, ::-1])
    assert compare_surfaces(turned_over, plane(0.0), 2_000)["normal_consistency"] == pytest.approx(1.0)


def test_a_missing_half_costs_recall_only() -> None:
    whole, half = plane(0.0, 8), plane(0.0, 8)
    half = TriMesh(half.vertices, half.faces[(half.vertices[half.faces].mean(axis=1)[:, 0] < 0.5)])
    values = compare_surfaces(half, whole, SAMPLES)
    # Precision 1, recall 1/2 and a rim of the threshold's width.
    recall = 0.5 + 0.01
    assert values["f_score_1"] == pytest.approx(2 * recall / (1 + recall), abs=0.01)
    # Half of the true samples lie 0 to 1/2 away: a quarter on average, over both directions an eighth of that.
    assert values["point_to_surface"] == pytest.approx(0.5 * 0.5 * 0.25, rel=0.03)


def test_f_score_is_the_harmonic_mean_below_the_threshold() -> None:
    near, far = np.full(3, 0.004), np.full(1, 0.006)
    assert f_score(np.concatenate([near, far]), near, 0.005) == pytest.approx(2 * 0.75 / 1.75)
    assert f_score(far, far, 0.005) == 0.0
    assert f_score(far, far, 0.01) == 1.0


def test_edge_distortion_is_relative_to_the_keyframe() -> None:
    key = np.array([[0.0, 0, 0], [1, 0, 0], [1, 2, 0], [1, 2, 0]])
    now = np.array([[0.0, 0, 0], [1.5, 0, 0], [1.5, 1, 0], [7, 7, 7]])
    assert edge_distortion(now, key, np.array([[0, 1], [1, 2], [2, 3]])) == pytest.approx(0.5)
    assert edge_distortion(now, key, np.array([[2, 3]])) == 0.0


def test_the_unit_box_is_the_true_frames_longest_side() -> None:
    box = UnitBox.of(np.array([[1.0, 2.0, 3.0], [3.0, 6.0, 4.0]]))
    np.testing.assert_allclose(box.map(np.array([3.0, 6.0, 4.0])), [0.5, 1.0, 0.25])
    np.testing.assert_allclose(box.map(np.array([1.0, 2.0, 3.0])), 0.0)


# Sequences ----------------------------------------------------------------------------------------------------


def test_a_perfect_result() -> None:
    truth = turning_sphere()
    done = []
    values = evaluate(truth, truth, 5_000, keyframe=1, progress=lambda i, n: done.append((i, n)))
    assert list(values) == ["mean", "frames"]
    assert list(values["mean"]) == list(METRICS)
    assert [list(frame) for frame in values["frames"]] == [["frame", *METRICS]] * 3
    assert [frame["frame"] for frame in values["frames"]] == [0, 1, 2]
    assert done == [(1, 3), (2, 3), (3, 3)]
    for frame in values["frames"]:
        assert frame["tracking"] < 1e-12 and frame["edge_distortion"] < 1e-12 and frame["point_to_surface"] < 1e-12
        assert frame["chamfer_l2"] == pytest.approx(frame["chamfer_floor"], rel=0.1)
    assert values["mean"]["chamfer_l2"] == pytest.approx(np.mean([f["chamfer_l2"] for f in values["frames"]]))


def test_seeds_repeat() -> None:
    truth = turning_sphere(2)
    first, again, other = (evaluate(truth, truth, 1_000, seed=seed) for seed in (5, 5, 6))
    assert first == again
    assert first["mean"]["chamfer_l2"] != other["mean"]["chamfer_l2"]
    # Frames draw their own samples.
    still = MeshSequence(np.stack([truth.vertices[0]] * 2), truth.faces)
    a, b = evaluate(still, still, 1_000)["frames"]
    assert a["chamfer_l2"] != b["chamfer_l2"]


def test_the_scale_and_place_of_the_input_do_not_matter() -> None:
    truth = turning_sphere(3)
    worse = Result(truth.vertices * 1.01, truth.faces)
    small = evaluate(worse, truth, 2_000)["mean"]
    large = evaluate(
        Result(worse.vertices * 100.0 - 7.0, truth.faces),
        MeshSequence(truth.vertices * 100.0 - 7.0, truth.faces),
        2_000,
    )["mean"]
    for key in METRICS:
        assert large[key] == pytest.approx(small[key], rel=1e-6, abs=1e-12), key


def test_tracking_of_another_template_on_a_rigid_motion_is_exact() -> None:
    """The template's vertices lie inside true triangles; carried along rigidly they track perfectly."""
    truth = turning_sphere()
    inner = truth.vertices[:, truth.faces].mean(axis=2)  # one vertex in each triangle
    faces = np.arange(len(truth.faces) // 3 * 3).reshape(-1, 3)
    values = evaluate(Result(inner, faces, keyframe=2), truth, 100)
    assert values["mean"]["tracking"] < 1e-12


def test_tracking_measures_a_slide_along_the_surface() -> None:
    """Same shape in every frame, but the template's vertices slide: only tracking can see it."""
    truth = MeshSequence(np.stack([sphere(1.0, 16).vertices] * 2), sphere(1.0, 16).faces)
    # One step of the ring pattern about z: every vertex lands where its neighbour was.
    c, s = np.cos(np.pi / 16), np.sin(np.pi / 16)
    slid = truth.vertices[1] @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T
    values = evaluate(Result(np.stack([truth.vertices[0], slid]), truth.faces), truth, 2_000)["frames"]
    way = np.linalg.norm(slid - truth.vertices[1], axis=1).mean() / 2.0  # the longest side is 2
    assert values[0]["tracking"] < 1e-12
    assert values[1]["tracking"] == pytest.approx(way)
    assert values[1]["point_to_surface"] < 1e-9 and values[1]["edge_distortion"] < 1e-9


def test_tracking_starts_on_the_closest_true_place() -> None:
    truth = MeshSequence(np.stack([plane(0.0, 4).vertices, plane(0.0, 4).vertices + [0, 0, 1.0]]), plane(0.0, 4).faces)
    above = Result(truth.vertices + [0, 0, 0.1], truth.faces)
    assert [f["tracking"] for f in evaluate(above, truth, 100)["frames"]] == pytest.approx([0.1, 0.1])


def test_a_truth_of_changing_triangles_has_no_tracking() -> None:
    truth = turning_sphere(2)
    changed = [truth[0], TriMesh(truth[1].vertices, np.roll(truth.faces, 1, axis=0))]
    values = evaluate(Result(truth.vertices, truth.faces), changed, 500)
    assert values["mean"]["tracking"] is None and [f["tracking"] for f in values["frames"]] == [None, None]
    assert values["mean"]["edge_distortion"] is not None
    fewer = [truth[0], sphere(1.0, 8)]
    assert evaluate(Result(truth.vertices, truth.faces), fewer, 500)["mean"]["tracking"] is None
    same = evaluate(Result(truth.vertices, truth.faces), [truth[0], truth[1]], 500)
    assert same["mean"]["tracking"] is not None


def test_without_a_keyframe_nothing_is_tracked() -> None:
    truth = turning_sphere(2)
    mean = evaluate(truth, truth, 500)["mean"]
    assert mean["tracking"] is None and mean["edge_distortion"] is None
    given = evaluate(Result(truth.vertices * 1.1, truth.faces, keyframe=0), truth, 500, keyframe=1)["frames"]
    assert given[1]["edge_distortion"] == 0.0  # the argument wins


@pytest.mark.parametrize(
    ("frames", "arguments", "message"),
    [
        (3, {}, "result has 2 frames, the truth 3.*--frames"),
        (2, {"samples": 0}, "--samples"),
        (2, {"seed": -1}, "--seed"),
        (2, {"keyframe": 2}, r"0\.\.1, got 2"),
        (2, {"keyframe": -1}, r"0\.\.1, got -1"),
    ],
)
def test_bad_arguments_are_refused(frames: int, arguments: dict, message: str) -> None:
    truth = turning_sphere(3)
    with pytest.raises(InputError, match=message):
        evaluate(truth.select(slice(2)), truth.select(slice(frames)), **{"samples": 100, **arguments})


def test_a_surface_without_area_is_named_by_frame() -> None:
    truth = turning_sphere(2)
    collapsed = truth.vertices.copy()
    collapsed[1] = 0.0
    with pytest.raises(InputError, match="frame 1: .*degenerate"):
        evaluate(Result(collapsed, truth.faces), truth, 100)
    with pytest.raises(InputError, match="frame 1: the true mesh.*one place"):
        evaluate(truth, MeshSequence(collapsed, truth.faces), 100)


def test_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gpytoolbox", None)
    with pytest.raises(MissingPackageError, match="pip install gpytoolbox"):
        compare_surfaces(plane(0.0), plane(0.1), 100)


def test_nearest_points_are_those_of_the_tree(rng: np.random.Generator) -> None:
    tree, places = cKDTree(rng.random((50, 3))), rng.random((1, 3))
    for asked in (places, rng.random((301, 3))):
        for ours, its in zip(nearest(tree, asked), tree.query(asked), strict=True):
            np.testing.assert_array_equal(ours, its)


def test_a_search_that_is_interrupted_leaves_no_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 3)
    begun, ended = [], []

    class Tree:
        def query(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            begun.append(places[0, 0])
            if places[0, 0] == 0:
                raise KeyboardInterrupt
            time.sleep(0.2)
            ended.append(places[0, 0])
            return places, places

    with pytest.raises(KeyboardInterrupt):
        nearest(cast(Any, Tree()), np.arange(9.0).reshape(3, 3))
    assert set(begun) - {0.0} == set(ended)


def test_a_real_body_against_itself_gives_its_sampling_floor(shared_data: Path) -> None:
    """The floor follows from the area in the unit box, A / (pi N): no number is copied here."""
    archive = np.load(shared_data / "ama_crane" / "gt.npz")
    truth = MeshSequence(archive["vertices"][[10, 26]], archive["faces"])
    values = evaluate(truth, truth, SAMPLES, keyframe=0)
    for frame, result in enumerate(values["frames"]):
        corners = UnitBox.of(truth.vertices[frame]).map(truth.vertices[frame])[truth.faces]
        area = (
            0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
        )
        assert result["chamfer_l2"] == pytest.approx(area / (np.pi * SAMPLES), rel=0.03)
        assert result["chamfer_floor"] == pytest.approx(area / (np.pi * SAMPLES), rel=0.03)
