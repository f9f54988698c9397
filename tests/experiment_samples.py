"""Small sequences on disk, plans and made-up results for the tests of experiments."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from warpdef.apps.experiments.plan import FULL, Plan, PlanSize
from warpdef.apps.experiments.run import ExperimentRun, with_values
from warpdef.config import Config
from warpdef.mesh import MeshSequence
from warpdef.truth.metrics import METRICS

TINY = PlanSize(3, 200, 500, (2, 3), (2, 4), (1.0, 2.0), 4)
TINY_CONFIG = with_values(
    Config(),
    {
        **{"optimiser.iterations": 2, "optimiser.warmup": 1, "refine.iterations": 1, "refine.recover": False},
        **{"template.attempts": 1, "template.depth": 5},
    },
)


@dataclass(frozen=True)
class Named:
    """A true sequence that is only a name and a size; loading gives a tetrahedron that grows."""

    name: str
    frames: int = 100
    path: Path = Path("nowhere/gt.npz")
    kind: str = "npz"
    vertices: int = 4
    faces: int = 4
    clouds: Path | None = None

    def load(self, frames: slice | None = None) -> MeshSequence:
        corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
        growing = np.stack([corners * (1 + t) for t in range(self.frames)])
        return MeshSequence(growing[frames or slice(None)], np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))


def known_data(folder: Path) -> Plan:
    """A full-size plan on sequences with the names and sizes of the targets' data, clouds included."""
    sequences = []
    for name, frames in (("ama_crane", 100), ("cesiumman_walk", 61), ("face_mmface4d", 67), ("horse_gallop", 48)):
        (folder / name).mkdir()
        sequences.append(Named(name, frames, folder / name / "gt.npz"))
    note = {"first_frame": 10, "frames": 17, "scale": 0.5, "translation": [1.0, 2.0, 3.0]}
    (folder / "ama_crane" / "meta.json").write_text(json.dumps({"dynosurf": note}))
    (folder / "crane_clouds").mkdir()
    (folder / "crane_clouds" / "points.npz").touch()
    return Plan(tuple(sequences), size=FULL, folder=folder)


def write_ball(folder: Path, name: str = "ball", frames: int = 6) -> Path:
    """A ball of 642 vertices that stretches, as NAME/gt.npz below ``folder``."""
    import trimesh

    ball = trimesh.creation.icosphere(3)
    moved = [ball.vertices * [1.0 + 0.05 * t, 1.0, 1.0] for t in range(frames)]
    (folder / name).mkdir(parents=True)
    np.savez(folder / name / "gt.npz", vertices=np.array(moved, dtype=np.float32), faces=ball.faces.astype(np.int32))
    return folder


def made_up(run: ExperimentRun, cd: float = 1e-5, tracking: float = 0.004) -> dict[str, Any]:
    """A result as ``execute`` returns it, with the errors asked for."""
    mean = {**dict.fromkeys(METRICS, 0.5), "chamfer_l2": cd, "chamfer_floor": 2e-6, "tracking": tracking}
    return {
        "key": run.key,
        "run": run.describe(),
        "mean": mean,
        "worst": 2 * cd,
        "frames": [],
        "keyframe": 1,
        "template": {"vertices": 100},
        "iterations": run.config.optimiser.total(len(run.frames)),
        "reconstruct_s": 3.0,
        "evaluate_s": 1.0,
        "phases_s": {},
        "peak_memory_mb": 100.0 + len(run.frames),
        "warnings": [],
        "device": {"name": "CPU", "alias": "cpu"},
        "threads": 2,
        "versions": {},
    }


def tiny_plan(sequences: Sequence[Any], **changes: Any) -> Plan:
    """The smallest plan that still does everything."""
    return replace(Plan(tuple(sequences), TINY_CONFIG, TINY), **changes)
