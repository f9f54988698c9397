"""A verdict on a frame: good, doubtful or lost. Every threshold stands in ``BOUNDS``.

Coverage tells what the mesh has lost; the shape tells where it was torn or crumpled so that nothing is left uncovered.
Surface that no point lies on is not held against a frame: a scanner that sees half of the body is no fault of the mesh.
Neither is what differs from the shape alone a loss: cloth stretches, and where the shape itself was built from another
body every frame differs from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from warpdef.quality.frame import FrameQuality

GOOD, DOUBTFUL, LOST = "good", "doubtful", "lost"
VERDICTS = (GOOD, DOUBTFUL, LOST)
"""From best to worst."""


@dataclass(frozen=True)
class Bound:
    """One measure's thresholds: a frame above ``doubtful`` is doubtful, above ``lost`` lost.

    measure: a field of ``FrameQuality``. reason: the value in words, ``{}`` is the number. why: where they come from.
    """

    measure: str
    doubtful: float
    lost: float
    reason: str
    why: str


_NEVER = float("inf")
FEWEST_POINTS = 50
"""Points of a frame below which nothing tells a right mesh from a wrong one: some 50 lie a seventh of a body apart, and
one of them is 2 % of all."""
INNER_WALL = 0.01

BOUNDS = (
    Bound(
        "uncovered",
        0.01,
        0.10,
        "{:.1%} of the points are not covered",
        "frames that fit have 0 to 0.5 %; a hand is 1 % of a body, fingers of a hand 1 to 8 %, a limb 10 % and more",
    ),
    Bound(
        "astray",
        10.0,
        _NEVER,
        "points together lie {:.0f} spacings off the surface, as of a limb that it has lost",
        "up to 9 on right meshes, whole or before cameras; a leg of which one camera saw a sliver, and which the mesh "
        "has put behind the other, 14 to 21",
    ),
    Bound(
        "misfit",
        1.0,
        3.0,
        "the points are {:.1f} spacings from the surface in the mean",
        "clean clouds have 0.05, depth cameras 0.2 to 0.4, noise alone at most 0.8, the mean of a normal distribution "
        "over its deviation",
    ),
    Bound(
        "torn",
        0.002,
        0.05,
        "{:.1%} of the surface is stretched across places without points",
        "0 to 0.1 % where nothing is wrong; a web between two limbs has 0.3 % and more",
    ),
    Bound(
        "overhang",
        0.003,
        0.10,
        "{:.1%} of the surface hangs over where the points close",
        "none where nothing is wrong, up to 0.1 % where one camera saw a body; a foot turned inwards has 0.5 %, a "
        "snake that slid along itself 2 to 17 %",
    ),
    Bound(
        "surplus",
        0.03,
        0.10,
        "{:.0%} of the surface has no points, which show as much as in the keyframe all the same",
        "0 to 1 % on bodies and before one camera; a sheet that slid over its border 4 to 12 %, one that is lost 30 %",
    ),
    Bound(
        "outgrown",
        0.01,
        0.10,
        "{:.1%} of the surface has been drawn out over the border of the points",
        "none on right meshes held against whole clouds or cut ones, a stretchy face among them; a flag whose waves "
        "run along it 1 to 3 %, drawn out by as much",
    ),
    Bound(
        "merged",
        0.10,
        _NEVER,
        "{:.0%} of the points lie in two layers, of which the surface makes one",
        "0 to 0.5 % on bodies, noisy or not, 4 % before four cameras that do not quite agree; a skirt of two layers, "
        "two spacings apart, has 93 to 98 %",
    ),
    Bound(
        "doubled",
        0.035,
        _NEVER,
        "{:.0%} of the surface lies behind or inside another part of it",
        "below 1 % on bodies, up to 2.5 % on rough scans of a hand; crumpled and turned inside out 4 to 20 %",
    ),
    Bound(
        "layered",
        0.15,
        _NEVER,
        "{:.0%} of the surface lies on another part of it, as a second layer",
        "below 1 % on bodies, 8 % where fingers overlap before one camera; two cells drawn over the one that they were "
        "have 50 %",
    ),
    Bound(
        "shared",
        0.045,
        _NEVER,
        "{:.1%} of the surface lies on points that another part of it explains",
        "asked only of what one camera saw, which shows the nearer of two parts alone; up to 3.7 % along outlines and "
        "in creases; a finger put on the place of another 4.8 to 6 %, legs and arms that were confused 4.5 to 10 %",
    ),
    Bound(
        "exposed",
        0.007,
        _NEVER,
        "{:.1%} of the surface stands where the camera saw nothing",
        "asked only of what one camera saw; 0 to 0.4 % along outlines, a finger put beside the hand's outline 0.8 to "
        "1 %, an arm held up beside the body 3 to 7 %",
    ),
    Bound(
        "spanning",
        0.006,
        _NEVER,
        "{:.1%} of the surface spans gaps through which the camera saw",
        "0 to 0.5 % of flaps along outlines and between fingers; a web between two legs 0.6 to 1.2 %, a leg put across "
        "a gap 0.6 %",
    ),
    Bound(
        "swollen",
        0.13,
        _NEVER,
        "the surface of a limb is {:.0%} larger than in the shape, as where it lies on points of another",
        "asked only of what one camera saw; limbs in their place have grown by up to 12 %; a thumb that points at the "
        "camera and one drawn to a point by 13 %, fingers on points of others by 15 to 35 %",
    ),
    Bound(
        "blur",
        0.4,
        _NEVER,
        "noise is {:.0%} of the thickness of thin parts, and hides what is between them",
        "1 % on clean clouds, 7 % on sparse ones, 9 to 31 % at noise of 1 % of a body's diagonal; at 2 % it is 40 to "
        "50 %, and webs between the legs fit as well as the legs",
    ),
    Bound(
        "inner",
        INNER_WALL,
        _NEVER,
        "{:.0%} of the surface is a wall inside the points",
        "none where nothing parts or meets; a cell that divides has 3 to 20 %",
    ),
    Bound(
        "stretched",
        0.08,
        _NEVER,
        "{:.0%} of the edges are longer or shorter than in the shape by half",
        "below 1 % on bodies, 1 to 6 % on rough scans of a hand; another body's shape has 11 % and more",
    ),
    Bound(
        "drawn",
        0.005,
        _NEVER,
        "{:.1%} of the surface is drawn out to nearly twice its length, as over what the shape lacks",
        "0 to 0.2 % on right meshes, of a horse in gallop and of wide clothes; a hand over the ball that it has picked "
        "up 2 %, a snake's end over its other coils 0.8 %",
    ),
    Bound(
        "folded",
        0.05,
        _NEVER,
        "{:.1%} of the neighbouring faces are folded onto each other",
        "0.2 % on bodies, up to 3 % on noisy scans; crumpled meshes have 4 % and more",
    ),
    Bound(
        "thinned",
        0.30,
        _NEVER,
        "{:.0%} of the places are thicker or thinner than in the shape by half",
        "0 to 3 % on bodies; asked only where a closed shape has opposite sides",
    ),
)
"""What a frame is judged by, and from where on."""


@dataclass(frozen=True)
class Verdict:
    """name: one of ``VERDICTS``. reasons: a clause each, the worst first; empty for a good frame.
    severity: how many times over the worst measure's bound it is."""

    name: str
    reasons: tuple[str, ...] = ()
    severity: float = 0.0


