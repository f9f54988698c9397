"""The k nearest fellows of points, and the planes through them, against brute force and NumPy."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from warpdef.geometry import nearby as rooms
from warpdef.geometry.nearby import Fellows, Nearest
from warpdef.kernels.cells import PointGrid
from warpdef.kernels.nearby import NEARBY_MAX, NearbySearch, local_planes
from warpdef.kernels.ways import Way, going

CPU = wp.get_device("cpu")


def upload(points: np.ndarray, device: str) -> wp.array:
    return wp.array(np.ascontiguousarray(points, np.float32).reshape(-1, 3), dtype=wp.vec3, device=device)


def search(
    targets: list[np.ndarray], queries: np.ndarray, group: np.ndarray, count: int, device: str
) -> tuple[np.ndarray, np.ndarray]:
    grid = PointGrid(upload(np.concatenate(targets), device), [len(t) for t in targets])
    grid.build()
    groups = wp.array(group.astype(np.int32), dtype=wp.int32, device=device)
    found = NearbySearch(grid, upload(queries, device), groups, count)
    found.run()
    return found.index.numpy(), found.distance.numpy()


def brute(targets: np.ndarray, queries: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """By distance in float32's places, then by number."""
    targets, queries = (a.astype(np.float32).astype(np.float64) for a in (targets, queries))
    apart = np.linalg.norm(queries[:, None] - targets[None], axis=2)
    index = np.argsort(apart, axis=1, kind="stable")[:, :count]
    return index, np.take_along_axis(apart, index, axis=1)


def clouds(rng: np.random.Generator) -> dict[str, np.ndarray]:
    ball = rng.normal(size=(300, 3))
    return {
        "sphere": ball / np.linalg.norm(ball, axis=1, keepdims=True),
        "volume": rng.uniform(-1, 1, (300, 3)),
        "sheet": rng.uniform(-1, 1, (300, 3)) * [1, 1, 0],
        "line": np.linspace(-1, 1, 300)[:, None] * [[1, 0.5, 0]],
        "two clusters": np.concatenate([1e-3 * rng.normal(size=(150, 3)) + s for s in (-0.9, 0.9)]),
    }


@pytest.mark.parametrize("kind", ["sphere", "volume", "sheet", "line", "two clusters"])
@pytest.mark.parametrize("count", [1, 9, 33])
def test_the_nearest_are_found_in_order(kind: str, count: int, device: str, rng: np.random.Generator) -> None:
    """Distances agree to the rounding of float32; a square of length d^2 has three terms and as many roundings, twice
    that of the distance. Where two differ by more than this their order is the true one."""
    targets = clouds(rng)[kind]
    queries = np.concatenate([targets[::3], rng.uniform(-3, 3, (60, 3)), 50.0 * rng.normal(size=(20, 3))])
    index, distance = search([targets], queries, np.zeros(len(queries)), count, device)
    expected, apart = brute(targets, queries, count)
    error = 4 * np.finfo(np.float32).eps * (apart + 1e-30)
    assert (np.abs(distance - apart) <= error + 1e-30).all()
    wide = np.pad(apart, ((0, 0), (1, 0)), constant_values=-1.0)
    clear = (np.diff(wide, axis=1) > 2 * error)[:, :-1] & (np.diff(wide, axis=1)[:, 1:] > 2 * error[:, 1:])
    np.testing.assert_array_equal(index[:, :-1][clear], expected[:, :-1][clear])


def test_equally_near_ones_are_told_by_number_whatever_the_order_of_a_cell(rng: np.random.Generator) -> None:
    lattice = rng.permutation(np.array(list(np.ndindex(6, 6, 6))) / 8.0 - 0.375)  # of eighths no square is rounded
    targets = np.concatenate([lattice, lattice])
    square = ((targets[:, None] - targets[None]) ** 2).sum(axis=2)
    expected = np.argsort(square, axis=1, kind="stable")[:, :20]
    for way, lanes in ((Way.SPANS, 1), (Way.WHOLE, 4)):
        with going(way, lanes):
            index, distance = search([targets], targets, np.zeros(len(targets)), 20, "cpu")
        np.testing.assert_array_equal(index, expected)
        nearest = np.sqrt(np.take_along_axis(square, expected, axis=1).astype(np.float32))
        np.testing.assert_array_max_ulp(distance, nearest, 1)


def test_groups_are_searched_apart_and_too_few_are_told(device: str, rng: np.random.Generator) -> None:
    targets = [rng.normal(size=(n, 3)) for n in (40, 3, 60)]
    queries, group = rng.normal(size=(30, 3)), np.repeat([2, 1, 0], 10)
    index, distance = search(targets, queries, group, 5, device)
    for g, first in ((2, 43), (0, 0)):
        np.testing.assert_array_equal(index[group == g], first + brute(targets[g], queries[group == g], 5)[0])
    assert (index[group == 1, 3:] == -1).all() and np.isinf(distance[group == 1, 3:]).all()
    assert set(index[group == 1, :3].ravel()) == {40, 41, 42}


def test_as_many_as_fit(device: str) -> None:
    grid, asked = PointGrid(upload(np.zeros((4, 3)), device), [4]), upload(np.zeros((2, 3)), device)
    group = wp.zeros(2, dtype=wp.int32, device=device)
    for count in (0, NEARBY_MAX + 1):
        with pytest.raises(ValueError, match=f"expected 1 to {NEARBY_MAX} neighbours"):
            NearbySearch(grid, asked, group, count)


