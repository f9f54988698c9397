"""``warpdef export``: a result for another program."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from warpdef.apps.console import clean_stdout
from warpdef.apps.exit_codes import EXIT_OK
from warpdef.config import parse_slice


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
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Write a result in another program's format, chosen by the suffix of FILE.

    .glb .usd .usda .usdc .usdz .npz .anime are one file; .pc2 and .mdd come with the base mesh as .obj; .pvd with a
    folder of .vtp files; .obj and .ply are folders of numbered files. Vertices keep their order and their numbers. The
    image of a textured template goes to .glb, .usd and its kin, .obj and .ply; the others cannot carry it.

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
        overwrite: Replace an older export.
    """
    from warpdef.export import check_place, format_of
    from warpdef.export import export as write
    from warpdef.export.animation import load_animation

    started = time.perf_counter()
    check_place(file, format_of(file, format), overwrite)
    with clean_stdout():
        animation = load_animation(
            output,
            frames=parse_slice(frames),
            fps=fps,
            up=up,
            metres_per_unit=metres_per_unit,
            slow=slow,
            recorded_fps=recorded_fps,
        )
        places = write(animation, file, format=format, overwrite=overwrite)
    frame_count, vertex_count = animation.vertices.shape[:2]
    report_places(f"{frame_count} frames, {vertex_count} vertices, {len(animation.faces)} faces", places, started)
    return EXIT_OK


def report_places(what: str, places: list[Path], started: float) -> None:
    """One line on standard output: what was written where, its size, and the time since ``started``."""
    files = [p for place in places for p in ([place] if place.is_file() else place.iterdir())]
    megabytes = sum(p.stat().st_size for p in files) / 1e6
    seconds = time.perf_counter() - started
    print(f"{what}: {' and '.join(str(place) for place in places)} ({megabytes:.1f} MB, {seconds:.1f} s)")