def judge(frame: FrameQuality) -> Verdict:
    """The worst that any measure says; a frame without points is doubtful, as its mesh is a guess, and so is one of
    fewer than ``FEWEST_POINTS``."""
    if not frame.points:
        return Verdict(DOUBTFUL, ("no usable points: interpolated",))
    found = []
    if frame.points < FEWEST_POINTS:
        found.append((False, FEWEST_POINTS / frame.points, f"{frame.points} points are too few to tell"))
    for bound in BOUNDS:
        value = getattr(frame, bound.measure)
        if value is not None and value > bound.doubtful:
            found.append((value > bound.lost, value / bound.doubtful, bound.reason.format(value)))
    if not found:
        return Verdict(GOOD)
    found.sort(reverse=True)
    return Verdict(LOST if found[0][0] else DOUBTFUL, tuple(reason for _, _, reason in found), found[0][1])


def summary(verdicts: Sequence[str]) -> str:
    """``15 good, 1 doubtful (6), 1 lost (9)``: how many of each, and which frames are not good.

    Args:
        verdicts: T of ``VERDICTS``, by frame.
    """
    from warpdef.sequence import name_frames  # not before a command runs

    parts = []
    for name in VERDICTS:
        frames = [t for t, verdict in enumerate(verdicts) if verdict == name]
        if frames:
            which = "" if name == GOOD else f" ({name_frames(frames).split(' ', 1)[1]})"
            parts.append(f"{len(frames)} {name}{which}")
    return ", ".join(parts)
