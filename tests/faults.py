"""Faults done to runs on purpose, and how many of them were survived: ``python tests/faults.py --trials 20``.

A run that was killed, stopped or starved must, gone on with, end with the bits of one that nothing happened to. Where
there can be no result it must say why in one line, with exit code 2. Neither may leave half a file behind.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import signal
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
from fault_bench import Bench
from foreign_headers import make_foreign

from warpdef.files.place_lock import claimed


def killed(bench: Bench) -> bool:
    """SIGKILL at some moment; then gone on with."""
    bench.begin(after=bench.moment())
    return bench.ends_well()


def killed_again_and_again(bench: Bench) -> bool:
    """SIGKILL at some moment of the run, of the run that goes on, and so on, five times."""
    for _ in range(5):
        if bench.go_on(after=0.6 * bench.moment()).code == 0:
            break
    return bench.ends_well()


def interrupted(bench: Bench) -> bool:
    """Ctrl-C at some moment: a whole result or none; then gone on with."""
    code = bench.begin(after=bench.moment(), with_signal=signal.SIGINT).code
    if code == 0:
        return bench.same()
    return code == 130 and bench.tidy() and bench.ends_well()


def told_to_end(bench: Bench) -> bool:
    """SIGTERM or SIGHUP at some moment: as Ctrl-C, with the signal's own exit code."""
    number = signal.SIGTERM if bench.rng.random() < 0.5 else signal.SIGHUP
    # As a shell starts a program; the process that this one is forked from may have been told to ignore it.
    code = bench.begin(
        after=bench.moment(), with_signal=number, prepare=lambda: signal.signal(number, signal.SIG_DFL)
    ).code
    if code == 0:
        return bench.same()
    # Before the program has its handlers the signal ends it as it ends any other.
    return code in (128 + number, -number) and bench.tidy() and bench.ends_well()


def no_one_listens(bench: Bench) -> bool:
    """Standard output, error or both closed, full, or a pipe whose reader has left: the same result."""
    chosen = [(1,), (2,), (1, 2)][bench.rng.integers(3)]
    way = bench.rng.integers(3)

    def deafen() -> None:
        for descriptor in chosen:
            if way == 0:
                os.close(descriptor)
            elif way == 1:
                os.dup2(os.open("/dev/full", os.O_WRONLY), descriptor)
            else:
                ear, mouth = os.pipe()
                os.dup2(mouth, descriptor)
                os.close(ear)
                os.close(mouth)

    return bench.begin(prepare=deafen).code == 0 and bench.same()


def checkpoint_foreign(bench: Bench) -> bool:
    """A checkpoint that is whole but says something else, as another warpdef's would: gone on with, or a reason."""
    bench.begin_and_die()
    make_foreign(bench.checkpoint, bench.rng)
    outcome = bench.resume()
    if outcome.code == 0:
        return bench.tidy() and bench.out.exists()
    return outcome.refused and bench.begin("--overwrite").code == 0 and bench.same()


def place_taken(bench: Bench) -> bool:
    """Another run holds the place, at the start or where one was killed: a reason that names it; then as if not."""
    if bench.rng.random() < 0.5:
        bench.begin_and_die()
    with claimed(bench.out):
        outcome = bench.go_on()
        if not outcome.refused or f"process {os.getpid()} on " not in outcome.said or bench.out.exists():
            return False
    return bench.ends_well()


def out_of_time(bench: Bench) -> bool:
    """``--max-seconds``: a whole result that says why it ended; then gone on with."""
    limit = bench.moment()
    code = bench.begin("--max-seconds", f"{limit + 1e-3:.4f}").code
    if code or not bench.tidy():
        return False
    stopped = json.loads((bench.out / "report.json").read_text())["stopped"]
    if stopped is None:
        return bench.same()
    return "time limit" in stopped and bench.resume().code == 0 and bench.same()


def disk_full(bench: Bench) -> bool:
    """No file may grow beyond some size, from 100 bytes to 1 MB: the result, or a reason why not; then gone on with."""
    size = int(10 ** bench.rng.uniform(2, 6))

    def starve() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))

    outcome = bench.begin(prepare=starve)
    if outcome.code == 0:
        return bench.same()
    return outcome.refused and bench.tidy() and not bench.out.exists() and bench.go_on().code == 0 and bench.same()


def read_only(bench: Bench) -> bool:
    """The folder can no longer be written to, from some moment on."""
    timer = threading.Timer(bench.moment(), bench.place.chmod, (0o500,))

    def as_nobody() -> None:
        if os.geteuid() == 0:
            os.setgroups([])
            os.setresuid(65534, 65534, 65534)

    bench.place.chmod(0o777)
    timer.start()
    outcome = bench.begin(prepare=as_nobody)
    timer.join()
    bench.place.chmod(0o777)
    if outcome.code == 0:
        # Read-only between the result and the removal of its checkpoint: that one stays, and the run says so.
        left = bench.checkpoint.exists()
        return bench.tidy() and bench.result() == bench.truth and left == ("cannot be removed" in outcome.said)
    if not outcome.refused or bench.out.exists():
        return False
    # Before the first checkpoint there is nothing to go on with: another run must do.
    again = bench.go_on() if bench.checkpoint.exists() else bench.begin()
    return again.code == 0 and bench.out.exists()


