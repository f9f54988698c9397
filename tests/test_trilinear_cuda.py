"""What CUDA compiles of the samplers, compiled for the CPU: the same text with CUDA's own words explained to it.

Warps, which a CPU has not, are never complete here, so every thread adds on its own: what they do together is in
``test_warp_sums``.
"""

from __future__ import annotations

import numpy as np
import pytest
import reference
import warp as wp
import witness
from gradients import assert_gradients_close
from witness_cuda import sample_all

from warpdef.kernels.levels import LevelTable, node8
from warpdef.kernels.trilinear import part_jacobian, sample_jacobian

LEVELS = reference.resolutions(1, 4)
NODES = int(reference.offsets(LEVELS)[-1])


@pytest.mark.parametrize("reach", [0.95, 1.4])
def test_the_text_for_cuda_is_the_twin(reach: float, rng: np.random.Generator) -> None:
    """Points inside the cube, and some outside, where an axis is clamped."""
    nodes, points = rng.normal(size=(2, NODES, 6)), rng.uniform(-reach, reach, (200, 3)).astype(np.float32)
    adj = rng.normal(size=(200, 6))
    levels = LevelTable.build(1, 4).to_device(wp.get_device("cpu"))
    value, derivative, adj_nodes = (
        wp.zeros(shape, dtype=dtype, device="cpu")
        for shape, dtype in ((200, node8), (200, sample_jacobian), ((2, NODES), node8))
    )
    on_device = [wp.array(witness.pad(a), dtype=node8, ndim=a.ndim - 1, device="cpu") for a in (nodes, adj)]
    places = wp.array(points, dtype=wp.vec3, device="cpu")
    parts = wp.full((2, 200), part_jacobian(*[1.0] * 12), dtype=part_jacobian, device="cpu")
    inputs = [on_device[0], levels, places, on_device[1], value, derivative, adj_nodes, parts]
    wp.launch(sample_all, dim=200, inputs=inputs, device="cpu")
    places = points.astype(np.float64)
    np.testing.assert_allclose(value.numpy()[:, :6], reference.sample(nodes[1], LEVELS, places), rtol=0, atol=3e-6)
    found = derivative.numpy()[..., :6]
    np.testing.assert_allclose(found[:, 0], reference.sample(nodes[1], LEVELS, places), rtol=0, atol=3e-6)
    expected = reference.sample_derivative(nodes[1], LEVELS, places)
    np.testing.assert_allclose(found[:, 1:], expected, rtol=0, atol=2e-5)
    halves = parts.numpy()  # added onto ones
    np.testing.assert_allclose(np.concatenate([*halves], axis=2), found + 1.0, rtol=0, atol=2e-5)
    assert_gradients_close(adj_nodes.numpy()[1, :, :6], reference.adj_sample(LEVELS, places, adj))
    assert (adj_nodes.numpy()[0] == 0).all()
