"""A mesh bent onto what one camera saw of it: what is seen is met, what is not goes along, rigid and whole."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from leg_samples import DEGREE, body
from scipy.spatial import cKDTree

from warpdef.config import Config
from warpdef.device import find_device
from warpdef.fit.bending import FAULTLESS, NODES, Bending, SeenCloud, worth
from warpdef.fit.embedded import DeformationGraph, Pose
from warpdef.fit.follow import follow
from warpdef.fit.optimise import Optimiser
from warpdef.fit.problem import Problem
from warpdef.fit.refine import Refinement
from warpdef.fit.workers import Team
from warpdef.geometry.closest import closest_on_surface
from warpdef.geometry.triangles import unique_edges, vertex_normals

EYE = np.array([0.0, 0.0, 1.0])
CAMERA = 20.0 * EYE


def seen_part(vertices: np.ndarray, faces: np.ndarray, seed: int = 0, without: float = -np.inf) -> SeenCloud:
    """Samples that look towards +z and lie beyond ``without`` along x; the same chance for each pixel."""
    rng = np.random.default_rng(seed)
    points, normals = synthetic.sample_surface(vertices, faces, 6000, rng)
    shown = (normals @ EYE > rng.random(len(points))) & (points[:, 0] > without)
    return SeenCloud.of(points[shown], normals[shown])


def bending_of(vertices: np.ndarray, faces: np.ndarray) -> Bending:
    return Bending(vertices, faces, unique_edges(faces))


def lengths(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    ends = vertices[unique_edges(faces)]
    return np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)


def test_a_leg_that_swings_by_half_a_right_angle_is_met_and_its_far_side_goes_along():
    rest, faces = body((0.0, 0.0))
    there, _ = body((45.0 * DEGREE, 0.0))
    cloud = seen_part(there, faces)
    bending = bending_of(rest, faces)
    placed = bending.place(bending.onto(cloud, bending.still()))
    gap = closest_on_surface(cloud.points, placed, faces)[0]
    assert np.quantile(closest_on_surface(cloud.points, rest, faces)[0], 0.9) > 0.1
    assert np.quantile(gap, 0.95) < 0.02
    moved = np.linalg.norm(rest - there, axis=1)
    hidden = (vertex_normals(there, faces) @ EYE < -0.3) & (moved > 0.4)
    error = np.linalg.norm(placed - there, axis=1)
    # The leg is as wide as 0.16, and a place along it is open.
    assert hidden.any() and (error < 0.3 * moved)[hidden].all()


def test_a_limb_out_of_sight_stays_whole():
    rest, faces = body((0.0, 0.0))
    limb = rest[:, 0] < -0.2
    cloud = seen_part(rest @ synthetic.turn_about(EYE, 0.1).T + [0.05, 0.0, 0.0], faces, without=-0.05)
    bending = bending_of(rest, faces)
    placed = bending.place(bending.onto(cloud, bending.still()))
    edges = unique_edges(faces)
    stretch = lengths(placed, faces) / lengths(rest, faces)
    on = limb[edges].all(axis=1)
    assert on.sum() > 50
    assert 0.9 < np.quantile(stretch[on], 0.05) and np.quantile(stretch[on], 0.95) < 1.1


def hand(step: float = 0.03) -> tuple[np.ndarray, np.ndarray]:
    """A flat palm with three fingers of 0.15 x 1, 0.3 apart, in the plane z = 0, facing +z."""
    x, y = np.meshgrid(np.arange(-0.1, 0.9, step), np.arange(-0.5, 1.0, step), indexing="ij")
    on = (y < 0.0) | ((x % 0.3 < 0.15) & (x >= 0.0) & (x < 0.8))
    number = np.full(x.shape, -1)
    number[on] = np.arange(on.sum())
    quads = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1).reshape(-1, 4)
    quads = quads[(quads >= 0).all(axis=1)]
    places = np.column_stack([x[on], y[on], np.zeros(on.sum())])
    return places, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def test_fingers_that_swing_past_their_neighbours_places_find_their_own():
    """Tips move by 0.5, a finger's place is 0.3: nearest neighbours leave fingers on the place of others."""
    rest, faces = hand()
    there = rest + [[0.5, 0.0, 0.0]] * np.maximum(rest[:, 1:2], 0.0)
    bending, cloud = bending_of(rest, faces), SeenCloud.of(there, np.tile(EYE, (len(there), 1)))
    pose = bending.onto(cloud, bending.still())
    assert np.linalg.norm(bending.place(pose) - there, axis=1).max() < 0.15
    assert bending.fault(cloud, pose) < FAULTLESS < bending.fault(cloud, bending.still())


