"""Memory that a run needs, estimated before it begins, and memory that there is.

    estimate = estimate_memory(points=[5000] * 17, vertices=10_000, config=Config())
    estimate.total                      # bytes

T frames, S = T - 1 transitions, N points in all, V vertices, M nodes a transition, L levels.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import warp as wp

from warpdef.config import Config
from warpdef.device import is_cuda
from warpdef.errors import InputError
from warpdef.fit.gathering import GATHERED, may_gather
from warpdef.fit.pool import INDEX, MATRIX, NODE, VECTOR
from warpdef.fit.terms import VERTEX_TERMS
from warpdef.kernels.cells import CELLS_MAX

GIB = 2**30
_PROCESS = 300 * 2**20  # interpreter, Warp's compiler, loaded kernels, libraries
_OTHERS = ("grids", "input term")  # owners in the pool that do not grow with the vertices
_SORTED, _SEARCH = 2 * VECTOR + 2 * INDEX, VECTOR + 2 * INDEX + 8  # bytes of a target and of a query
_TEMPLATE_VERTEX = 700  # bytes of the template alone: graph, edges, patches, factor; measured
_TEMPLATE_POINT = 4_000  # bytes a point of it takes in screened Poisson and remeshing, measured


@dataclass(frozen=True)
class MemoryEstimate:
    """Bytes at the peak of a run, by what they grow with.

    process: the program itself          clouds: input and normals, float64, never on a device
    points: of all frames, with searches grids: parameters and their state
    vertices: of all frames, both stages template: while it is being built
    """

    process: int
    clouds: int
    points: int
    grids: int
    vertices: int
    template: int

    @property
    def device(self) -> int:
        """What lies on the device; on the CPU in the same memory as the rest."""
        return self.points + self.grids + self.vertices

    @property
    def total(self) -> int:
        """Peak of the process on the CPU: the template's memory is free again before the fit takes its own."""
        return self.process + self.clouds + max(self.device, self.template)


def estimate_memory(points: Sequence[int], vertices: int, config: Config, cuda: bool = False) -> MemoryEstimate:
    """What a run on clouds of these sizes takes at its peak.

    Args:
        points: points of each frame. vertices: of the template; see ``vertices_most``.
        config: the whole configuration; levels, pruning, solver and whether there is a vertex stage matter here.
        cuda: whether it runs on such a device.
    """
    frames, total, largest = len(points), sum(points), max(points)
    guided = _guided(points, config)
    pooled = pooled_bytes(points, vertices, config)
    nodes = _nodes(config) * (frames - 1)
    direct = config.sobolev.solver == "cosine" or (config.sobolev.solver == "auto" and not config.grid.prune)
    # Beyond the pool a node takes what is kept to go back to (4 of 8 float32), and the solvers: scratch of the
    # transforms (2, on CUDA), or conjugate gradients (8, kept 2) with 6 neighbours a node.
    a_node = NODE * (4 + (2 if cuda else 0)) if direct else NODE * (4 + 8 + 2) + 2 * 4 * 9
    # A vertex of a frame is searched for and searches; the vertex stage adds matrices, rotations, normals, places to go
    # back to and, where a frame is incomplete, expected; on CUDA also the conjugate gradients of 3x3 blocks.
    a_vertex = _SORTED + _SEARCH + INDEX
    if config.refine.iterations:
        a_vertex += 2 * MATRIX + 4 * VECTOR + (MATRIX + 3 * VECTOR if cuda else 0)
    per_point = 8 if cuda else 3

    def cells(targets: int) -> int:
        return INDEX * frames * min(per_point * targets, CELLS_MAX)

    # A cloud's points: place, normal, frame; sorted, and searching; their normals as given.
    of_points = (2 * VECTOR + INDEX + _SORTED + _SEARCH + VECTOR) * total + cells(largest)
    # What grids are fitted to, if it is fewer, once more; then as it sets out, moved, sorted and searching.
    few, apart = sum(guided), guided != list(points)
    of_points += (2 * VECTOR + INDEX + _SORTED if apart else 0) * few + (cells(max(guided)) if apart else 0)
    of_points += (_SEARCH + VECTOR + 2 * INDEX + _SORTED + _SEARCH) * few + cells(max(guided))
    return MemoryEstimate(
        process=_PROCESS,
        # Points and normals as read, and one of them once more on its way to the device: 3 float64 each.
        clouds=24 * 3 * total,
        points=of_points + pooled["input term"],
        grids=a_node * nodes + pooled["grids"],
        # A factor of the template's own system: some 40 entries a vertex.
        vertices=a_vertex * vertices * frames
        + cells(vertices)
        + _TEMPLATE_VERTEX * vertices
        + sum(pooled[owner] for owner in pooled if owner not in _OTHERS),
        template=_TEMPLATE_POINT * (min(total, GATHERED + largest) if may_gather(points, config) else largest),
    )


def _guided(points: Sequence[int], config: Config) -> list[int]:
    """Points of each frame that grids are fitted to, at most."""
    return [min(n, config.optimiser.points or n) for n in points]


