"""Our own experiments: the targets, what each idea of the default preset is worth, and what length costs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from warpdef.apps.experiments.plan import Experiment, Plan, Setting, benchmark, descent, label
from warpdef.apps.experiments.run import ExperimentRun, to_and_fro, value_of

IDEAS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("tangential damping", {"loss.tangential": 1.0}),
    ("mesh that follows its guide", {"optimiser.chain": True, "optimiser.points": 0}),
    ("vertex stage", {"refine.iterations": 0}),
    ("shared rest shape", {"refine.shape_step": 0.0}),
    ("smoothness in time", {"refine.time": 0.0}),
    ("neighbours that turn alike", {"refine.rotation_smoothness": 0.0}),
    ("momentum of rounds", {"refine.momentum": 0.0}),
    ("a material learnt", {"refine.material": False}),
    ("lost limbs found again", {"refine.recover": False}),
    ("stiffness by noise", {"refine.rigidity_noisy": "=refine.rigidity"}),
    ("normal agreement of pairs", {"refine.agreement": -1.0}),
    ("full grids, exact solves", {"grid.prune": True, "sobolev.solver": "cg"}),
    ("high rate", {"optimiser.rate": 5e-3}),
    ("rate decay", {"optimiser.decay": "constant"}),
    ("rates by length", {"optimiser.rate_fall": 0.0}),
    ("Poisson depth by spacing", {"template.depth": 10}),
    ("middle as wide in long films", {"keyframe.gamma_fall": 0.0}),
    ("template of all frames", {"template.grow": False}),
    ("template made again of sparse frames", {"template.gather": False}),
    ("faces for the points of all frames", {"template.faces_sparse": 0}),
    ("full coverage of keyframes", {"keyframe.coverage_min": 0.0}),
    ("static planes cut", {"cut_static": False}),
    ("stray points left out", {"drop_strays": False}),
    ("sides of given normals looked at", {"trust_normals": True}),
    ("scans in no order found out", {"order": "time"}),
    ("odd frames left out", {"drop_odd_frames": False}),
    ("isometry", {"loss.isometry_weight": 0.0}),
    ("confidence", {"loss.confidence": False}),
    ("preconditioning", {"sobolev.enabled": False}),
    ("multi-resolution", {"grid.coarsest": "=grid.levels"}),
)
"""Ideas and what switches each off: values by key; ``=key`` stands for another key's value."""
OF_THE_DESCENT = ("mesh that follows its guide", "rates by length", "isometry", "confidence")
"""Those that say something in the paper's descent alone: they are switched off there."""


def accuracy(plan: Plan) -> Experiment:
    """One row a target: every sequence, and the reference sequence under noise, resolution, length and given clouds."""
    runs = {label(run): run for run in plan.each()}
    reference = plan.reference()
    base = plan.run(reference)
    for noise in (0.005, 0.01):
        runs[f"{label(base)}, noise {100 * noise:g} %"] = plan.run(reference, noise=noise)
    for points in (plan.size.points // 2, plan.size.points * 4):
        runs[f"{label(base)}, {points:,} points"] = plan.run(reference, points=points)
    for name, run in _given_clouds(plan).items():
        runs[name] = run
    notes = []
    count = plan.size.accuracy_length
    if reference.frames >= count:
        long = plan.run(reference, frames=tuple(range(count)))
        runs[label(long)] = long
    else:
        notes.append(f"{reference.name} has fewer than {count} frames: the long row is left out.")
    rows = tuple(Setting(name, (run,)) for name, run in runs.items())
    return Experiment("accuracy", "Accuracy against targets", rows, notes=tuple(notes))


def _given_clouds(plan: Plan) -> dict[str, ExperimentRun]:
    """Folders NAME_clouds with points.npz: clouds as a user brings them, of the sequence whose name ends in NAME."""
    found = {}
    for file in sorted(plan.folder.glob("*_clouds/points.npz")) if plan.folder is not None else ():
        name = file.parent.name
        for source in plan.sequences:
            note = benchmark(source)
            if source.name.endswith(name.removesuffix("_clouds")) and {"frames", "scale", "translation"} <= set(note):
                count = min(note["frames"], plan.size.frames)
                whole = count == note["frames"]
                found[name if whole else f"{name}, {count} frames"] = plan.run(
                    source,
                    frames=tuple(range(note["first_frame"], note["first_frame"] + count)),
                    points=0 if whole else plan.size.points,
                    clouds=Path(file),
                    scale=float(note["scale"]),
                    translation=tuple(map(float, note["translation"])),
                )
    return found


def ideas(plan: Plan) -> Experiment:
    """The configuration as it is, and with one idea switched off at a time, on all sequences and one with noise.

    Without a chain, ideas of the paper's descent are switched off in that, and judged beside its row.
    """
    rows = [_idea(plan, "all on", {})]
    notes = []
    for name, off in IDEAS:
        values = {k: value_of(plan.config, v[1:]) if str(v).startswith("=") else v for k, v in off.items()}
        if values == {key: value_of(plan.config, key) for key in off}:
            notes.append(f"{name}: off already in this configuration.")
        else:
            turned = descent(plan.config) if name in OF_THE_DESCENT else {}
            rows.append(_idea(plan, f"without {name}", turned | values))
    return Experiment("ideas", "What each idea is worth", tuple(rows), notes=tuple(notes))


def _idea(plan: Plan, name: str, values: dict[str, Any]) -> Setting:
    noisy = plan.run(plan.reference(), values, noise=0.005)
    about = ", ".join(f"{key} = {value}" for key, value in values.items())
    return Setting(name, (*plan.each(values), noisy), about=about)


def long(plan: Plan) -> Experiment:
    """What length costs: memory up to 300 frames, and the iterations that a length needs.

    The reference sequence, played to and fro where it is too short, each run in a process of its own.
    """
    reference, optimiser = plan.reference(), plan.config.optimiser
    rows = []
    for count in plan.size.memory_lengths:
        frames = to_and_fro(reference.frames, count)
        few = {"optimiser.iterations": min(20, optimiser.iterations), "optimiser.iterations_per_frame": 0.0}
        few |= {"refine.iterations": min(2, plan.config.refine.iterations)}
        run = plan.run(reference, few, frames=frames, samples=min(plan.size.samples, 5000), fresh=True)
        rows.append(Setting(f"memory, {count} frames", (run,), None, f"{run.config.optimiser.total(count)} iterations"))
    for count in plan.size.lengths:
        if count <= reference.frames:
            for factor in plan.size.factors:
                iterations = max(1, round(optimiser.iterations * factor))
                values = {"optimiser.iterations": iterations, "optimiser.iterations_per_frame": 0.0}
                run = plan.run(reference, values, frames=tuple(range(count)), fresh=True)
                rows.append(Setting(f"{count} frames, {iterations} iterations", (run,), count))
    notes = (f"{reference.name}, played to and fro beyond its {reference.frames} frames.",)
    return Experiment("long", "Long sequences", tuple(rows), "frames", notes)
