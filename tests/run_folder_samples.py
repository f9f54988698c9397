"""A small result, what a folder holds, and what goes wrong with either."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from warpdef.config import Config, OptimiserConfig
from warpdef.files.run_folder import RunFolder

FACES = np.array([[0, 1, 2], [0, 2, 3]])
VERTICES = np.random.default_rng(0).normal(size=(12, 4, 3)).astype(np.float32)


def save(place: RunFolder, **changes) -> Path:
    result = {
        "vertices": VERTICES,
        "faces": FACES,
        "keyframe": 5,
        "config": Config(seed=7, optimiser=OptimiserConfig(iterations=3)),
        "report": {"iterations": np.int64(3), "seconds": {"load": np.float32(0.5)}, "warnings": ["naïve"]},
        "steps": [{"iteration": i, "loss": 1.0 / (i + 1)} for i in range(3)],
        "names": [f"scan{i}.ply" for i in range(12)],
    }
    return place.save(**(result | changes))


def entries(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def drop_report(out: Path) -> None:
    (out / "report.json").unlink()


def full_disk(*_args, **_kwargs):
    raise OSError(28, "No space left on device")
