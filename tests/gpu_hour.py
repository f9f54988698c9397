"""The first hour with a CUDA device: ten parts, each under ten minutes and in a process of its own.

    python tests/gpu_hour.py                           # everything on the first CUDA device, into gpu-hour/
    python tests/gpu_hour.py --only a,c                # these parts; those done before are not done again
    python tests/gpu_hour.py --device cpu --quick      # to see that everything runs

NumPy, SciPy, pytest and Warp are enough. The sequence is the walking figure, whose mesh at the keyframe is the
template; ``--data TRUTH.npz`` (vertices, faces) takes another one. Results stand in ``hour.json`` and, as a table, in
``hour.md``.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from hour_book import Book, Row, Skip  # noqa: E402 - the folders above come first
from hour_job import Job  # noqa: E402

from warpdef.errors import WarpdefError  # noqa: E402

LIMIT_S = 570.0
_DEATH_OF_PARENT = 1  # PR_SET_PDEATHSIG
TITLES = {
    "a": "driver, device, memory pools, compilation from nothing",
    "b": "adds to one address, nodes that do nothing",
    "c": "tests that have a device",
    "d": "memory accesses of a fit of four frames",
    "e": "one fit, every way: distances and quality",
    "f": "an iteration, a round, memory",
    "g": "kernels one by one",
    "h": "the largest problem",
    "i": "going on, going back, being interrupted",
    "j": "many frames followed outwards",
}


def run_here(letter: str, job: Job) -> list[Row]:
    """A part, in this process."""
    import hour_fits
    import hour_machine

    for module in (hour_machine, hour_fits):
        if hasattr(module, f"part_{letter}"):
            return getattr(module, f"part_{letter}")(job)
    raise KeyError(letter)


def run_apart(letter: str, arguments: list[str], folder: Path, limit_s: float = LIMIT_S) -> list[Row]:
    """A part in a process of its own, ended with all that it started when its time is up.

    Raises:
        Skip: it has nothing to work with. TimeoutError, RuntimeError: it did not end in time, or failed.
    """
    answer, log = folder / f"part-{letter}.json", folder / f"part-{letter}.log"
    folder.mkdir(parents=True, exist_ok=True)
    answer.unlink(missing_ok=True)
    command = [sys.executable, str(Path(__file__).resolve()), *arguments, "--part", letter]
    with log.open("w", encoding="utf-8") as said:
        process = subprocess.Popen(
            command, stdout=said, stderr=subprocess.STDOUT, start_new_session=True, env=_environment()
        )
        try:
            code = process.wait(limit_s)
        except subprocess.TimeoutExpired:
            raise TimeoutError(f"not done after {limit_s:g} s, see {log}") from None
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
    if not answer.exists():
        tail = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()[-1:] or ["it said nothing"]
        raise RuntimeError(f"ended with code {code}: {tail[0]:.300} (all of it in {log})")
    found = json.loads(answer.read_text(encoding="utf-8"))
    if "skip" in found:
        raise Skip(found["skip"])
    return found["rows"]


def _environment() -> dict[str, str]:
    """For processes that a part starts itself: they find the project as this one does, installed or not."""
    paths = [str(ROOT), str(ROOT / "tests"), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


def end_with_parent() -> None:
    """A part ends with the program that began it, however that was ended, and with it all that it started itself."""
    if os.getpgrp() != os.getpid():
        return  # begun by hand: its group is not its own
    signal.signal(signal.SIGTERM, lambda *_: os.killpg(os.getpgrp(), signal.SIGKILL))
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_DEATH_OF_PARENT, signal.SIGTERM)


def _answer(letter: str, job: Job) -> None:
    found: dict[str, Any]
    try:
        found = {"rows": run_here(letter, job)}
    except Skip as why:
        found = {"skip": str(why)}
    text = json.dumps(found, default=float)  # before the file is opened: half an answer is none
    (job.folder / f"part-{letter}.json").write_text(text, encoding="utf-8")


def main(arguments: list[str] | None = None) -> int:
    """0: every part asked for is done or has nothing to work with here; 1: one failed; 2: no such device."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda", help="cuda, cuda:N or cpu")
    parser.add_argument("--quick", action="store_true", help="tiny sizes, to see that everything runs")
    parser.add_argument("--only", default="", help="letters of the parts to do; all if not given")
    parser.add_argument("--again", action="store_true", help="do finished parts again")
    parser.add_argument("--out", type=Path, default=Path("gpu-hour"), help="folder of the results")
    parser.add_argument("--data", type=Path, help="npz with vertices (T, V, 3) and faces (F, 3) instead of the figure")
    parser.add_argument("--limit", type=float, default=LIMIT_S, help="seconds that a part may take")
    parser.add_argument("--part", help=argparse.SUPPRESS)
    chosen = parser.parse_args(arguments)
    job = Job(chosen.device, chosen.quick, chosen.out.resolve(), chosen.data)
    if chosen.part:
        end_with_parent()
        _answer(chosen.part, job)
        return 0
    given = ["--device", chosen.device, "--out", str(job.folder)]
    given += ["--quick"] if chosen.quick else []
    given += ["--data", str(chosen.data.resolve())] if chosen.data else []
    command = " ".join(["python tests/gpu_hour.py", *(sys.argv[1:] if arguments is None else arguments)])
    try:
        facts = job.facts()
    except WarpdefError as error:
        print(f"gpu_hour: error: {error}", file=sys.stderr)
        return 2
    book = Book(job.folder, TITLES, facts, lambda letter: run_apart(letter, given, job.folder, chosen.limit), command)
    try:
        well = book.go(chosen.only, chosen.again)
    except ValueError as error:
        parser.error(str(error))
    print(f"\n{book.table()}\n\nkept in {job.folder}")
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main())
