"""Imports during which no garbage is looked for, and libraries on one thread."""

from __future__ import annotations

import gc
import os
import subprocess
import sys

import pytest

from warpdef.apps.imports import one_thread_each, uncollected


def test_collection_goes_on_afterwards_as_it_was() -> None:
    assert gc.isenabled()
    try:
        with uncollected():
            assert not gc.isenabled()
            with uncollected():
                assert not gc.isenabled()
            assert not gc.isenabled()
        assert gc.isenabled() and gc.get_freeze_count() > 0
        with pytest.raises(ImportError), uncollected():
            raise ImportError
        assert gc.isenabled()
    finally:
        gc.unfreeze()


_THREADS = """
import os, sys
from warpdef.apps.main import main
try:
    main()
except SystemExit:
    import numpy, scipy.linalg
    square = numpy.ones((500, 500))
    scipy.linalg.lu_factor(square @ square + numpy.eye(500))
    print(len(os.listdir("/proc/self/task")))
"""


@pytest.mark.skipif(not os.path.isdir("/proc/self/task"), reason="no list of threads here")
def test_the_command_keeps_libraries_to_one_thread() -> None:
    apart = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    command = [sys.executable, "-c", _THREADS, "--version"]
    done = subprocess.run(command, capture_output=True, text=True, env=apart, check=True)
    assert done.stdout.split()[-1] == "1"


def test_threads_that_the_environment_asks_for_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "3")
    monkeypatch.setenv("MKL_NUM_THREADS", "2")
    monkeypatch.setenv("OMP_NUM_THREADS", "")  # so that it goes away with the test
    monkeypatch.delenv("OMP_NUM_THREADS")
    one_thread_each()
    assert [os.environ[f"{name}_NUM_THREADS"] for name in ("OPENBLAS", "MKL", "OMP")] == ["3", "2", "1"]
