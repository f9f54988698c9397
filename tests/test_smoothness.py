"""Smooth in time: the filter, the patches of a template, and what both do to a sequence of noisy clouds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import synthetic
from refine_samples import MovingEllipsoid, Rounds

from warpdef.fit.smoothness import patches_of, time_filter
from warpdef.geometry.triangles import unique_edges


@pytest.mark.parametrize("count", [1, 2, 3, 4, 7, 12])
def test_the_filter_leaves_parabolas_and_weakens_noise(count: int, rng: np.random.Generator) -> None:
    """Times need not be even: a gap of missing frames is one."""
    times = np.cumsum(rng.integers(1, 4, size=count)).astype(float)
    first, weights = time_filter(times)
    used = first[:, None] + np.arange(weights.shape[1])
    assert used.min() >= 0 and used.max() < count
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-9)
    way = 3.0 - 0.7 * times + 0.2 * times**2
    np.testing.assert_allclose((weights * way[used]).sum(axis=1), way, rtol=1e-9)
    assert (np.abs(used - np.arange(count)[:, None])[weights != 0] <= 3).all()
    if count == 12:
        assert (weights[3:-3] ** 2).sum(axis=1).max() < 0.6


def test_patches_overlap_and_stay_in_their_component() -> None:
    """Two spheres that touch, and a triangle of its own."""
    sphere, faces = synthetic.icosphere(3)
    vertices = np.concatenate([sphere, sphere + [2.0, 0, 0], [[9.0, 0, 0], [9, 1, 0], [9, 0, 1]]])
    faces = np.concatenate([faces, faces + len(sphere), [[2 * len(sphere) + k for k in range(3)]]])
    index, weight = patches_of(vertices, unique_edges(faces))
    np.testing.assert_allclose(weight.sum(axis=1), 1.0)
    assert (weight[:, :1] >= weight).all() and (weight >= 0).all()
    parts = np.split(np.arange(len(vertices)), [len(sphere), 2 * len(sphere)])
    of_part = [set(index[p][weight[p] > 0]) for p in parts]
    assert not (of_part[0] & of_part[1]) and not (of_part[2] & (of_part[0] | of_part[1]))
    size = np.bincount(index[weight > 0], minlength=index.max() + 1)
    assert 32 < np.median(size) < 200
    assert (weight[:, 1] > 0.05).mean() > 0.5  # most lie in more than one


def unsteadiness(vertices: np.ndarray, scene: MovingEllipsoid) -> float:
    """Root mean square second difference in time of the vertices' places in the body."""
    body = np.einsum("tba,tvb->tva", scene.turn, vertices - scene.shift[:, None])
    return float(np.sqrt(np.square(np.diff(body, 2, axis=0)).sum(axis=-1).mean()))


def test_a_body_that_turns_is_calmer_and_no_farther_from_the_truth(device: str, rng: np.random.Generator) -> None:
    """Clouds with a little noise; vertices start displaced in every frame in another way."""
    scene = MovingEllipsoid.make(7, 400, rng)
    scene.clouds[:] = [cloud + rng.normal(scale=0.004, size=cloud.shape) for cloud in scene.clouds]
    shaken = scene.posed(scene.waves(7, 0.02, rng))
    truth = scene.posed(scene.body[None])
    limits = {"clean_thickness": 8.0, "noisy_thickness": 9.0, "iterations": 10}
    free, smooth = (Rounds(scene, shaken, device, 10, keyframe=3, time=time, **limits) for time in (0.0, 4.0))
    assert not free.stage.smoothness and smooth.stage.smoothness
    calm = unsteadiness(smooth.vertices, scene) / unsteadiness(free.vertices, scene)
    off = [np.linalg.norm(run.vertices - truth, axis=-1).mean() for run in (free, smooth)]
    assert calm < 0.8 and off[1] < 1.02 * off[0]


def test_noisy_clouds_in_no_order_are_stiffened_by_patches(device: str, rng: np.random.Generator) -> None:
    """Without time, and a material of all frames, no frame hears of another: whatever the third's points, the second
    frame's result is the same."""
    scene = MovingEllipsoid.make(4, 300, rng)
    limits = {"clean_thickness": 0.01, "noisy_thickness": 0.02, "iterations": 3, "shape_step": 0.0, "material": False}
    shaken, found = scene.posed(scene.waves(4, 0.02, rng)), []
    for shift in (0.0, 0.05):
        scene.clouds[2] = scene.clouds[2] + [0.0, 0.0, shift]
        run = Rounds(scene, shaken, device, 3, keyframe=0, time=0.0, **limits)
        assert run.stage.noise == 1.25 and run.stage.smoothness.weight == pytest.approx(4.0 * 25.0**1.25)
        found.append(run.vertices[1])
    apart = 0.0
    if device != "cpu":
        # A device adds up in any order: what that comes to is seen by rounding the start anew (test_refine_partial).
        for seed in range(4):
            last_bits = np.random.default_rng(seed).uniform(-1, 1, shaken.shape) * 2.0**-23
            rounded = Rounds(scene, shaken * (1 + last_bits), device, 3, keyframe=0, time=0.0, **limits)
            apart = max(apart, 3 * float(np.abs(rounded.vertices[1] - found[1]).max()))
        assert apart < 1e-4
    np.testing.assert_allclose(*found, rtol=0, atol=apart)
    assert np.abs(found[0] - shaken[1]).max() > 1e-3


def test_the_shape_is_faired_where_clouds_are_noisy_alone(device: str, rng: np.random.Generator) -> None:
    """Its own solve left out: after two rounds a rough shape is the same, or by a third smoother."""
    scene = MovingEllipsoid.make(4, 300, rng)
    rough = scene.vertices + rng.normal(scale=0.01, size=scene.vertices.shape)
    edges = unique_edges(scene.faces)
    kept = {}
    for noisy, clean in ((False, 8.0), (True, 0.01)):
        thickness: dict[str, Any] = {"clean_thickness": clean, "noisy_thickness": 2 * clean}
        run = Rounds(scene, rough, device, 2, keyframe=0, shape_step=0.0, iterations=2, **thickness)
        ends = [
            np.linalg.norm(a[edges[:, 0]] - a[edges[:, 1]], axis=1) for a in (run.rest, rough[0], scene.vertices[0])
        ]
        kept[noisy] = np.std(ends[0] / ends[2]) / np.std(ends[1] / ends[2])
    assert kept[False] == pytest.approx(1.0, abs=1e-4) and kept[True] < 0.75


def test_missing_frames_are_time_that_passes(rng: np.random.Generator) -> None:
    """A parabola in true time is kept over a gap of one frame; nothing is smoothed over one of six."""
    times = [0, 1, 2, 4, 5, 6, 13, 14, 15, 16]
    scene = MovingEllipsoid.make(len(times), 60, rng)
    stage = Rounds(scene, scene.vertices, "cpu", 0, keyframe=3, times=times).stage
    first, weights = (array.numpy() for array in stage.smoothness._filter)
    used, at = first[:, None] + np.arange(len(weights[0])), np.array(times, dtype=float)
    np.testing.assert_allclose((weights * (at**2)[used]).sum(axis=1), at**2, atol=1e-4)
    apart = np.abs(at[used] - at[:, None])
    assert apart[np.abs(weights) > 1e-6].max() == 3 and (np.abs(weights[2]) > 1e-6).sum() == 5
