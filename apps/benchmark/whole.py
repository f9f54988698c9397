"""A whole run of ``warpdef reconstruct``, from its start to its folder, over one pass of neighbours by cKDTree.

The command runs in a process of its own, as a user starts it, with kernels that are compiled already. A pass is what
fitting a mesh to clouds needs at least once: trees of all clouds and of the mesh in all frames, the point of a cloud
that is nearest to every vertex, and the vertex nearest to every point.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from warpdef.apps.benchmark.data import Work
from warpdef.apps.benchmark.sizes import WHOLE, Size
from warpdef.errors import WarpdefError

_PASSES = 3


def whole_run(work: Work, size: Size, device: str, threads: int, folder: Path) -> dict[str, Any]:
    """Run the command on the clouds of this work; its template is built, with as many vertices at most.

    Args:
        folder: where clouds and results may lie.

    Returns:
        ``size``, ``threads``, ``frames``, ``points``, ``vertices``; ``cpu_s``: user and system time of the process, and
        ``wall_s``; ``stages``: the same by stage, and ``others``: what is left of them; ``peak_mb``: most resident
        memory; ``ckdtree_s``: processor time of a pass; ``ratio``: of cpu_s and that.

    Raises:
        WarpdefError: the process failed.
    """
    clouds, short, out = folder / "clouds.npz", folder / "short.npz", folder / "whole"
    np.savez(clouds, points=np.stack(work.clouds), normals=np.stack(work.normals))
    np.savez(short, points=np.stack(work.clouds[:2]), normals=np.stack(work.normals[:2]))
    where = ["--device", device, "--threads", str(threads), "--overwrite"]
    faces = ["--template.faces-max", str(2 * size.vertices)]
    _run(["reconstruct", str(short), "-o", str(out), "--iterations", "1", *faces, *where])  # compiles what is not yet
    cpu, wall = _run(["reconstruct", str(clouds), "-o", str(out), *faces, *where])
    report = json.loads((out / "report.json").read_text())
    with np.load(out / "sequence.npz") as result:
        tree = _pass_seconds(work.clouds, list(result["vertices"]))
    stages = {
        name: {"cpu_s": seconds, "wall_s": report["seconds"][name]} for name, seconds in report["cpu_seconds"].items()
    }
    return {
        "size": size.name,
        "threads": threads,
        "frames": len(work.clouds),
        "points": len(work.clouds[0]),
        "vertices": report["template"]["vertices"],
        "cpu_s": cpu,
        "wall_s": wall,
        "stages": stages,
        "others": {
            "cpu_s": cpu - sum(stage["cpu_s"] for stage in stages.values()),
            "wall_s": wall - sum(stage["wall_s"] for stage in stages.values()),
        },
        "peak_mb": report["peak_memory_mb"] * 2**20 * 1e-6,
        "ckdtree_s": tree,
        "ratio": cpu / tree,
    }


def whole_row(found: dict[str, Any], work: Work) -> dict[str, Any]:
    """The run as a row of the table, in milliseconds of processor time; cKDTree's pass stands beside it."""
    ms, elements = 1e3 * found["cpu_s"], sum(map(len, work.clouds))
    tree = {"name": "scipy cKDTree, one pass", "workers": None, "ms": 1e3 * found["ckdtree_s"]}
    return {
        "name": WHOLE,
        "size": found["size"],
        "threads": found["threads"],
        "unit": "points",
        "elements": elements,
        "melements_per_s": 1e-3 * elements / ms,
        **{key: ms for key in ("ms", "ms_low", "ms_high", "ms_mean")},
        "launches": 1,
        "peers": [{**tree, "speed_up": found["ckdtree_s"] / found["cpu_s"]}],
        "error": None,
    }


def _run(arguments: list[str]) -> tuple[float, float]:
    """Processor and wall seconds of the ``warpdef`` command."""
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run([sys.executable, "-m", "warpdef", *arguments], capture_output=True, text=True)
    wall, after = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
        raise WarpdefError(f"bench: warpdef {' '.join(arguments)} ended with code {done.returncode}: {last}")
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall


def _pass_seconds(clouds: list[np.ndarray], meshes: list[np.ndarray]) -> float:
    """Least processor time of a pass, the tree built whichever way answers sooner."""
    from scipy.spatial import cKDTree

    def once(**options: bool) -> None:
        for cloud, vertices in zip(clouds, meshes, strict=True):
            cKDTree(cloud, **options).query(vertices)
            cKDTree(vertices, **options).query(cloud)

    ways: tuple[Callable[[], None], ...] = (once, lambda: once(balanced_tree=False, compact_nodes=False))
    return min(_processor_seconds(way) for way in ways for _ in range(_PASSES))


def _processor_seconds(call: Callable[[], None]) -> float:
    begun = time.process_time()
    call()
    return time.process_time() - begun
