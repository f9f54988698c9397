"""Depth images and masks of an .npz: points where a pixel saw something, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest
from present import present

import warpdef
from warpdef.errors import InputError
from warpdef.files import read_clouds

K = np.array([[50.0, 0, 15.5], [0, 60.0, 11.5], [0, 0, 1]])
FRAMES, HEIGHT, WIDTH = 4, 24, 32
rng = np.random.default_rng(3)
DEPTH = rng.uniform(0.5, 2.0, size=(FRAMES, HEIGHT, WIDTH))
DEPTH[:, :3], DEPTH[:, :, :2] = 0.0, np.nan
SEEN = np.nan_to_num(DEPTH) > 0
TURN = np.array([[0, 0, 1.0, 3], [1, 0, 0, 4], [0, 1, 0, 5], [0, 0, 0, 1]])
COLORS = rng.integers(0, 256, size=(FRAMES, HEIGHT, WIDTH, 3), dtype=np.uint8)


def saved(folder, **arrays):
    np.savez(folder / "a.npz", **arrays)
    return folder / "a.npz"


def test_points_project_back_onto_their_pixels():
    points = warpdef.points_of_depth(DEPTH[0], K)
    pixels = points @ K.T
    v, u = np.nonzero(SEEN[0])
    np.testing.assert_allclose(pixels[:, :2] / pixels[:, 2:], np.stack([u, v], axis=1), atol=1e-12)
    np.testing.assert_array_equal(points[:, 2], DEPTH[0][SEEN[0]])
    np.testing.assert_array_equal(warpdef.points_of_depth(DEPTH[0], K[[0, 1, 0, 1], [0, 1, 2, 2]]), points)
    homogeneous = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    np.testing.assert_allclose(warpdef.points_of_depth(DEPTH[0], K, TURN), (homogeneous @ TURN.T)[:, :3])


@pytest.mark.parametrize("names", [("depth", "intrinsics"), ("depths", "K")])
def test_an_npz_of_depth_images(tmp_path, names):
    sequence = read_clouds(saved(tmp_path, **dict(zip(names, (DEPTH, K), strict=True)), colors=COLORS))
    for t in range(FRAMES):
        np.testing.assert_array_equal(sequence.points[t], warpdef.points_of_depth(DEPTH[t], K))
        np.testing.assert_array_equal(sequence.colors[t], COLORS[t][SEEN[t]])
    assert sequence.warnings == ()


def test_millimetres_as_whole_numbers(tmp_path):
    whole = np.rint(np.nan_to_num(DEPTH) * 1000).astype(np.uint16)
    sequence = read_clouds(saved(tmp_path, depth=whole, intrinsics=K, depth_scale=0.001, poses=TURN))
    np.testing.assert_allclose(sequence.points[1], warpdef.points_of_depth(whole[1] / 1000, K, TURN), atol=1e-12)


def test_two_cameras_of_their_own_that_move_or_stand(tmp_path):
    both = np.stack([DEPTH, DEPTH[::-1]], axis=1)
    ks, poses = np.stack([K, K * [[2], [2], [1]]]), np.stack([np.eye(4), TURN])
    path = saved(tmp_path, depth=both, intrinsics=ks, poses=poses)
    expected = [warpdef.points_of_depth(both[2, c], ks[c], poses[c]) for c in range(2)]
    np.testing.assert_array_equal(read_clouds(path).points[2], np.concatenate(expected))
    moving = np.stack([poses, poses, poses, poses[::-1]])
    path = saved(tmp_path, depth=both, intrinsics=K, poses=moving)
    expected = [warpdef.points_of_depth(both[3, c], K, poses[1 - c]) for c in range(2)]
    np.testing.assert_array_equal(read_clouds(path).points[3], np.concatenate(expected))


@pytest.mark.parametrize("cameras", [1, 2])
def test_an_npz_a_frame(tmp_path, cameras):
    poses = np.stack([np.eye(4), TURN])
    half = np.broadcast_to(np.arange(WIDTH) < WIDTH // 2, (HEIGHT, WIDTH))
    for t in range(FRAMES):
        one = {"depth": DEPTH[t], "K": K, "colors": COLORS[t], "valid": half}
        two = {"depth": np.stack([DEPTH[t], DEPTH[t]]), "K": K, "poses": poses, "colors": np.stack([COLORS[t]] * 2)}
        np.savez(tmp_path / f"{t}.npz", **(one if cameras == 1 else two))
    sequence = read_clouds(tmp_path)
    used = np.where(half, DEPTH[2], 0) if cameras == 1 else DEPTH[2]
    expected = [warpdef.points_of_depth(used, K, pose) for pose in poses[:cameras]]
    np.testing.assert_array_equal(sequence.points[2], np.concatenate(expected))
    shades = COLORS[2][np.nan_to_num(used) > 0]
    np.testing.assert_array_equal(sequence.colors[2], np.concatenate([shades] * cameras))


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({}, r"a.npz: depth: expected beside it intrinsics \(3, 3\)"),
        ({"K": np.eye(5)}, r"K: expected shape \(4,\), or one for each"),
        ({"K": -K}, "focal lengths in pixels above 0"),
        ({"K": K, "poses": np.eye(3)}, r"poses: expected shape \(4, 4\), or one for each"),
        ({"K": K, "poses": TURN.T}, "last row 0 0 0 1"),
        ({"K": K, "extrinsics": TURN}, r"np.linalg.inv\(extrinsics\)"),
        ({"K": K, "depth": np.stack([DEPTH, DEPTH], axis=1)}, r"the poses of 2 cameras"),
        ({"K": K, "depth": DEPTH[0]}, r"expected shape \(T, H, W\)"),
        ({"K": K, "depth_scale": 0.0}, "one number above 0"),
        ({"K": K, "colors": COLORS[:, :5]}, r"colours: expected shape \(4, 24, 32, 3\)"),
    ],
)
def test_what_does_not_fit_together_says_what_to_do(tmp_path, arrays, message):
    with pytest.raises(InputError, match=message):
        read_clouds(saved(tmp_path, **{"depth": DEPTH, **arrays}), strict=True)


POINTS = rng.normal(size=(FRAMES, 40, 3))
VALID = rng.random((FRAMES, 40)) < 0.7


@pytest.mark.parametrize("name", ["valid", "is_valid"])
@pytest.mark.parametrize("kind", [bool, np.uint8, np.float32])
def test_rows_that_are_no_points_are_left_out(tmp_path, name, kind):
    shades = COLORS[:, 0, :1].repeat(40, axis=1)
    path = saved(tmp_path, points=POINTS, normals=POINTS, colors=shades, **{name: VALID.astype(kind)})
    sequence = read_clouds(path)
    for t in range(FRAMES):
        np.testing.assert_array_equal(sequence.points[t], POINTS[t][VALID[t]])
        assert len(present(sequence.normals[t])) == len(present(sequence.colors[t])) == VALID[t].sum()
    assert sequence.warnings == (f"{1 - VALID.mean():.1%} of the rows of points left out, as 'valid' says",)


def test_of_clouds_of_their_own_and_of_depth_images(tmp_path):
    arrays = {f"points_{t}": p for t, p in enumerate(POINTS)} | {f"valid_{t}": v for t, v in enumerate(VALID)}
    np.testing.assert_array_equal(read_clouds(saved(tmp_path, **arrays)).points[3], POINTS[3][VALID[3]])
    half = np.arange(WIDTH) < WIDTH // 2
    valid = np.broadcast_to(half, (HEIGHT, WIDTH))
    sequence = read_clouds(saved(tmp_path, depth=DEPTH, K=K, valid=valid))
    np.testing.assert_array_equal(sequence.points[0], warpdef.points_of_depth(np.where(valid, DEPTH[0], 0), K))


def test_a_mask_that_could_mean_either_is_told(tmp_path):
    sequence = read_clouds(saved(tmp_path, points=POINTS, mask=VALID))
    np.testing.assert_array_equal(sequence.points, POINTS)
    assert [w for w in sequence.warnings if "'mask' is not applied" in w and "save it as 'valid'" in w]


@pytest.mark.parametrize("valid", [VALID[:, :5], VALID * 0.5])
def test_a_mask_of_another_shape_or_of_shares_is_refused(tmp_path, valid):
    with pytest.raises(InputError, match=r"a.npz: valid: expected (shape|true or false)"):
        read_clouds(saved(tmp_path, points=POINTS, valid=valid))
