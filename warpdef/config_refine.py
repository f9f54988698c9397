"""The vertex stage: what may be set of it (see ``config``)."""

from __future__ import annotations

from dataclasses import dataclass

from warpdef.config_values import require, require_sane


@dataclass(frozen=True)
class RefineConfig:
    """The vertex stage after the grids: Gauss-Newton on every vertex of every frame, and one shape for all frames."""

    iterations: int = 20
    """Rounds over all frames and the shape; 0 leaves the stage out, as the paper does."""
    follow: int = 6
    """Rounds for a frame alone, on the way outwards from the keyframe, before the next starts from it."""
    rigidity: float = 0.1
    """Weight of local rigidity against one point-to-plane residual a vertex, for clean clouds."""
    rigidity_noisy: float = 2.0
    """The same for clouds whose local thickness is ``noisy_thickness``; between and beyond, by the logarithm."""
    rotation_smoothness: float = 1.0
    """Weight that ties a vertex's rotation to its neighbours', so that turns spread; 0 for none.

    Of what one camera saw, and where noise is wider than 1.2 edges, nothing is tied; of an open sheet, and where noise
    is wider than the spacing, a frame alone is not."""
    material: bool = True
    """Learn from all frames where the surface strains most, and hold it less there.

    Not of what one camera saw, nor where noise is wider than the spacing."""
    clean_thickness: float = 0.3
    """Local thickness over width of a cloud (16 neighbours) up to which it counts as clean."""
    noisy_thickness: float = 0.55
    """Local thickness over width at which a cloud's own normals are no longer used."""
    landmark_weight: float = 10.0
    """Weight of a landmark against one point-to-plane residual (see ``landmarks``)."""
    time: float = 4.0
    """Weight of a vertex's smooth place in time, in the patch of surface around it; 0 for none."""
    damping: float = 0.001
    """Weight that holds a vertex where it was at the start of a round."""
    reach: float = 3.0
    """Distance, in mean point spacings of the frame, at which a pair's weight has fallen to 1/e."""
    agreement: float = 0.5
    """Least cosine between the normals of a pair."""
    shape_smoothness: float = 50.0
    """Stiffness of the common shape's solve: larger lets a round change it over longer distances."""
    shape_step: float = 1.7
    """Step of the common shape towards its optimum in a round; above 1 overshoots, which converges faster."""
    tolerance: float = 1e-3
    """Residual, relative to the right-hand side, at which a frame's linear solve stops."""
    momentum: float = 0.7
    """Share of the last round's way by which a vertex goes on before the next (heavy ball), its rotation fitted anew.

    0 for none. Only where rotations of neighbours are tied."""
    iterations_max: int = 300
    """Steps after which a frame's linear solve stops all the same."""
    recover: bool = True
    """Fit frames that lost a limb again, from their neighbour, by matches of one connected part."""

    def __post_init__(self) -> None:
        require(self.iterations >= 0, "refine.iterations", "0 or more", self.iterations)
        require(self.follow >= 0, "refine.follow", "0 or more", self.follow)
        require(self.time >= 0, "refine.time", "a number from 0", self.time)
        smoothness = self.rotation_smoothness
        require(smoothness >= 0, "refine.rotation_smoothness", "a number from 0", smoothness)
        for key in (
            "rigidity",
            "rigidity_noisy",
            "landmark_weight",
            "damping",
            "reach",
            "shape_smoothness",
            "clean_thickness",
        ):
            require(getattr(self, key) > 0, f"refine.{key}", "a number above 0", getattr(self, key))
        above = f"a number above refine.clean_thickness ({self.clean_thickness})"
        require(self.noisy_thickness > self.clean_thickness, "refine.noisy_thickness", above, self.noisy_thickness)
        require(-1 <= self.agreement < 1, "refine.agreement", "from -1 to below 1", self.agreement)
        require(0 <= self.momentum < 1, "refine.momentum", "from 0 to below 1", self.momentum)
        require(0 <= self.shape_step < 2, "refine.shape_step", "from 0 to below 2", self.shape_step)
        require(0 < self.tolerance < 1, "refine.tolerance", "between 0 and 1", self.tolerance)
        require(self.iterations_max >= 1, "refine.iterations_max", "at least 1", self.iterations_max)
        require_sane(self, "refine.")
