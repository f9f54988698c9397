"""The window of ``reconstruct --live``, in a process of its own; see ``live``.

It runs when nothing else wants the processor, and draws no oftener than a small share of the machine allows: the
optimiser must not wait for it.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any

from warpdef.apps.console import say
from warpdef.apps.viewer.live import GIVEN, ITERATION, ITERATIONS, PHASE, PHASES, STOP, TAKEN

SHARE = 0.02
"""Of all the processor time of the machine, at most."""
_IDLE_SECONDS = 0.03
_FPS = 6.0


def main(arguments: list[str]) -> int:
    """Show what the run in folder ``arguments[0]`` hands out until it ends or the window is closed."""
    folder, title, parent = Path(arguments[0]), arguments[1], int(arguments[2])
    os.nice(10)
    import pyvista  # noqa: F401  the longest part of the start; the run has its template to make meanwhile

    step_aside()
    while not (folder / "scene.npz").exists():
        if os.getppid() != parent:
            return 0
        time.sleep(_IDLE_SECONDS)
    show(folder, title, lambda: os.getppid() == parent)
    return 0


def step_aside() -> None:
    """Let every other process go first."""
    os.nice(19)  # no more than 19 in all
    if hasattr(os, "SCHED_IDLE"):
        try:
            os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
        except OSError:
            pass  # nice alone, then


class Allowance:
    """When the next picture may be drawn, by the processor time that the last ones took."""

    def __init__(self, share: float, now: float, used: float) -> None:
        self.share, self._since, self._used = share, now, used

    def wait(self, now: float, used: float) -> float:
        """Seconds until the processor time ``used`` so far is within the share; a long rest is not saved up."""
        due = self._since + (used - self._used) / self.share
        if due <= now:
            self._since, self._used = now, used
        return max(due - now, 0.0)


def show(folder: Path, title: str, goes_on: Any) -> None:
    """Open the window and keep it up to date."""
    import numpy as np

    from warpdef.apps.viewer.actors import Look
    from warpdef.apps.viewer.content import Content, Pane
    from warpdef.apps.viewer.player import Player
    from warpdef.apps.viewer.scene import Scene
    from warpdef.apps.viewer.window import Window
    from warpdef.mesh import MeshSequence

    with np.load(folder / "scene.npz") as stored:
        arrays = dict(stored)
    control = np.memmap(folder / "control", dtype=np.int64, mode="r+", shape=(8,))
    shared = np.memmap(folder / "vertices", dtype="f4", mode="r", shape=tuple(arrays["shape"]))
    clouds = [arrays[name] for name in sorted(arrays) if name.startswith("cloud_")]
    meshes = MeshSequence(np.array(shared), arrays["faces"])
    # Colours stay with the vertices from the first mesh on.
    pane = Pane("reconstruction", meshes, clouds, rest=meshes.vertices[0])
    content = Content([pane], tuple(arrays["names"].tolist()), str(arrays["up"]))
    scene = Scene(content, off_screen=False, size=(960, 720), look=Look())
    try:
        player = Player(len(content), _FPS)
        window = Window(scene, player, Path.cwd(), say)
        window.open(f"warpdef: {title}")
        window.play()
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        allowance = Allowance(SHARE * cores, time.monotonic(), time.process_time())
        while window.is_open and not control[STOP] and goes_on():
            rest = allowance.wait(time.monotonic(), time.process_time())
            if rest > 0.0:
                time.sleep(min(rest, _IDLE_SECONDS))
                continue
            given = int(control[GIVEN])
            if given != control[TAKEN]:
                phase = PHASES[int(control[PHASE])]
                pane.title = f"{phase}: {control[ITERATION]} of {control[ITERATIONS]}"
                scene.set_vertices(0, MeshSequence(np.array(shared), arrays["faces"]))
                window.redraw()
                control[TAKEN] = given
            if not window.spin(time.monotonic()):
                time.sleep(_IDLE_SECONDS)
    finally:
        scene.close()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
