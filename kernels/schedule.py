"""What changes from one iteration to the next, kept on the device so that a captured graph needs no host.

The state is one array: see the names below. Nothing here has an adjoint.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.sizes import sizes

wp.set_module_options(MODULE_OPTIONS)

# Entries of the float32 schedule array.
RATE_SCALE = wp.constant(0)  # learning-rate decay, 1 at the start
BIAS_1 = wp.constant(1)  # 1 / (1 - beta1^step)
BIAS_2 = wp.constant(2)  # 1 / (1 - beta2^step)
DELTA = wp.constant(3)  # exponent of the confidence
SCHEDULE_SIZE = 4


@sizes(f"threads step: 1; schedule_out: {SCHEDULE_SIZE}")
@wp.kernel
def _advance(
    # In:
    iterations: int,
    cosine_decay: int,
    beta1: float,
    beta2: float,
    # In and out: [0] iterations done
    step: wp.array[wp.int32],
    # Out:
    schedule_out: wp.array[wp.float32],
):
    """One thread."""
    e = step[0]
    done = float(e) / float(iterations)
    scale = float(1.0)
    if cosine_decay != 0:
        scale = 0.5 * (1.0 + wp.cos(wp.PI * done))
    schedule_out[RATE_SCALE] = scale
    schedule_out[BIAS_1] = 1.0 / (1.0 - wp.pow(beta1, float(e + 1)))
    schedule_out[BIAS_2] = 1.0 / (1.0 - wp.pow(beta2, float(e + 1)))
    schedule_out[DELTA] = wp.max(1.0 - wp.sqrt(done), 0.0)
    step[0] = e + 1


def advance(
    iterations: int, cosine_decay: bool, beta1: float, beta2: float, step: wp.array, schedule_out: wp.array,
) -> None:  # fmt: skip
    """Fill the schedule for iteration ``step[0]`` (counted from 0) of ``iterations``, then count it."""
    inputs = [iterations, int(cosine_decay), beta1, beta2, step, schedule_out]
    launch(_advance, 1, inputs, step.device)
