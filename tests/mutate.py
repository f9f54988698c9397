"""Damage valid inputs in thousands of ways and hold warpdef to its promises about bad input.

    python tests/mutate.py --count 10000

Every try writes one sample (``mutation_samples``) with one file damaged, runs the real command on it, with a stand-in
for the method itself, and demands: it ends within 5 s of processor time (a busy machine is no fault) with exit code 0
or 2; code 2 says one line ``warpdef: error: ...``, and nothing looks like a traceback; memory grows by at most 10 times
the input and 256 MiB; nothing is written but the result; nothing of a file's contents is executed. Try i of a seed is
always the same: ``--only I`` repeats it and shows what it says.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from process_probe import peak_memory, reset_peak, speaks

SECONDS_MAX = 5.0  # of processor time
PATIENCE_MAX = 120.0  # of the clock: longer means that it waits for something
MEMORY_FACTOR, MEMORY_CONSTANT = 10, 256 << 20
_WATCHDOG = 30.0  # seconds of its own without a word after which a worker is taken for hung inside a library
_ADDRESS_SPACE = 12 << 30


@dataclass(frozen=True)
class MutantOutcome:
    """What one try did. problem: empty if all promises were kept. grown: bytes of memory beyond the start."""

    sample: str
    how: str
    code: int | None
    seconds: float
    grown: int
    problem: str
    said: str


def mutated(data: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    """One damage, drawn at random, and its name."""
    kind = rng.choice(list(_MUTATIONS))
    return str(kind), _MUTATIONS[kind](data, rng)


def _span(data: bytes, rng: np.random.Generator, longest: int = 64) -> tuple[int, int]:
    start = int(rng.integers(0, max(len(data), 1)))
    return start, min(len(data), start + int(rng.integers(1, longest)))


def _flip(data: bytes, rng: np.random.Generator) -> bytes:
    broken = bytearray(data)
    for at in rng.integers(0, len(data), size=rng.integers(1, 9)):
        broken[at] = rng.integers(0, 256)
    return bytes(broken)


def _cut_out(data: bytes, rng: np.random.Generator) -> bytes:
    start, end = _span(data, rng, 400)
    return data[:start] + data[end:]


def _repeat(data: bytes, rng: np.random.Generator) -> bytes:
    start, end = _span(data, rng, 400)
    return data[:end] + data[start:end] * int(rng.integers(1, 50)) + data[end:]


def _noise(data: bytes, rng: np.random.Generator) -> bytes:
    start, end = _span(data, rng, 400)
    return data[:start] + rng.bytes(end - start) + data[end:]


def _insert(data: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(0, len(data) + 1))
    piece = rng.choice(np.array(_PIECES, dtype=object))
    return data[:at] + piece + data[at:]


def _number(data: bytes, rng: np.random.Generator) -> bytes:
    """Another number in the place of one written in digits; half of the time within the first lines."""
    found = list(re.finditer(rb"-?[0-9][0-9.eE+-]*", data[: 600 if rng.random() < 0.5 else len(data)]))
    if not found:
        return _integer(data, rng)
    word = found[int(rng.integers(len(found)))]
    return data[: word.start()] + rng.choice(np.array(_NUMBERS, dtype=object)) + data[word.end() :]


def _integer(data: bytes, rng: np.random.Generator) -> bytes:
    """Another number in the place of 2, 4 or 8 bytes, mostly near the start or the end."""
    size = int(rng.choice([2, 4, 8]))
    reach = max(1, min(len(data) - size, 400))
    at = int(rng.integers(0, reach))
    at = at if rng.random() < 0.6 else max(0, len(data) - size - at)
    value = int(rng.choice([0, 1, 127, 2**15 - 1, 2**16 - 1, 2**31 - 1, 2**32 - 1, 2**40, 2**62, 2**63 - 1]))
    return data[:at] + (value & (1 << 8 * size) - 1).to_bytes(size, "little") + data[at + size :]


def _swap_lines(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.split(b"\n")
    i, j = rng.integers(0, len(lines), size=2)
    lines[i], lines[j] = lines[j], lines[i]
    return b"\n".join(lines)


_PIECES = [
    b"\0",
    b"\xff\xfe",
    "点云".encode(),
    "é".encode("latin-1"),
    b"\r",
    b"\n\n",
    b"\x1b[31m",
    b"%s%n",
    b" " * 5000,
]
_PIECES += [b"9" * 5000, b"(" * 3000, b"[" * 3000, b"{{", b"..", b'"""', b"'", b"nan ", b"inf ", b"-1e999 "]
_NUMBERS = [
    b"0",
    b"-1",
    b"4294967296",
    b"9" * 30,
    b"1e400",
    b"nan",
    b"-inf",
    b"1e30",
    b"0x10",
    b"1_0",
    b"3.5",
    b"2147483647",
]
_NUMBERS += [b"", b"1000000000", b"-9223372036854775809", b"9" * 5000, b"1e-320", b"true", "٣".encode()]
_MUTATIONS = {
    "flip": _flip,
    "truncate": lambda data, rng: data[: int(rng.integers(0, len(data)))],
    "cut out": _cut_out,
    "repeat": _repeat,
    "noise": _noise,
    "insert": _insert,
    "number": _number,
    "integer": _integer,
    "swap lines": _swap_lines,
    "all noise": lambda data, rng: rng.bytes(int(rng.integers(0, 3000))),
    "head and noise": lambda data, rng: data[: int(rng.integers(4, 200))] + rng.bytes(int(rng.integers(0, 3000))),
    "twice": lambda data, rng: mutated(mutated(data, rng)[1] or b" ", rng)[1],
}


