"""``warpdef evaluate``: a run folder against the truth, or against the clouds that it was made from."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter
from cyclopts.validators import Number

from warpdef.apps.console import ProgressDisplay, clean_stdout, print_json
from warpdef.apps.exit_codes import EXIT_OK
from warpdef.apps.metric_tables import print_frames, print_means
from warpdef.apps.quality_tables import print_quality
from warpdef.config_values import parse_slice
from warpdef.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from warpdef.files.saved_run import SavedRun
    from warpdef.mesh import MeshSequence, TriMesh

SAMPLES = 100_000
"""Samples a surface in the paper's protocol."""


def evaluate(
    output: Path,
    truth: Path | None = None,
    /,
    *,
    clouds: Path | None = None,
    frames: Annotated[str, Parameter(allow_leading_hyphen=True)] = "",
    samples: Annotated[int, Parameter(validator=Number(gte=1))] = SAMPLES,
    seed: Annotated[int, Parameter(validator=Number(gte=0))] = 0,
    per_frame: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Compare a result with the true mesh sequence; without one, with its own clouds: what fits, and what is lost.

    Args:
        output: Folder of a reconstruction; the measures are put into it as metrics.json.
        truth: An npz with vertices (T, V, 3) and faces, a folder of meshes, or any other that warpdef datasets finds.
            Without it every frame is held against its cloud and judged: good, doubtful or lost.
        clouds: Without a truth, the clouds to judge by; those of the run if not given, which must be what they were.
        frames: The truth's frames that the result was made from, start:stop:step; empty: all.
        samples: Samples on each surface.
        seed: Seed of the samples.
        per_frame: Show every frame, not only the mean.
        json: Print the measures as JSON on standard output, and nothing else there.
    """
    from warpdef.datasets.truth import read_truth
    from warpdef.files.saved_run import load_run

    run = load_run(output)
    if truth is None:
        assessed = assess_run(run, clouds)
        if json:
            print_json(assessed)
        else:
            print_quality(assessed, f"{output} against its clouds")
        return EXIT_OK
    if clouds is not None:
        raise InputError("--clouds: expected no truth beside it, got both; with a truth the clouds are not asked")
    chosen = parse_slice(frames)
    metrics = evaluate_run(run, read_truth(truth, chosen), samples=samples, seed=seed)
    if json:
        print_json(metrics)
    else:
        if per_frame:
            print_frames(metrics)
        print_means(metrics, f"{output} against {truth}", run.keyframe)
    return EXIT_OK


def assess_run(run: SavedRun, clouds: Path | None = None) -> dict[str, Any]:
    """Judge every frame of a run by its clouds; see ``quality.assess.Assessment.as_dict``.

    Raises:
        InputError: the clouds are gone, changed, or of another number of frames.
    """
    from warpdef.geometry.viewpoint import camera_place, viewing_direction
    from warpdef.quality.assess import assess
    from warpdef.run_clouds import clouds_of

    with clean_stdout(), ProgressDisplay() as display:
        display.start("load")
        sequence = clouds_of(run, clouds)
        display.start("assess", len(run.meshes), "frames")
        view = viewing_direction(sequence.points) if any(n is None for n in sequence.normals) else None
        eye = None if view is None else camera_place(sequence.points, view)
        return assess(sequence.judged_frames(), run.vertices, run.faces, run.keyframe, eye=eye).as_dict()


def evaluate_run(
    run: SavedRun, truth: MeshSequence | Sequence[TriMesh], *, samples: int = SAMPLES, seed: int = 0
) -> dict[str, Any]:
    """Evaluate a run with progress on standard error, and put ``metrics.json`` into its folder.

    Raises:
        InputError: a truth that does not fit the run; then nothing is written.
    """
    from warpdef.files.saved_run import write_metrics
    from warpdef.progress import Progress
    from warpdef.truth.metrics import evaluate as evaluate_meshes

    with clean_stdout(), ProgressDisplay() as display:
        display.start("evaluate", len(truth), "frames")
        metrics = evaluate_meshes(
            run.meshes,
            truth,
            samples=samples,
            seed=seed,
            keyframe=run.keyframe,
            progress=lambda done, count: display(Progress("evaluate", done, count)),
        )
    write_metrics(run.path, metrics)
    return metrics
