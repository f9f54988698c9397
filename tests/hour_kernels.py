"""Kernels of the first questions to a device: what adds to one address cost, and a node that does nothing."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def add_doubles(out: wp.array[wp.float64]):
    i = wp.tid()
    wp.atomic_add(out, i % out.shape[0], wp.float64(1.0))


@wp.kernel
def add_vectors(out: wp.array[wp.vec3]):
    i = wp.tid()
    wp.atomic_add(out, i % out.shape[0], wp.vec3(1.0, 1.0, 1.0))


@wp.kernel
def add_runs(run: int, out: wp.array[wp.float64]):
    """Neighbouring threads add to the same address, as those of one frame do."""
    i = wp.tid()
    wp.atomic_add(out, (i / run) % out.shape[0], wp.float64(1.0))


@wp.kernel
def do_nothing(out: wp.array[wp.float32]):
    if out.shape[0] < 0:
        out[0] = 1.0
