"""Rows of the bench's table: one for each kernel, size and thread count, with peers that gave the same answer."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping

import warp as wp

from warpdef.apps.benchmark.bed import Bed, Case, Peer, difference, runner
from warpdef.apps.benchmark.loss_cases import loss_cases
from warpdef.apps.benchmark.motion_cases import motion_cases
from warpdef.apps.benchmark.refine_cases import ROUND, refine_cases, round_rows
from warpdef.apps.benchmark.search_cases import search_cases
from warpdef.apps.benchmark.sizes import ROWS
from warpdef.apps.benchmark.solve_cases import solve_cases
from warpdef.apps.benchmark.timing import DeviceTimer, Effort, Timing, measure
from warpdef.fit.workers import Team

GROUPS: Mapping[str, Callable[[Bed], list[Case]]] = {
    "motion": motion_cases,
    "neighbours": search_cases,
    "losses": loss_cases,
    "solves": solve_cases,
    "refine": refine_cases,
}


def kernel_rows(
    bed: Bed, teams: Mapping[int, Team], bandwidth: Mapping[int, float], effort: Effort, wanted: Collection[str]
) -> Iterator[dict]:
    """Measure every wanted case.

    Args:
        teams: a team for each thread count. bandwidth: bytes a second for each thread count. wanted: names of rows.
    """
    for group, cases in GROUPS.items():
        if not set(ROWS[group]) & set(wanted):
            continue
        for case in cases(bed):
            if case.name in wanted:
                yield from case_rows(case, bed, teams, bandwidth, effort)
    if ROUND in wanted:
        yield from round_rows(bed, teams)


def case_rows(
    case: Case, bed: Bed, teams: Mapping[int, Team], bandwidth: Mapping[int, float], effort: Effort
) -> Iterator[dict]:
    """One row a thread count; the answers are compared first, before anything is timed."""
    compared = {peer.name: compare(case, peer, max(teams)) for peer in case.peers}
    once: dict[tuple[str, int], Timing] = {}
    for threads, team in teams.items():
        clock = DeviceTimer(bed.device)
        timing = measure(runner(case, bed.device, team), clock.seconds, effort, case.before)
        row = {
            "name": case.name,
            "size": bed.size.name,
            "threads": threads,
            "unit": case.unit,
            "elements": case.elements,
            **timing.to_json(),
            "melements_per_s": 1e-6 * case.elements / timing.median,
            "bytes_per_element": case.bytes / case.elements,
            "gb_per_s": 1e-9 * case.bytes / timing.median,
            "share_of_copy": case.bytes / timing.median / bandwidth[threads],
            "gflop_per_s": 1e-9 * case.flops / timing.median if case.flops else None,
            "flops_per_byte": case.flops / case.bytes if case.flops else None,
            "peers": [],
            "error": None,
        }
        for peer in case.peers:
            known = compared[peer.name]
            entry = {"name": peer.name, "difference": known["difference"], "agrees": known["error"] is None}
            if known["error"] is None:
                # A peer is as fast as it can be made: with all workers or with one.
                for workers in {1, threads} if peer.parallel else {1}:
                    if (peer.name, workers) not in once:
                        once[peer.name, workers] = time_peer(peer, workers, effort)
                tried = {w: t for (name, w), t in once.items() if name == peer.name and w in (1, threads)}
                workers, theirs = min(tried.items(), key=lambda item: item[1].median)
                entry |= {"workers": workers if peer.parallel else None, **theirs.to_json()}
                entry["speed_up"] = theirs.median / timing.median
            else:
                row["error"] = known["error"]
            row["peers"].append(entry)
        yield row


def compare(case: Case, peer: Peer, workers: int) -> dict:
    """Relative difference between our answer and the peer's, and a sentence if it is beyond the tolerance."""
    assert case.answer is not None  # a case with peers has one
    apart = difference(case.answer(), peer.run(workers))
    ok = apart <= case.tolerance  # false for NaN as well
    error = None if ok else f"{case.name}: differs from {peer.name} by {apart:.1e}, more than {case.tolerance:.0e}"
    return {"difference": apart, "error": error}


def time_peer(peer: Peer, workers: int, effort: Effort) -> Timing:
    """Peers run on the CPU; a third of the effort does."""
    call = peer.timed or peer.run
    few = Effort(effort.seconds / 2, max(effort.least // 3, 2), effort.most)
    return measure(lambda: call(workers), DeviceTimer(wp.get_device("cpu")).seconds, few)
