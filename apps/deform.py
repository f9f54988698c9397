"""``warpdef deform``: other geometry, moved as a result moves."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from warpdef.apps.console import clean_stdout, say
from warpdef.apps.exit_codes import EXIT_OK
from warpdef.apps.export import report_places
from warpdef.config_values import parse_slice

if TYPE_CHECKING:
    import numpy as np

    from warpdef.export.animation import Animation
    from warpdef.export.points import MovingPoints
    from warpdef.files.surface import Surface
    from warpdef.motion.deform import Deformed

_FAR = 0.05  # of the mesh's largest side: geometry that lies further away on the median is likely misplaced


def deform(
    output: Path,
    geometry: Path,
    /,
    *,
    file: Annotated[Path, Parameter(alias="-o")],
    format: str = "",
    fps: Annotated[float, Parameter(validator=Number(gt=0))] = 24.0,
    slow: Annotated[float, Parameter(validator=Number(gt=0))] = 1.0,
    recorded_fps: Annotated[float | None, Parameter(validator=Number(gt=0))] = None,
    up: Literal["y", "z"] = "y",
    frames: Annotated[str, Parameter(allow_leading_hyphen=True)] = "",
    metres_per_unit: Annotated[float, Parameter(validator=Number(gt=0))] = 1.0,
    bones: str = "",
    precise: Annotated[bool, Parameter(negative="")] = False,
    meshopt: Annotated[bool, Parameter(negative="")] = False,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Move other geometry as a result moves: a denser or textured mesh, a point set, landmarks.

    GEOMETRY stands as the result's mesh does at its keyframe, in the input's units. Faces, colours, texture and
    normals of its own come along. Meshes go to every format of `warpdef export`; points to .npz, or to a folder of
    .ply.

    Args:
        output: Folder of a reconstruction.
        geometry: A mesh (.ply, .obj, .off) or points (also .xyz, .npy and others that clouds are read from).
        file: Where to write; its suffix chooses the format.
        format: A format's suffix, where FILE has another or none: --format ply.
        fps: Frames a second of the file.
        slow: Play so many times slower than recorded, with frames in between by interpolated motion: --slow 4.
        recorded_fps: Frames a second of the input; those of the file if not given. 15 with --fps 60 makes four frames
            of one, at the same speed.
        up: The axis that points up in the result; .glb and .usd carry it.
        frames: Frames used, start:stop:step; empty: all.
        metres_per_unit: Length of the result's unit in metres; .glb and .usd carry it.
        bones: Fit so many rigid bones to the motion, or as many as it needs (--bones auto), and write a mesh that they
            move: .glb, or the bones alone as .bvh.
        precise: Keep float32 in .glb, whose positions else are whole multiples of a small step, which is reported.
        meshopt: Pack .glb with EXT_meshopt_compression, by the extra [meshopt]; for web pages and engines, Blender does
            not read it.
        overwrite: Replace an older file.
    """
    from warpdef.apps.export_options import Packing
    from warpdef.export.pace import frame_names, pace
    from warpdef.files import read_geometry
    from warpdef.files.frame_files import select_frames
    from warpdef.files.saved_run import load_run

    started = time.perf_counter()
    chosen = parse_slice(frames)
    packing = Packing(file, format, bones, precise, meshopt, overwrite)
    packing.check()
    with clean_stdout():
        run = load_run(output)
        times = pace(select_frames(range(len(run.meshes)), chosen, 1, run.path), fps, slow, recorded_fps)
        given = read_geometry(geometry)
        for note in given.notes:
            say(f"warpdef: warning: {note}")
        form = packing.check(points=given.faces is None)
        moved = run.follow(given.points)
        how = {"names": frame_names(run.names, times), "fps": fps, "up": up, "metres_per_unit": metres_per_unit}
        animation = _animate(given, moved, times, how)
        places = packing.write(animation, form)
    _warn_of_distance(geometry, moved, run)
    kind = "points" if given.faces is None else f"vertices, {len(given.faces)} faces"
    report_places(f"{len(times)} frames, {len(given.points)} {kind}, moved from frame {run.keyframe}", places, started)
    packing.say_cost(animation, form)
    return EXIT_OK


def _animate(given: Surface, moved: Deformed, times: np.ndarray, how: dict[str, Any]) -> Animation | MovingPoints:
    """What was given, at its new places."""
    from warpdef.appearance import Appearance
    from warpdef.export.animation import dress
    from warpdef.export.points import MovingPoints

    points, normals = moved.at(times), None if given.normals is None else moved.turned(given.normals, times)
    if given.faces is None:
        return MovingPoints(points, how["names"], how["fps"], normals, given.colors)
    look = Appearance(given.colors, given.uv, given.corner_uv, given.texture)
    return dress(points, given.faces, look, normals, **how)


def _warn_of_distance(geometry: Path, moved: Deformed, run: Any) -> None:
    import numpy as np

    template = run.vertices[run.keyframe]
    side = float((template.max(axis=0) - template.min(axis=0)).max())
    distance = float(np.median(moved.distance))
    if distance > _FAR * side:
        say(
            f"warpdef: warning: half of {geometry} lies more than {distance:.4g} from the mesh at keyframe "
            f"{run.keyframe}, whose largest side is {side:.4g}; is it in the same place and units, in the pose of "
            f"{run.names[run.keyframe]}?"
        )
