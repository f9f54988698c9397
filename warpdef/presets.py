"""Named configurations: ours, measured to be better, and the paper's own values."""

from __future__ import annotations

from dataclasses import replace

from warpdef.config import Config
from warpdef.errors import ConfigError

PRESETS = ("default", "paper")


def preset(name: str) -> Config:
    """A named Config: ``default`` (measured to be better) or ``paper`` (the published values).

    Raises:
        ConfigError: an unknown name.
    """
    if name not in PRESETS:
        raise ConfigError(f"configuration: preset: expected default or paper, got {name!r}")
    base = Config()
    if name == "default":
        return base
    return replace(
        base,
        cut_static=False,
        drop_strays=False,
        drop_odd_frames=False,
        order="time",
        keyframe=replace(base.keyframe, gamma_fall=0.0),
        grid=replace(base.grid, prune=True),
        sobolev=replace(base.sobolev, solver="cg"),
        loss=replace(base.loss, tangential=1.0),
        template=replace(base.template, depth=10, faces_sparse=0, grow=False, gather=False),
        refine=replace(base.refine, iterations=0),
        optimiser=replace(
            base.optimiser,
            chain=True,
            points=0,
            iterations=5000,
            iterations_per_frame=80.0,
            warmup=100,
            rate=5e-3,
            rate_fall=0.0,
            decay="constant",
        ),
    )
