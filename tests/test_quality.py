"""What is known of a result without a truth, on results whose faults were made by hand."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from judged import assess, frames, names
from scipy.spatial import cKDTree

from warpdef.geometry.noise import noise_level
from warpdef.geometry.sampling import sample_surface
from warpdef.quality import assess as quality
from warpdef.quality.coverage import measure_coverage
from warpdef.quality.frame import FrameQuality
from warpdef.quality.shape import ReferenceShape, neighbouring_faces, opposite_vertices
from warpdef.quality.temporal import acceleration, flicker
from warpdef.quality.verdict import BOUNDS, FEWEST_POINTS, summary

pytest.importorskip("gpytoolbox")
FRAMES, POINTS, KEYFRAME = 5, 1500, 2


def tube(rings: int = 40, around: int = 32) -> tuple[np.ndarray, np.ndarray]:
    """A closed tube along x, 4 long and 1 wide, with flat ends; outward triangles."""
    angle = np.arange(around) * 2.0 * np.pi / around
    x = np.linspace(-2.0, 2.0, rings)
    ring = np.stack([np.zeros(around), 0.5 * np.cos(angle), 0.5 * np.sin(angle)], axis=1)
    vertices = (ring[None] + x[:, None, None] * [1.0, 0.0, 0.0]).reshape(-1, 3)
    a = np.arange(around)
    b = (a + 1) % around
    faces = []
    for r in range(rings - 1):
        i, j = r * around, (r + 1) * around
        faces += [np.stack([i + a, i + b, j + b], axis=1), np.stack([i + a, j + b, j + a], axis=1)]
    low, high, last = len(vertices), len(vertices) + 1, (rings - 1) * around
    faces += [np.stack([np.full_like(a, low), b, a], axis=1), np.stack([np.full_like(a, high), last + a, last + b], 1)]
    return np.concatenate([vertices, [[-2.0, 0, 0], [2.0, 0, 0]]]), np.concatenate(faces).astype(np.int32)


VERTICES, FACES = tube()


def moved(frame: int, vertices: np.ndarray = VERTICES) -> np.ndarray:
    """The tube turned by 5 degrees a frame, and carried along."""
    c, s = np.cos(np.radians(5.0 * frame)), np.sin(np.radians(5.0 * frame))
    return vertices @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + [0.1 * frame, 0.0, 0.0]


@pytest.fixture
def meshes() -> np.ndarray:
    return np.stack([moved(t) for t in range(FRAMES)])


@pytest.fixture
def clouds(meshes: np.ndarray) -> list[np.ndarray]:
    return [sample_surface(v, FACES, POINTS, np.random.default_rng(t))[0] for t, v in enumerate(meshes)]


def test_frames_side_by_side_are_judged_as_one_after_the_other(meshes, clouds) -> None:
    gap = [*clouds[:2], clouds[2][:0], *clouds[3:]]
    one, many = (quality.assess(gap, meshes, FACES, KEYFRAME, threads=n) for n in (1, 3))
    assert one.as_dict() == many.as_dict() and [f.frame for f in many.frames] == list(range(FRAMES))
    np.testing.assert_array_equal(one.confidence, many.confidence)


def test_a_perfect_result_is_good(meshes, clouds) -> None:
    found = assess(clouds, meshes, FACES, KEYFRAME)
    assert names(found) == ["good"] * FRAMES and not found.warnings()
    for frame in frames(found):
        assert frame.residual_p95 < 1e-9 and frame.uncovered == 0.0 and frame.torn == 0.0
        assert frame.far < 0.002 and frame.unseen < 0.01 and frame.folded == 0.0 and frame.stretch_max < 1e-9
        assert frame.thickness == pytest.approx(1.0) and frame.volume == pytest.approx(1.0)
        # Points thrown at random lie half the square root of the area of one apart.
        assert frame.spacing == pytest.approx(0.5 * np.sqrt((np.pi * 4.0 + np.pi * 0.5) / POINTS), rel=0.1)
    assert found.confidence.shape == meshes.shape[:2] and found.confidence.dtype == np.uint8
    assert found.confidence.mean() > 250


def test_one_frame_beside_its_points_is_lost(meshes, clouds) -> None:
    meshes[3] += [0.0, 0.0, 0.4]
    found = assess(clouds, meshes, FACES, KEYFRAME)
    assert names(found) == ["good", "good", "good", "lost", "good"]
    assert "points" in found.verdicts[3].reasons[0] and frames(found)[3].residual_mean_percent > 3.0
    assert found.warnings()[0].startswith("the mesh is lost in frame 3: ")
    assert found.confidence[3].mean() < 0.3 * found.confidence[1].mean()


def test_a_limb_left_behind_is_not_good(meshes, clouds) -> None:
    """The last twentieth of the tube has points, and no mesh."""
    along = np.minimum(VERTICES[:, 0], 1.8)
    meshes[1] = moved(1) + (along - VERTICES[:, 0])[:, None] * (moved(1)[-1] - moved(1)[-2]) / 4.0
    found = assess(clouds, meshes, FACES, KEYFRAME)
    assert names(found) == ["good", "doubtful", "good", "good", "good"]
    assert 0.03 < frames(found)[1].uncovered < 0.1


def test_half_of_the_surface_unseen_is_no_fault(meshes, clouds) -> None:
    half = [cloud[cloud[:, 2] > 0.0] for cloud in clouds]
    found = assess(half, meshes, FACES, KEYFRAME)
    assert names(found) == ["good"] * FRAMES
    # What lies within four spacings of the upper half is not far.
    share = 0.5 - 4.0 * frames(found)[0].spacing / (np.pi * 0.5)
    assert frames(found)[0].far == pytest.approx(share, abs=0.04) and frames(found)[0].unseen >= frames(found)[0].far
    up = VERTICES[:, 2] > 0.2
    assert found.confidence[:, up].mean() > 250 and found.confidence[:, VERTICES[:, 2] < -0.4].max() < 10


def test_a_limb_beyond_the_end_of_a_closed_cloud_hangs_over(meshes, clouds) -> None:
    """In frame 3 the points are those of a tube that ends earlier, in frame 1 the tube's own are cut off as early."""
    shorter = meshes[3] + ((VERTICES[:, :1] + 2.0) * -0.08) * (meshes[3][-1] - meshes[3][-2]) / 4.0
    clouds[3] = sample_surface(shorter, FACES, POINTS, np.random.default_rng(3))[0]
    along = (meshes[1][-1] - meshes[1][-2]) / 4.0
    clouds[1] = clouds[1][(clouds[1] - meshes[1][-2]) @ along < 3.68]
    found = assess(clouds, meshes, FACES, KEYFRAME)
    assert names(found) == ["good", "good", "good", "doubtful", "good"]
    assert 0.03 < frames(found)[3].overhang < 0.1 and "hangs over" in found.verdicts[3].reasons[0]
    assert [frames(found)[t].overhang for t in (0, 1, 2, 4)] == [0.0] * 4 and frames(found)[1].far > 0.03


