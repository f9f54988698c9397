"""``reconstruct --live``: the run's side of a window that shows the mesh while it is optimised.

The window is a process of its own (``live_window``), so that neither drawing nor a crash of the graphics library can
hold up or end the run. They share a folder: ``scene.npz``, written once; ``vertices``, the mesh as raw numbers; and
``control``, a few integers. The run writes only after the window has taken what was there, at most four times a second,
and for a small share of its time.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpdef.apps.viewer.probe import explained
from warpdef.apps.viewer.screen import has_screen

if TYPE_CHECKING:
    from warpdef.progress import Progress
    from warpdef.sequence import PointSequence

GIVEN, TAKEN, STOP, ITERATION, ITERATIONS, PHASE = range(6)
"""Places in ``control``: counts of what was written and read, the end, and what the title says."""
PHASES = ("optimise", "refine")
POINTS_MAX = 20_000
"""Points of a cloud that are shown."""

_SECONDS = 0.25  # between two hand-outs, or longer:
_SHARE = 0.015  # of the run's time they may take
_PATIENCE = 3.0  # seconds in which the window may close by itself


class LiveView:
    """Call it with every ``Progress``; close it at the end. It never raises on account of the window.

    Args:
        sequence: the clouds, shown under the mesh at a key's press. title: of the window. say: told what happened.
        up: the axis that points up.
    """

    def __init__(self, sequence: PointSequence, title: str, say: Callable[[str], None], up: str = "y") -> None:
        self._sequence, self._say, self._up = sequence, say, up
        self._process: subprocess.Popen | None = None
        self._folder: Path | None = None
        self._control: Any = None
        self._vertices: Any = None
        self._next = 0.0
        if sys.platform.startswith("linux") and not has_screen():
            self._give_up("no screen for a window (DISPLAY is not set)")
            return
        self._folder = Path(tempfile.mkdtemp(prefix="warpdef-live-"))
        with open(self._folder / "errors", "wb") as errors:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "warpdef.apps.viewer.live_window", str(self._folder), title, str(os.getpid())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                start_new_session=True,  # Ctrl-C is for the run
            )

    def __call__(self, progress: Progress) -> None:
        """Hand the mesh out if there is one, the window has taken the last, and it is time."""
        if self._process is None:
            return
        if self._process.poll() is not None:
            self._note_end()
            return
        now = time.monotonic()
        if progress.meshes is None or now < self._next:
            return
        if self._control is not None and self._control[TAKEN] != self._control[GIVEN]:
            return
        try:
            self._give(progress)
        except OSError as error:  # a full disk, for one
            self._give_up(f"the mesh could not be handed over ({error})")
        done = time.monotonic()
        self._next = done + max(_SECONDS, (done - now) / _SHARE)

    def close(self) -> None:
        """Close the window and tidy up."""
        if self._process is not None:
            if self._control is not None:
                self._control[STOP] = 1
                try:
                    self._process.wait(_PATIENCE)
                except subprocess.TimeoutExpired:
                    pass
            if self._process.poll() is None:
                self._process.kill()
            if self._process.wait() > 0 and self._control is not None:
                self._note_end()
        self._process = self._control = self._vertices = None
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)

    def _give(self, progress: Progress) -> None:
        import numpy as np

        assert progress.meshes is not None and self._folder is not None
        meshes = progress.meshes()
        if self._control is None:
            self._vertices, self._control = self._write_scene(meshes, self._folder)
        self._vertices[:] = meshes.vertices
        self._control[ITERATION], self._control[ITERATIONS] = progress.iteration, progress.iterations
        self._control[PHASE] = PHASES.index(progress.phase) if progress.phase in PHASES else 0
        self._control[GIVEN] += np.int64(1)

    def _write_scene(self, meshes: Any, folder: Path) -> tuple[Any, Any]:
        """Write what stays; returns the arrays that are shared with the window: vertices and control."""
        import numpy as np

        clouds = self._sequence.all_frames()
        arrays: dict[str, Any] = {
            f"cloud_{t:04d}": p[:: -(-len(p) // POINTS_MAX) or 1].astype("f4") for t, p in enumerate(clouds)
        }
        arrays |= {"faces": meshes.faces, "shape": np.array(meshes.vertices.shape), "up": np.array(self._up)}
        arrays["names"] = np.array(self._sequence.frame_names, dtype=np.str_)
        vertices = np.memmap(folder / "vertices", dtype="f4", mode="w+", shape=meshes.vertices.shape)
        control = np.memmap(folder / "control", dtype=np.int64, mode="w+", shape=(8,))
        np.savez(folder / "scene.partial.npz", **arrays)
        os.replace(folder / "scene.partial.npz", folder / "scene.npz")
        return vertices, control

    def _note_end(self) -> None:
        """The window is gone: closed by its user, or by what it says."""
        assert self._process is not None and self._folder is not None
        code = self._process.returncode
        if code == 0:
            self._process = None
            return
        text = (self._folder / "errors").read_text(errors="replace")
        self._give_up(explained(code, text, window=True))

    def _give_up(self, why: str) -> None:
        self._say(f"warpdef: --live: {why}; the run goes on without a window")
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        self._process = None
