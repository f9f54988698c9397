"""The template: built on both backends, gated, chosen among frames, or taken from the user."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import icosphere

from warpdef.config import Config, KeyframeConfig, TemplateConfig
from warpdef.errors import InputError, MissingPackageError
from warpdef.geometry import triangles
from warpdef.mesh import TriMesh
from warpdef.template import build as building
from warpdef.template import choose as template
from warpdef.template import poisson, quality

SMALL = TemplateConfig(faces_max=1500)


def no_mesh(*_: object) -> poisson.Mesh:
    return np.zeros((0, 3)), np.zeros((0, 3), np.int32)


@pytest.fixture(params=["gpytoolbox", "pymeshlab"])
def backend(request) -> poisson.Backend:
    try:
        return poisson.load_backend(request.param)
    except MissingPackageError as missing:
        pytest.skip(str(missing))


def ball(rng: np.random.Generator, count: int = 600, axes=(0.9, 0.6, 0.5)) -> tuple[np.ndarray, np.ndarray]:
    """An ellipsoid's points and outward normals."""
    x = rng.normal(size=(count, 3))
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    normals = x / np.array(axes)
    return x * np.array(axes), normals / np.linalg.norm(normals, axis=1, keepdims=True)


def cap(rng: np.random.Generator, count: int = 600) -> np.ndarray:
    """An open bowl."""
    x = rng.uniform(-0.9, 0.9, (count, 2))
    return np.column_stack([x, 0.3 * (x**2).sum(axis=1)])


def config(**options) -> Config:
    """A small template; options of the keyframe by ``choice``, the rest of the template."""
    choice = options.pop("choice", "auto")
    return Config(keyframe=KeyframeConfig(choice=choice), template=replace(SMALL, **options))


# --- building ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("given", [True, False])
def test_a_ball_becomes_a_closed_even_outward_mesh_on_its_points(backend, rng, given):
    points, normals = ball(rng)
    built = building.build(points, normals if given else None, SMALL, backend)
    vertices, faces = built.mesh.vertices, built.mesh.faces
    assert triangles.is_watertight(faces)
    assert triangles.euler_number(faces) == 2
    assert triangles.signed_volume(vertices, faces) == pytest.approx(4 / 3 * np.pi * 0.9 * 0.6 * 0.5, rel=0.05)
    assert len(np.unique(faces)) == len(vertices)
    assert triangles.face_areas(vertices, faces).min() > 0
    assert 0.9 * 1500 <= len(faces) <= 1500
    assert triangles.triangle_quality(vertices, faces) > 0.9
    assert np.abs((vertices / [0.9, 0.6, 0.5]) ** 2 @ np.ones(3) - 1).max() < 0.1
    assert built.report.normals == ("given" if given else "estimated")
    assert built.report.backend == backend.name
    assert built.warnings == []


def test_faces_follow_the_points_below_the_bound(backend, rng):
    points, normals = ball(rng, 400)
    built = building.build(points, normals, TemplateConfig(faces_per_point=2.0), backend)
    assert built.report.faces_target == 800
    assert 0.9 * 800 <= len(built.mesh.faces) <= 800


def test_the_same_cloud_gives_the_same_bytes_and_nothing_is_printed(backend, rng, capfd):
    points, _ = ball(rng)
    one, two = (building.build(points.copy(), None, SMALL, backend).mesh for _ in range(2))
    assert one.vertices.tobytes() == two.vertices.tobytes()
    assert one.faces.tobytes() == two.faces.tobytes()
    assert capfd.readouterr() == ("", "")


def test_units_and_place_do_not_matter(rng):
    points, normals = ball(rng)
    near = building.build(points, normals, SMALL)
    far = building.build(points * 1000.0 + 5000.0, normals, SMALL)
    assert near.report.depth == far.report.depth
    volume = triangles.signed_volume(near.mesh.vertices, near.mesh.faces)
    assert triangles.signed_volume(far.mesh.vertices, far.mesh.faces) == pytest.approx(volume * 1e9, rel=1e-3)
    assert far.report.edge_length == pytest.approx(near.report.edge_length * 1000, rel=1e-3)


