"""What a reconstruction returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from warpdef.config import Config


@dataclass
class Reconstruction:
    """One mesh that moves.

    vertices: positions in every frame, input units   (T, V, 3) float32
    faces:    the same in every frame                 (F, 3) int32
    keyframe: frame that the template was built on
    config:   the configuration, whole
    report:   versions, device, keyframe and why, template statistics, seconds, losses, solver statistics, warnings
    steps:    the loss curve, one record every few iterations
    """

    vertices: np.ndarray
    faces: np.ndarray
    keyframe: int
    config: Config
    report: dict[str, Any] = field(default_factory=dict)
    steps: list[dict[str, float]] = field(default_factory=list)
