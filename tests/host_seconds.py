"""Processor seconds of a whole run, piece by piece: what stands around the fit, and the fit.

    python tests/host_seconds.py CLOUDS [flags of warpdef reconstruct]

It reconstructs CLOUDS on one thread, as the program does, into a folder that is thrown away, and prints a table of the
pieces in ``PIECES``. A piece has what it takes itself, without the pieces called in it; imports, wherever they happen,
are one of their own. What belongs to no piece is the rest of its phase. The first run may compile kernels.
"""

from __future__ import annotations

import builtins
import functools
import importlib
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

PIECES = {
    "warpdef.prepare:read_input": "reading",
    "warpdef.device:start_warp": "Warp's start",
    "warpdef.prepare:drop_far": "far points",
    "warpdef.prepare:cut_static_planes": "static planes",
    "warpdef.prepare:drop_strays": "strays",
    "warpdef.prepare:tell_static_parts": "static parts",
    "warpdef.prepare:leave_out_odd": "odd frames",
    "warpdef.cube_clouds:viewing_direction": "normals of all clouds",
    "warpdef.cube_clouds:CubeClouds.normals": "normals of all clouds",
    "warpdef.pipeline:find_template": "template: the rest",
    "warpdef.template.choose:rank_keyframes": "template: keyframe",
    "warpdef.template.build:estimate_normals": "template: normals",
    "warpdef.template.build:repair_normals": "template: normals",
    "warpdef.template.choose:load_backend": "template: the rest",
    "warpdef.template.build:find_trimming": "template: trimming",
    "warpdef.template.build:_keep_objects": "template: objects",
    "warpdef.template.choose:judge": "template: gate",
    "warpdef.pipeline:Problem": "compile: clouds and template laid out",
    "warpdef.pipeline:Optimiser": "compile: the descent made",
    "warpdef.pipeline:Refinement": "compile: the vertex stage made",
    "warpdef.fit.optimise:Optimiser.prepare": "compile: kernels loaded, commands recorded",
    "warpdef.fit.refine:Refinement.prepare": "compile: kernels loaded, commands recorded",
    "warpdef.fit.run:FitRun.descend": "fit: descent",
    "warpdef.fit.run:FitRun.refine": "fit: vertex stage",
    "warpdef.pipeline:find_verdicts": "verdicts: the rest",
    "warpdef.quality.coverage:closest_on_surface": "verdicts: distances to the surface",
    "warpdef.quality.assess:measure_coverage": "verdicts: coverage",
    "warpdef.quality.assess:inner_share": "verdicts: inner walls",
    "warpdef.quality.assess:flicker": "verdicts: flicker",
    "warpdef.quality.assess:vertex_confidence": "verdicts: confidence",
    "warpdef.quality.shape:ReferenceShape.compare": "verdicts: shape",
    "warpdef.files.run_folder:RunFolder.save": "writing",
}
"""Functions where they are called from, and the name of the piece."""


class Pieces:
    """Processor seconds by piece."""

    def __init__(self) -> None:
        self.seconds = {"interpreter": time.process_time()}
        self._running, self._since = ["the rest"], self.seconds["interpreter"]

    def lap(self) -> None:
        """Give the running piece what it took since the last lap."""
        now, name = time.process_time(), self._running[-1]
        self.seconds[name] = self.seconds.get(name, 0.0) + now - self._since
        self._since = now

    @contextmanager
    def piece(self, name: str) -> Iterator[None]:
        """The block is part of that piece, and of none around it."""
        self.lap()
        self._running.append(name)
        try:
            yield
        finally:
            self.lap()
            self._running.pop()

    def timed(self, function: Callable, name: str) -> Callable:
        """The function as that piece."""

        @functools.wraps(function)
        def wrapped(*args: Any, **kwargs: Any) -> Any:
            with self.piece(name):
                return function(*args, **kwargs)

        return wrapped

    def time_imports(self) -> None:
        """Let every import statement be of the piece ``imports``."""
        plain = builtins.__import__

        def wrapped(name: str, *args: Any, **kwargs: Any) -> Any:
            # Most only look up what is there: these would fill the table with our own time.
            if self._running[-1] == "imports" or name in sys.modules:
                return plain(name, *args, **kwargs)
            with self.piece("imports"):
                return plain(name, *args, **kwargs)

        builtins.__import__ = wrapped

    def time_pieces(self) -> None:
        """Put every function of ``PIECES`` under the clock."""
        for place, name in PIECES.items():
            module, path = place.split(":")
            *owners, attribute = path.split(".")
            owner = functools.reduce(getattr, owners, importlib.import_module(module))
            timed = self.timed(getattr(owner, attribute), name)
            setattr(owner, attribute, self._libraries_timed(timed) if attribute == "load_backend" else timed)

    def _libraries_timed(self, load: Callable[[str], Any]) -> Callable[[str], Any]:
        """What a backend consists of, as pieces."""

        def loaded(name: str) -> Any:
            backend = load(name)
            poisson = self.timed(backend.poisson, "template: Poisson")
            return replace(backend, poisson=poisson, remesh=self.timed(backend.remesh, "template: even triangles"))

        return loaded

    def table(self) -> str:
        """Markdown, in the order in which pieces began; sums at the end."""
        fit = sum(s for name, s in self.seconds.items() if name.startswith("fit:"))
        template = sum(s for name, s in self.seconds.items() if name.startswith("template:"))
        total = sum(self.seconds.values())
        sums = {"all": total, "around the fit": total - fit, "of which the template": template}
        rows = [*self.seconds.items(), *sums.items()]
        return "\n".join(["| piece | CPU s |", "| --- | --- |", *(f"| {name} | {s:.2f} |" for name, s in rows)])


def main(arguments: list[str]) -> None:
    pieces = Pieces()
    pieces.time_imports()
    with pieces.piece("imports"):
        from warpdef.apps.main import run

        pieces.time_pieces()
    with tempfile.TemporaryDirectory() as folder:
        code = run(["reconstruct", *arguments, "--threads", "1", "-o", str(Path(folder) / "result"), "--quiet"])
    pieces.lap()
    if code:
        sys.exit(code)
    print(pieces.table())


if __name__ == "__main__":
    main(sys.argv[1:])