def test_what_the_camera_should_have_seen_is_told(meshes, clouds) -> None:
    """From above, half of the tube is out of sight in two frames: under the other half in one, in full view in one."""
    up = np.array([0.0, 0.0, 1.0])
    above = [cloud[cloud[:, 2] > 0.0] for cloud in clouds]
    middle = [moved(t)[-2:].mean(axis=0) for t in range(FRAMES)]
    for t in (3, 4):
        above[t] = above[t][(above[t] - middle[t]) @ (moved(t)[-1] - moved(t)[-2]) > 0.0]
    folded = VERTICES * [-1.0, 1.0, 1.0] - [0.0, 0.0, 1.5]
    meshes[3] = moved(3, np.where(VERTICES[:, :1] < 0.0, folded, VERTICES))
    found = assess(above, meshes, FACES, KEYFRAME, eye=50.0 * up)
    shares = [frame.exposed for frame in frames(found)]
    assert max(shares[:4]) < 0.01 and 0.1 < shares[4] < 0.3
    assert any("camera saw nothing" in reason for reason in found.verdicts[4].reasons)
    assert not any("camera saw nothing" in reason for verdict in found.verdicts[:4] for reason in verdict.reasons)
    assert quality.assess(above, meshes, FACES, KEYFRAME).frames[4].exposed is None