class Trial:
    """Runs tries one after the other in this process."""

    def __init__(self, folder: Path) -> None:
        import pytest
        from mutation_samples import samples
        from stand_in_method import StandInMethod

        self.folder, self.samples = folder, samples()
        StandInMethod.install(pytest.MonkeyPatch())
        for sample in self.samples:  # imports and caches are no part of a try, and samples must be valid
            if (outcome := self.attempt(sample, "as it is", sample.files[sample.victim])).code != 0:
                raise AssertionError(f"the sample '{sample.name}' is not valid: {outcome.said} {outcome.problem}")

    def run(self, seed: int, index: int) -> MutantOutcome:
        """Try number ``index``: the harmful files first, then random damage."""
        specials = [(s, name) for s in self.samples for name in s.specials]
        if index < len(specials):
            sample, name = specials[index]
            return self.attempt(sample, name, sample.specials[name])
        rng = np.random.default_rng([seed, index])
        sample = self.samples[index % len(self.samples)]
        how, data = mutated(sample.files[sample.victim], rng)
        return self.attempt(sample, how, data)

    def attempt(self, sample, how: str, data: bytes) -> MutantOutcome:
        """Write the sample with ``data`` for its victim, run its command, and judge what it did."""
        from mutation_samples import TRAP

        place = self.folder / "in"
        for name, content in (sample.files | {sample.victim: data}).items():
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            (place / name).write_bytes(content)
        before = _listing(self.folder)
        words = {"in": str(place), "out": str(self.folder / "out")}
        arguments = [word.format(**words) for word in sample.arguments]
        code, problem = None, ""
        start, base = time.process_time(), reset_peak()
        with _captured(self.folder / "said") as said, _moved(self.folder):
            try:
                code = _command(arguments)
            except TimeoutError as error:
                problem = f"no end after {error}"
            except BaseException as error:
                problem = f"{type(error).__name__}: {error}"[:300]
        seconds, grown = time.process_time() - start, max(0, peak_memory() - base)
        words_said = said()
        size = sum(map(len, (sample.files | {sample.victim: data}).values()))
        left = _listing(self.folder) - before
        foreign = sorted(p for p in left if p.split("/")[0] not in ("out", "out.npz"))
        if not problem and code not in (0, 2):
            problem = f"exit code {code}"
        elif not problem and (trap := [p for p in foreign if TRAP in p]):
            problem = f"executed what the file contains: {trap}"
        elif not problem and foreign:
            problem = f"wrote {foreign[:3]}"
        elif not problem and code == 2 and left:
            problem = f"exit code 2, but left {sorted(left)[:3]}"
        elif not problem and ("Traceback" in words_said or "panicked" in words_said):
            problem = "a traceback"
        elif not problem and code == 2 and len(re.findall("^warpdef: error: .+$", words_said, re.MULTILINE)) != 1:
            problem = "not one line 'warpdef: error: ...'"
        elif not problem and grown > MEMORY_FACTOR * size + MEMORY_CONSTANT:
            problem = f"{grown >> 20} MiB for an input of {size} bytes"
        shutil.rmtree(place)
        for name in {p.split("/")[0] for p in left} | {"out", "out.npz", TRAP}:
            _remove(self.folder / name)
        return MutantOutcome(sample.name, how, code, seconds, grown, problem, words_said)


