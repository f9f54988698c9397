"""Configurations of the paper's descent: the template moved by the grids of all transitions, one after the other."""

from __future__ import annotations

from dataclasses import replace

from warpdef.config import Config


def chained(config: Config) -> Config:
    """The same with the paper's descent, on all points."""
    return replace(config, optimiser=replace(config.optimiser, chain=True, points=0))
