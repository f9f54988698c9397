"""The whole way, on a tiny sequence: clouds in, vertices out in the input's own units."""

from __future__ import annotations

import json
import os
import signal
from dataclasses import replace

import numpy as np
import pytest
import synthetic

import warpdef
from warpdef.config import Config
from warpdef.errors import DeviceError, InputError
from warpdef.files import write_ply
from warpdef.files.json_text import json_text
from warpdef.mesh import TriMesh
from warpdef.presets import preset
from warpdef.sequence import PointSequence


@pytest.fixture(scope="module")
def truth() -> synthetic.Synthetic:
    return synthetic.turning_ellipsoid(4, 500, np.random.default_rng(3))


@pytest.fixture
def clouds(truth: synthetic.Synthetic) -> PointSequence:
    return PointSequence.from_arrays(truth.clouds, truth.normals)


@pytest.fixture
def template(truth: synthetic.Synthetic) -> TriMesh:
    return TriMesh(truth.vertices[1], truth.faces)


def quick(iterations: int = 30, rounds: int = 3, **fields) -> Config:
    base = Config(**fields)
    return replace(
        base,
        keyframe=replace(base.keyframe, choice="1"),
        grid=replace(base.grid, levels=3),
        optimiser=replace(base.optimiser, iterations=iterations, warmup=10),
        refine=replace(base.refine, iterations=rounds),
    )


def test_a_cloud_sequence_becomes_a_moving_mesh(truth, clouds, device: str) -> None:
    """With a template of our own making; the mesh ends near the true surface in every frame."""
    heard = []
    result = warpdef.reconstruct(clouds, quick(120, 8), device=device, callback=heard.append)
    frames, count, _ = result.vertices.shape
    assert frames == 4 and result.vertices.dtype == np.float32 and result.keyframe == 1
    assert result.faces.min() == 0 and result.faces.max() == count - 1
    before = max(off(truth, np.repeat(result.vertices[1:2], 4, axis=0)))
    after = max(off(truth, result.vertices))
    assert after < 0.1 * before
    assert {p.phase for p in heard} == {"template", "compile", "optimise", "refine"}
    # No more iterations than it takes to arrive.
    assert [s["iteration"] for s in result.steps] == [10, 20, 30, 40]
    assert [p.iteration for p in heard if p.phase == "optimise"] == [10, 20, 30, 40]


def off(truth: synthetic.Synthetic, vertices: np.ndarray) -> list[float]:
    """Mean distance of the vertices to the true surface, a frame."""
    from warpdef.geometry.closest import closest_on_surface

    return [closest_on_surface(x, v, truth.faces)[0].mean() for x, v in zip(vertices, truth.vertices, strict=True)]


def test_units_and_place_are_the_inputs(truth, clouds, template, device: str) -> None:
    plain = warpdef.reconstruct(clouds, quick(), device=device, template=template)
    scale, shift = 250.0, np.array([1e3, -2e3, 5e2])
    moved = PointSequence.from_arrays([p * scale + shift for p in clouds.points], truth.normals)
    mesh = TriMesh(template.vertices * scale + shift, template.faces)
    result = warpdef.reconstruct(moved, quick(), device=device, template=mesh)
    back = (result.vertices.astype(np.float64) - shift) / scale
    # float32 at 2,000 units is worth 1e-6 of the cube; the descent multiplies it.
    np.testing.assert_allclose(back, plain.vertices, rtol=0, atol=2e-3)


def test_a_template_keeps_its_vertex_order(clouds, template, device: str) -> None:
    result = warpdef.reconstruct(clouds, quick(1, 0), device=device, template=template)
    np.testing.assert_array_equal(result.faces, template.faces)
    np.testing.assert_allclose(result.vertices[1], template.vertices, rtol=0, atol=1e-3)


def test_the_configuration_names_a_template(clouds, template, device: str, tmp_path) -> None:
    write_ply(tmp_path / "mine.ply", template.vertices, template.faces)
    config = replace(quick(1, 0), template=replace(Config().template, mesh=str(tmp_path / "mine.ply")))
    result = warpdef.reconstruct(clouds, config, device=device)
    np.testing.assert_array_equal(result.faces, template.faces)