def pooled_bytes(points: Sequence[int], vertices: int, config: Config) -> dict[str, int]:
    """What the fit's pool hands out (``fit.pool``), by owner: at most, and exactly where all clouds are of one size."""
    frames, transitions = len(points), len(points) - 1
    guided, chain = _guided(points, config), config.optimiser.chain
    moved = sum(guided) - guided[0] - guided[-1] + max(guided)
    # Positions; where gradients come back what is carried, and rotation, Jacobian and six-vector of every move.
    back = VECTOR * (frames + 1) + (VECTOR + MATRIX + NODE) * transitions
    return {
        # Values, gradients and moments.
        "grids": 6 * NODE * _nodes(config) * transitions,
        "shape": 6 * VECTOR * vertices,
        "chain": vertices * (VECTOR * frames + (back if chain else 0)),
        # The sums of the terms' gradients; of the vertex stage right-hand side, solution, and two places of a vertex.
        "lent": (4 if config.refine.iterations else 2) * VECTOR * vertices * frames,
        # Rotations, places, gradient.
        "input term": 3 * VECTOR * moved + 8 * transitions,
        "transform term": 8 * frames,
        **{term.owner: term.bytes_of(frames, vertices) for term in VERTEX_TERMS if chain},
    }


def _nodes(config: Config) -> int:
    """Of one transition."""
    return sum((2 * level - 1) ** 3 for level in range(config.grid.coarsest, config.grid.levels + 1))


def vertices_most(points: Sequence[int], config: Config) -> int:
    """The most vertices that a template built here can have: half of its faces."""
    return config.template.faces_most(max(points), len(points)) // 2 + 2


def available_memory() -> int | None:
    """Bytes this process can still take: what the system has free, or what is left below a container's limit.

    None where the system does not tell.
    """
    found = [read() for read in (_system_free, _group_left)]
    return min((f for f in found if f is not None), default=None)


def _system_free() -> int | None:
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except (OSError, ValueError, IndexError):
        pass
    try:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return None


def _group_left(root: Path = Path("/sys/fs/cgroup"), own: Path = Path("/proc/self/cgroup")) -> int | None:
    """What is left of the control groups' limits, version 2 or 1; page cache counts as free, as it can be dropped."""
    left = []
    for folder, limit, used, cache in _groups(root, own):
        try:
            most, now = int((folder / limit).read_text()), int((folder / used).read_text())
            stat = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
        except (OSError, ValueError):  # no such file, or "max"
            continue
        if most < 2**60:  # version 1 writes an absurd number where there is no limit
            left.append(max(most - now + int(stat.get(cache, 0)), 0))
    return min(left, default=None)


def _groups(root: Path, own: Path) -> Iterator[tuple[Path, str, str, str]]:
    """Folders of this process's control groups, innermost first, and the files to read there."""
    try:
        lines = [line.split(":", 2) for line in own.read_text().splitlines()]
    except OSError:
        lines = []
    for parts in lines:
        if len(parts) != 3 or parts[1] not in ("", "memory"):
            continue
        base, names = root, ("memory.max", "memory.current", "inactive_file")
        if parts[1]:
            base = root / "memory"
            names = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
        folder = base / parts[2].strip().lstrip("/")
        # A container sees its own group as the root, whatever the path says.
        for place in dict.fromkeys([folder, *folder.parents, base]):
            if place == base or base in place.parents:
                yield place, names[0], names[1], names[2]


def require_memory(
    points: Sequence[int], vertices: int | None, config: Config, device: wp.Device, limit: float | None = None
) -> MemoryEstimate:
    """Refuse a run that cannot fit, before it begins.

    Args:
        points: points of each frame. vertices: of a template that is there already; None: one will be built.
        limit: GiB that the run may take; None: what is free; 0: whatever it takes.

    Raises:
        InputError: the estimate is above that; it says by how much, and what would fit.
    """
    vertices = vertices or vertices_most(points, config)
    estimate = estimate_memory(points, vertices, config, is_cuda(device))
    if limit == 0:
        return estimate

    def needed(points: Sequence[int], config: Config) -> MemoryEstimate:
        most = min(vertices, vertices_most(points, config))
        return estimate_memory(points, most, config, is_cuda(device))

    def check(what: str, there: float | None, size: Callable[[MemoryEstimate], int]) -> None:
        if there is None or size(estimate) <= there:
            return
        fits = _what_fits(points, config, lambda *smaller: size(needed(*smaller)) <= there)
        raise InputError(
            f"the run needs about {size(estimate) / GIB:.2g} GiB of {what}, expected at most {there / GIB:.2g}; "
            f"{fits}; --memory-limit 0 tries all the same"
        )

    check("memory", available_memory() if limit is None else limit * GIB, lambda e: e.total)
    if is_cuda(device):
        check(f"memory of {device.name}", device.free_memory, lambda e: e.device)
    return estimate


def _what_fits(points: Sequence[int], config: Config, fits: Callable[[Sequence[int], Config], bool]) -> str:
    """The mildest of each kind of cut that is enough."""

    def fewer_levels(levels: int) -> Config:
        return replace(config, grid=replace(config.grid, levels=levels))

    cuts = [max(points) // 2**k for k in range(1, 20)]
    kinds = [
        next((f"--points {n}" for n in cuts if n >= 500 and fits([min(n, m) for m in points], config)), ""),
        next((f"--frames ::{k}" for k in range(2, len(points) // 2) if fits(points[::k], config)), ""),
        next(
            (
                f"--grid.levels {n}"
                for n in range(config.grid.levels - 1, max(4, config.grid.coarsest - 1), -1)
                if fits(points, fewer_levels(n))
            ),
            "",
        ),
    ]
    found = [kind for kind in kinds if kind]
    return f"{' or '.join(found)} would fit" if found else "take fewer frames and points"
