"""Assessments as tests read them: measures that are numbers, verdicts by their names."""

from __future__ import annotations

from typing import Any

from warpdef.quality import assess as quality
from warpdef.quality.assess import Assessment


def assess(*given: Any, **more: Any) -> Any:
    """As the library's; the frames here have points, so that every measure of theirs is a number."""
    return quality.assess(*given, **more)


def names(assessment: Assessment) -> list[str]:
    return [verdict.name for verdict in assessment.verdicts]


def frames(assessment: Assessment) -> list[Any]:
    """What was measured; every frame but one without points has all of it."""
    return list(assessment.frames)
