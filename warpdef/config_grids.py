"""The descent on grids: what may be set of it (see ``config``)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from warpdef.config_values import require, require_sane

BASE_FRAMES = 17
"""Length of the paper's sequences, up to which iterations and rates are as configured."""
WARMUP_SHARE = 2 / 3
"""Of all iterations: at most so many are warm-up in a longer sequence."""


@dataclass(frozen=True)
class GridConfig:
    """The multi-resolution deformation grids (sec. Multi-Resolution Transformation Grid)."""

    levels: int = 10
    """Number L of the finest level; level l has 2l - 1 nodes an axis."""
    coarsest: int = 1
    """First level used; equal to ``levels`` it is the single-resolution ablation."""
    prune: bool = False
    """Keep only nodes near input points (sec. Implementation Details)."""
    prune_cells: int = 3
    """Nodes within this many cells of an occupied one are kept."""

    def __post_init__(self) -> None:
        require(1 <= self.levels <= 16, "grid.levels", "1 to 16", self.levels)
        require(1 <= self.coarsest <= self.levels, "grid.coarsest", f"1 to grid.levels ({self.levels})", self.coarsest)
        require(self.prune_cells >= 0, "grid.prune_cells", "0 or more", self.prune_cells)
        require_sane(self, "grid.")


@dataclass(frozen=True)
class SobolevConfig:
    """The preconditioner (I + lambda L)^-2 (sec. Spatial Smoothness via Grid Preconditioning)."""

    enabled: bool = True
    """False is the ablation without preconditioning; rates then fall to ``unpreconditioned_rate``."""
    lambda_base: float = 0.25
    """Smoothing weight of level 1."""
    lambda_growth: float = 1.5
    """Factor on the smoothing weight from a level to the next finer one."""
    lambda_template: float = 16.0
    """Smoothing weight on the template's edges."""
    unpreconditioned_rate: float = 0.1
    """Factor on all learning rates when ``enabled`` is false."""
    solver: Literal["auto", "cosine", "cg", "warp"] = "auto"
    """``cosine``: exact, full grids only; ``cg``: our own; ``warp``: Warp's own; ``auto``: the fastest that fits."""
    tolerance: float = 1e-4
    """Residual, relative to the right-hand side, at which conjugate gradients stop."""
    iterations_max: int = 200
    """Conjugate-gradient iterations after which a solve is reported as not converged."""

    def __post_init__(self) -> None:
        require(self.lambda_base >= 0, "sobolev.lambda_base", "a number from 0", self.lambda_base)
        require(self.lambda_growth > 0, "sobolev.lambda_growth", "a number above 0", self.lambda_growth)
        require(self.lambda_template >= 0, "sobolev.lambda_template", "a number from 0", self.lambda_template)
        require(
            self.unpreconditioned_rate > 0,
            "sobolev.unpreconditioned_rate",
            "a number above 0",
            self.unpreconditioned_rate,
        )
        require(
            self.solver in ("auto", "cosine", "cg", "warp"), "sobolev.solver", "auto, cosine, cg or warp", self.solver
        )
        require(0 < self.tolerance < 1, "sobolev.tolerance", "between 0 and 1", self.tolerance)
        require(self.iterations_max >= 1, "sobolev.iterations_max", "at least 1", self.iterations_max)
        require_sane(self, "sobolev.")


@dataclass(frozen=True)
class LossConfig:
    """The objective (sec. Optimization Objectives)."""

    reduction: Literal["sum", "mean"] = "sum"
    """Chamfer over points: ``sum`` as in the authors' program, ``mean`` as the paper prints it."""
    mesh_weight: float = 1.0
    """Weight of the robust Chamfer distance between template and keyframe."""
    input_weight: float = 1.0
    """Weight of the robust Chamfer distance between a moved cloud and the next cloud."""
    transform_weight: float = 1.0
    """Weight of the robust Chamfer distance between the moved template and a cloud."""
    isometry_weight: float = 250.0
    """Weight of the mean change of edge length between neighbouring frames; 0 is the ablation."""
    robust_alpha: float = 5.56
    """Sharpness of the robust weight exp(-alpha d^2), d in cube units; 0 switches it off."""
    robust_power: Literal[2, 4] = 2
    """2: weight exp(-alpha d^2) as printed; 4: exp(-alpha d^4) as in the authors' program."""
    tangential: float = 0.1
    """Weight of a residual's part along the target's surface; 1 is the plain distance of the paper."""
    confidence: bool = True
    """Weigh frames by the errors between them and the keyframe (par. Confidence-Based Error Control)."""
    confidence_bound: Literal["max", "mean"] = "max"
    """cd_max over the steps: ``max`` as printed, ``mean`` as in the authors' program."""
    template_follows_all: bool = False
    """True lets every frame move the template; False lets only the mesh term do so."""

    def __post_init__(self) -> None:
        require(self.reduction in ("sum", "mean"), "loss.reduction", "sum or mean", self.reduction)
        for key, value in vars(self).items():
            if key.endswith("_weight") or key == "robust_alpha":
                require(value >= 0, f"loss.{key}", "a number from 0", value)
        require(self.robust_power in (2, 4), "loss.robust_power", "2 or 4", self.robust_power)
        require(0 <= self.tangential <= 1, "loss.tangential", "0 to 1", self.tangential)
        require(self.confidence_bound in ("max", "mean"), "loss.confidence_bound", "max or mean", self.confidence_bound)
        require_sane(self, "loss.")


