"""Small run folders for the tests of ``warpdef view``, and whether this machine can draw at all."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from synthetic import bending_bar

from warpdef.apps.viewer.probe import RenderingProbe
from warpdef.config import Config
from warpdef.errors import MissingPackageError
from warpdef.files import write_clouds_npz
from warpdef.files.run_folder import RunFolder
from warpdef.sequence import PointSequence

FRAMES = 5
BAR = bending_bar(FRAMES, 60, np.random.default_rng(0), subdivisions=2)
VERTICES = BAR.vertices.astype(np.float32)


def save_run(path: Path, vertices: np.ndarray = VERTICES, **config) -> Path:
    """A run of the bending bar."""
    pytest.importorskip("tomli_w")
    names = [f"scan{t}.ply" for t in range(len(vertices))]
    return RunFolder.prepare(path).save(
        vertices=vertices, faces=BAR.faces, keyframe=2, config=Config(**config), report={}, steps=[], names=names
    )


def save_clouds(path: Path) -> Path:
    """The clouds that the bar was sampled to."""
    write_clouds_npz(path, PointSequence.from_arrays(BAR.clouds))
    return path


def save_truth(path: Path, shift: float = 0.0) -> Path:
    """The bar itself, moved along z."""
    np.savez(path, vertices=BAR.vertices + [0.0, 0.0, shift], faces=BAR.faces)
    return path


@cache
def why_no_drawing() -> str:
    """Empty where this machine draws."""
    try:
        RenderingProbe(window=False).require()
    except MissingPackageError as error:
        return str(error)
    return ""


@pytest.fixture
def drawing() -> None:
    """Skips the test where this machine cannot draw."""
    if why_no_drawing():
        pytest.skip(why_no_drawing())