def test_planes_are_those_of_the_covariance(device: str, rng: np.random.Generator) -> None:
    """Float64 but for the result: normals are unit to float32's rounding, and tilt by no more where the two lesser
    variances are apart; what float64 loses of a variance is some 1e-15 of the largest."""
    flat = rng.normal(size=(50, 12, 3)) * rng.uniform([[[1, 0.3, 1e-3]]], [[[2, 0.8, 0.1]]], (50, 1, 3))
    turn = np.linalg.qr(rng.normal(size=(50, 3, 3)))[0]
    points = (flat @ turn).reshape(-1, 3).astype(np.float32)
    index = wp.array(np.arange(600, dtype=np.int32).reshape(50, 12), dtype=wp.int32, ndim=2, device=device)
    normal, variance = (wp.zeros(50, dtype=wp.vec3, device=device) for _ in range(2))
    local_planes(0, 50, upload(points, device), index, normal, variance)
    near = points.reshape(50, 12, 3).astype(np.float64)
    near -= near.mean(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", near, near))
    eps = np.finfo(np.float32).eps
    np.testing.assert_allclose(variance.numpy(), spread, rtol=2 * eps, atol=1e-13 * spread.max())
    np.testing.assert_allclose(np.linalg.norm(normal.numpy(), axis=1), 1.0, rtol=0, atol=4 * eps)
    off = np.linalg.norm(np.cross(normal.numpy(), axes[:, :, 0]), axis=1)
    assert (off <= 4 * eps + 1e-13 * spread[:, 2] / (spread[:, 1] - spread[:, 0])).all()


@pytest.mark.parametrize("points", [np.zeros((20, 3)), np.eye(3)[[0] * 20] * np.arange(20)[:, None]])
def test_planes_of_what_has_none_are_numbers(points: np.ndarray, device: str) -> None:
    fellows = Fellows(points, 6, device=wp.get_device(device))
    normal, variance = fellows.planes()
    assert np.isfinite(normal).all() and (variance >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-5)
    np.testing.assert_allclose(variance[:, :2], 0.0, atol=1e-9)


@pytest.mark.parametrize("every", [1, 7])
@pytest.mark.parametrize("on", ["a device", "the host"])
def test_fellows_in_any_unit_and_far_away(every: int, on: str, rng: np.random.Generator, device: str) -> None:
    """Places are rounded to float32 about their middle: to 6e-8 of the size, in three coordinates of two points."""
    points = 1e3 * clouds(rng)["sphere"] + 1e7
    found = Fellows(points, 9, every, wp.get_device(device) if on == "a device" else None)
    apart = np.linalg.norm(points[::every, None] - points[found.index], axis=2)
    np.testing.assert_allclose(found.distance, apart, rtol=1e-6, atol=1e3 * 2 * np.sqrt(3) * 6e-8)
    assert (found.index[:, 0] == np.arange(len(points))[::every]).all()
    expected = np.sort(np.linalg.norm(points[::every, None] - points[None], axis=2), axis=1)[:, :9]
    np.testing.assert_allclose(found.distance, expected, rtol=1e-6, atol=1e3 * 4 * np.sqrt(3) * 6e-8)
    normal, variance = found.planes()
    near = points[found.index] - points[found.index].mean(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", near, near))
    np.testing.assert_allclose(variance, spread, rtol=1e-4, atol=1e-4 * spread.max())
    flat = spread[:, 0] < 0.1 * spread[:, 1]
    assert flat.mean() > 0.5 and (np.abs((normal * axes[:, :, 0]).sum(axis=1))[flat] > 1 - 1e-5).all()


def test_a_crowded_grid_gives_way_to_a_tree(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    points = np.concatenate([1e-4 * rng.normal(size=(1500, 3)) + s for s in (-1, 1)])
    asked: list[int] = []
    tree = Fellows._by_tree

    def noted(self: Fellows, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        asked.append(len(places))
        return tree(self, places)

    monkeypatch.setattr(Fellows, "_by_tree", noted)
    by_tree = Fellows(points, 9, device=CPU)
    assert asked == [3000]
    monkeypatch.setattr(rooms, "_CROWDED", 1e9)
    by_grid = Fellows(points, 9, device=CPU)
    assert asked == [3000]
    # Of places rounded to float32 near 1, in three coordinates of two points.
    np.testing.assert_allclose(by_grid.distance, by_tree.distance, rtol=1e-6, atol=4 * np.sqrt(3) * 6e-8)
    Fellows(clouds(rng)["sphere"], 9, device=CPU)
    assert asked == [3000]


def test_the_nearest_on_a_device_and_on_the_host(device: str, rng: np.random.Generator) -> None:
    """Places are rounded to 6e-8 of their size, each of three coordinates of both: so much farther one may be."""
    for targets in clouds(rng).values():
        places = np.concatenate([targets + 0.01 * rng.normal(size=targets.shape), rng.uniform(-2, 2, (50, 3))])
        on_device, on_host = Nearest(targets, wp.get_device(device)), Nearest(targets, None)
        for asked in (places, places[:7], places[:0]):
            (distance, index), (least, other) = on_device.query(asked), on_host.query(asked)
            np.testing.assert_array_equal(distance, np.linalg.norm(asked - targets[index], axis=1))
            assert (distance >= least - 1e-15).all()
            assert (distance <= least + 4 * np.sqrt(3) * 6e-8 * 2.0).all()
            assert not len(asked) or (index == other).mean() > 0.9
