"""One way to launch: at once, or recorded so that a worker thread can replay it without Python's cost.

A CPU launch is one serial loop, so a caller splits work into spans ``begin .. begin + count`` and hands them to
threads. Inside ``recording()`` nothing runs: the commands are collected and replayed later, again and again.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import warp as wp

from warpdef.kernels.sizes import check

# max_unroll=0 keeps compile time low (a level loop unrolled ten times costs ten times); contraction makes FMAs.
MODULE_OPTIONS = {
    "enable_backward": False,
    "max_unroll": 0,
    "cpu_compiler_flags": "-march=native -ffp-contract=fast -mllvm=-inline-threshold=9000",
}

_state = threading.local()


@contextmanager
def recording() -> Iterator[list[wp.Launch]]:
    """Collect the launches of the block instead of running them; yields the list of commands."""
    outer = getattr(_state, "commands", None)
    _state.commands = []
    try:
        yield _state.commands
    finally:
        _state.commands = outer


@contextmanager
def listing() -> Iterator[list[wp.Kernel]]:
    """Collect the kernels that the block would launch; nothing runs, and nothing is compiled."""
    outer = getattr(_state, "kernels", None)
    _state.kernels = []
    try:
        yield _state.kernels
    finally:
        _state.kernels = outer


def launch(
    kernel: wp.Kernel,
    dim: int | tuple[int, ...],
    inputs: Sequence[Any],
    device: wp.Device,
    lanes: int = 0,
    cluster: int = 1,
) -> None:
    """Run ``kernel`` over ``dim`` threads, or record it inside ``recording()``. An empty span is no launch.

    Args:
        lanes: threads of the block that each of ``dim`` systems has to itself (``blocks``); 0: no kernel for blocks.
        cluster: as many blocks have it (``clusters``).

    Raises:
        TypeError, ValueError: an argument that the kernel's signature or table refuses, see ``sizes``.
    """
    check(kernel, dim, inputs, device)
    if dim == 0:
        return
    kernels = getattr(_state, "kernels", None)
    if kernels is not None:
        kernels.append(kernel)
        return
    over: dict[str, Any] = {"dim": dim}
    if lanes and isinstance(dim, int):
        over = {"dim": dim * cluster * lanes, "block_dim": lanes}
    commands = getattr(_state, "commands", None)
    if commands is None:
        wp.launch(kernel, inputs=list(inputs), device=device, **over)
    else:
        commands.append(wp.launch(kernel, inputs=list(inputs), device=device, record_cmd=True, **over))
