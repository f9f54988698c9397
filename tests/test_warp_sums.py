"""Sums within a warp: the very text that CUDA compiles, over 32 lanes of a vector in place of 32 threads."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from warpdef.kernels.warp_sums import CORNER_SUM, add_loss

LANES = """
    typedef float lanes __attribute__((vector_size(128)));
    typedef int whole __attribute__((vector_size(128)));
    #define F lanes
    #define PLACE place
    #define PICK(c, a, b) ((c) ? (a) : (b))
    #define NOTHING (lanes{})
    const auto shuffle = [](lanes v, int m) { lanes r; for (int l = 0; l < 32; ++l) r[l] = v[l ^ m]; return r; };
    #define SHUFFLE(v, m) shuffle(v, m)
    whole place, mine;
    lanes fx, fy, fz, given[6];
    for (int l = 0; l < 32; ++l) {
        place[l] = l; mine[l] = mine_of.data[l] ? -1 : 0;
        fx[l] = fraction.data[3 * l]; fy[l] = fraction.data[3 * l + 1]; fz[l] = fraction.data[3 * l + 2];
        for (int c = 0; c < 6; ++c) given[c][l] = value.data[6 * l + c];
    }
"""
STORE = """
    for (int l = 0; l < 32; ++l) for (int c = 0; c < 6; ++c) sum_out.data[6 * l + c] = corner_sum[c][l];
"""


@wp.func_native(LANES + CORNER_SUM + STORE)
def corner_sums(
    mine_of: wp.array[wp.int32],
    fraction: wp.array[wp.float32],
    value: wp.array[wp.float32],
    sum_out: wp.array[wp.float32],
): ...


@wp.kernel(module="unique", enable_backward=False)
def sum_corners(
    mine_of: wp.array[wp.int32],
    fraction: wp.array[wp.float32],
    value: wp.array[wp.float32],
    sum_out: wp.array[wp.float32],
):
    corner_sums(mine_of, fraction, value, sum_out)


@wp.kernel(module="unique", enable_backward=False)
def add_all(slot: wp.array[wp.int32], value: wp.array[wp.float64], loss: wp.array[wp.float64]):
    i = wp.tid()
    add_loss(slot[i], value[i], loss)


def sums_of(mine: np.ndarray, fraction: np.ndarray, value: np.ndarray) -> np.ndarray:
    """What each lane holds in the end, (32, 6)."""
    out = wp.zeros(192, dtype=wp.float32, device="cpu")
    arrays = [mine.astype(np.int32), fraction.astype(np.float32).ravel(), value.astype(np.float32).ravel()]
    inputs = [wp.array(a, device="cpu") for a in arrays]
    wp.launch(sum_corners, dim=1, inputs=[*inputs, out], device="cpu")
    return out.numpy().reshape(32, 6)


@pytest.mark.parametrize("share", [1.0, 0.4, 0.0])
def test_every_corner_has_the_sum_over_the_warp(share: float, rng: np.random.Generator) -> None:
    mine, fraction, value = rng.random(32) < share, rng.random((32, 3)), rng.normal(size=(32, 6))
    value[~mine] = np.nan  # of another cell, which must not reach this one
    found = sums_of(mine, fraction, value)
    for place in range(32):
        upper = np.array([place & 16, place & 8, place & 4]) > 0
        weight = np.where(upper, fraction, 1 - fraction).prod(axis=1)
        expected = (weight[mine, None] * value[mine]).sum(axis=0)
        np.testing.assert_allclose(found[place], expected, rtol=0, atol=1e-5)


def test_losses_are_added_by_slot(device: str, rng: np.random.Generator) -> None:
    """Runs of one slot, as warps see them, strewn ones, and a number of threads that fills no warp."""
    slot = np.concatenate([np.repeat([2, 0], [64, 40]), rng.integers(0, 3, 33)]).astype(np.int32)
    value = rng.normal(size=len(slot))
    loss = wp.array([1.0, 2.0, 3.0], dtype=wp.float64, device=device)
    inputs = [wp.array(slot, device=device), wp.array(value, dtype=wp.float64, device=device), loss]
    wp.launch(add_all, dim=len(slot), inputs=inputs, device=device)
    np.testing.assert_allclose(loss.numpy(), [1, 2, 3] + np.bincount(slot, value), rtol=1e-12)