def test_inverted_normals_are_turned_over_and_told(rng):
    points, normals = ball(rng)
    built = building.build(points, -normals, SMALL)
    assert triangles.signed_volume(built.mesh.vertices, built.mesh.faces) > 0
    assert built.report.flipped == len(points)
    assert "600 of 600 given normals pointed inwards" in built.warnings[0]
    calm = building.build(points, -normals, SMALL, source="calm")
    assert "600 of 600 normals estimated from the noisy cloud pointed inwards" in calm.warnings[0]
    assert calm.mesh.vertices.tobytes() == built.mesh.vertices.tobytes()


def test_a_second_body_gets_a_piece_of_its_own_and_crumbs_are_left_out(rng):
    points, normals = ball(rng, 800, (0.3, 0.3, 0.3))
    second, crumb = points[:400] * 0.6 + [0.7, 0, 0], points[:15] * 0.2 + [0, 0.8, 0]
    cloud = np.concatenate([points, second, crumb])
    built = building.build(cloud, np.concatenate([normals, normals[:400], normals[:15]]), SMALL)
    assert triangles.face_components(built.mesh.faces).max() == 1
    assert triangles.is_watertight(built.mesh.faces)
    assert built.mesh.vertices[:, 0].max() > 0.8 and built.mesh.vertices[:, 1].max() < 0.4
    assert built.report.left_out > 0


def test_depth_follows_the_spacing_and_an_explicit_depth_is_kept(rng):
    sparse, dense = ball(rng, 500)[0], ball(rng, 8000)[0]
    assert building.depth_by_spacing(dense) == building.depth_by_spacing(sparse) + 2
    assert building.build(*ball(rng), replace(SMALL, depth=5)).report.depth == 5


def test_a_cloud_far_denser_than_its_mesh_gets_no_finer_cells_than_that(rng):
    sparse, dense = (ball(rng, count, (1.0, 1.0, 1.0))[0] for count in (2000, 80_000))
    assert building.depth_by_spacing(sparse, 2000) == building.depth_by_spacing(sparse)
    coarse = building.depth_by_spacing(dense, 2000)
    assert coarse < building.depth_by_spacing(dense)
    area = 4.0 * np.pi
    cell, edge = 2.2 / 2**coarse, np.sqrt(4 / np.sqrt(3) * area / 2000)
    assert 0.5 <= cell / (edge / building.CELLS_AN_EDGE) <= 1.0


def test_a_cloud_on_a_line_is_an_input_error(rng):
    line = np.column_stack([np.linspace(-1, 1, 50), np.zeros(50), np.zeros(50)])
    broken = poisson.Backend("none", no_mesh, no_mesh)
    with pytest.raises(InputError, match="does not look like a closed surface"):
        building.build(line, None, SMALL, broken)


def flat_mesh(*_):
    return np.zeros((6, 3)), np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]], np.int32)


def test_a_surface_without_area_is_an_input_error(rng):
    with pytest.raises(InputError, match="no area"):
        building.build(ball(rng)[0], None, SMALL, poisson.Backend("none", flat_mesh, flat_mesh))


def test_a_failing_remesh_is_an_input_error(rng):
    sphere = icosphere(2)

    def refuse(*_):
        raise ValueError("Input mesh is non-manifold.")

    with pytest.raises(InputError, match="cannot be remeshed .*non-manifold"):
        building.build(ball(rng)[0], None, SMALL, poisson.Backend("none", lambda *_: sphere, refuse))
    nothing = poisson.Backend("none", lambda *_: sphere, lambda *_: (np.zeros((0, 3)), np.zeros((0, 3), np.int32)))
    with pytest.raises(InputError, match="lost the surface"):
        building.build(ball(rng)[0], None, SMALL, nothing)


