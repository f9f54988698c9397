"""``warpdef view``: a result in a window, or as pictures, a movie, or a web page."""

from __future__ import annotations

import math
import re
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from warpdef.apps.console import ProgressDisplay, clean_stdout, say
from warpdef.apps.exit_codes import EXIT_ERROR, EXIT_OK
from warpdef.apps.viewer.movie import check_outputs
from warpdef.config_values import parse_slice
from warpdef.errors import InputError

if TYPE_CHECKING:
    from warpdef.apps.viewer.actors import Look
    from warpdef.apps.viewer.camera import Stand
    from warpdef.apps.viewer.content import Content
    from warpdef.apps.viewer.scene import Scene

Flag = Annotated[bool, Parameter(negative="")]
Slice = Annotated[str, Parameter(allow_leading_hyphen=True)]


def view(
    output: Path,
    /,
    *,
    input: Path | None = None,
    truth: Path | None = None,
    truth_frames: Slice = "",
    compare: Path | None = None,
    side_by_side: Flag = False,
    frames: Slice = "",
    color: Literal["template", "plain", "error", "stretch", "displacement", "confidence"] = "template",
    clim: Annotated[tuple[float, float] | None, Parameter(allow_leading_hyphen=True)] = None,
    cmap: str = "",
    cloud: Flag = False,
    trajectories: Flag = False,
    wireframe: Flag = False,
    flat: Flag = False,
    scale_bar: Flag = False,
    transparent: Flag = False,
    fps: Annotated[float, Parameter(validator=Number(gt=0))] = 12.0,
    up: Literal["y", "z"] = "y",
    unit: str = "input units",
    frame: Annotated[int, Parameter(validator=Number(gte=0))] = 0,
    azimuth: Annotated[float, Parameter(validator=Number(gte=-360, lte=360))] = 25.0,
    elevation: Annotated[float, Parameter(validator=Number(gte=-89, lte=89))] = 12.0,
    zoom: Annotated[float, Parameter(validator=Number(gte=0.01, lte=100))] = 1.0,
    camera: Path | None = None,
    size: str = "",
    screenshot: Path | None = None,
    sheet: Annotated[int, Parameter(validator=Number(gte=0))] = 0,
    movie: Path | None = None,
    turntable: Flag = False,
    html: Path | None = None,
    overwrite: Flag = False,
) -> int:
    """Show a result: in a window, where h lists the keys, or without one as pictures, a movie or a web page.

    Args:
        output: Folder of a reconstruction.
        input: The clouds it was made from; clouds.npz in OUTPUT is taken where there is one.
        truth: The true meshes; truth.npz in OUTPUT is taken where there is one.
        truth_frames: The truth's frames that the result was made from, start:stop:step.
        compare: Another result of the same frames, beside it.
        side_by_side: Input, reconstruction and truth in panes of their own with one camera.
        frames: Frames of the result to show, start:stop:step; empty: all.
        color: template: colours that stay with the surface; error: distance to the truth's surface, or else of the
            input's points; stretch and displacement: against the keyframe; confidence: how far a place can be trusted.
        clim: Ends of the colour bar, as 0 0.01; else 0, or its negative, and the 99th percentile.
        cmap: Colours of the bar, by matplotlib's name, as magma or RdBu.
        cloud: Show the input cloud over the mesh.
        trajectories: Show the ways of some vertices.
        wireframe: Show the edges of the triangles on the surface.
        flat: Shade every triangle by itself.
        scale_bar: Show how long a length is in the middle of what is seen.
        transparent: Leave the background out of the picture, a .png.
        fps: Frames a second.
        up: The axis that points up.
        unit: What the bars call a length of 1.
        frame: The frame shown first, counted from 0.
        azimuth: Where the camera stands, degrees about the up axis.
        elevation: How high it stands, degrees above the ground.
        zoom: How much nearer than where the whole motion is seen.
        camera: Stand where this file says; k in the window writes it.
        size: Width and height of window or pictures, as 1280x720; the largest tile of a contact sheet.
        screenshot: Write a picture, .png or .jpg.
        sheet: Make the picture a contact sheet of this many frames.
        movie: Write a movie, .gif, or .mp4 with the extra [movie].
        turntable: Turn the camera once around during the movie.
        html: Write a page for the browser that needs neither server nor network.
        overwrite: Replace older files.
    """
    from warpdef.apps.viewer.actors import Look
    from warpdef.apps.viewer.camera import Stand
    from warpdef.apps.viewer.probe import RenderingProbe

    if sheet and screenshot is None:
        raise InputError("--sheet: expected --screenshot FILE.png for the picture, got none; name it")
    if turntable and movie is None:
        raise InputError("--turntable: expected --movie FILE for it, got none; name it")
    if transparent and (screenshot is None or screenshot.suffix.lower() != ".png" or movie is not None):
        raise InputError("--transparent: expected --screenshot FILE.png alone; other files have no transparency")
    if scale_bar and html is not None and screenshot is None and movie is None:
        raise InputError("--scale-bar: expected a window, --screenshot or --movie, got --html alone; a page has none")
    if not output.exists():
        raise InputError(f"{output}: nothing is there; expected the folder of a result, as reconstruct writes it")
    check_outputs(screenshot, movie, html, overwrite)
    width, height = parse_size(size)
    _check_camera(camera, Stand(azimuth, elevation, zoom), html, screenshot or movie)
    in_window = screenshot is None and movie is None and html is None
    probe = RenderingProbe(in_window) if in_window or screenshot is not None or movie is not None else None
    try:
        from warpdef.apps.viewer.camera_file import load_camera
        from warpdef.apps.viewer.content import load_content

        content = load_content(
            output,
            clouds=input,
            truth=truth,
            truth_frames=parse_slice(truth_frames),
            compare=compare,
            side_by_side=side_by_side,
            frames=parse_slice(frames),
            up=up,
            unit=unit,
        )
        if frame >= len(content):
            raise InputError(f"--frame: expected 0..{len(content) - 1}, got {frame}")
        stand = Stand(azimuth, elevation, zoom)
        kept = load_camera(camera, content.origin) if camera is not None and camera.is_file() else None
        look = Look(color, cloud, trajectories, wireframe, not flat, clim, cmap, scale_bar, transparent)
        _check_look(content, look)
        if html is not None:
            _write_html(content, look, html, fps, frame, stand, output.resolve().name)
        if probe is not None:
            probe.require()
    finally:
        if probe is not None:
            probe.stop()
    if not in_window and probe is None:
        return EXIT_OK
    from warpdef.apps.viewer.scene import Scene

    if in_window:
        with clean_stdout():
            scene = Scene(content, off_screen=False, size=(width, height), look=look, stand=stand, camera=kept)
        _open_window(scene, fps, frame, str(output), camera)
    else:
        with clean_stdout():
            # mp4 wants even numbers of pixels.
            even = width // 2 * 2, height // 2 * 2
            scene = Scene(content, off_screen=True, size=even, look=look, stand=stand, camera=kept)
        _write_pictures(scene, (width, height), fps, frame, screenshot, sheet, movie, turntable)
    return EXIT_OK


