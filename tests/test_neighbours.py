"""Nearest neighbours are exact against brute force, wherever the query is and whatever it starts from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
import reference
import warp as wp

from warpdef.fit.morton import morton_order
from warpdef.kernels.cells import PointGrid, fit_cells
from warpdef.kernels.neighbours import NearestSearch
from warpdef.kernels.ways import Way, going


def upload(points: np.ndarray, device: str) -> wp.array:
    return wp.array(np.ascontiguousarray(points, np.float32).reshape(-1, 3), dtype=wp.vec3, device=device)


way = {"one_by_one": False}


@pytest.fixture(params=["sixteen at a time", "one by one"], autouse=True)
def _both_ways(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The CPU's way and that of CUDA, which the CPU can go, too."""
    monkeypatch.setitem(way, "one_by_one", request.param == "one by one")


def search(grid: PointGrid, queries: np.ndarray, group: Sequence[int] | np.ndarray) -> NearestSearch:
    """A search that knows nothing yet."""
    device = grid.points.device
    groups = wp.array(np.asarray(group, dtype=np.int32), dtype=wp.int32, device=device)
    return NearestSearch(grid, upload(queries, str(device)), groups, **way)


def find(
    grid: PointGrid, queries: np.ndarray, group: Sequence[int] | np.ndarray, start: np.ndarray | None = None
) -> np.ndarray:
    """Answers from the starts given or from nothing."""
    asked = search(grid, queries, group)
    if start is not None:
        asked.index.assign(start.astype(np.int32))
    asked.run()
    return asked.index.numpy()


def assert_nearest(queries: np.ndarray, targets: np.ndarray, found: np.ndarray) -> None:
    """The lowest nearest index; float32 may not tell apart two targets whose distances agree to 1e-6."""
    queries, targets = (np.asarray(a, np.float32).astype(np.float64) for a in (queries, targets))
    assert ((found >= 0) & (found < len(targets))).all()
    sq = ((queries[:, None] - targets[None]) ** 2).sum(axis=2)
    rows = np.arange(len(queries))
    best = sq.min(axis=1)
    reached = sq[rows, found]
    assert (reached <= best * (1 + 1e-6) + 1e-14).all(), f"{int((reached > best * (1 + 1e-6)).sum())} not the nearest"
    lowest = sq.argmin(axis=1)
    sq[rows, lowest] = np.inf
    clear = sq.min(axis=1) > best * (1 + 1e-5)
    np.testing.assert_array_equal(found[clear], lowest[clear])


def queries_everywhere(rng: np.random.Generator) -> np.ndarray:
    """Inside, just outside, far, very far, on the cube's corners and faces."""
    return np.concatenate(
        [
            rng.uniform(-1, 1, (150, 3)),
            rng.uniform(-1.5, 1.5, (80, 3)),
            rng.normal(size=(40, 3)) * 20,
            rng.normal(size=(20, 3)) * 1e4,
            np.array(list(np.ndindex(3, 3, 3))) - 1.0,
        ]
    )


def targets_of(kind: str, count: int, rng: np.random.Generator) -> np.ndarray:
    if kind == "uniform":
        return rng.uniform(-1, 1, (count, 3))
    if kind == "clustered":
        return rng.normal(size=(count, 3)) * 0.01 + rng.choice([-0.8, 0.0, 0.7], (count, 1))
    if kind == "outside":
        return rng.normal(size=(count, 3)) * 3
    if kind == "plane":
        return rng.uniform(-1, 1, (count, 3)) * [1, 1, 0]
    return np.round(rng.uniform(-1, 1, (count, 3)) * 4) / 4  # "lattice": cell borders, and many duplicates


@pytest.mark.parametrize("kind", ["uniform", "clustered", "outside", "plane", "lattice"])
def test_exact_against_brute_force(kind: str, device: str, rng: np.random.Generator) -> None:
    targets, queries = targets_of(kind, 800, rng), queries_everywhere(rng)
    grid = PointGrid(upload(targets, device), [len(targets)])
    grid.build()
    assert_nearest(queries, targets, find(grid, queries, np.zeros(len(queries))))


@pytest.mark.parametrize("per_point", [0.01, 0.1, 1.0, 8.0, 100.0, 800.0])
def test_exact_for_cells_of_every_size(per_point: float, device: str, rng: np.random.Generator) -> None:
    targets, queries = targets_of("uniform", 300, rng), queries_everywhere(rng)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("warpdef.kernels.cells._CELLS_PER_POINT", dict.fromkeys(Way, per_point))
        grid = PointGrid(upload(targets, device), [len(targets)])
    wanted = max(300 * per_point, 8)
    assert wanted / 8 <= grid.cells.nx * grid.cells.ny * grid.cells.nz <= wanted
    grid.build()
    assert_nearest(queries, targets, find(grid, queries, np.zeros(len(queries))))


