"""How libraries are imported: without looking for garbage, and on one thread each."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from contextlib import contextmanager

_THREADS_OF_LIBRARIES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


def one_thread_each() -> None:
    """Keep BLAS and OpenMP to one thread, but where the environment says how many; to be called before NumPy is there.

    ``--threads`` counts our own. Between products as small as ours those of a library wait in loops: of a hand before
    one camera they took a fifth of the processor time, and gained nothing.
    """
    for name in _THREADS_OF_LIBRARIES:
        os.environ.setdefault(name, "1")


@contextmanager
def uncollected() -> Iterator[None]:
    """For a block of heavy imports: what they make stays, and searching it is a sixth of their time.

    What there is at its end is not searched later on, either.
    """
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        if collecting:
            gc.enable()
