"""The mesh that a running reconstruction hands out when asked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from synthetic import turning_ellipsoid

from warpdef.config import Config
from warpdef.mesh import TriMesh
from warpdef.pipeline import reconstruct


def test_the_mesh_is_handed_out_in_input_units():
    made = turning_ellipsoid(3, 200, np.random.default_rng(0), subdivisions=1)
    config = Config()
    config = replace(
        config,
        grid=replace(config.grid, levels=2),
        keyframe=replace(config.keyframe, choice="1"),
        optimiser=replace(config.optimiser, iterations=20, iterations_per_frame=0.0, warmup=5),
        refine=replace(config.refine, iterations=2),
    )
    seen = {"optimise": [], "refine": []}

    def look(progress) -> None:
        if progress.meshes is not None and not progress.message:
            seen[progress.phase].append(progress.meshes())

    scale, shift = 50.0, np.array([3.0, -2.0, 1.0])
    template = TriMesh(made.vertices[1] * scale + shift, made.faces)
    result = reconstruct([c * scale + shift for c in made.clouds], config, threads=1, template=template, callback=look)
    assert len(seen["optimise"]) == 2 and len(seen["refine"]) == 2
    for meshes in (*seen["optimise"], *seen["refine"]):
        assert meshes.vertices.dtype == np.float32
        np.testing.assert_array_equal(meshes.faces, made.faces)
        assert np.abs(meshes.vertices - result.vertices).max() < 0.5 * scale
    # The last one is the result.
    np.testing.assert_allclose(seen["refine"][-1].vertices, result.vertices, atol=1e-5 * scale)
    assert np.abs(seen["optimise"][0].vertices - result.vertices).max() > 1e-5 * scale
