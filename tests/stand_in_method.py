"""A method that does nothing, quickly: for tests of the command line, which is not about meshes."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from warpdef.config import Config
from warpdef.progress import Progress
from warpdef.result import Reconstruction


@dataclass
class StandInMethod:
    """Stands in for ``warpdef.pipeline``; keeps the arguments of its calls, raises ``error`` if there is one.

    ``more`` goes into the reports."""

    calls: list[dict[str, Any]] = field(default_factory=list)
    error: BaseException | None = None
    interrupted: bool = False
    more: dict[str, Any] = field(default_factory=dict)

    def reconstruct(self, sequence, config: Config, *, callback=None, **others):
        self.calls.append({"sequence": sequence, "config": config, **others})
        if callback is not None:
            callback(Progress("template", message="frame 0 has no closed surface; trying frame 1"))
            for iteration in range(1, 4):
                callback(Progress("optimise", iteration, 3, {"mesh": 1.0 / iteration}))
        print("a library talks on standard output")
        if self.error is not None:
            raise self.error
        report: dict[str, Any] = {
            "keyframe": 1,
            "keyframe_why": "as told",
            "interrupted": self.interrupted,
            "iterations": 3,
            "seconds": {"optimise": 0.5},
            "losses": {"mesh": 0.25},
            "warnings": ["frame 0 has no closed surface"],
            **self.more,
        }
        first = sequence.points[0][:4]
        vertices = np.stack([first + t for t in range(sequence.frame_count)]).astype(np.float32)
        faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
        return Reconstruction(vertices, faces, 1, config, report, [{"iteration": i} for i in range(3)])

    @classmethod
    def install(cls, monkeypatch: pytest.MonkeyPatch) -> StandInMethod:
        """Put a fresh one in the place of the real module for the length of a test."""
        method, module = cls(), ModuleType("warpdef.pipeline")
        module.reconstruct = method.reconstruct  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "warpdef.pipeline", module)
        return method
