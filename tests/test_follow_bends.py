"""When a frame is bent by matches on the way outwards: lost ones alone, once more from behind, only for the better."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from test_follow import BODY, FRAMES, KEYFRAME, lost_chain

from warpdef.fit import follow as walks
from warpdef.fit.follow import follow
from warpdef.fit.recover import Search
from warpdef.fit.workers import Team


def tried(
    monkeypatch: pytest.MonkeyPatch,
    lost: set[int],
    partial: tuple[int, ...] = (),
    sources: int = 0,
    finds: tuple[tuple[int, int], ...] = (),
) -> list[tuple[int, int]]:
    """Frames bent, each with the one it was bent from, if these frames stay lost whatever is done but ``finds``."""
    monkeypatch.setattr(walks, "SOURCES", sources)
    calls: list[tuple[int, int]] = []
    found: set[int] = set()

    def bend(self: walks._Walk, frame: int, neighbour: int) -> None:
        calls.append((frame, neighbour))
        if (frame, neighbour) in finds:
            found.add(frame)

    monkeypatch.setattr(Search, "lost", lambda self, t: t in lost - found)
    monkeypatch.setattr(walks._Walk, "_bend", bend)
    monkeypatch.setattr(walks._Walk, "_turn", lambda self, frame, neighbour: None)
    with closing(Team(1)) as team:
        optimiser, refinement = lost_chain(team, chain=False)
        optimiser.problem.measures.complete = ~np.isin(np.arange(FRAMES), partial)
        followed, bent = follow(optimiser.objective, refinement)
    assert followed == [t for t in range(FRAMES) if t != KEYFRAME] and bent == []
    return calls


def test_what_stays_lost_is_tried_once_more_from_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the first frame behind it that is not lost, no matter on which side of the keyframe."""
    assert tried(monkeypatch, {8, 9, 3}) == [(8, 7), (9, 8), (9, 10), (3, 4), (3, 2)]


def test_the_last_frame_has_none_behind_it(monkeypatch: pytest.MonkeyPatch) -> None:
    assert tried(monkeypatch, {0, FRAMES - 1}) == [(FRAMES - 1, FRAMES - 2), (0, 1)]


def test_incomplete_frames_are_never_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    assert tried(monkeypatch, {8, 9, 3}, partial=(8, 9)) == [(3, 4), (3, 2)]


@pytest.mark.parametrize(
    ("finds", "forward"),
    [
        ((), [(8, 6), (8, 10), (9, 7), (9, 11)]),  # 8 from 7 and 9 from 10 was tried
        (((8, 6),), [(8, 6), (9, 8), (9, 7)]),  # what was found leads on
    ],
)
def test_what_stays_lost_then_is_tried_from_afar(monkeypatch: pytest.MonkeyPatch, finds, forward) -> None:
    """From as many frames of its side as are asked, the nearest first, and never twice from a neighbour."""
    assert KEYFRAME == 6
    outwards = [(8, 7), (9, 8), (9, 10)], [(3, 4), (3, 2)]
    calls = tried(monkeypatch, {8, 9, 3}, sources=3, finds=finds)
    assert calls == [*outwards[0], *forward, *outwards[1], (3, 1)]


def test_what_lost_more_than_a_limb_is_not_tried_from_afar(monkeypatch: pytest.MonkeyPatch) -> None:
    shares = {8: 1.01 * walks.LIMB, 9: 0.99 * walks.LIMB}
    monkeypatch.setattr(Search, "uncovered", lambda self, t: shares.get(t, 0.0))
    assert tried(monkeypatch, {8, 9}, sources=3) == [(8, 7), (9, 8), (9, 10), (9, 7), (9, 11)]