def test_surface_drawn_out_where_no_points_are_is_torn(meshes, clouds) -> None:
    """A web: some vertices of the side are drawn far away from it."""
    side = (np.abs(VERTICES[:, 0]) < 0.2) & (VERTICES[:, 2] > 0.3)
    meshes[4, side] += [0.0, 0.0, 1.0]
    found = assess(clouds, meshes, FACES, KEYFRAME)
    assert names(found)[:4] == ["good"] * 4 and names(found)[4] != "good"
    assert frames(found)[4].torn > 0.02 and any("without points" in reason for reason in found.verdicts[4].reasons)
    assert found.confidence[4, side].max() <= 255 * 0.5 * 0.8 + 1  # its shape is known from the other frames
    assert found.confidence[:4, side].mean() > 240


def test_surface_folded_behind_another_is_told(meshes, clouds) -> None:
    """The lower half lies on the upper one: all points of that are covered, and no length has changed."""
    upper = [cloud[cloud[:, 2] > 0.0] for cloud in clouds]
    meshes[0, :, 2] = np.abs(meshes[0, :, 2])
    found = assess(upper, meshes, FACES, KEYFRAME)
    assert frames(found)[0].uncovered == 0.0 and frames(found)[0].doubled > 0.3
    assert names(found) == ["doubtful"] + ["good"] * 4
    assert any("behind or inside" in reason for reason in found.verdicts[0].reasons)


def test_a_second_layer_on_the_surface_is_told(clouds) -> None:
    """Two tubes that lie side by side, and in one frame both on the points of both: each covers all of them."""
    both = np.concatenate([FACES, FACES + len(VERTICES)])
    side = np.array([0.0, 0.0, 3.0])
    apart = [np.concatenate([cloud, cloud + side]) for cloud in clouds]
    apart[3] = np.concatenate([clouds[3], clouds[3] + [1e-3, 0.0, 0.0]])
    pairs = np.stack([np.concatenate([moved(t), moved(t) + (t != 3) * side]) for t in range(FRAMES)])
    found = assess(apart, pairs, both, KEYFRAME)
    assert names(found) == ["good"] * 3 + ["doubtful", "good"]
    assert frames(found)[3].layered > 0.4 and frames(found)[0].layered < 0.01
    assert any("second layer" in reason for reason in found.verdicts[3].reasons)


def test_a_limb_on_the_place_of_another_before_one_camera_is_told(clouds) -> None:
    """From above, two tubes side by side; in one frame the end of the second lies on the points of the first."""
    up, side = np.array([0.0, 0.0, 1.0]), np.array([0.0, 3.0, 0.0])
    both, end = np.concatenate([FACES, FACES + len(VERTICES)]), VERTICES[:, :1] > 1.2
    above = [np.concatenate([cloud, cloud + side])[np.tile(cloud[:, 2] > 0.0, 2)] for cloud in clouds]
    pairs = np.stack([np.concatenate([moved(t), moved(t) + side]) for t in range(FRAMES)])
    pairs[3, len(VERTICES) :] -= end * side
    above[3] = above[3][~((above[3][:, 1] > 1.5) & (above[3][:, 0] > moved(3)[end[:, 0], 0].min()))]
    eyes = {eye is not None: assess(above, pairs, both, KEYFRAME, eye=eye) for eye in (50.0 * up, None)}
    shares = [frame.shared for frame in frames(eyes[True])]
    assert 0.045 < shares[3] < 0.15 and max(shares[:3] + shares[4:]) == 0.0
    assert any("another part of it explains" in reason for reason in eyes[True].verdicts[3].reasons)
    assert frames(eyes[False])[3].layered == shares[3] and frames(eyes[False])[3].shared is None


