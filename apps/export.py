"""``warpdef export``: a result for another program."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from warpdef.apps.console import clean_stdout
from warpdef.apps.exit_codes import EXIT_OK
from warpdef.config_values import parse_slice


def export(
    output: Path,
    file: Path,
    /,
    *,
    format: str = "",
    fps: Annotated[float, Parameter(validator=Number(gt=0))] = 24.0,
    slow: Annotated[float, Parameter(validator=Number(gt=0))] = 1.0,
    recorded_fps: Annotated[float | None, Parameter(validator=Number(gt=0))] = None,
    up: Literal["y", "z"] = "y",
    frames: Annotated[str, Parameter(allow_leading_hyphen=True)] = "",
    metres_per_unit: Annotated[float, Parameter(validator=Number(gt=0))] = 1.0,
    bones: str = "",
    color: Literal["template", "error", "stretch", "displacement", "confidence"] = "template",
    input: Path | None = None,
    truth: Path | None = None,
    truth_frames: Annotated[str, Parameter(allow_leading_hyphen=True)] = "",
    precise: Annotated[bool, Parameter(negative="")] = False,
    meshopt: Annotated[bool, Parameter(negative="")] = False,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Write a result in another program's format, chosen by the suffix of FILE.

    .glb .usd .usda .usdc .usdz .npz .anime .bvh are one file; .pc2 and .mdd come with the base mesh as .obj; .pvd
    with a folder of .vtp files; .obj .ply .stl .3mf are folders of numbered files. Vertices keep their order and their
    numbers. The image of a textured template goes to .glb, .usd and its kin, .obj and .ply; the others cannot carry it.

    Args:
        output: Folder of a reconstruction.
        file: Where to write.
        format: A format's suffix, where FILE has another or none: --format ply.
        fps: Frames a second of the file.
        slow: Play so many times slower than recorded, with frames in between by interpolated motion: --slow 4.
        recorded_fps: Frames a second of the input; those of the file if not given. 15 with --fps 60 makes four frames
            of one, at the same speed.
        up: The axis that points up in the result; .glb and .usd carry it.
        frames: Frames used, start:stop:step; empty: all.
        metres_per_unit: Length of the result's unit in metres; .glb and .usd carry it.
        bones: Fit so many rigid bones to the motion, or as many as it needs (--bones auto), and write a mesh that they
            move: .glb, or the bones alone as .bvh. Small, quick to play, and what animators go on with; the error is
            reported.
        color: template: the colours and texture that the template has; else a measure in their place, as colours that
            change in .glb and .usd and its kin, as numbers in .pvd, .ply and .npz: error, the distance to the truth's
            surface, or else of the input's points; stretch and displacement, against the keyframe; confidence, how far
            a place can be trusted.
        input: The clouds it was made from, for --color error; clouds.npz in OUTPUT is taken where there is one.
        truth: The true meshes, for --color error; truth.npz in OUTPUT is taken where there is one.
        truth_frames: The truth's frames that the result was made from, start:stop:step.
        precise: Keep float32 in .glb, whose positions else are whole multiples of a small step, which is reported.
        meshopt: Pack .glb with EXT_meshopt_compression, by the extra [meshopt]; for web pages and engines, Blender does
            not read it.
        overwrite: Replace an older export.
    """
    from warpdef.apps.export_options import Packing, load_measures, say_measure, unit_name
    from warpdef.export.animation import load_animation

    started = time.perf_counter()
    packing = Packing(file, format, bones, precise, meshopt, overwrite)
    measured = color != "template"
    form = packing.check(measured)
    with clean_stdout():
        measures = load_measures(output, input, truth, parse_slice(truth_frames)) if measured else None
        animation = load_animation(
            output,
            frames=parse_slice(frames),
            fps=fps,
            up=up,
            metres_per_unit=metres_per_unit,
            slow=slow,
            recorded_fps=recorded_fps,
            measures=measures,
            color=color,
            unit=unit_name(metres_per_unit),
        )
        places = packing.write(animation, form)
    frame_count, vertex_count = animation.vertices.shape[:2]
    report_places(f"{frame_count} frames, {vertex_count} vertices, {len(animation.faces)} faces", places, started)
    say_measure(animation, packing.suffix, packing.is_rigged(form))
    packing.say_cost(animation, form)
    return EXIT_OK


def report_places(what: str, places: list[Path], started: float) -> None:
    """One line on standard output: what was written where, its size, and the time since ``started``."""
    files = [p for place in places for p in ([place] if place.is_file() else place.iterdir())]
    megabytes = sum(p.stat().st_size for p in files) / 1e6
    seconds = time.perf_counter() - started
    print(f"{what}: {' and '.join(str(place) for place in places)} ({megabytes:.1f} MB, {seconds:.1f} s)")
