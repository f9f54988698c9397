"""What may be set for a run: frozen, validated, each field one sentence with its source.

Here are the numbers of the paper and of its ablations, and those that another kind of scan or another machine may want
otherwise: weights, rates, resolutions, thicknesses. Not here, but at the head of the room that uses them, each with
its reason, are those that judge scans and results (what is a stray, a border, an object, a lost frame), those inside a
single step (the tetrahedral template's descent, the search for lost limbs, the estimate of normals), sizes of
neighbourhoods, tolerances against rounding, and limits of file formats and of memory. Such a number stands in one
room; others import it.

Section and equation names are those of *Preconditioned Deformation Grids* (Pacific Graphics 2025). ``Config()`` is
the ``default`` preset; for others see ``presets``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from warpdef.config_grids import BASE_FRAMES, GridConfig, LossConfig, OptimiserConfig, SobolevConfig
from warpdef.config_refine import RefineConfig
from warpdef.config_template import KeyframeConfig, TemplateConfig
from warpdef.config_values import parse_box, parse_slice, require, require_sane

__all__ = [
    "BASE_FRAMES",
    "Config",
    "GridConfig",
    "KeyframeConfig",
    "LossConfig",
    "OptimiserConfig",
    "RefineConfig",
    "SobolevConfig",
    "TemplateConfig",
]


@dataclass(frozen=True)
class Config:
    """One run, whole: the same input and the same Config give the same result.

    On the CPU to the bit, on any number of threads; on CUDA as far as sums in another order say in float32."""

    frames: str = ""
    """Frames used, ``start:stop:step`` as a Python slice; empty: all."""
    points: int = 0
    """Points a frame, drawn without replacement; 0: all."""
    columns: str = ""
    """Columns of tables without names, as ``x,y,z,nx,ny,nz,r,g,b``, ``_`` for one to pass over; empty: by values."""
    landmarks: str = ""
    """File of known correspondences, .csv or .json: vertex or place at the keyframe, frame, place; empty: none."""
    crop: str = ""
    """Only points inside this box are used, ``x0:x1,y0:y1,z0:z1`` in input units, any end left out; empty: all."""
    cut_static: bool = True
    """Cut planes wider than the object that stand still in all frames (floor, walls, table), furniture with them."""
    drop_strays: bool = True
    """Leave out points that belong to no surface: single ones and loose clusters far from it; clean clouds keep all."""
    trust_normals: bool = False
    """Given normals keep their sides: none is turned over or left out, nor told anew where clouds are noisy."""
    colours: Literal["still", "moving", "off"] = "still"
    """Colours of the clouds on the mesh: ``still``, a median over the frames; ``moving``, of each frame; ``off``."""
    drop_odd_frames: bool = True
    """Leave out frames that are unlike their neighbours while those are alike; their meshes are interpolated."""
    order: Literal["auto", "time"] = "auto"
    """``time``: frames are a film; ``auto``: scans in no order are found out, put in order by their poses, and not
    smoothed in time."""
    fill: float = 0.95
    """Half the side of the cube that the sequence's bounding box fills."""
    seed: int = 0
    """Seed of everything random."""
    keyframe: KeyframeConfig = field(default_factory=KeyframeConfig)
    template: TemplateConfig = field(default_factory=TemplateConfig)
    grid: GridConfig = field(default_factory=GridConfig)
    sobolev: SobolevConfig = field(default_factory=SobolevConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    optimiser: OptimiserConfig = field(default_factory=OptimiserConfig)
    refine: RefineConfig = field(default_factory=RefineConfig)

    def __post_init__(self) -> None:
        parse_slice(self.frames)
        parse_box(self.crop)
        require(self.points == 0 or self.points >= 10, "points", "0 (all) or at least 10", self.points)
        require(self.colours in ("still", "moving", "off"), "colours", "still, moving or off", self.colours)
        require(self.order in ("auto", "time"), "order", "auto or time", self.order)
        vertex_stage = not self.landmarks or self.refine.iterations > 0
        require(vertex_stage, "landmarks", "refine.iterations above 0 with them", self.refine.iterations)
        require(0 < self.fill <= 1, "fill", "above 0, up to 1", self.fill)
        require(self.seed >= 0, "seed", "0 or more", self.seed)
        exact_on_pruned = self.sobolev.solver == "cosine" and self.grid.prune
        require(not exact_on_pruned, "sobolev.solver", "cg, warp or auto where grid.prune is true", "cosine")
        require_sane(self)
