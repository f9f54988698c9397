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

from dataclasses import dataclass, field, replace
from typing import Literal

from warpdef.config_values import parse_box, parse_slice, require, require_sane

BASE_FRAMES = 17
"""Length of the paper's sequences, up to which iterations and rates are as configured."""
WARMUP_SHARE = 2 / 3
"""Of all iterations: at most so many are warm-up in a longer sequence."""


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
        require(0 <= self.shape_step < 2, "refine.shape_step", "from 0 to below 2", self.shape_step)
        require(0 < self.tolerance < 1, "refine.tolerance", "between 0 and 1", self.tolerance)
        require(self.iterations_max >= 1, "refine.iterations_max", "at least 1", self.iterations_max)
        require_sane(self, "refine.")


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
    """Cut planes wider than the object that stand still in all frames: floor, walls, table; objects alone keep all."""
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