def test_an_inside_out_surface_is_turned(rng):
    vertices, faces = icosphere(2)
    inside_out = poisson.Backend("none", lambda *_: (vertices, faces[:, ::-1]), lambda v, f, h: (v, f))
    built = building.build(ball(rng)[0], None, SMALL, inside_out)
    assert triangles.signed_volume(built.mesh.vertices, built.mesh.faces) > 0


# --- choosing ---------------------------------------------------------------------------------------------------------


def test_the_first_candidate_that_passes_is_taken_without_a_warning(rng):
    clouds = [ball(rng)[0] for _ in range(3)]
    chosen = template.choose_template(clouds, [None] * 3, config())
    assert chosen.gate.passed and chosen.warnings == []
    assert "occupied voxels" in chosen.why


def test_a_sparse_keyframe_has_the_faces_that_the_points_of_all_frames_can_tell(rng):
    cloud, ways = ball(rng, 200)[0], {}
    for frames, options in ((1, {}), (3, {}), (3, {"faces_sparse": 1000}), (3, {"faces_sparse": 0})):
        asked = config(faces_max=20000, **options)
        chosen = template.choose_template([cloud] * frames + [cloud[:0]], [None] * (frames + 1), asked)
        ways[frames, options.get("faces_sparse")] = chosen.report.faces_target
        assert 0.85 * chosen.report.faces_target <= len(chosen.mesh.faces) <= chosen.report.faces_target
    assert ways == {(1, None): 800, (3, None): 2400, (3, 1000): 1000, (3, 0): 800}


def test_an_open_best_frame_is_passed_over_and_told(rng):
    small = ball(rng, 400, (0.5, 0.4, 0.4))[0]
    clouds = [small, cap(rng, 900), small]
    chosen = template.choose_template(clouds, [None] * 3, config(surface="closed"))
    assert chosen.keyframe in (0, 2) and chosen.gate.passed
    assert len(chosen.warnings) == 1
    assert "keyframe 1 failed the template gate: " in chosen.warnings[0]
    assert f"of its surface is far from every point; trying frame {chosen.keyframe}" in chosen.warnings[0]


def test_when_none_passes_the_best_is_used_with_a_warning(rng):
    clouds = [cap(rng) for _ in range(3)]
    chosen = template.choose_template(clouds, [None] * 3, config(attempts=2, surface="closed"))
    assert not chosen.gate.passed
    assert len(chosen.warnings) == 3
    assert "no keyframe passed the template gate" in chosen.warnings[-1]
    assert f"frame {chosen.keyframe}" in chosen.warnings[-1]
    assert "an open or partly seen surface" in chosen.warnings[-1]


def test_a_lost_limb_is_told_as_such(rng):
    body, limb = ball(rng, 985)[0], ball(rng, 15, (0.05, 0.05, 0.05))[0] + [0, 0.9, 0]
    chosen = template.choose_template([np.concatenate([body, limb])] * 2, [None] * 2, config(choice="first"))
    assert not chosen.gate.passed
    assert "points are far from its surface; a thin limb may be lost" in chosen.warnings[-1]


def test_the_users_frame_is_not_replaced(rng):
    clouds = [ball(rng)[0], cap(rng), ball(rng)[0]]
    chosen = template.choose_template(clouds, [None] * 3, config(choice="1", surface="closed"))
    assert chosen.keyframe == 1
    assert "no keyframe passed" in chosen.warnings[-1]


