"""The sizes that ``warpdef bench`` measures, declared in one place, and the figures it is held to."""

from __future__ import annotations

from dataclasses import dataclass

from warpdef.errors import InputError


@dataclass(frozen=True)
class Size:
    """One problem.

    frames, points (a frame), vertices, levels: as in the method; vertices within 5 % of the figure's own are taken as
    they are. iterations: length of the descent that the iteration rows are measured over.
    """

    name: str
    frames: int
    points: int
    vertices: int
    levels: int
    iterations: int

    @property
    def warmup(self) -> int:
        """Iterations without the template, a sixth, as in the default configuration."""
        return self.iterations // 6


WORK = Size("work", 17, 5_000, 10_000, 10, 300)
SIZES = (
    Size("small", 9, 2_000, 4_000, 8, 150),
    WORK,
    Size("large", 17, 20_000, 40_000, 10, 48),
)
SIZES_QUICK = (Size("quick", 4, 500, 1_000, 5, 24),)

ROWS = {
    "motion": (
        "sampling",
        "sampling adjoint",
        "Cayley",
        "move points",
        "move points adjoint",
        "move vertices",
        "move vertices adjoint",
        "scatter vertices",
    ),
    "neighbours": (
        "neighbours: build",
        "neighbours: cloud to vertices, cold",
        "neighbours: cloud to vertices, tracked",
        "neighbours: vertices to cloud, cold",
        "neighbours: vertices to cloud, tracked",
    ),
    "losses": ("Chamfer, vertices to cloud", "Chamfer, cloud to vertices", "isometry"),
    "solves": (
        "cosine solve",
        "pruned-grid CG, cold",
        "pruned-grid CG, warm",
        "template solve",
        "template CG, cold",
        "template CG, warm",
        "Adam",
    ),
    "refine": (
        "vertex normals",
        "planes, vertices to cloud",
        "planes, cloud to vertices",
        "rotations",
        "rigid right-hand side",
        "rest right-hand side",
        "block CG",
        "vertex stage: a round",
    ),
}
"""Rows of kernels by group."""
WHOLE = "whole run"
PARTS = ("iteration", WHOLE, "start")
"""What else is measured: the whole iteration against cKDTree; a whole run against one pass of cKDTree; start, compile
time and memory."""

SWEEPS = {
    "points": (2_500, 5_000, 10_000, 25_000, 50_000, 100_000),
    "vertices": (2_500, 5_000, 10_000, 25_000, 50_000, 100_000),
    "frames": (9, 17, 33, 65, 100),
    "levels": (2, 4, 6, 8, 10, 12),
}
"""One field of ``WORK`` is varied at a time; threads are swept from 1 to all."""
SWEEPS_QUICK = {"points": (250, 500, 1_000), "vertices": (500, 1_000), "frames": (3, 5), "levels": (3, 5)}
LARGEST = Size("largest", 100, 100_000, 100_000, 10, 0)
"""Everything at its upper end at once, measured beside the sweeps; its first iterations only."""

SWEEP_WARMUP, SWEEP_ITERATIONS = 50, 12
"""Iterations of the input term alone ahead of a sweep's others, as in the default configuration: without them the
vertices of far frames would start where the keyframe is, and a longer sequence pay for longer searches. And those
others, the later half of which count."""
LARGEST_ITERATIONS = 4

EXPONENT_MAX = 1.1
LINEAR_SWEEPS = ("points", "vertices", "frames")
"""Sweeps whose time and memory may grow with at most ``EXPONENT_MAX``."""


def selection(only: str) -> set[str]:
    """Names of all rows and parts that ``only`` asks for: every one whose name, or whose group's name, contains it.

    Raises:
        InputError: none does.
    """
    text = only.casefold()
    rows = {name for group, names in ROWS.items() for name in names if text in name.casefold() or text in group}
    parts = {part for part in (*PARTS, "scaling") if text in part}
    if not rows | parts:
        names = ", ".join([*ROWS, *PARTS, "scaling", *(name for names in ROWS.values() for name in names)])
        raise InputError(f"--only: expected part of one of {names}; got {only!r}")
    return rows | parts


@dataclass(frozen=True)
class Target:
    """An upper bound on one figure of the size ``work``."""

    key: str
    title: str
    bound: float
    unit: str
    device: str  # "cpu" or "cuda"


TARGETS = (
    Target("iteration_over_ckdtree_all", "iteration / cKDTree, all threads", 0.3, "", "cpu"),
    Target("iteration_over_ckdtree_one", "iteration / cKDTree, one thread", 0.5, "", "cpu"),
    Target("cold_start_s", "start to first iteration, no kernel cache", 20.0, "s", "cpu"),
    Target("warm_start_s", "start to first iteration, kernels cached", 3.0, "s", "cpu"),
    Target("peak_memory_mb", "peak memory", 1000.0, "MB", "cpu"),
    Target("largest_peak_mb", "peak memory of the largest problem", 8000.0, "MB", "cpu"),
    Target("iteration_ms", "iteration", 1.5, "ms", "cuda"),
    Target("device_memory_mb", "peak device memory", 500.0, "MB", "cuda"),
)