def test_what_covers_less_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bent far away, a frame goes back to where the grids and the vertex stage had left it."""

    def learn(self: Search, t: int, neighbour: int) -> bool:
        self.vertices[t] = self.vertices[neighbour] + 5.0
        return True

    found = []
    for bends in (True, False):
        with monkeypatch.context() as patch, closing(Team(1)) as team:
            patch.setattr(Search, "lost", lambda self, t: t == KEYFRAME + 1)
            patch.setattr(Search, "learn", learn)
            optimiser, refinement = lost_chain(team, chain=False)
            config = optimiser.problem.config
            optimiser.problem.config = replace(config, refine=replace(config.refine, recover=bends))
            found.append((follow(optimiser.objective, refinement)[1], optimiser.objective.vertices.numpy().copy()))
    (bent, vertices), (_, expected) = found
    assert bent == []
    np.testing.assert_array_equal(vertices[KEYFRAME + 1], expected[KEYFRAME + 1])
    np.testing.assert_allclose(vertices, expected, rtol=0, atol=1e-3)


class _Told:
    """A bending whose poses are the frames they came from, last first, and whose faults are told."""

    def __init__(self, faults: dict[tuple[int, ...], float]) -> None:
        self.faults, self.bends, self.from_rest = faults, list[tuple[int, ...]](), set[int]()

    def still(self) -> tuple[int, ...]:
        return ()

    def best(
        self, cloud: int, start: tuple[int, ...], usual: float, other: tuple[int, ...] | None = None
    ) -> tuple[tuple[int, ...], float]:
        self.bends.append((cloud, *start))
        if other == self.still():
            self.from_rest.add(cloud)
        return self.bends[-1], self.faults.get(self.bends[-1], 0.01)

    def place(self, pose: tuple[int, ...]) -> np.ndarray:
        return np.full((len(BODY.vertices[0]), 3), float(len(pose)))


class _Limbs:
    """A search for limbs whose faults are told, by frame; its poses are two longer."""

    def __init__(self, left: dict[int, float]) -> None:
        self.left, self.asked = left, list[int]()

    def better(self, cloud: int, found: tuple[int, ...], fault: float) -> tuple[tuple[int, ...], float]:
        self.asked.append(cloud)
        return (0, 0, *found), self.left.get(cloud, fault)


def followed_bent(
    monkeypatch: pytest.MonkeyPatch, told: _Told, limbs: _Limbs, recover: bool
) -> tuple[list[int], list[int], float, list[tuple[int, int]]]:
    """Frames followed and bent, how far bent poses put frame 10, and what was settled from which neighbour."""
    monkeypatch.setattr(walks._Walk, "bending", told)
    monkeypatch.setattr(walks._Walk, "limb_search", limbs)
    monkeypatch.setattr(walks._Walk, "_seen_cloud", lambda self, frame: frame)
    settled: list[tuple[int, int]] = []
    monkeypatch.setattr(walks._Walk, "_settle", lambda self, frame, neighbour: settled.append((frame, neighbour)))
    with closing(Team(1)) as team:
        optimiser, refinement = lost_chain(team, chain=False)
        problem = optimiser.problem
        problem.seen, config = True, problem.config
        problem.config = replace(config, refine=replace(config.refine, recover=recover))
        followed, bent = follow(optimiser.objective, refinement)
        return followed, bent, optimiser.objective.vertices.numpy()[10, 0, 0], settled


BACK = (10, 11, 10, 9, 8, 7)  # frame 10 once more, from 11


@pytest.mark.parametrize(
    ("faults", "recover", "tried_again", "kept"),
    [
        ({BACK[2:]: 0.08, BACK: 0.035}, True, True, True),  # less than half
        ({BACK[2:]: 0.08, BACK: 0.05}, True, True, False),  # still wrong
        ({BACK[2:]: 0.034, BACK: 0.028}, True, True, True),  # right now
        ({BACK[2:]: 0.02, BACK: 0.018}, True, True, False),  # hardly better
        ({BACK[2:]: 0.014}, True, False, False),  # no fault
        ({BACK[2:]: 0.08}, False, False, False),
    ],
)
def test_what_one_camera_saw_is_tried_from_behind(monkeypatch, faults, recover, tried_again, kept) -> None:
    told = _Told(faults)
    followed, bent, placed, settled = followed_bent(monkeypatch, told, _Limbs({}), recover)
    assert len(followed) == FRAMES - 1 and bent == [10] * kept and ((10, 11) in settled) == kept
    assert (BACK in told.bends) == tried_again and len(told.bends) == FRAMES - 1 + tried_again
    assert placed == (len(BACK) if kept else len(BACK) - 2)
    # All from rest as well, but those whose neighbour is at rest.
    assert told.from_rest == set(range(FRAMES)) - {KEYFRAME - 1, KEYFRAME, KEYFRAME + 1}


@pytest.mark.parametrize(
    ("fault", "left", "recover", "asked", "kept"),
    [
        (0.08, 0.035, True, True, True),  # less than half
        (0.08, 0.05, True, True, False),
        (0.02, 0.016, True, True, True),  # right now
        (0.014, 0.001, True, False, False),  # no fault
        (0.08, 0.01, False, False, False),
    ],
)
def test_limbs_are_looked_for_where_a_fault_stays(monkeypatch, fault, left, recover, asked, kept) -> None:
    limbs, told = _Limbs({10: left}), _Told({BACK[2:]: fault, BACK: 1.0})
    _, bent, placed, settled = followed_bent(monkeypatch, told, limbs, recover)
    assert limbs.asked == [10] * asked and bent == [10] * kept
    assert settled.count((10, 9)) == 1 + kept and placed == len(BACK[2:]) + 2 * kept