def test_fingers_that_went_astray_in_the_frame_before_find_their_places_from_rest():
    """Fingers that have changed places: no way from there finds back."""
    rest, faces = hand()
    cloud = SeenCloud.of(rest, np.tile(EYE, (len(rest), 1)))
    bending, changed = bending_of(rest, faces), rest.copy()
    for place, finger in ((0.3, 0.6), (-0.3, 0.9)):
        changed[(rest[:, 1] > 0.1) & (rest[:, 0] > finger - 0.31) & (rest[:, 0] < finger), 0] += place
    astray = bending.pose_of(changed)
    assert bending.best(cloud, astray)[1] > FAULTLESS
    pose, left = bending.best(cloud, astray, other=bending.still())
    assert left < FAULTLESS
    assert np.linalg.norm(bending.place(pose) - rest, axis=1).max() < 0.1


@pytest.mark.parametrize(("fault", "enough"), [(0.4, 0.2), (0.05, 0.03), (0.02, 0.017)])
def test_from_elsewhere_a_frame_is_bent_for_half_of_its_fault_or_if_that_makes_it_right(fault, enough):
    assert worth(fault) == pytest.approx(enough)


def test_a_finger_on_the_place_of_another_is_a_fault():
    rest, faces = hand()
    bending, cloud = bending_of(rest, faces), SeenCloud.of(rest, np.tile(EYE, (len(rest), 1)))
    finger = (rest[:, 0] > 0.59) & (rest[:, 1] > 0.1)
    there = rest - [[0.3, 0.0, 0.0]] * finger[:, None]
    pose = bending.pose_of(there)
    assert bending.fault(cloud, bending.still()) == 0.0
    # Its points are uncovered, and it lies on vertices far from it: each a share of its size.
    assert bending.fault(cloud, pose) > 1.5 * finger.mean()


def test_what_the_camera_would_have_seen_is_pushed_out_of_sight():
    """A finger that the points do not show may be anywhere but where the camera looks at nothing."""
    rest, faces = hand()
    shown = (rest[:, 0] < 0.59) | (rest[:, 1] < 0.0)
    bending = bending_of(rest, faces)
    normals = np.tile(EYE, (shown.sum(), 1))
    beside = []
    for eye in (None, CAMERA):
        cloud = SeenCloud.of(rest[shown], normals, eye)
        placed = bending.place(bending.onto(cloud, bending.still()))
        beside.append(cKDTree(rest[shown][:, :2]).query(placed[~shown][:, :2])[0].mean())
        assert np.quantile(closest_on_surface(cloud.points, placed, faces)[0], 0.95) < 0.03
    assert beside[1] < 0.5 * beside[0]


def test_links_that_no_match_holds_stay_bent_as_they_were():
    rest, faces = hand()
    bending = bending_of(rest, faces)
    pose = bending.pose_of(rest + 0.1 * np.random.default_rng(0).normal(size=rest.shape))
    bend = bending.graph.bend(rest, pose)
    finger = np.flatnonzero((rest[:, 0] > 0.59) & (rest[:, 1] > 0.0))
    others = np.setdiff1d(np.arange(len(rest)), finger)
    usual = bending._usual(pose, bend, others, np.ones(len(others)))
    inside = np.isin(bending.graph.node[bending.graph.link], finger[rest[finger, 1] > 0.2]).all(axis=1)
    palm = (rest[bending.graph.node, 1] < -0.1)[bending.graph.link].all(axis=1)
    assert inside.any() and not usual[palm].any()
    there = np.einsum("eab,eb->ea", pose.rotation[bending.graph.link[:, 0]], bend)
    np.testing.assert_array_equal(usual[inside], there[inside])


def test_points_are_not_met_by_the_far_side():
    """A thin plate; what is seen moves through it to where the far side was: the near side must follow, facing."""
    direction, faces = synthetic.icosphere(3)
    rest = direction * [0.8, 0.6, 0.05]
    there = rest - [0.0, 0.0, 0.1]
    placed_by = bending_of(rest, faces)
    placed = placed_by.place(placed_by.onto(seen_part(there, faces), placed_by.still()))
    assert np.abs(placed - there)[:, 2].mean() < 0.01


