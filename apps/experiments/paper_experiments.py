"""The paper's experiments (sec. Evaluation and Ablation Study) as lists of runs."""

from __future__ import annotations

from itertools import product

from warpdef.apps.experiments.plan import Experiment, Plan, Setting, descent, settings
from warpdef.apps.experiments.run import TRUTH_TEMPLATE, TruthSource
from warpdef.errors import InputError

NOISE = (0.0, 0.0025, 0.005, 0.01, 0.02)
METHODS = ("poisson", "tetrahedra")
LEVELS = (1, 2, 4, 6, 8, 10, 12)
MESH_SUFFIXES = (".ply", ".obj", ".off")


def main(plan: Plan) -> Experiment:
    """Table 1. Where a data set comes with clouds of its own, those are taken, as in the paper."""
    runs = []
    for source in plan.sequences:
        run = plan.run(source)
        consecutive = run.frames == tuple(range(len(run.frames)))
        if source.clouds is not None and consecutive:
            run = plan.run(source, clouds=source.clouds)
        runs.append(run)
    notes = ("The paper's rows are means over its own sequences; compare only on the same data.",)
    return Experiment("main", "Reconstruction quality", (Setting("all", tuple(runs)),), notes=notes)


def length(plan: Plan) -> Experiment:
    """Sequences of growing length from the same first frame; iterations grow with ``iterations_per_frame``."""
    rows, notes = [], []
    for count in plan.size.lengths:
        fitting = [s for s in plan.sequences if s.frames >= count]
        if len(fitting) < len(plan.sequences):
            missing = ", ".join(s.name for s in plan.sequences if s.frames < count)
            notes.append(f"{count} frames: too long for {missing}.")
        if fitting:
            runs = tuple(plan.run(s, frames=tuple(range(count))) for s in fitting)
            rows.append(Setting(f"{count} frames", runs, count, f"{plan.config.optimiser.total(count)} iterations"))
    if not rows:
        raise InputError(
            f"--data: expected a sequence of at least {plan.size.lengths[0]} frames, got none; choose other data"
        )
    return Experiment("length", "Sequence length", tuple(rows), "frames", tuple(notes))


def resolution(plan: Plan) -> Experiment:
    """Half to four times the usual number of points a frame."""
    counts = [plan.size.points * k // 2 for k in (1, 2, 4, 8)]
    rows = tuple(Setting(f"{n:,} points", plan.each(points=n), n) for n in counts)
    return Experiment("resolution", "Point cloud resolution", rows, "points a frame")


def noise(plan: Plan) -> Experiment:
    """Gaussian noise on every coordinate; normals are then estimated from the noisy points."""
    rows = tuple(Setting(f"{100 * s:g} %", plan.each(noise=s), 100 * s) for s in NOISE)
    return Experiment("noise", "Noise", rows, "noise, % of the bounding box's diagonal")


def components(plan: Plan) -> Experiment:
    """The eight rows of preconditioning (P), multi-resolution (M) and isometry (I) on and off."""
    rows = []
    for p, m, i in product((False, True), repeat=3):
        name = " ".join(letter if on else "-" for letter, on in zip("PMI", (p, m, i), strict=True))
        # Without multi-resolution only the finest level is used; without P the rate falls to a tenth (the library's).
        off = descent(plan.config)
        off |= {} if p else {"sobolev.enabled": False}
        off |= {} if m else {"grid.coarsest": plan.config.grid.levels}
        off |= {} if i else {"loss.isometry_weight": 0.0}
        rows.append((name, None, off))
    notes = ["P: Sobolev preconditioning; M: all grid levels, else the finest only; I: isometry loss."]
    if descent(plan.config):
        notes.append("All rows are of the paper's descent: grids that only guide the mesh know no isometry.")
    if plan.config.refine.iterations:
        notes.append(
            "The vertex stage after the grids is on, which the paper does not have; it has a rigidity of its own. "
            "--preset paper shows the grids alone."
        )
    return Experiment("components", "Key components", settings(plan, rows), notes=tuple(notes))


def levels(plan: Plan) -> Experiment:
    """Number of grid levels."""
    rows = [(f"{n} level" + ("s" if n > 1 else ""), float(n), {"grid.levels": n}) for n in LEVELS]
    return Experiment("levels", "Grid levels", settings(plan, rows), "grid levels")


def initialization(plan: Plan) -> Experiment:
    """Keyframe choices times ways to the first mesh."""
    rows = []
    for choice in ("first", "middle", "auto"):
        keyframe = {"keyframe.choice": choice}
        rows += [Setting(f"{choice}, {m}", plan.each({**keyframe, "template.method": m})) for m in METHODS]
        runs = tuple(plan.run(s, keyframe, template=_outside(plan, s, choice)) for s in plan.sequences)
        rows.append(Setting(f"{choice}, given", runs))
    given = "the keyframe's true mesh, the best that any initialiser could give; --meshes takes yours."
    note = "given: " + (given if plan.meshes is None else "the meshes of --meshes.")
    return Experiment("initialization", "Initialization", tuple(rows), notes=(note,))


def _outside(plan: Plan, source: TruthSource, choice: str) -> str:
    if plan.meshes is None:
        return TRUTH_TEMPLATE
    names = [f"{stem}{suffix}" for stem in (f"{source.name}_{choice}", source.name) for suffix in MESH_SUFFIXES]
    found = next((plan.meshes / name for name in names if (plan.meshes / name).is_file()), None)
    if found is None:
        raise InputError(
            f"{plan.meshes}: expected {source.name}_{choice}.ply (or {source.name}.ply, .obj, .off): the mesh of that "
            "keyframe; got none"
        )
    return str(found)
