"""Keyframe and template: what may be set of them (see ``config``)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from warpdef.config_values import require, require_sane


@dataclass(frozen=True)
class KeyframeConfig:
    """Which frame the template is built on (sec. Keyframe Selection)."""

    choice: str = "auto"
    """``auto``, ``first``, ``middle``, or a frame index counted from 0."""
    voxels: int = 128
    """Cells an axis of the grid in which occupied voxels are counted."""
    gamma: float = 0.001
    """Gaussian weight exp(-gamma (t - T/2)^2) that favours the temporal middle."""
    gamma_fall: float = 2.0
    """Beyond 17 frames T gamma is (17 / T)^gamma_fall of that; with 2 the middle is as wide a share of any film."""
    coverage_min: float = 0.87
    """Share of the fullest frame's area from which a frame counts as complete: others are no keyframes if these can be,
    and what they do not show does not pull."""

    def __post_init__(self) -> None:
        named = self.choice in ("auto", "first", "middle")
        known = named or (self.choice.isdecimal() and len(self.choice) < 10)
        require(known, "keyframe.choice", "auto, first, middle or an index from 0", self.choice)
        require(1 <= self.voxels <= 1024, "keyframe.voxels", "1 to 1024", self.voxels)
        require(self.gamma >= 0, "keyframe.gamma", "a number from 0", self.gamma)
        require(0 <= self.gamma_fall <= 2, "keyframe.gamma_fall", "0 to 2", self.gamma_fall)
        require(0 <= self.coverage_min <= 1, "keyframe.coverage_min", "0 to 1", self.coverage_min)
        require_sane(self, "keyframe.")


@dataclass(frozen=True)
class TemplateConfig:
    """How the template mesh is made and judged (sec. Keyframe Selection; screened Poisson)."""

    mesh: str = ""
    """Path of a mesh of your own for the keyframe, vertex order kept; empty: reconstruct one."""
    align: bool = False
    """Place a mesh of your own on its keyframe first, by one rotation, shift and scale."""
    backend: Literal["auto", "gpytoolbox", "pymeshlab"] = "auto"
    """Library for screened Poisson and remeshing; ``auto`` takes gpytoolbox, else pymeshlab."""
    method: Literal["poisson", "tetrahedra"] = "poisson"
    """``poisson``: screened Poisson; ``tetrahedra``: a deforming tetrahedral grid, fitted by gradient descent."""
    surface: Literal["auto", "closed", "open"] = "auto"
    """``open``: trimmed where the points end; ``auto``: open if more than ``far_share_max`` would be trimmed."""
    depth: int = 0
    """Octree depth of screened Poisson; 0: cells of the mean point spacing, as finer ones add false handles."""
    screening: float = 10.0
    """Point (screening) weight of screened Poisson."""
    faces_max: int = 20000
    """Upper bound on template faces."""
    faces_per_point: float = 4.0
    """Template faces a keyframe point, below ``faces_max``."""
    faces_sparse: int = 10000
    """Faces up to which those of a sparse keyframe are counted by the points of all frames: all tell one shape."""
    neighbours: int = 16
    """Neighbours from which a missing normal is estimated."""
    far_spacings: float = 4.0
    """A surface place is far when its nearest point is further than this many mean point spacings."""
    far_share_max: float = 0.05
    """Largest share of far surface that passes the quality gate."""
    missed_share_max: float = 0.01
    """Largest share of keyframe points further than that from the template that passes the quality gate."""
    attempts: int = 4
    """Keyframes tried before the best failing template is used with a warning."""
    grow: bool = True
    """Where one camera saw a body that turns: make the template of all frames, not of what a keyframe shows."""
    gather: bool = True
    """Of at most 2,000 points a frame without normals: make the template again of all frames, once they are fitted."""

    def __post_init__(self) -> None:
        known = self.backend in ("auto", "gpytoolbox", "pymeshlab")
        require(known, "template.backend", "auto, gpytoolbox or pymeshlab", self.backend)
        require(self.method in ("poisson", "tetrahedra"), "template.method", "poisson or tetrahedra", self.method)
        require(self.surface in ("auto", "closed", "open"), "template.surface", "auto, closed or open", self.surface)
        require(self.depth == 0 or 3 <= self.depth <= 14, "template.depth", "0 (by spacing) or 3 to 14", self.depth)
        require(self.screening >= 0, "template.screening", "a number from 0", self.screening)
        require(self.faces_max >= 20, "template.faces_max", "at least 20", self.faces_max)
        require(self.faces_per_point > 0, "template.faces_per_point", "a number above 0", self.faces_per_point)
        require(self.faces_sparse >= 0, "template.faces_sparse", "0 or more", self.faces_sparse)
        require(self.neighbours >= 4, "template.neighbours", "at least 4", self.neighbours)
        require(self.far_spacings > 0, "template.far_spacings", "a number above 0", self.far_spacings)
        require(0 <= self.far_share_max <= 1, "template.far_share_max", "0 to 1", self.far_share_max)
        require(0 <= self.missed_share_max <= 1, "template.missed_share_max", "0 to 1", self.missed_share_max)
        require(self.attempts >= 1, "template.attempts", "at least 1", self.attempts)
        require_sane(self, "template.")

    def faces_most(self, points: int, frames: int) -> int:
        """Upper bound on the faces of a template that is built on so many points, of one of so many frames."""
        one = self.faces_per_point * points
        return int(min(self.faces_max, max(one, min(self.faces_sparse, one * frames))))
