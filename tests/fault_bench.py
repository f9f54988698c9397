"""A problem on which runs can be disturbed: children forked off one process that has everything loaded.

A trial takes a fraction of a second that way. See ``faults.py`` for what is done to them.
"""

from __future__ import annotations

import os
import shutil
import signal
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

SMALL = """\
keyframe.choice = "1"
grid.levels = 4
optimiser.iterations = 120
optimiser.warmup = 10
refine.iterations = 10
template.mesh = "{mesh}"
"""


@dataclass(frozen=True)
class FaultOutcome:
    """What a run left: exit code (negative: the signal that ended it) and what it said on standard error."""

    code: int
    said: str

    @property
    def refused(self) -> bool:
        """Exit code 2, and a reason on the last line, without a traceback."""
        lines = self.said.strip().splitlines()
        return self.code == 2 and bool(lines) and lines[-1].startswith("warpdef: ") and "Traceback" not in self.said


class Bench:
    """A problem, the result of an undisturbed run, and a place for disturbed ones.

    Args:
        folder: empty, for everything. source: clouds of your own; None: a small turning ellipsoid.
    """

    def __init__(self, folder: Path, rng: np.random.Generator, source: Path | None = None) -> None:
        self.folder, self.rng = folder, rng
        self.source, self.flags = (source, []) if source else self._small_problem()
        self.place = folder / "place"
        self.out = self.place / "out"
        self._load_everything()
        self.empty()
        start = time.perf_counter()
        done = self.begin()
        self.seconds = time.perf_counter() - start
        if done.code:
            raise SystemExit(done.said)
        self.truth = self.result()

    def result(self) -> list[bytes]:
        """Mesh and loss curve of the run folder, without the frames' names, which tell where the input lay."""
        meshes = np.load(self.out / "sequence.npz")
        arrays = [meshes[name].tobytes() for name in ("vertices", "faces", "keyframe")]
        return [*arrays, (self.out / "steps.jsonl").read_bytes()]

    def _load_everything(self) -> None:
        """Here, so that children have it: modules, kernels compiled and in memory."""
        from warpdef.apps import main

        # By a command, for what it imports late as well: who may not read the folder of packages cannot do so later.
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            rounds = ["--optimiser.iterations", "20", "--refine.iterations", "1", "--threads", "1", "--device", "cpu"]
            main.run(["reconstruct", str(self.source), "-o", str(self.folder / "warm"), *self.flags, *rounds])
        shutil.rmtree(self.folder / "warm")

    def _small_problem(self) -> tuple[Path, list[str]]:
        import synthetic

        from warpdef.files import write_ply

        moving = synthetic.turning_ellipsoid(4, 300, np.random.default_rng(1))
        np.savez(self.folder / "clouds.npz", points=np.stack(moving.clouds), normals=np.stack(moving.normals))
        write_ply(self.folder / "mesh.ply", moving.vertices[1], moving.faces)
        (self.folder / "small.toml").write_text(SMALL.format(mesh=self.folder / "mesh.ply"))
        return self.folder / "clouds.npz", ["--config", str(self.folder / "small.toml")]

    def empty(self) -> None:
        """Leave nothing where results go."""
        shutil.rmtree(self.place, ignore_errors=True)
        self.place.mkdir()

    @property
    def checkpoint(self) -> Path:
        return self.place / ".out.checkpoint"

    def begin(self, *more: str, **how) -> FaultOutcome:
        """A run from the start."""
        return self._run([str(self.source), "-o", str(self.out), *self.flags, *more], **how)

    def resume(self, *more: str, **how) -> FaultOutcome:
        """A run from the checkpoint."""
        return self._run(["--resume", str(self.out), *more], **how)

    def go_on(self, **how) -> FaultOutcome:
        """From the checkpoint if there is one, else from the start, as a person would."""
        return self.resume(**how) if self.checkpoint.exists() else self.begin(**how)

    def ends_well(self) -> bool:
        """Whether the run, gone on with unless it was through, ends with the bits of the undisturbed one."""
        through = self.out.exists() and not self.checkpoint.exists()
        return (through or self.go_on().code == 0) and self.same()

    def _run(
        self,
        arguments: list[str],
        after: float | None = None,
        with_signal: int = signal.SIGKILL,
        prepare: Callable[[], None] | None = None,
    ) -> FaultOutcome:
        """``warpdef reconstruct`` in a child that runs ``prepare`` first and gets a signal ``after`` some seconds."""
        ear, mouth = os.pipe()
        child = os.fork()
        if child == 0:
            code = 99
            try:
                os.dup2(mouth, 1)
                os.dup2(mouth, 2)
                os.close(mouth)
                if prepare is not None:
                    prepare()
                from warpdef.apps.main import run

                common = ["--device", "cpu", "--threads", "1", "--checkpoint-seconds", "0"]
                code = run(["reconstruct", *arguments, *common])
            except BaseException:
                import traceback

                traceback.print_exc()
            finally:
                os._exit(code)
        os.close(mouth)
        timer = threading.Timer(after or 0.0, os.kill, (child, with_signal))
        if after is not None:
            timer.start()
        with open(ear, encoding="utf-8", errors="replace") as stream:
            said = stream.read()  # until the child ends
        if after is not None:
            timer.cancel()
            timer.join()
        return FaultOutcome(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), said)

    def begin_and_die(self) -> None:
        """A run from the start, killed as soon as it has written so many checkpoints."""
        count = int(self.rng.integers(1, 15))

        def die_then() -> None:
            from warpdef.fit import saving
            from warpdef.fit.saving import Saver

            saving._SHARE = 1e9  # however slow the disk, one at every look
            save, left = Saver.save, [count]

            def last_save(self: Saver, facts: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> str:
                told = save(self, facts, arrays)
                left[0] -= 1
                if not left[0]:
                    os.kill(os.getpid(), signal.SIGKILL)
                return told

            Saver.save = last_save

        self.begin(prepare=die_then)

    def moment(self) -> float:
        """Some time of a run, seconds."""
        return self.rng.uniform(0.0, self.seconds)

    def same(self) -> bool:
        """Whether the result is, bit for bit, that of the undisturbed run, and nothing else lies beside it."""
        # A lock that a killed process left is no one's: the next run takes it over.
        return {p.name for p in self.place.iterdir()} - {".out.lock"} == {"out"} and self.truth == self.result()

    def tidy(self) -> bool:
        """Whether nothing lies there but a whole result or a checkpoint."""
        from warpdef.files.saved_run import load_run

        names = {p.name for p in self.place.iterdir()}
        if "out" in names:
            load_run(self.out)
        return names <= {"out", ".out.checkpoint", ".out.lock"}