def test_the_unseen_back_of_a_thin_limb_is_no_fault(meshes, clouds) -> None:
    """Thinner than four spacings, so that it is near to the points on its front, but not on theirs."""
    thin = meshes * [1.0, 1.0, 0.15]
    front = [cloud[cloud[:, 2] > 0.0] * [1.0, 1.0, 0.15] for cloud in clouds]
    found = assess(front, thin, FACES, KEYFRAME)
    assert names(found) == ["good"] * FRAMES
    assert frames(found)[0].far < 0.05 and frames(found)[0].unseen > 0.35 and frames(found)[0].doubled < 0.01


def test_a_wall_inside_the_points_is_named(meshes, clouds) -> None:
    """A disc across the middle of the tube, as between two cells that were one; a scan of one half does not tell."""
    ring = np.column_stack([np.zeros(32), VERTICES[:32, 1:]])
    disc = np.concatenate([radius * ring for radius in np.linspace(0.1, 1.0, 10)])
    a = np.arange(32)
    b = (a + 1) % 32
    rings = [32 * r for r in range(9)]
    faces = [np.stack([i + x, i + y, i + 32 + y], axis=1) for i in rings for x, y in ((a, b),)]
    faces += [np.stack([i + x, i + 32 + y, i + 32 + x], axis=1) for i in rings for x, y in ((a, b),)]
    walled = np.stack([np.concatenate([v, disc + 0.1 * t * np.eye(3)[0]]) for t, v in enumerate(meshes)])
    walled[3:, len(VERTICES) :] = walled[3:, :1]  # gone in the last two frames
    both = np.concatenate([FACES, np.concatenate(faces) + len(VERTICES)])
    found = assess(clouds, walled, both, KEYFRAME, shape=walled[0])
    area = np.pi * (0.5 - 4.0 * frames(found)[0].spacing) ** 2
    assert frames(found)[0].inner == pytest.approx(area / (np.pi * (4.0 + 0.5 + 0.25)), rel=0.3)
    assert names(found)[:3] == ["doubtful"] * 3 and frames(found)[3].inner == 0.0
    assert any("meet or part, in frames 0-2: " in line for line in found.warnings())
    half = assess([c[c[:, 2] > 0.0] for c in clouds], walled, both, KEYFRAME, shape=walled[0])
    assert max(frame.inner for frame in frames(half)) == 0.0 and frames(half)[0].far > 0.3


def test_growth_is_no_stretch(meshes, clouds) -> None:
    meshes[4], clouds[4] = 1.7 * meshes[4], 1.7 * clouds[4]
    found = assess(clouds, meshes, FACES, KEYFRAME)
    assert names(found) == ["good"] * FRAMES
    assert frames(found)[4].stretch_p95 == pytest.approx(np.log(1.7)) and frames(found)[4].stretched == 0.0


def test_noise_is_no_fault(meshes, clouds) -> None:
    rng = np.random.default_rng(5)
    noisy = [cloud + rng.normal(scale=0.05, size=cloud.shape) for cloud in clouds]
    found = assess(noisy, meshes, FACES, KEYFRAME)
    assert names(found) == ["good"] * FRAMES
    assert frames(found)[0].noise == pytest.approx(0.05, rel=0.35)


def test_noise_as_wide_as_the_body_hides_what_is_wrong(meshes, clouds) -> None:
    rng = np.random.default_rng(5)
    thin, noise = meshes * [1.0, 0.3, 0.3], 0.15
    noisy = [cloud * [1.0, 0.3, 0.3] + rng.normal(scale=noise, size=cloud.shape) for cloud in clouds]
    found = assess(noisy, thin, FACES, KEYFRAME)
    assert names(found) == ["doubtful"] * FRAMES and any("noise" in reason for reason in found.verdicts[0].reasons)
    assert frames(found)[0].blur == pytest.approx(noise / 0.3, rel=0.35)