def parse_size(text: str) -> tuple[int, int]:
    """``"1280x720"`` as (1280, 720); the empty text as that size.

    Raises:
        InputError: not of that form, or below 64 or above 8192.
    """
    match = re.fullmatch(r"([0-9]{1,5})[xX×]([0-9]{1,5})", text or "1280x720")
    size = (int(match[1]), int(match[2])) if match else (0, 0)
    if not 64 <= min(size) <= max(size) <= 8192:
        raise InputError(f"--size: expected width x height from 64 to 8192, as 1280x720, got {text}")
    return size


def _check_look(content: Content, look: Look) -> None:
    """A measure or a cloud that was asked for must be there."""
    if look.color == "error" and "error" not in content.measures:
        raise InputError("--color error: expected something to measure against; give --truth or --input")
    if (look.clim is not None or look.cmap) and look.color in ("template", "plain"):
        raise InputError(
            f"--clim and --cmap: expected a measure to colour by, got --color {look.color}; choose error, stretch, "
            "displacement or confidence"
        )
    if look.clim is not None and not (math.isfinite(look.clim[0]) and look.clim[0] < look.clim[1] < math.inf):
        raise InputError(f"--clim: expected two numbers, the lower first, got {look.clim[0]:g} {look.clim[1]:g}")
    if look.cmap:
        from matplotlib import colormaps

        if look.cmap not in colormaps:
            raise InputError(
                f"--cmap: expected a colour map of matplotlib, as viridis, magma, cividis, coolwarm or RdBu, "
                f"got {look.cmap}"
            )
    if look.cloud and all(pane.clouds is None for pane in content.panes):
        raise InputError("--cloud: expected the clouds that the result was made from; give --input")