def test_the_same_bits_for_any_number_of_threads(clouds, template) -> None:
    runs = [warpdef.reconstruct(clouds, quick(), device="cpu", threads=n, template=template) for n in (1, 3)]
    np.testing.assert_array_equal(runs[0].vertices, runs[1].vertices)
    assert [r.report["threads"] for r in runs] == [1, 3]


def test_arrays_without_normals_will_do(truth, template, device: str) -> None:
    result = warpdef.reconstruct(np.stack(truth.clouds), quick(), device=device, template=template)
    assert np.isfinite(result.vertices).all()


def test_frames_and_points_are_those_of_the_configuration(clouds, template, device: str) -> None:
    config = quick(5, 1, frames="1:4:2", points=300)
    config = replace(config, keyframe=replace(config.keyframe, choice="0"))
    result = warpdef.reconstruct(clouds, config, device=device, template=template)
    assert len(result.vertices) == 2
    assert result.report["points"] == [300, 300]


def test_the_report_tells_what_was_done(clouds, template, device: str) -> None:
    report = warpdef.reconstruct(clouds, quick(), device=device, template=template).report
    assert json.loads(json_text(report)) is not None
    assert report["iterations"] == 30 and report["refine"]["rounds"] == 3 and not report["interrupted"]
    assert set(report["seconds"]) == {"clean", "template", "compile", "optimise", "refine", "assess"}
    assert set(report["cpu_seconds"]) == set(report["seconds"])
    assert all(seconds > 0 for seconds in report["cpu_seconds"].values())
    assert set(report["losses"]) == {"input", "total"}
    assert report["refine"]["frames_followed"] == [t for t in range(4) if t != report["keyframe"]]
    assert report["solver"]["sobolev"]["name"] == "cosine" and report["solver"]["refine"]["not_converged"] == 0
    assert report["peak_memory_mb"] > 10 and report["frames"] == 4


@pytest.mark.parametrize(("chain", "recover", "rounds"), [(False, False, 6), (False, True, 0), (True, False, 6)])
def test_which_fits_follow_their_grids(clouds, template, chain: bool, recover: bool, rounds: int) -> None:
    """All that have no chain, whether or not lost limbs are looked for; after the paper's descent lost frames alone."""
    config = quick(10, 1)
    optimiser = replace(config.optimiser, chain=chain)
    config = replace(config, optimiser=optimiser, refine=replace(config.refine, recover=recover, follow=rounds))
    report = warpdef.reconstruct(clouds, config, device="cpu", template=template).report
    assert report["refine"]["frames_followed"] == ([0, 2, 3] if rounds and not chain else [])


def test_ctrl_c_keeps_the_best_state_so_far(clouds, template, device: str) -> None:
    def interrupt(progress: warpdef.Progress) -> None:
        if progress.iteration == 20:
            os.kill(os.getpid(), signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    result = warpdef.reconstruct(clouds, quick(1000), device=device, template=template, callback=interrupt)
    assert result.report["interrupted"] and 20 <= result.report["iterations"] < 30
    assert np.isfinite(result.vertices).all()
    assert signal.getsignal(signal.SIGINT) is before


def test_the_paper_preset_runs(clouds, template, device: str) -> None:
    """Pruned grids, conjugate gradients, plain distances, no vertex stage; only shorter."""
    paper = preset("paper")
    config = replace(
        paper, grid=replace(paper.grid, levels=4), optimiser=replace(paper.optimiser, iterations=30, warmup=10)
    )
    report = warpdef.reconstruct(clouds, config, device=device, template=template).report
    assert report["solver"]["sobolev"]["name"] == "cg" and report["solver"]["sobolev"]["iterations_most"] > 0
    assert report["refine"] is None and report["warnings"][1:] == []


def test_what_cannot_be_used_is_refused(clouds, template) -> None:
    with pytest.raises(DeviceError, match="--device: expected .*cuda:99"):
        warpdef.reconstruct(clouds, quick(), device="cuda:99", template=template)
    with pytest.raises(InputError, match="at least 2"):
        warpdef.reconstruct(clouds, quick(frames="0:1"), device="cpu", template=template)
    config = replace(quick(), keyframe=replace(quick().keyframe, choice="9"))
    with pytest.raises(InputError, match="9"):
        warpdef.reconstruct(clouds, config, device="cpu", template=template)