def _command(arguments: list[str]) -> int:
    from warpdef.apps.main import run

    def late(number: int, frame: object) -> None:
        raise TimeoutError(f"{PATIENCE_MAX:g} s of the clock" if number == signal.SIGALRM else f"{SECONDS_MAX:g} s")

    timers = {signal.SIGPROF: (signal.ITIMER_PROF, SECONDS_MAX), signal.SIGALRM: (signal.ITIMER_REAL, PATIENCE_MAX)}
    old = {number: signal.signal(number, late) for number in timers}
    for timer, seconds in timers.values():
        signal.setitimer(timer, seconds)
    try:
        return run(arguments)
    finally:
        for number, (timer, _) in timers.items():
            signal.setitimer(timer, 0)
            signal.signal(number, old[number])


@contextlib.contextmanager
def _moved(folder: Path) -> Iterator[None]:
    before = os.getcwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


@contextlib.contextmanager
def _captured(path: Path):
    """Everything written to standard output and error, by Python or by libraries; yields a function that reads it."""
    sys.stdout.flush()
    sys.stderr.flush()
    kept = os.dup(1), os.dup(2)
    with open(path, "wb") as stream:
        os.dup2(stream.fileno(), 1)
        os.dup2(stream.fileno(), 2)
    try:
        yield lambda: path.read_text(encoding="utf-8", errors="replace")
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for number, descriptor in enumerate(kept, 1):
            os.dup2(descriptor, number)
            os.close(descriptor)


def _listing(folder: Path) -> set[str]:
    return {str(p.relative_to(folder)) for p in folder.rglob("*")} - {"said"}


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _work(seed: int, indices: range) -> None:
    """A worker: a line for each try on standard output."""
    import json
    import resource
    from dataclasses import asdict

    with tempfile.TemporaryDirectory() as folder:
        resource.setrlimit(resource.RLIMIT_AS, (_ADDRESS_SPACE, _ADDRESS_SPACE))
        trial = Trial(Path(folder))
        for index in indices:
            print(json.dumps([index, asdict(trial.run(seed, index))]), flush=True)


def run_tries(seed: int, indices: range) -> Iterator[tuple[int, MutantOutcome]]:
    """Outcomes of the tries, run in a process that is started anew where it crashes or hangs."""
    import json

    left = indices
    while left:
        command = [sys.executable, __file__, "--seed", str(seed), "--work", f"{left.start}:{left.stop}:{left.step}"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as worker:
            assert worker.stdout is not None and worker.stderr is not None
            started = False
            while left:
                patience = _WATCHDOG if started else 4 * _WATCHDOG
                line = worker.stdout.readline() if speaks(worker, patience) else ""
                if not line:
                    break
                started = True
                index, outcome = json.loads(line)
                left = left[1:]
                yield index, MutantOutcome(**outcome)
            if left:
                hung = worker.poll() is None and line == ""
                worker.kill()
                said = worker.stderr.read()[-2000:]
                if not started:
                    raise RuntimeError(f"the worker did not start: {said}")
                problem = "hung" if hung else "crashed"
                yield left[0], MutantOutcome("?", "?", worker.wait(), _WATCHDOG, 0, f"the process {problem}", said)
                left = left[1:]


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=10_000, help="tries")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--only", type=int, default=None, help="repeat one try and show what it says")
    parser.add_argument("--work", default="", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        _work(options.seed, range(*map(int, options.work.split(":"))))
        return 0
    if options.only is not None:
        _, outcome = next(run_tries(options.seed, range(options.only, options.only + 1)))
        print(outcome.said, outcome, sep="\n")
        return bool(outcome.problem)
    from concurrent.futures import ThreadPoolExecutor

    start = time.perf_counter()
    shares = [range(first, options.count, options.processes) for first in range(options.processes)]
    with ThreadPoolExecutor(options.processes) as pool:
        outcomes = [o for share in pool.map(lambda r: list(run_tries(options.seed, r)), shares) for o in share]
    codes = collections.Counter(o.code for _, o in outcomes)
    for index, o in outcomes:
        if o.problem:
            print(f"try {index}: {o.sample}, {o.how}: {o.problem}")
    broken = sum(bool(o.problem) for _, o in outcomes)
    slowest = max(outcomes, key=lambda pair: pair[1].seconds)
    largest = max(outcomes, key=lambda pair: pair[1].grown)
    print(
        f"{len(outcomes)} tries in {time.perf_counter() - start:.0f} s: {broken} promises broken; "
        f"exit codes {dict(codes)}; "
        f"slowest {slowest[1].seconds:.2f} s (try {slowest[0]}, {slowest[1].sample}, {slowest[1].how}); "
        f"most memory {largest[1].grown >> 20} MiB (try {largest[0]}, {largest[1].sample}, {largest[1].how})"
    )
    return broken > 0


if __name__ == "__main__":
    sys.exit(main())
