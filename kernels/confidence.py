"""How far a frame is trusted, by the errors between it and the keyframe (par. Confidence-Based Error Control).

    w(t) = prod_tau (1 + max(0, CD_tau - cd_max))^-delta over the steps from the keyframe to t

with delta = 1 - sqrt(e / e_max). Weights are constants to the gradient, so nothing here has an adjoint.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.schedule import DELTA, SCHEDULE_SIZE
from warpdef.kernels.sizes import sizes

wp.set_module_options(MODULE_OPTIONS)


@sizes(f"threads: 2; keyframe: <T; schedule: {SCHEDULE_SIZE}; loss_input: S; loss_transform confidence_out: T")
@wp.kernel
def _confidence(
    # In:
    enabled: int,
    bound_is_mean: int,
    keyframe: int,
    schedule: wp.array[wp.float32],
    loss_input: wp.array[wp.float64],
    loss_transform: wp.array[wp.float64],
    # Out:
    confidence_out: wp.array[wp.float32],
):
    """One thread a direction: 0 runs from the keyframe to the last frame, 1 to the first."""
    direction = wp.tid()
    bound = wp.float64(0.0)
    for s in range(loss_input.shape[0]):
        if bound_is_mean != 0:
            bound = bound + loss_input[s] / wp.float64(loss_input.shape[0])
        else:
            bound = wp.max(bound, loss_input[s])
    delta = wp.float64(schedule[DELTA])
    w = wp.float64(1.0)
    count = keyframe
    if direction == 0:
        confidence_out[keyframe] = 1.0
        count = loss_transform.shape[0] - 1 - keyframe
    for k in range(count):
        t = keyframe - 1 - k
        if direction == 0:
            t = keyframe + 1 + k
        excess = wp.max(loss_transform[t] - bound, wp.float64(0.0))
        if enabled != 0:
            w = w * wp.pow(wp.float64(1.0) + excess, -delta)
        confidence_out[t] = wp.float32(w)


def confidence(
    enabled: bool, bound_is_mean: bool, keyframe: int, schedule: wp.array, loss_input: wp.array,
    loss_transform: wp.array, confidence_out: wp.array,
) -> None:  # fmt: skip
    """Weights of all frames from this iteration's losses, in the same units as these.

    Args:
        loss_input: shape (S,) float64, CD_R of a moved cloud and the next. loss_transform: shape (T,) float64.
        confidence_out: shape (T,) float32, 1 at the keyframe.
    """
    inputs = [int(enabled), int(bound_is_mean), keyframe, schedule, loss_input, loss_transform, confidence_out]
    launch(_confidence, 2, inputs, schedule.device)
