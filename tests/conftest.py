"""Fixtures that every test may use."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
import warp as wp

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


def _devices() -> list[str]:
    # The test run prints its own report; Warp's start-up lines and module notes would bury it.
    wp.config.log_level = logging.WARNING
    wp.init()
    return ["cpu", "cuda:0"] if wp.is_cuda_available() else ["cpu"]


@pytest.fixture(params=_devices())
def device(request: pytest.FixtureRequest) -> str:
    """Every device at hand: the CPU, and the first CUDA device where there is one."""
    return request.param


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator with a fixed seed, fresh for each test."""
    return np.random.default_rng(0)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real sequences beside the checkout; the test is skipped where it is absent."""
    if not SHARED_DATA.is_dir():
        pytest.skip("no real sequences beside this checkout")
    return SHARED_DATA