@pytest.mark.parametrize(
    "box",
    [
        [[-0.1, -0.2, -0.1], [0.1, 0.2, 0.3]],  # most targets lie outside
        [[-5, -5, -5], [5, 5, 5]],  # all in a few cells
        [[-1, -1, 0.5], [1, 1, 0.5]],  # flat
        [[0, 0, 0], [0, 0, 0]],  # a point
        [[2, 2, 2], [3, 3, 3]],  # elsewhere
    ],
)
def test_exact_wherever_the_box_is(box: list, device: str, rng: np.random.Generator) -> None:
    targets, queries = targets_of("uniform", 300, rng), queries_everywhere(rng)
    grid = PointGrid(upload(targets, device), [len(targets)], np.array(box, dtype=float))
    grid.build()
    assert_nearest(queries, targets, find(grid, queries, np.zeros(len(queries))))


def test_the_number_of_cells_stays_within_its_bound() -> None:
    lower, upper = np.array([-1.0, -0.5, 0.0]), np.array([1.0, 0.5, 0.3])
    found = [fit_cells(lower, upper, 8.0 * n) for n in (1, 100, 10_000, 10**6, 10**8)]
    counts = [c.nx * c.ny * c.nz for c in found]
    assert counts == sorted(counts) and counts[-1] <= 2**18
    for c in found:
        covered = np.array([c.nx, c.ny, c.nz]) * c.size
        assert (np.array(c.lower) <= lower + 1e-6).all() and (np.array(c.lower) + covered >= upper - 1e-6).all()


@pytest.mark.parametrize("order", ["along a curve", "at random"])
@pytest.mark.parametrize("start", ["nothing", "any target"])
def test_exact_for_many_queries_wherever_their_neighbours_stand(
    order: str, start: str, device: str, rng: np.random.Generator
) -> None:
    """More than a thread takes; as packets of neighbours, of strangers, and of both."""
    targets, queries = targets_of("clustered", 600, rng), targets_of("clustered", 1500, rng)
    if order == "along a curve":
        queries = queries[morton_order(queries)]
    grid = PointGrid(upload(targets, device), [600])
    grid.build()
    known = None if start == "nothing" else rng.integers(0, 600, 1500)
    assert_nearest(queries, targets, find(grid, queries, np.zeros(1500), known))


def test_exact_after_positions_that_were_no_numbers(device: str, rng: np.random.Generator) -> None:
    """Moves through NaN cannot be measured: nothing known before may be believed after."""
    targets, queries = targets_of("uniform", 300, rng), targets_of("uniform", 200, rng)
    grid = PointGrid(upload(targets, device), [300])
    grid.build()
    asked = search(grid, queries, np.zeros(200))
    asked.run()
    for forget in (False, True):
        lost = targets.copy()
        lost[::3] = np.nan
        grid.points.assign(lost.astype(np.float32))
        grid.build()
        if not forget:
            asked.run()
        targets[::3] = targets_of("uniform", 100, rng)
        grid.points.assign(targets.astype(np.float32))
        if forget:
            grid.forget()
            asked.forget()
        grid.build()
        asked.run()
        assert_nearest(queries, targets, asked.index.numpy())


def test_groups_do_not_see_each_other(device: str, rng: np.random.Generator) -> None:
    sizes = [5, 400, 1, 90, 1200]
    clouds = [targets_of("uniform", n, rng) for n in sizes]
    first = np.concatenate([[0], np.cumsum(sizes)])
    grid = PointGrid(upload(np.concatenate(clouds), device), sizes)
    grid.build()
    queries = queries_everywhere(rng)
    for g, cloud in enumerate(clouds):
        found = find(grid, queries, np.full(len(queries), g))
        assert_nearest(queries, cloud, found - first[g])
    mixed = rng.integers(0, len(sizes), len(queries))
    each = zip(queries, mixed, strict=True)
    expected = np.array([first[g] + reference.nearest(q[None], clouds[g].astype(np.float32))[0] for q, g in each])
    found = find(grid, queries, mixed)
    near = np.abs(queries).max(axis=1) <= 1.5
    np.testing.assert_array_equal(found[near], expected[near])


def test_a_span_of_groups_is_built_alone(rng: np.random.Generator) -> None:
    """What CPU threads do: each builds its own groups, the others keep theirs."""
    sizes = [200, 300, 250]
    clouds = [targets_of("uniform", n, rng) for n in sizes]
    points = upload(np.concatenate(clouds), "cpu")
    grid = PointGrid(points, sizes)
    for g in (2, 0, 1):
        grid.build(g, g + 1)
    queries = rng.uniform(-1, 1, (100, 3))
    for g, begin in enumerate([0, 200, 500]):
        assert_nearest(queries, clouds[g], find(grid, queries, np.full(100, g)) - begin)
    # Group 1 moves and is built again.
    clouds[1] = targets_of("uniform", 300, rng)
    points.assign(np.concatenate(clouds).astype(np.float32))
    grid.build(1, 2)
    for g, begin in enumerate([0, 200, 500]):
        assert_nearest(queries, clouds[g], find(grid, queries, np.full(100, g)) - begin)