def test_few_points_are_no_noise(meshes, clouds) -> None:
    """A body bends so much between 60 points that they look like a ball; the surface goes through them all the same."""
    thin = meshes * [1.0, 0.3, 0.3]
    sparse = [cloud[: 60 if t == 3 else None] * [1.0, 0.3, 0.3] for t, cloud in enumerate(clouds)]
    found = assess(sparse, thin, FACES, KEYFRAME)
    assert names(found) == ["good"] * FRAMES
    assert frames(found)[3].noise > 0.3 * 0.3 and frames(found)[3].blur < 0.01


def test_too_few_points_to_tell(meshes, clouds) -> None:
    clouds[1], clouds[3] = clouds[1][: FEWEST_POINTS - 1], clouds[3][:FEWEST_POINTS]
    found = assess(clouds, meshes, FACES, KEYFRAME)
    assert names(found) == ["good", "doubtful", "good", "good", "good"]
    assert found.warnings() == ["the mesh is doubtful in frame 1: 49 points are too few to tell"]
    meshes[1] += [0.0, 0.0, 3.0]
    assert names(assess(clouds, meshes, FACES, KEYFRAME))[1] == "lost"  # what they do tell stands


def test_a_frame_without_points_is_doubtful(meshes, clouds) -> None:
    clouds[1] = np.zeros((0, 3))
    found = assess(clouds, meshes, FACES, KEYFRAME)
    assert names(found) == ["good", "doubtful", "good", "good", "good"]
    assert found.verdicts[1].reasons == ("no usable points: interpolated",)
    assert frames(found)[1].uncovered is None and frames(found)[1].stretch_max < 1e-9
    assert not found.warnings()  # the input has told it already
    report = found.as_dict()
    assert report["verdicts"] == names(found) and report["quality"][1]["reasons"] == ["no usable points: interpolated"]


def test_the_keyframe_is_held_against_the_others(meshes, clouds) -> None:
    """It is its own shape: built from another body it differs from all others, and they from it."""
    wide = meshes.copy()
    wide[KEYFRAME] = (VERTICES * [1.0, 2.2, 2.2]) + moved(KEYFRAME)[-1]
    clouds[KEYFRAME] = sample_surface(wide[KEYFRAME], FACES, POINTS, np.random.default_rng(0))[0]
    assert names(assess(clouds, wide, FACES, KEYFRAME)) == ["doubtful"] * FRAMES
    # With the shape known, the one alone.
    told = assess(clouds, wide, FACES, KEYFRAME, shape=VERTICES)
    assert names(told) == ["good", "good", "doubtful", "good", "good"]


def test_units_and_place_do_not_matter(meshes, clouds) -> None:
    meshes[3] += [0.0, 0.0, 0.1]
    near = assess(clouds, meshes, FACES, KEYFRAME)
    far = assess([1000.0 * c + 1e7 for c in clouds], 1000.0 * meshes + 1e7, FACES, KEYFRAME)
    assert names(near) == names(far)
    for a, b in zip(frames(near), frames(far), strict=True):
        assert b.residual_mean_percent == pytest.approx(a.residual_mean_percent, abs=1e-6)
        assert b.residual_mean == pytest.approx(1000.0 * a.residual_mean, abs=1e-4)
        assert b.unseen == pytest.approx(a.unseen, abs=1e-3)


# The single measures ------------------------------------------------------------------------------------------


def test_the_thickness_of_a_tube() -> None:
    one, other = opposite_vertices(VERTICES, FACES)
    side = np.abs(VERTICES[one, 0]) < 1.4  # of the others the ends are as near
    assert side.sum() > 500
    np.testing.assert_allclose(np.linalg.norm(VERTICES[one] - VERTICES[other], axis=1)[side], 1.0, atol=0.02)
    thin = ReferenceShape(VERTICES, FACES).compare(VERTICES * [1.0, 0.5, 0.5])
    assert thin.thickness == pytest.approx(0.5, abs=0.02) and thin.volume == pytest.approx(0.25)
    assert thin.thinned is not None and thin.thinned > 0.8


