"""How time and memory of an iteration grow: one field of the size varied at a time, a process of its own a point."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from warpdef.apps.benchmark.data import Source, make_work
from warpdef.apps.benchmark.point import run_point
from warpdef.apps.benchmark.sizes import (
    EXPONENT_MAX,
    LARGEST_ITERATIONS,
    LINEAR_SWEEPS,
    Size,
)
from warpdef.apps.benchmark.timing import fit_exponent
from warpdef.errors import WarpdefError

GROWING = ("ms", "cpu_ms", "arrays_mb", "peak_mb")


def sweep_sizes(base: Size, field: str, values: Sequence[int]) -> list[Size]:
    """``base`` with one field varied."""
    return [replace(base, name=f"{field} {value}", **{field: value}) for value in values]


def thread_counts(most: int) -> list[int]:
    """1, 2, 4, ... and ``most``."""
    counts = [1]
    while counts[-1] * 2 < most:
        counts.append(counts[-1] * 2)
    return [*counts, most] if most > 1 else counts


def run_sweeps(
    source: Source,
    base: Size,
    sweeps: dict[str, Sequence[int]],
    largest: Size | None,
    device: str,
    threads: int,
    iterations: int,
    warmup: int,
    folder: Path,
    tell: Callable[[str], None],
) -> list[dict]:
    """All sweeps, the one over threads (CPU only), and the largest problem.

    More frames show the same motion in smaller steps. Times are medians over early full iterations of a descent, where
    neighbours move most: later ones are cheaper.
    """
    done = []
    file = folder / "work.npz"

    def point(size: Size, count: int, iterations: int = iterations) -> dict:
        tell(f"scaling: {size.name}, {count} threads")
        make_work(source.retimed(base.frames, size.frames), size).save(file)
        return run_point(file, size, device, count, iterations, warmup)

    if device == "cpu":
        points = [{"value": count, **point(replace(base, name="threads"), count)} for count in thread_counts(threads)]
        done.append({"field": "threads", "threads": None, "points": points, "exponents": exponents(points)})
    for field, values in sweeps.items():
        points = [
            {"value": len_or(value, field, found), **found}
            for value, size in zip(values, sweep_sizes(base, field, values), strict=True)
            for found in [point(size, threads)]
        ]
        done.append({"field": field, "threads": threads, "points": points, "exponents": exponents(points)})
    if largest is not None:
        points, error = [], None
        try:
            points.append({"value": largest.points, **point(largest, threads, min(iterations, LARGEST_ITERATIONS))})
        except WarpdefError as failure:  # a machine too small for it must not lose all that came before
            error = str(failure)
        done.append({"field": "largest", "threads": threads, "points": points, "exponents": {}, "error": error})
    for sweep in done:
        sweep["within"] = within_bound(sweep)
    return done


def len_or(value: int, field: str, found: dict) -> int:
    """What was measured: vertices come as near to what was asked for as the mesh allows."""
    return found["vertices"] if field == "vertices" else value


def exponents(points: Sequence[dict]) -> dict[str, float]:
    """Fitted exponent of each quantity measured, and ``..._top``: that between the two largest points alone."""
    if len({p["value"] for p in points}) < 2:
        return {}
    sizes = [p["value"] for p in points]
    found = {}
    for key in GROWING:
        values = [p[key] for p in points if p.get(key) is not None]
        if len(values) < len(points):
            continue
        found[key] = fit_exponent(sizes, values)
        found[f"{key}_top"] = fit_exponent(sizes[-2:], values[-2:])
    return found


def within_bound(sweep: dict) -> bool | None:
    """Whether time and memory grow with at most ``EXPONENT_MAX``; None where nothing is promised.

    On the CPU by processor time: wall time grows as the machine's other programs let it.
    """
    if sweep["field"] not in LINEAR_SWEEPS:
        return None
    return all(sweep["exponents"][key] <= EXPONENT_MAX for key in judged_by(sweep))


def judged_by(sweep: Mapping[str, Any]) -> tuple[str, str]:
    """Which time and which memory a sweep is judged by."""
    return "cpu_ms" if "cpu_ms" in sweep["exponents"] else "ms", "arrays_mb"