def test_nothing_in_reach_is_no_reason_to_move():
    rest, faces = body((0.0, 0.0))
    cloud = seen_part(rest, faces)
    away = SeenCloud(cloud.points + 100.0, cloud.normals, cloud.spacing)
    bending = bending_of(rest, faces)
    np.testing.assert_array_equal(bending.onto(away, bending.still()).shift, 0.0)


def test_the_pose_of_a_turned_mesh_is_its_turn():
    rest, faces = body((0.0, 0.0))
    bending, turn = bending_of(rest, faces), synthetic.turn_about([1.0, 2.0, -0.5], 2.0)
    pose = bending.pose_of(rest @ turn.T + [0.3, -0.2, 0.1])
    np.testing.assert_allclose(pose.rotation, np.broadcast_to(turn, pose.rotation.shape), atol=1e-9)
    np.testing.assert_allclose(bending.place(pose), rest @ turn.T + [0.3, -0.2, 0.1], atol=1e-9)
    mirrored = bending.pose_of(rest * [1.0, 1.0, -1.0])
    np.testing.assert_allclose(np.linalg.det(mirrored.rotation), 1.0)


def test_weights_of_a_step_count_matches():
    rest, faces = synthetic.icosphere(2)
    graph = bending_of(rest, faces).graph
    rng = np.random.default_rng(0)
    vertex, goal = np.arange(len(rest)), rest + 0.05 * rng.normal(size=rest.shape)
    match = (goal, rest, 0.1, 0.1)
    half = np.arange(len(rest)) % 2 == 0
    some = graph.step(rest, Pose.identity(len(graph.node)), vertex[half], goal[half], rest[half], 0.1, 0.1)
    weighed = graph.step(rest, Pose.identity(len(graph.node)), vertex, *match, weight=half.astype(float))
    np.testing.assert_allclose(weighed.shift, some.shift, atol=1e-9)
    whole = graph.step(rest, Pose.identity(len(graph.node)), vertex, *match)
    assert np.abs(whole.shift - some.shift).max() > 1e-3


def test_clouds_of_one_camera_are_followed_by_bending():
    turning = synthetic.turning_ellipsoid(5, 3000, np.random.default_rng(0), subdivisions=3)
    shown = [normals @ EYE > 0.1 for normals in turning.normals]
    clouds, normals = ([a[s] for a, s in zip(all_, shown, strict=True)] for all_ in (turning.clouds, turning.normals))
    config = replace(Config(), grid=replace(Config().grid, levels=3))
    device = find_device("cpu")
    problem = Problem(clouds, normals, turning.vertices[2], turning.faces, 2, config, device, eye=CAMERA)
    assert not problem.measures.complete.any()
    with closing(Team(1)) as team:
        optimiser = Optimiser(problem, 1, team)
        optimiser.finish()
        refinement = Refinement(optimiser.objective, team)
        followed, bent = follow(optimiser.objective, refinement)
    assert followed == [0, 1, 3, 4]
    assert bent == []
    size = [lengths(v, problem.faces).sum() for v in optimiser.objective.vertices.numpy()]
    np.testing.assert_allclose(size, size[2], rtol=0.03)


def test_chords_go_through_the_inside_of_a_body():
    """From side to side of each leg, never across the gap between the two."""
    rest, faces = body((0.0, 0.0))
    bending = bending_of(rest, faces)
    shell = DeformationGraph.build(rest, unique_edges(faces), NODES)
    known = set(map(tuple, shell.link.tolist()))
    chords = np.array([pair for pair in bending.graph.link.tolist() if tuple(pair) not in known])
    assert len(chords) > 100 and len(np.unique(bending.graph.link, axis=0)) == len(bending.graph.link)
    a, b = rest[bending.graph.node[chords]].transpose(1, 0, 2)
    # Winding number of the closed mesh around inner places of the chords: 1 inside.
    inside = np.concatenate([a + s * (b - a) for s in (0.25, 0.5, 0.75)])
    assert np.abs(winding(inside, rest, faces) - 1.0).max() < 0.1


