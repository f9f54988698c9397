"""Files without a window: a screenshot, a movie, a turntable."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpdef.errors import InputError, MissingPackageError

if TYPE_CHECKING:
    import numpy as np

    from warpdef.apps.viewer.scene import Scene
    from warpdef.progress import Callback

MOVIES = (".mp4", ".gif")
PICTURES = (".png", ".jpg", ".jpeg")
_MEASURED = 3  # pictures that a forecast is made from
TURN_SECONDS = 6.0
"""Shortest time of a turntable's round."""


def check_outputs(screenshot: Path | None, movie: Path | None, html: Path | None, overwrite: bool) -> None:
    """Check names, places and packages before anything is read.

    Raises:
        InputError: an unknown suffix, no such folder, or a place that is taken.
        MissingPackageError: .mp4 without its package.
    """
    for path, suffixes in ((screenshot, PICTURES), (movie, MOVIES), (html, (".html", ".htm"))):
        if path is None:
            continue
        if path.suffix.lower() not in suffixes:
            raise InputError(f"{path}: unknown suffix '{path.suffix}'; expected one of {' '.join(suffixes)}")
        if not path.parent.is_dir():
            raise InputError(f"{path}: expected a file in a folder that is there, got '{path.parent}'; make it first")
        if path.is_dir() or (path.exists() and not overwrite):
            raise InputError(f"{path}: already exists; choose another place, or replace it with --overwrite")
    if movie is not None and movie.suffix.lower() == ".mp4":
        _require_ffmpeg()


def save_picture(picture: np.ndarray, path: Path) -> None:
    """Write (height, width, 3) uint8, or 4 with the opacity as .png; the file appears at once or not at all."""
    from PIL import Image

    from warpdef.files.disk import replacing

    with replacing(path) as stream:
        Image.fromarray(picture).save(stream, format="PNG" if path.suffix.lower() == ".png" else "JPEG")


def movie_steps(total: int, fps: float, turntable: bool) -> list[tuple[int, float]]:
    """Frame and camera turn in degrees of each picture of a movie.

    A turntable repeats the motion, whole, until its round has taken at least ``TURN_SECONDS``.
    """
    if not turntable:
        return [(frame, 0.0) for frame in range(total)]
    length = total * max(1, math.ceil(TURN_SECONDS * fps / total))
    return [(k % total, 360.0 * k / length) for k in range(length)]


def write_movie(scene: Scene, path: Path, fps: float, turntable: bool, tell: Callback | None = None) -> int:
    """Write .mp4 or .gif; the file appears at once or not at all. Returns the number of pictures.

    Args: tell: called with every picture, and after the first few with how long all of them will take.

    Raises:
        InputError: the file cannot be written.
        MissingPackageError: .mp4 without its package.
    """
    from warpdef.progress import Progress

    steps = movie_steps(len(scene.content), fps, turntable)

    def pictures() -> Iterator[np.ndarray]:
        times = []
        for done, (frame, turn) in enumerate(steps):
            times.append(time.perf_counter())
            if tell is not None:
                tell(Progress("movie", done, len(steps), message=movie_forecast(times, len(steps))))
            if turntable:
                scene.place_camera(turn, all_round=True)
            scene.show(frame)
            yield scene.picture()

    if path.suffix.lower() == ".gif":
        _write_gif(pictures(), path, fps)
    else:
        _write_mp4(pictures(), path, fps)
    return len(steps)


def movie_forecast(times: Sequence[float], count: int) -> str:
    """How long ``count`` pictures will take in all, said once, when a few are made; empty at other times.

    Args: times: when each picture so far was begun, seconds. What is set up with the first one is no measure.
    """
    if len(times) != _MEASURED + 2 or count < 2 * _MEASURED:
        return ""
    each = (times[-1] - times[1]) / _MEASURED
    return f"about {duration(times[1] - times[0] + each * (count - 1))} for {count} pictures"


def duration(seconds: float) -> str:
    """Seconds, minutes or hours, as exact as a forecast is."""
    if seconds < 90.0:
        return f"{max(seconds, 1.0):.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


def _write_gif(pictures: Iterator[np.ndarray], path: Path, fps: float) -> None:
    from PIL import Image

    from warpdef.files.disk import replacing

    images: list[Any] = []
    for picture in pictures:
        # One palette for all pictures: no flicker of colours between them.
        palette = images[0] if images else None
        image = Image.fromarray(picture)
        images.append(
            image.quantize(255) if palette is None else image.quantize(255, palette=palette, dither=Image.Dither.NONE)
        )
    # A .gif counts hundredths of a second; rounding the sum keeps the whole as long as it should be.
    ticks = [round(100.0 * k / fps) for k in range(len(images) + 1)]
    durations = [max(2, b - a) * 10 for a, b in zip(ticks, ticks[1:], strict=False)]
    with replacing(path) as stream:
        images[0].save(
            stream, format="GIF", save_all=True, append_images=images[1:], duration=durations, loop=0, disposal=1
        )


def _write_mp4(pictures: Iterator[np.ndarray], path: Path, fps: float) -> None:
    from warpdef.files.disk import reason, sibling

    imageio = _require_ffmpeg()
    temporary = sibling(path, "partial.mp4")
    try:
        # yuv420p is what browsers and players read; macro_block_size 2 keeps the size that was asked for.
        with imageio.get_writer(temporary, format="FFMPEG", fps=fps, macro_block_size=2, quality=8) as writer:
            for picture in pictures:
                writer.append_data(picture)
        temporary.replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({reason(error)}); choose another place or free space") from None
    finally:
        temporary.unlink(missing_ok=True)


def _require_ffmpeg() -> Any:
    try:
        import imageio.v2 as imageio
        import imageio_ffmpeg  # pyright: ignore[reportMissingImports] - the extra [movie], which checks need not have

        imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError) as error:
        raise MissingPackageError(
            f".mp4 needs imageio with ffmpeg ({error!s:.120}); install it: pip install 'warpdef[movie]', or take .gif"
        ) from error
    return imageio