def broken_ring(rng: np.random.Generator, gap: float, count: int = 2000) -> np.ndarray:
    """A torus cut open by a gap along its large circle, with rounded ends: no handle, unless the gap is closed."""
    angle, around = rng.uniform(0, 2 * np.pi, (2, count))
    angle = gap / 2 + angle * (1 - gap / (2 * np.pi))
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    tube = 0.6 * ring + 0.2 * (np.cos(around)[:, None] * ring + np.sin(around)[:, None] * [0, 0, 1])
    ends = []
    for at, side in ((gap / 2, -1), (2 * np.pi - gap / 2, 1)):
        forward = side * np.array([-np.sin(at), np.cos(at), 0])
        cap_points = ball(rng, count // 6, (0.2, 0.2, 0.2))[0]
        cap_points[cap_points @ forward < 0] *= -1
        ends.append(cap_points + 0.6 * np.array([np.cos(at), np.sin(at), 0]))
    return np.concatenate([tube, *ends]) if gap else tube


def test_a_frame_without_handles_is_found_among_frames_that_touch_themselves(rng):
    ring, gapped = broken_ring(rng, 0.0, 1500), broken_ring(rng, 0.9, 900)
    chosen = template.choose_template([ring, ring, gapped], [None] * 3, config(attempts=3, faces_max=800))
    assert chosen.keyframe == 2 and chosen.gate.handles == 0 and chosen.warnings == []
    assert "handles of the template: 0 here, 1 in frame 1, 1 in frame 0" in chosen.why


def counting_remeshes(monkeypatch, remesh=None) -> list[int]:
    """Faces of every surface that is remeshed; by ``remesh`` if given."""
    backend, asked = template.load_backend("auto"), []

    def counted(vertices, faces, edge_length):
        asked.append(len(faces))
        return (remesh or backend.remesh)(vertices, faces, edge_length)

    monkeypatch.setattr(template, "load_backend", lambda name: replace(backend, remesh=counted))
    return asked


def test_only_what_is_taken_gets_even_triangles(rng, monkeypatch):
    asked = counting_remeshes(monkeypatch)
    ring = broken_ring(rng, 0.0, 1500)
    roomy = config(attempts=3, surface="closed", faces_max=800)
    chosen = template.choose_template([ring] * 3, [None] * 3, roomy)
    once = len(asked)
    assert "1 here, 1 in frame" in chosen.why and chosen.gate.quality > 0.9 and chosen.gate.faces <= 800
    asked.clear()
    alone = template.choose_template([ring] * 3, [None] * 3, replace(roomy, keyframe=KeyframeConfig(choice="1")))
    assert once == len(asked) and np.array_equal(chosen.mesh.faces, alone.mesh.faces)


def test_a_draft_that_cannot_be_finished_makes_way_for_the_next(rng, monkeypatch):
    refused = []

    def refuse_first(vertices, faces, edge_length):
        if not refused:
            refused.append(len(faces))
            raise ValueError("Input mesh is non-manifold.")
        return vertices, faces

    counting_remeshes(monkeypatch, refuse_first)
    clouds = [ball(rng, count)[0] for count in (600, 620, 640)]
    chosen = template.choose_template(clouds, [None] * 3, config(attempts=2, surface="closed"))
    assert len(refused) == 1 and chosen.gate.passed and len(chosen.warnings) == 1
    assert "gave no template: the reconstructed surface cannot be remeshed" in chosen.warnings[0]


def test_drafts_that_pass_and_fail_once_finished_leave_the_best_with_a_warning(rng, monkeypatch):
    counting_remeshes(monkeypatch, lambda vertices, faces, edge_length: (vertices * 0.5, faces))
    ring = broken_ring(rng, 0.0, 1500)
    chosen = template.choose_template([ring] * 3, [None] * 3, config(attempts=2, surface="closed", faces_max=800))
    assert not chosen.gate.passed and "points are far from its surface" in chosen.gate.failures[-1]
    assert any("no keyframe passed the template gate; using the best" in warning for warning in chosen.warnings)


def test_one_handle_is_no_reason_to_begin_at_the_end(rng):
    vertices, faces = icosphere(2)
    gate = quality.judge(TriMesh(vertices, faces), vertices, SMALL, 0)

    def made(frame: int, handles: int) -> template.ChosenTemplate:
        report = building.TemplateReport(backend="none")
        return template.ChosenTemplate(
            TriMesh(vertices, faces), frame, "", report, replace(gate, handles=handles), ["its own"]
        )

    def chosen(*passed: template.ChosenTemplate) -> int:
        best = template._fewest_handles(list(passed), ["before"], 17)
        assert best.warnings == ["before", "its own"]
        return best.keyframe

    assert chosen(made(8, 1), made(0, 0)) == 8
    assert chosen(made(8, 3), made(0, 0)) == 0
    assert chosen(made(8, 1), made(12, 0)) == 12
    assert chosen(made(8, 1), made(10, 1)) == 8


def test_useless_given_normals_give_way_to_estimated_ones(rng):
    points, _ = ball(rng, 1500)
    useless = rng.normal(size=points.shape)
    useless /= np.linalg.norm(useless, axis=1, keepdims=True)
    strict = config(choice="0", far_share_max=0.0, missed_share_max=0.0, far_spacings=2.0)
    chosen = template.choose_template([points, points], [useless, None], strict)
    assert "trying estimated normals" in chosen.warnings[0]
    assert chosen.report.normals == "estimated"


def test_frames_that_yield_nothing_end_in_an_input_error(rng, monkeypatch):
    nothing = poisson.Backend("none", no_mesh, no_mesh)
    monkeypatch.setattr(template, "load_backend", lambda name: nothing)
    clouds = [ball(rng)[0] for _ in range(2)]
    with pytest.raises(InputError, match="no template: keyframe .*give a mesh of your own"):
        template.choose_template(clouds, [None, None], config())


# --- a mesh of the user's own -----------------------------------------------------------------------------------------


def test_a_users_mesh_is_kept_as_it_is_and_finds_its_frame(rng):
    vertices, faces = icosphere(3)
    order = rng.permutation(len(vertices))
    mesh = TriMesh(vertices[order] * [0.9, 0.6, 0.5], np.argsort(order)[faces])
    clouds = [ball(rng)[0] + [shift, 0, 0] for shift in (-0.2, -0.1, 0.0, 0.1)]
    chosen = template.accept_user_template(mesh, clouds, config())
    assert chosen.mesh is mesh
    assert chosen.keyframe == 2
    assert "taking frame 2" in chosen.warnings[0] and len(chosen.warnings) == 1
    assert chosen.report.backend == "user"


def test_a_users_keyframe_is_taken_without_a_word(rng):
    vertices, faces = icosphere(3)
    mesh = TriMesh(vertices * [0.9, 0.6, 0.5], faces)
    chosen = template.accept_user_template(mesh, [ball(rng)[0]] * 3, config(choice="1"))
    assert chosen.keyframe == 1 and chosen.warnings == []


def test_an_open_users_mesh_is_accepted_with_a_warning(rng):
    vertices, faces = icosphere(3)
    faces = faces[vertices[faces].mean(axis=1)[:, 2] > 0]
    mesh = TriMesh(vertices * [0.9, 0.6, 0.5], faces)
    points = ball(rng, 2000)[0]
    chosen = template.accept_user_template(mesh, [points[points[:, 2] > 0]] * 2, config(choice="first"))
    assert chosen.mesh is mesh
    assert any("not watertight" in w for w in chosen.warnings)
    assert any("belong to no face" in w for w in chosen.warnings)


def test_a_users_mesh_without_area_or_with_a_wrong_keyframe_is_refused(rng):
    clouds = [ball(rng)[0]] * 2
    with pytest.raises(InputError, match="--template: expected a surface with an area above 0"):
        template.accept_user_template(TriMesh(np.zeros((3, 3)), np.array([[0, 1, 2]])), clouds, config())
    with pytest.raises(InputError, match=r"0\.\.1, got 7"):
        template.accept_user_template(TriMesh(*icosphere(1)), clouds, config(choice="7"))


# --- real data --------------------------------------------------------------------------------------------------------


def test_a_captured_person_gets_a_template(shared_data):
    data = np.load(shared_data / "crane_clouds" / "points.npz")
    clouds, normals = data["points"].astype(float)[6:9], data["normals"].astype(float)[6:9]
    chosen = template.choose_template(list(clouds), list(normals), Config())
    assert chosen.gate.passed, chosen.gate.failures
    assert 18_000 <= chosen.gate.faces <= 20_000
    assert chosen.gate.quality > 0.9
