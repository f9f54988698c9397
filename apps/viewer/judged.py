"""What the report of a run says of its frames, for titles and for the strip under the slider."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from warpdef.quality.verdict import DOUBTFUL, GOOD, LOST, VERDICTS

COLORS = {GOOD: "#4a9d5f", DOUBTFUL: "#e0a021", LOST: "#c63d32"}


@dataclass(frozen=True)
class Judged:
    """A frame.

    verdict:  ``good``, ``doubtful`` or ``lost``
    residual: mean distance of its points to the mesh, % of the extent; None for a frame without points
    reason:   why it is not good, a clause; empty for good frames
    """

    verdict: str
    residual: float | None = None
    reason: str = ""

    @property
    def words(self) -> str:
        """The verdict and its reason."""
        return f"{self.verdict}: {self.reason}" if self.reason else self.verdict


def judged_frames(report: Mapping[str, Any], chosen: Sequence[int], count: int) -> list[Judged] | None:
    """The ``chosen`` of a run's ``count`` frames; None where its report, of an earlier version, has no verdicts."""
    verdicts, quality = report.get("verdicts"), report.get("quality")
    if not isinstance(verdicts, list) or len(verdicts) != count or not set(verdicts) <= set(VERDICTS):
        return None
    if not (isinstance(quality, list) and len(quality) == count and all(isinstance(q, dict) for q in quality)):
        quality = [{}] * count
    frames = []
    for t in chosen:
        values = quality[t]
        residual, reasons = values.get("residual_mean_percent"), values.get("reasons") or [""]
        frames.append(Judged(verdicts[t], None if residual is None else float(residual), str(reasons[0])))
    return frames
