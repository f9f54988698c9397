"""warpdef: from a sequence of raw point clouds to one mesh that moves.

    sequence = warpdef.read_clouds("scans/")
    result = warpdef.reconstruct(sequence)
    result.vertices, result.faces      # (T, V, 3), (F, 3)

Names are loaded when first used, so that importing warpdef costs nothing.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

_HOMES = {
    "Appearance": "warpdef.appearance",
    "Config": "warpdef.config",
    "points_of_depth": "warpdef.files.depth_images",
    "preset": "warpdef.presets",
    "MeshSequence": "warpdef.mesh",
    "TriMesh": "warpdef.mesh",
    "PointSequence": "warpdef.sequence",
    "Progress": "warpdef.progress",
    "Reconstruction": "warpdef.result",
    "Safeguards": "warpdef.prepare",
    "WarpdefError": "warpdef.errors",
    "evaluate": "warpdef.truth.metrics",
    "load_run": "warpdef.files.saved_run",
    "read_clouds": "warpdef.files",
    "read_mesh": "warpdef.files",
    "read_mesh_sequence": "warpdef.files",
    "reconstruct": "warpdef.pipeline",
    "sample_sequence": "warpdef.truth.sample",
    "save_run": "warpdef.files.saved_run",
    "walking_figure": "warpdef.truth.figure",
}

__all__ = ["__version__", *_HOMES]  # pyright: ignore[reportUnsupportedDunderAll] - loaded when used, see below


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'warpdef' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
