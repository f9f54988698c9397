"""Adam on preconditioned parameters (paper, sec. Implementation Details; Kingma and Ba).

    m = b1 m + (1 - b1) g,  v = b2 v + (1 - b2) g^2,  u -= rate scale (m c1) / (sqrt(v c2) + eps)

with c1, c2 the bias corrections and scale the decay, all three read from the schedule on the device. An optimiser
step is not differentiated.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.levels import node8
from warpdef.kernels.schedule import BIAS_1, BIAS_2, RATE_SCALE, SCHEDULE_SIZE
from warpdef.kernels.sizes import sizes

wp.set_module_options(MODULE_OPTIONS)


@wp.func
def adam_change(g: float, m: float, v: float, bias_1: float, bias_2: float, epsilon: float) -> float:
    return m * bias_1 / (wp.sqrt(v * bias_2) + epsilon)


@wp.func
def adam_step(
    i: int,
    rate: float,
    schedule: wp.array[wp.float32],
    beta1: float,
    beta2: float,
    epsilon: float,
    gradient: wp.array[Any],
    first: wp.array[Any],
    second: wp.array[Any],
    parameter: wp.array[Any],
):
    """Parameter i and its moments."""
    scale = rate * schedule[RATE_SCALE]
    g = gradient[i]
    m = beta1 * first[i] + (1.0 - beta1) * g
    v = beta2 * second[i] + (1.0 - beta2) * wp.cw_mul(g, g)
    p = parameter[i]
    for c in range(len(g)):
        p[c] = p[c] - scale * adam_change(g[c], m[c], v[c], schedule[BIAS_1], schedule[BIAS_2], epsilon)
    first[i] = m
    second[i] = v
    parameter[i] = p


@sizes(f"threads gradient first second parameter: N; period rate: R; schedule: {SCHEDULE_SIZE}")
@wp.kernel
def _adam(
    # In:
    begin: int,
    period: int,
    rate: wp.array[wp.float32],
    schedule: wp.array[wp.float32],
    beta1: float,
    beta2: float,
    epsilon: float,
    gradient: wp.array[Any],
    # In and out:
    first: wp.array[Any],
    second: wp.array[Any],
    parameter: wp.array[Any],
):
    """One thread a node or vertex; its rate is ``rate[i modulo period]``."""
    i = begin + wp.tid()
    adam_step(i, rate[i % period], schedule, beta1, beta2, epsilon, gradient, first, second, parameter)


for _dtype in (node8, wp.vec3):
    _arrays = [wp.array[_dtype]] * 4
    wp.overload(_adam, [int, int, wp.array[wp.float32], wp.array[wp.float32], float, float, float, *_arrays])


def adam(
    begin: int, count: int, rate: wp.array, schedule: wp.array, betas: tuple[float, float], epsilon: float,
    gradient: wp.array, first: wp.array, second: wp.array, parameter: wp.array,
) -> None:  # fmt: skip
    """One step for parameters ``begin .. begin + count``.

    Args:
        rate: shape (R,) float32, repeated over the parameters: (M,) for every transition's nodes, (1,) for all alike.
        schedule: see ``schedule.py``. betas: (beta1, beta2).
        gradient, first, second, parameter: shape (N,) node8 or vec3, flat.
    """
    inputs = [begin, len(rate), rate, schedule, *betas, epsilon, gradient, first, second, parameter]
    launch(_adam, count, inputs, parameter.device)