@pytest.mark.parametrize("start", ["nearest before the move", "any target", "farthest target"])
def test_the_start_does_not_change_the_answer(start: str, device: str, rng: np.random.Generator) -> None:
    clouds = [targets_of("uniform", n, rng) for n in (300, 500)]
    grid = PointGrid(upload(np.concatenate(clouds), device), [300, 500])
    grid.build()
    queries = queries_everywhere(rng)
    distance = ((queries[:, None] - clouds[1][None]) ** 2).sum(axis=2)
    candidates = {
        "nearest before the move": distance[rng.permutation(len(queries))].argmin(axis=1),
        "any target": rng.integers(0, 500, len(queries)),
        "farthest target": distance.argmax(axis=1),
    }[start]
    found = find(grid, queries, np.ones(len(queries)), 300 + candidates)
    assert_nearest(queries, clouds[1], found - 300)


@pytest.mark.parametrize("move", [1e-6, 1e-3, 0.02, 0.5, "settling"])
@pytest.mark.parametrize("moving", ["queries", "targets", "both"])
def test_exact_while_both_move(moving: str, move: float | str, device: str, rng: np.random.Generator) -> None:
    """What a search remembers must never outlive the moves since."""
    targets, queries = targets_of("clustered", 400, rng), targets_of("clustered", 200, rng) + 0.02
    grid = PointGrid(upload(targets, device), [150, 250])
    asked = search(grid, queries, np.ones(200))
    for round_ in range(15):
        size = 0.1 * 0.5**round_ if move == "settling" else float(move)
        if moving != "targets":
            queries = queries + rng.normal(size=queries.shape) * size
            asked._queries.assign(queries.astype(np.float32))
        if moving != "queries":
            targets = targets + rng.normal(size=targets.shape) * size
            grid.points.assign(targets.astype(np.float32))
        grid.build()
        asked.run(0, 77)
        asked.run(77)
        assert_nearest(queries, targets[150:], asked.index.numpy() - 150)


def test_exact_when_targets_creep_after_a_long_way(device: str) -> None:
    """Moves too small to show on a float32 sum of what went before still add up."""
    targets = np.array([[0.1, 0, 0], [-0.1004, 0, 0], [0, 0, 1]], dtype=np.float32)
    grid = PointGrid(upload(targets, device), [3])
    grid.build()
    for height in [-1.0, 1.0] * 32:
        targets[2, 2] = height
        grid.points.assign(targets)
        grid.build()
    asked = search(grid, np.zeros((1, 3)), [0])
    asked.run()
    assert asked.index.numpy()[0] == 0
    for _ in range(400):
        targets[1, 0] += np.float32(2e-6)
        grid.points.assign(targets)
        grid.build()
        asked.run()
    assert targets[1, 0] > -0.0998
    assert asked.index.numpy()[0] == 1


def test_ties_go_to_the_lowest_index(device: str, rng: np.random.Generator) -> None:
    once = targets_of("uniform", 50, rng).astype(np.float32)
    order = rng.permutation(200)
    targets = np.tile(once, (4, 1))[order]
    grid = PointGrid(upload(targets, device), [200])
    grid.build()
    copies = [np.flatnonzero((targets == p).all(axis=1)) for p in once]
    lowest, highest = (np.array([c[k] for c in copies]) for k in (0, -1))
    near = once + rng.normal(size=once.shape).astype(np.float32) * 1e-3
    for queries in (once, near):
        nearest = reference.nearest(queries, once)
        expected = lowest[nearest]
        np.testing.assert_array_equal(find(grid, queries, np.zeros(50)), expected)
        # Also from the highest of the equals.
        np.testing.assert_array_equal(find(grid, queries, np.zeros(50), highest[nearest]), expected)
    # Between two targets in different cells.
    pair = PointGrid(upload(np.array([[0.5, 0, 0], [-0.5, 0, 0]]), device), [2])
    pair.build()
    for start in (-1, 0, 1):
        assert find(pair, np.zeros((1, 3)), [0], np.array([start]))[0] == 0


def test_one_target_and_all_equal_targets(device: str, rng: np.random.Generator) -> None:
    queries = queries_everywhere(rng)
    for count in (1, 100):
        grid = PointGrid(upload(np.tile([0.3, -0.2, 0.9], (count, 1)), device), [count])
        grid.build()
        np.testing.assert_array_equal(find(grid, queries, np.zeros(len(queries))), 0)