def _check_camera(camera: Path | None, stand: Stand, html: Path | None, picture: Path | None) -> None:
    """A camera's file is all that says where to stand, and must be there where no window could write it."""
    from warpdef.apps.viewer.camera import Stand

    if camera is None:
        return
    if stand != Stand():
        raise InputError("--camera: expected it without --azimuth, --elevation and --zoom, got both; leave out one")
    if html is not None:
        raise InputError("--camera: expected a window or pictures, got --html; give the page --azimuth and --elevation")
    if picture is not None and not camera.is_file():
        raise InputError(f"--camera: {camera}: nothing is there; open the window with it and press k, which writes it")
    if not camera.parent.is_dir():
        raise InputError(f"--camera: {camera}: expected a file in a folder that is there; make it first")


def _write_html(content: Content, look: Look, path: Path, fps: float, frame: int, stand: Stand, name: str) -> None:
    from warpdef.apps.viewer.html import write_html

    started = time.perf_counter()
    write_html(content, look, path, fps, frame, stand, name)
    _report(path, started, f"{len(content)} frames")


def _write_pictures(
    scene: Scene,
    size: tuple[int, int],
    fps: float,
    frame: int,
    screenshot: Path | None,
    sheet: int,
    movie: Path | None,
    turntable: bool,
) -> None:
    from warpdef.apps.viewer.movie import movie_steps, save_picture, write_movie
    from warpdef.apps.viewer.sheet import contact_sheet

    try:
        count = len(scene.content)
        if screenshot is not None:
            started = time.perf_counter()
            with clean_stdout():
                scene.show(frame)
                save_picture(contact_sheet(scene, sheet, size) if sheet else scene.picture(), screenshot)
            _report(screenshot, started, f"{min(sheet, count)} frames" if sheet else f"frame {frame}")
        if movie is not None:
            started = time.perf_counter()
            with clean_stdout(), ProgressDisplay() as display:
                display.start("movie", len(movie_steps(count, fps, turntable)), "pictures")
                count = write_movie(scene, movie, fps, turntable, display)
            _report(movie, started, f"{count} pictures")
    finally:
        scene.close()


def _open_window(scene: Scene, fps: float, frame: int, title: str, camera: Path | None) -> None:
    from warpdef.apps.viewer.player import Player
    from warpdef.apps.viewer.screen import explain_loss
    from warpdef.apps.viewer.window import Window

    explain_loss(say, EXIT_ERROR)
    with clean_stdout():
        try:
            player = Player(len(scene.content), fps, frame)
            window = Window(scene, player, Path.cwd(), say, camera)
            window.open(f"warpdef: {title}")
            say("warpdef: h in the window lists the keys")
            window.play()
            window.run()
        finally:
            scene.close()


def _report(path: Path, started: float, what: str) -> None:
    print(f"{what}: {path} ({path.stat().st_size / 1e6:.1f} MB, {time.perf_counter() - started:.1f} s)")