@dataclass(frozen=True)
class OptimiserConfig:
    """Adam and its schedule (sec. Implementation Details)."""

    chain: bool = False
    """True: the paper's descent, the template moved by the grids of all transitions one after the other.

    False: grids are fitted cloud to cloud, and the mesh follows them frame by frame (``refine``)."""
    points: int = 5000
    """Points a frame, evenly spread, that grids are fitted to; 0: all. The vertices are always fitted to all."""
    iterations: int = 100
    """Iterations for up to 17 frames, at most: cloud to cloud a transition that has arrived is left alone earlier."""
    iterations_per_frame: float = 0.0
    """Further iterations for every frame beyond 17."""
    warmup: int = 50
    """First iterations, in which only the input and mesh terms act, for up to 17 frames."""
    rate: float = 2e-2
    """Learning rate of level 1, for up to 17 frames."""
    rate_fall: float = 0.5
    """Beyond 17 frames T rates are (17 / T)^rate_fall of that, and the warm-up as much longer: moves add up along T."""
    rate_growth: float = 1.1
    """Factor on the learning rate from a level to the next finer one."""
    template_rate: float = 1e-4
    """Learning rate of the template's vertices."""
    decay: Literal["constant", "cosine"] = "cosine"
    """``constant`` as in the paper, or a half cosine to 0 over the run."""
    beta1: float = 0.9
    """Adam's decay of the first moment."""
    beta2: float = 0.999
    """Adam's decay of the second moment."""
    epsilon: float = 1e-8
    """Adam's guard against division by zero."""

    def __post_init__(self) -> None:
        require(self.points >= 0, "optimiser.points", "0 (all) or more", self.points)
        require(self.iterations >= 1, "optimiser.iterations", "at least 1", self.iterations)
        require(
            self.iterations_per_frame >= 0,
            "optimiser.iterations_per_frame",
            "a number from 0",
            self.iterations_per_frame,
        )
        require(self.warmup >= 0, "optimiser.warmup", "0 or more", self.warmup)
        for key in ("rate", "rate_growth", "epsilon"):
            require(getattr(self, key) > 0, f"optimiser.{key}", "a number above 0", getattr(self, key))
        require(0 <= self.rate_fall <= 1, "optimiser.rate_fall", "0 to 1", self.rate_fall)
        require(self.template_rate >= 0, "optimiser.template_rate", "a number from 0", self.template_rate)
        require(self.decay in ("constant", "cosine"), "optimiser.decay", "constant or cosine", self.decay)
        for key in ("beta1", "beta2"):
            require(0 <= getattr(self, key) < 1, f"optimiser.{key}", "from 0 to below 1", getattr(self, key))
        require_sane(self, "optimiser.")

    def for_length(self, frame_count: int) -> OptimiserConfig:
        """The same with the rate and the warm-up of ``frame_count`` frames; without a chain no number depends on it."""
        if not self.chain:
            return self
        fall = (BASE_FRAMES / max(frame_count, BASE_FRAMES)) ** self.rate_fall
        longest = max(self.warmup, int(WARMUP_SHARE * self.total(frame_count)))
        return replace(self, rate=self.rate * fall, warmup=min(round(self.warmup / fall), longest))

    def total(self, frame_count: int) -> int:
        """Iterations for a sequence of ``frame_count`` frames."""
        return self.iterations + round(self.iterations_per_frame * max(0, frame_count - BASE_FRAMES))