def test_an_empty_group_answers_none(device: str, rng: np.random.Generator) -> None:
    grid = PointGrid(upload(rng.uniform(-1, 1, (20, 3)), device), [10, 0, 10])
    grid.build()
    queries = rng.uniform(-1, 1, (5, 3))
    np.testing.assert_array_equal(find(grid, queries, np.ones(5)), -1)
    assert (find(grid, queries, np.full(5, 2)) >= 10).all()


def test_a_negative_group_asks_nothing(device: str, rng: np.random.Generator) -> None:
    grid = PointGrid(upload(rng.uniform(-1, 1, (20, 3)), device), [20])
    grid.build()
    found = find(grid, rng.uniform(-1, 1, (4, 3)), np.array([0, -1, 0, -1]), np.array([3, 3, -1, -1]))
    np.testing.assert_array_equal(found[[1, 3]], -1)
    assert (found[[0, 2]] >= 0).all()


def test_what_is_no_number_does_not_crash(device: str, rng: np.random.Generator) -> None:
    targets = rng.uniform(-1, 1, (100, 3))
    targets[[3, 50]] = np.nan
    targets[60] = [np.inf, 0, -np.inf]
    grid = PointGrid(upload(targets, device), [100])
    grid.build()
    queries = rng.uniform(-1, 1, (50, 3))
    queries[7], queries[9] = np.nan, [np.inf, 0, 0]
    found = find(grid, queries, np.zeros(50))
    assert ((found >= 0) & (found < 100)).all()
    sound = np.isfinite(queries).all(axis=1)
    clean = np.where(np.isfinite(targets).all(axis=1, keepdims=True), targets, 1e6)
    assert_nearest(queries[sound], clean, found[sound])


def test_points_of_another_shape_are_refused(device: str) -> None:
    with pytest.raises(ValueError, match=r"points: expected shape \(5,\), got \(4,\)"):
        PointGrid(upload(np.zeros((4, 3)), device), [2, 3])
    with pytest.raises(TypeError, match="points: expected dtype vec3"):
        PointGrid(wp.zeros(4, dtype=wp.float32, device=device), [4])
    grid = PointGrid(upload(np.zeros((4, 3)), device), [4])
    with pytest.raises(ValueError, match=r"query_group: expected shape \(2,\), got \(3,\)"):
        NearestSearch(grid, upload(np.zeros((2, 3)), device), wp.zeros(3, dtype=wp.int32, device=device))
    with pytest.raises(TypeError, match="query_group: expected dtype int32"):
        NearestSearch(grid, upload(np.zeros((2, 3)), device), wp.zeros(2, dtype=wp.float32, device=device))


@pytest.mark.parametrize("lanes", [1, 3, 64])
def test_blocks_sort_as_the_cpu_does(lanes: int, rng: np.random.Generator) -> None:
    """The kernel that CUDA runs, on the CPU: count, add up, place; groups larger than a block, empty ones, spans."""
    sizes = [500, 1, 0, 700]
    targets, queries = targets_of("lattice", sum(sizes), rng), queries_everywhere(rng)
    serial = PointGrid(upload(targets, "cpu"), sizes)
    serial.build()
    with going(Way.SPANS, lanes):
        shared = PointGrid(upload(targets, "cpu"), sizes, np.stack([targets.min(axis=0), targets.max(axis=0)]))
        for _ in range(2):  # a second build starts from the first one's leftovers
            shared.build_in_blocks()
        np.testing.assert_array_equal(serial.start.numpy(), shared.start.numpy())
        for g in range(4):
            group = np.full(len(queries), g)
            np.testing.assert_array_equal(find(shared, queries, group), find(serial, queries, group))
        moved = targets + 0.01 * rng.normal(size=targets.shape)
        before = shared.start.numpy()
        for grid in (serial, shared):
            grid.points.assign(moved.astype(np.float32))
        serial.build(1, 4)
        shared.build_in_blocks(1, 4)
    np.testing.assert_array_equal(serial.start.numpy(), shared.start.numpy())
    np.testing.assert_array_equal(shared.start.numpy()[0], before[0])
    np.testing.assert_allclose(serial.odometer.numpy(), shared.odometer.numpy(), rtol=1e-6)
    assert shared.odometer.numpy().tolist()[::2] == [0, 0] and (shared.odometer.numpy()[[1, 3]] > 0).all()


def test_a_move_that_is_no_number_is_infinite_in_blocks() -> None:
    with going(Way.SPANS, 3):
        grid = PointGrid(upload(np.zeros((7, 3)), "cpu"), [3, 4])
        grid.points.assign(np.array([[0.0] * 3] * 6 + [[np.nan] * 3], dtype=np.float32))
        grid.build_in_blocks()
    assert grid.odometer.numpy().tolist() == [0, np.inf]
