"""What changes from one iteration to the next, kept on the device so that a captured graph needs no host.

The state is one array: see the names below. The confidence weights are the paper's (par. Confidence-Based Error
Control): w(t) = prod_tau (1 + max(0, CD_tau - cd_max))^-delta over the steps from the keyframe to t, with
delta = 1 - sqrt(e / e_max). They are constants to the gradient, so nothing here has an adjoint.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.levels import node8

wp.set_module_options(MODULE_OPTIONS)

# Entries of the float32 schedule array.
RATE_SCALE = wp.constant(0)  # learning-rate decay, 1 at the start
BIAS_1 = wp.constant(1)  # 1 / (1 - beta1^step)
BIAS_2 = wp.constant(2)  # 1 / (1 - beta2^step)
DELTA = wp.constant(3)  # exponent of the confidence
SCHEDULE_SIZE = 4


@wp.kernel
def _advance(
    # In:
    iterations: int,
    cosine_decay: int,
    beta1: float,
    beta2: float,
    # In and out: [0] iterations done
    step: wp.array(dtype=wp.int32),
    # Out:
    schedule_out: wp.array(dtype=wp.float32),
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


@wp.kernel
def _confidence(
    # In:
    enabled: int,
    bound_is_mean: int,
    keyframe: int,
    schedule: wp.array(dtype=wp.float32),
    loss_input: wp.array(dtype=wp.float64),
    loss_transform: wp.array(dtype=wp.float64),
    # Out:
    confidence_out: wp.array(dtype=wp.float32),
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


@wp.kernel
def _template_gradient(
    # In:
    keyframe: int,
    follow: int,
    adj_chamfer: wp.array2d(dtype=wp.vec3),
    adj_isometry: wp.array2d(dtype=wp.vec3),
    carry: wp.array2d(dtype=wp.vec3),
    # Out:
    adj_template_out: wp.array(dtype=wp.vec3),
):
    """One thread a vertex."""
    i = wp.tid()
    a = adj_chamfer[keyframe, i]
    if follow != 0:
        a = a + adj_isometry[keyframe, i] + carry[keyframe, i] + carry[carry.shape[0] - 1, i]
    adj_template_out[i] = a


@wp.kernel
def _clear(begin: int, array: wp.array(dtype=wp.float64)):
    array[begin + wp.tid()] = wp.float64(0.0)


@wp.kernel
def _clear_rows(begin: int, array: wp.array(dtype=wp.vec3)):
    array[begin + wp.tid()] = wp.vec3(0.0, 0.0, 0.0)


@wp.kernel
def _copy(source: wp.array(dtype=wp.vec3), target_out: wp.array(dtype=wp.vec3)):
    i = wp.tid()
    target_out[i] = source[i]


@wp.kernel
def _add_scaled(begin: int, scale: float, change: wp.array(dtype=wp.vec3), target_out: wp.array(dtype=wp.vec3)):
    i = begin + wp.tid()
    target_out[i] = target_out[i] + scale * change[i]


@wp.kernel
def _blend(share: float, source: wp.array(dtype=wp.vec3), target_out: wp.array(dtype=wp.vec3)):
    i = wp.tid()
    target_out[i] = target_out[i] + share * (source[i] - target_out[i])


@wp.kernel
def _clear_nodes(begin: int, array: wp.array(dtype=node8)):
    array[begin + wp.tid()] = node8()


def advance(iterations, cosine_decay, beta1, beta2, step, schedule_out):
    """Fill the schedule for iteration ``step[0]`` (counted from 0) of ``iterations``, then count it."""
    inputs = [iterations, int(cosine_decay), beta1, beta2, step, schedule_out]
    launch(_advance, 1, inputs, step.device)


def confidence(enabled, bound_is_mean, keyframe, schedule, loss_input, loss_transform, confidence_out):
    """Weights of all frames from this iteration's losses, in the same units as these.

    Args:
        loss_input: shape (S,) float64, CD_R of a moved cloud and the next. loss_transform: shape (T,) float64.
        confidence_out: shape (T,) float32, 1 at the keyframe.
    """
    inputs = [int(enabled), int(bound_is_mean), keyframe, schedule, loss_input, loss_transform, confidence_out]
    launch(_confidence, 2, inputs, schedule.device)


def clear_losses(begin, count, array):
    """Zero a span of a float64 array."""
    launch(_clear, count, [begin, array], array.device)


def clear_vectors(begin, count, array):
    """Zero a span of a vec3 array."""
    launch(_clear_rows, count, [begin, array], array.device)


def copy_vectors(source, target_out):
    """Copy a vec3 array, recordable like any launch."""
    launch(_copy, len(source), [source, target_out], source.device)


def add_scaled(begin, count, scale, change, target_out):
    """``target += scale change`` for a span of a vec3 array."""
    launch(_add_scaled, count, [begin, scale, change, target_out], target_out.device)


def blend(share, source, target_out):
    """``target += share (source - target)``; a share above 1 overshoots."""
    launch(_blend, len(source), [share, source, target_out], target_out.device)


def clear_nodes(begin, count, array):
    """Zero a span of a node8 array."""
    launch(_clear_nodes, count, [begin, array], array.device)


def template_gradient(keyframe, follow, adj_chamfer, adj_isometry, carry, adj_template_out):
    """Gradient of the template: the mesh term alone, or with ``follow`` everything that reaches the keyframe.

    Args:
        adj_chamfer, adj_isometry: shape (T, V) vec3. carry: shape (T + 1, V) vec3, see ``adj_move_vertices``.
        adj_template_out: shape (V,) vec3.
    """
    inputs = [keyframe, int(follow), adj_chamfer, adj_isometry, carry, adj_template_out]
    launch(_template_gradient, len(adj_template_out), inputs, adj_template_out.device)