def input_gone(bench: Bench) -> bool:
    """Killed, and the input moved away: a reason; then gone on with from the new place."""
    bench.begin(after=bench.moment())
    if bench.out.exists() and not bench.checkpoint.exists():
        return bench.same()
    moved = bench.folder / f"moved{bench.source.suffix}"
    bench.source.rename(moved)
    try:
        if not bench.go_on().refused:
            return False
        if bench.checkpoint.exists() and bench.resume(str(moved)).code:
            return False
    finally:
        moved.rename(bench.source)
    return bench.ends_well()


def input_changed(bench: Bench) -> bool:
    """Stopped, and a point of one frame moved: a reason that names the frame."""
    kept = bench.source.read_bytes()
    bench.begin_and_die()
    arrays = dict(np.load(bench.source))
    arrays["points"] = arrays["points"].copy()
    frame = int(bench.rng.integers(len(arrays["points"])))
    arrays["points"][frame, 3, 1] *= 1.0001
    np.savez(bench.source, **arrays)
    try:
        outcome = bench.resume()
    finally:
        bench.source.write_bytes(kept)
    named = f"1 of {len(arrays['points'])} frames: {frame} (" in outcome.said
    return outcome.refused and named and bench.resume().code == 0 and bench.same()


def checkpoint_damaged(bench: Bench) -> bool:
    """A checkpoint cut short, or with one bit turned: never believed; begun anew."""
    bench.begin_and_die()
    data = bytearray(bench.checkpoint.read_bytes())
    if bench.rng.random() < 0.5:
        data = data[: int(bench.rng.integers(1, len(data)))]
    else:
        data[int(bench.rng.integers(len(data)))] ^= 1 << int(bench.rng.integers(8))
    bench.checkpoint.write_bytes(data)
    return bench.resume().refused and bench.begin("--overwrite").code == 0 and bench.same()


def no_numbers(bench: Bench) -> bool:
    """NaN or infinity put into the gradient's place at some iteration: undone, told, and the same twice."""
    iteration, bad = int(bench.rng.integers(1, 40)), float(bench.rng.choice([np.nan, np.inf]))

    def poison() -> None:
        from warpdef.fit.optimise import Optimiser

        step, left = Optimiser.iterate, [1]

        def poisoned(self: Optimiser) -> None:
            if self.done == iteration and left:
                left.pop()
                self.grids.u.fill_(bad)
            step(self)

        Optimiser.iterate = poisoned

    results = []
    for _ in range(2):
        if bench.begin(prepare=poison).code:
            return False
        told = " ".join(json.loads((bench.out / "report.json").read_text())["warnings"])
        results.append(bench.result())
        if "left the finite numbers and were undone" not in told or not bench.tidy():
            return False
        bench.empty()
    return results[0] == results[1] != bench.truth


def out_of_memory(bench: Bench) -> bool:
    """An allocation that fails, some way into the run: a reason that names what helps."""
    count = int(bench.rng.integers(1, 60))

    def starve() -> None:
        import warp as wp

        make, left = wp.zeros, [count]

        def zeros(*args, **kwargs):
            left[0] -= 1
            if not left[0]:
                raise RuntimeError("Failed to allocate 1073741824 bytes on device 'cuda:0'")
            return make(*args, **kwargs)

        wp.zeros = zeros

    outcome = bench.begin(prepare=starve)
    return outcome.refused and "--points" in outcome.said and bench.tidy() and bench.go_on().code == 0 and bench.same()


FAULTS: dict[str, Callable[[Bench], bool]] = {
    "killed (SIGKILL) at a random moment": killed,
    "killed five times over": killed_again_and_again,
    "Ctrl-C at a random moment": interrupted,
    "SIGTERM or SIGHUP at a random moment": told_to_end,
    "standard streams closed, full or without a reader": no_one_listens,
    "time limit at a random moment": out_of_time,
    "disk full (files limited to 100 B to 1 MB)": disk_full,
    "folder made read-only at a random moment": read_only,
    "killed, input moved away": input_gone,
    "killed, one point of one frame changed": input_changed,
    "checkpoint truncated or a bit turned": checkpoint_damaged,
    "checkpoint of another warpdef": checkpoint_foreign,
    "place taken by another run": place_taken,
    "NaN or infinity at a random iteration": no_numbers,
    "out of memory at a random allocation": out_of_memory,
}


def count_survived(bench: Bench, fault: Callable[[Bench], bool], trials: int) -> int:
    """Trials survived."""
    survived = 0
    for _ in range(trials):
        bench.empty()
        survived += fault(bench)
    return survived


def main() -> None:
    parser = argparse.ArgumentParser(description="Count faults survived.")
    parser.add_argument("--trials", type=int, default=20, help="of each fault")
    parser.add_argument("--kills", type=int, help="of the first fault, in place of --trials")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--source", type=Path, help="clouds (.npz) in place of the small problem")
    parser.add_argument("--only", help="faults whose name contains this")
    asked = parser.parse_args()
    total = np.zeros(2, dtype=int)
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        source = asked.source
        if source is not None:  # faults move and change it
            source = Path(shutil.copy(source, Path(folder) / source.name))
        bench = Bench(Path(folder), np.random.default_rng(asked.seed), source)
        print(f"an undisturbed run takes {bench.seconds:.2f} s\n\n| fault | tried | survived |\n| --- | --- | --- |")
        for name, fault in FAULTS.items():
            if asked.only is None or asked.only in name:
                trials = asked.kills if fault is killed and asked.kills else asked.trials
                survived = count_survived(bench, fault, trials)
                total += trials, survived
                print(f"| {name} | {trials} | {survived} |", flush=True)
    print(f"| all | {total[0]} | {total[1]} |")
    raise SystemExit(int(total[0] != total[1]))


if __name__ == "__main__":
    main()