def winding(places: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Solid angle of all triangles over 4 pi (van Oosterom and Strackee 1983), for places (N, 3)."""
    a, b, c = (vertices[faces[:, i]][None] - places[:, None] for i in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=2) for x in (a, b, c))
    over = (a * np.cross(b, c)).sum(axis=2)
    under = la * lb * lc + (a * b).sum(axis=2) * lc + (b * c).sum(axis=2) * la + (c * a).sum(axis=2) * lb
    return np.arctan2(over, under).sum(axis=1) / (2.0 * np.pi)


def test_a_body_seen_from_above_keeps_its_thickness():
    direction, faces = synthetic.icosphere(3)
    rest = direction * [1.0, 0.6, 0.4]
    there = rest + [[0.0, 0.0, 0.3]] * rest[:, :1] ** 2
    bending = bending_of(rest, faces)
    placed = bending.place(bending.onto(seen_part(there, faces), bending.still()))
    top, bottom = (int(np.argmax(s * rest[:, 2])) for s in (1.0, -1.0))
    thickness = np.linalg.norm(placed[top] - placed[bottom])
    assert abs(thickness - 0.8) < 0.06
    shell = Bending(rest, faces, unique_edges(faces))
    shell.graph = DeformationGraph.build(rest, unique_edges(faces), NODES)
    flat = shell.place(shell.onto(seen_part(there, faces), shell.still()))
    assert abs(np.linalg.norm(flat[top] - flat[bottom]) - 0.8) > 2.0 * abs(thickness - 0.8)


def test_what_one_camera_does_not_see_is_held_where_the_bending_left_it():
    turning = synthetic.turning_ellipsoid(3, 3000, np.random.default_rng(0), subdivisions=3)
    shown = [normals @ EYE > 0.1 for normals in turning.normals]
    clouds, normals = ([a[s] for a, s in zip(all_, shown, strict=True)] for all_ in (turning.clouds, turning.normals))
    config = replace(Config(), grid=replace(Config().grid, levels=3))
    with closing(Team(1)) as team:
        problem = Problem(
            clouds, normals, turning.vertices[1], turning.faces, 1, config, find_device("cpu"), eye=CAMERA
        )  # fmt: skip
        optimiser = Optimiser(problem, 1, team)
        optimiser.finish()
        refinement = Refinement(optimiser.objective, team)
        assert refinement.unseen and not refinement.unseen.by_time
        assert "expected" in refinement.state()
        follow(optimiser.objective, refinement)
        refinement.start()
        expected = refinement.state()["expected"].numpy()
        for _ in range(5):
            refinement.run_round()
        np.testing.assert_array_equal(refinement.state()["expected"].numpy(), expected)
    rest, placed = problem.template, optimiser.objective.vertices.numpy()
    hidden = vertex_normals(turning.vertices[1], turning.faces)[np.argsort(problem.place)] @ EYE < -0.5
    assert np.linalg.norm(placed[1] - rest, axis=1)[hidden].max() < 0.01


def test_a_frame_that_matches_do_not_find_is_bent_from_its_neighbours_pose(monkeypatch):
    """All of the body is seen, the grids know nothing, and the search for lost limbs finds none."""
    poses = [body((0.0, 0.0))[0], body((45.0 * DEGREE, 0.0))[0]]
    faces = body((0.0, 0.0))[1]
    clouds, normals = zip(
        *(synthetic.sample_surface(v, faces, 3000, np.random.default_rng(0)) for v in poses), strict=True
    )
    monkeypatch.setattr("warpdef.fit.recover.Search.learn", lambda *_: False)
    config = replace(Config(), grid=replace(Config().grid, levels=3))
    problem = Problem(list(clouds), list(normals), poses[0], faces, 0, config, find_device("cpu"))
    with closing(Team(1)) as team:
        optimiser = Optimiser(problem, 1, team)
        optimiser.finish()
        assert follow(optimiser.objective, Refinement(optimiser.objective, team)) == ([1], [1])
    placed = optimiser.objective.placed_vertices()[1]
    assert np.quantile(closest_on_surface(clouds[1], poses[0], faces)[0], 0.95) > 0.1
    assert np.quantile(closest_on_surface(clouds[1], placed, faces)[0], 0.95) < 0.02


def open_refinement(eye: np.ndarray | None, team: Team, **refine: int) -> tuple[Refinement, Problem]:
    """The upper half of a moving ellipsoid, seen from above or all around, in three frames."""
    turning = synthetic.turning_ellipsoid(3, 3000, np.random.default_rng(0), subdivisions=3)
    shown = [normals @ EYE > 0.1 for normals in turning.normals]
    clouds, normals = ([a[s] for a, s in zip(all_, shown, strict=True)] for all_ in (turning.clouds, turning.normals))
    upper = vertex_normals(turning.vertices[1], turning.faces) @ EYE > 0.1
    faces = np.cumsum(upper)[turning.faces[upper[turning.faces].all(axis=1)]] - 1
    used = np.unique(faces)
    place = np.zeros(upper.sum(), dtype=np.int32)
    place[used] = np.arange(len(used))
    vertices = turning.vertices[1][upper][used]
    config = replace(Config(), grid=replace(Config().grid, levels=3), refine=replace(Config().refine, **refine))
    problem = Problem(clouds, normals, vertices, place[faces], 1, config, find_device("cpu"), eye=eye)
    optimiser = Optimiser(problem, 1, team)
    optimiser.finish()
    return Refinement(optimiser.objective, team), problem


def unmet_and_away(team: Team) -> tuple[np.ndarray, np.ndarray]:
    """How well the frames of that half show its vertices after some rounds, and how far these are from where the
    bending left them, (T, V) each."""
    refinement, problem = open_refinement(CAMERA, team)
    assert problem.border is not None
    follow(refinement.objective, refinement)
    refinement.start()
    for _ in range(6):
        refinement.run_round()
    state, trust = refinement.state(), refinement.unseen.trust
    assert trust is not None
    return trust.numpy(), np.linalg.norm(state["vertices"].numpy() - state["expected"].numpy(), axis=2)


def test_what_a_frame_does_not_show_of_a_sheet_is_held_where_the_bending_left_it(monkeypatch):
    with closing(Team(1)) as team:
        trust, held = unmet_and_away(team)
        monkeypatch.setattr("warpdef.fit.unseen._HOLD_SHEET", 0.0)
        free = unmet_and_away(team)[1]
    unmet = trust < 0.1
    assert unmet.any()
    assert held[unmet].mean() < 0.9 * free[unmet].mean()


def test_a_sheet_that_nothing_was_bent_onto_is_not_held():
    with closing(Team(1)) as team:
        assert open_refinement(CAMERA, team, follow=0)[0].unseen.by_time
        assert not open_refinement(CAMERA, team)[0].unseen.by_time
        assert open_refinement(None, team)[0].unseen.by_time


def test_spikes_of_the_border_of_what_one_camera_saw_are_faired():
    for eye, fair in ((CAMERA, True), (None, False)):
        with closing(Team(1)) as team:
            refinement, problem = open_refinement(eye, team)
            shape, border = refinement.shape, problem.border
            assert border is not None
            on = np.flatnonzero(border[:, 0] >= 0)
            before, after = border[on, 0], border[on, 1]

            def spikes(y: np.ndarray, on=on, before=before, after=after) -> float:
                return float(np.linalg.norm(y[on] - (y[before] + y[after]) / 2.0, axis=1).mean())

            rest = shape.places.numpy().copy()
            spiky = rest.copy()
            spiky[on] += 0.05 * np.random.default_rng(1).normal(size=(len(on), 3))
            # Frames say of the shape what it is: without fairing the solve leaves it as it is.
            refinement.objective.vertices.assign(np.tile(spiky, (problem.frame_count, 1, 1)))
            shape.places.assign(spiky)
            refinement.rotation.assign(np.tile(np.eye(3), (problem.frame_count, problem.vertex_count, 1, 1)))
            if refinement.unseen.trust is not None:
                refinement.unseen.trust.fill_(1.0)
            shape.ask(0, problem.vertex_count)
            shape.solve()
            found = shape.places.numpy()
            assert (spikes(found) < 0.5 * spikes(spiky)) == fair
            inner = np.setdiff1d(np.arange(len(rest)), on)
            np.testing.assert_allclose(found[inner], rest[inner], atol=2e-3)


def test_frames_are_asked_for_what_they_show():
    """A frame far from its mesh shows nothing of it; the others show nearly all of it."""
    with closing(Team(1)) as team:
        refinement, problem = open_refinement(CAMERA, team)
        trust, vertices = refinement.unseen.trust, refinement.objective.vertices.numpy().copy()
        assert trust is not None
        vertices[0] += 3.0
        refinement.objective.vertices.assign(vertices)
        refinement.start()
        refinement.run_round()
        shown = trust.numpy()
        assert shown[0].max() < 1e-6 and np.median(shown[1]) > 0.7