def test_folds_against_the_shapes_own() -> None:
    one, other = neighbouring_faces(FACES)
    assert len(one) == 3 * len(FACES) // 2
    shape = ReferenceShape(VERTICES, FACES)
    assert shape.compare(VERTICES).folded == 0.0
    turned = VERTICES.copy()
    turned[:, 0] = -np.abs(turned[:, 0])  # folded in the middle, once around
    assert shape.compare(turned).folded == pytest.approx(32 / len(one), rel=0.1)
    assert ReferenceShape(turned, FACES).compare(turned).folded == 0.0


def test_the_noise_of_a_plane() -> None:
    rng = np.random.default_rng(0)
    plane = np.column_stack([rng.random((3000, 2)), np.zeros(3000)])
    assert noise_level(plane, cKDTree(plane), rng) < 1e-6
    for level in (0.002, 0.01, 0.03):  # the last is three times the spacing
        points = plane + np.column_stack([np.zeros((3000, 2)), rng.normal(scale=level, size=3000)])
        assert noise_level(points, cKDTree(points), rng) == pytest.approx(level, rel=0.25)


def test_a_face_is_far_where_its_corners_are_not() -> None:
    """Two dense patches of points, and a triangle from one to the other."""
    rng = np.random.default_rng(0)
    patch = np.column_stack([rng.normal(scale=0.02, size=(400, 2)), np.zeros(400)])
    points = np.concatenate([patch, patch + [1.0, 0.0, 0.0]])
    vertices, faces = np.array([[0.0, 0, 0], [1.0, 0, 0], [1.0, 0.01, 0]]), np.array([[0, 1, 2]])
    assert measure_coverage(points, vertices, faces).far == 1.0


def test_a_steady_turn_has_the_second_difference_of_a_circle() -> None:
    meshes = np.stack([moved(t) - [0.1 * t, 0.0, 0.0] for t in range(4)])
    # |n(t-1) - 2 n + n(t+1)| = 2 (1 - cos 5 degrees) times the part of n that turns; likewise for places.
    bend = 2.0 * (1.0 - np.cos(np.radians(5.0)))
    radius = np.linalg.norm(VERTICES[:, :2], axis=1).mean()
    np.testing.assert_allclose(acceleration(meshes)[1:3], bend * radius, rtol=1e-9)
    found = flicker(meshes, FACES)
    assert np.isnan(found[[0, 3]]).all() and 0.5 * bend < np.radians(found[1]) < bend
    assert np.isnan(acceleration(meshes[:2])).all()
    sliding = np.stack([VERTICES + [t * t, 0.0, 0.0] for t in range(3)])
    assert flicker(sliding, FACES)[1] == pytest.approx(0.0, abs=1e-9) and acceleration(sliding)[1] == pytest.approx(2.0)


# Verdicts -----------------------------------------------------------------------------------------------------


def test_the_table_of_thresholds() -> None:
    known = {field.name for field in fields(FrameQuality)}
    for bound in BOUNDS:
        assert bound.measure in known and 0.0 < bound.doubtful < bound.lost
        assert bound.why and bound.reason.format(0.5) != bound.reason


@pytest.mark.parametrize(
    ("verdicts", "text"),
    [
        (["good"] * 3, "3 good"),
        (["good"] * 6 + ["doubtful"] + ["good"] * 2 + ["lost"], "8 good, 1 doubtful (6), 1 lost (9)"),
        (["lost"] * 3 + ["good", "lost"], "1 good, 4 lost (0-2, 4)"),
    ],
)
def test_the_line_at_the_end(verdicts: list[str], text: str) -> None:
    assert summary(verdicts) == text
