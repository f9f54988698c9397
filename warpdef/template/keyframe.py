"""Which frame the template is built on (sec. Keyframe Selection; completeness and objects go beyond the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from warpdef.config import BASE_FRAMES, KeyframeConfig
from warpdef.errors import InputError
from warpdef.geometry.coverage import area_and_objects, complete_frames, objects_of, shares_of_fullest

SAMPLE = 2500  # points of a frame from which its area and its objects are told
PICTURE_SHARE = 0.1  # least share of the points that is an object in a picture: a foot has 0.04 of a person's
_MIDDLE_IN_NOISE = 10.0  # times as much the middle counts there
FEW_POINTS = 0.5  # of the frames' median: a keyframe asked for that has fewer is coarser than it need be
SPREAD = 0.12  # of the frames: how far apart in time further keyframes should be


@dataclass(frozen=True)
class KeyframeCandidate:
    """A frame that may carry the template.

    frame:           index from 0
    occupied_voxels: cells of the grid over [-1, 1]^3 that hold a point
    weight:          Gaussian of the distance to the temporal middle, 0 to 1
    score:           occupied_voxels * weight
    coverage:        area that it shows, relative to the frame with most; it tells of missing surface, which fine voxels
                     do not once they hold no more than a point each
    full:            whether that is complete (``geometry.coverage``)
    objects:         clusters of its points
    why:             one sentence for the report
    """

    frame: int
    occupied_voxels: int
    weight: float
    score: float
    coverage: float
    full: bool
    objects: int
    why: str

    @property
    def standing(self) -> tuple[float, ...]:
        """What comes before the score, the least first: complete frames, then those with most objects."""
        return not self.full, -self.objects


def require_keyframe(config: KeyframeConfig, frame_count: int) -> None:
    """Check a keyframe given by its number.

    Raises:
        InputError: the sequence has no such frame.
    """
    if config.choice.isdecimal() and int(config.choice) >= frame_count:
        raise InputError(
            f"--keyframe: expected auto, first, middle or a frame in 0..{frame_count - 1}, got {int(config.choice)}; "
            f"the sequence has {frame_count} frames, counted from 0"
        )


def rank_keyframes(
    clouds: Sequence[np.ndarray],
    config: KeyframeConfig,
    places: np.ndarray | None = None,
    view: np.ndarray | None = None,
    noisy: bool = False,
) -> list[KeyframeCandidate]:
    """Candidates, best first: all frames for ``auto``, one for ``first``, ``middle`` or an index.

    The score is |G(P_t)| exp(-gamma (t - T/2)^2), T the last frame's index, so that the weight is 1 in the true middle;
    gamma falls with the length of the film (``gamma_fall``).
    Equal scores go to the frame nearer the middle, then to the earlier one. Frames that show less than ``coverage_min``
    of what the fullest frame shows come after all others; among the full ones, those in which most objects lie apart
    come first, as objects that touch would become one.

    Args:
        clouds: one array a frame, each (N_t, 3), cube units, free of outliers.
        config: the choice, the grid, gamma and the least coverage.
        places: of the frames where these are in no order, (T,), to be near the middle of; None: their times.
        view: towards the one camera that saw all clouds, (3,): a part in front of another is no object of its own,
            though it hangs together with nothing, so that objects are told in the picture.
        noisy: whether noise is wide: voxels that it fills differ by chance, and errors grow on the way outwards, so
            that the order, not the score, takes the weight to the power of ten.

    Raises:
        InputError: an index that is not a frame of the sequence, or one without points.
    """
    frame_count = len(clouds)
    middle = (frame_count - 1) / 2
    named = {"first": 0, "middle": int(middle)}
    if config.choice == "auto":
        frames = [t for t in range(frame_count) if len(clouds[t])]
    else:
        frame = named[config.choice] if config.choice in named else int(config.choice)
        require_keyframe(config, frame_count)
        if not len(clouds[frame]):
            raise InputError(f"--keyframe: frame {frame} has no usable points; choose another frame")
        frames = [frame]

    area, sizes, objects = compare_frames([clouds[frame] for frame in frames], view)
    coverage, complete = shares_of_fullest(area, sizes), complete_frames(area, sizes, config.coverage_min)
    places = np.arange(frame_count) if places is None else places
    gamma = config.gamma * (BASE_FRAMES / max(frame_count, BASE_FRAMES)) ** config.gamma_fall
    scored = []
    for frame, seen, full, apart in zip(frames, coverage, complete, objects, strict=True):
        occupied = occupied_voxels(clouds[frame], config.voxels)
        weight = float(np.exp(-gamma * (places[frame] - middle) ** 2))
        score = occupied * weight
        scored.append(KeyframeCandidate(frame, occupied, weight, score, float(seen), bool(full), int(apart), ""))
    power = _MIDDLE_IN_NOISE if noisy else 1.0
    worth = {c.frame: c.occupied_voxels * c.weight**power for c in scored}
    scored.sort(key=lambda c: (*c.standing, -worth[c.frame], abs(places[c.frame] - middle), c.frame))
    full = [c for c in scored if c.full]
    ranked = []
    for rank, candidate in enumerate(scored):
        why = _why(config.choice, rank, len(scored), candidate.occupied_voxels, candidate.weight)
        if config.choice == "auto" and candidate.full and candidate.objects > min(c.objects for c in full):
            why += f"; {candidate.objects} objects lie apart there, which touch in other frames"
        if config.choice == "auto" and rank == 0 and len(full) < len(frames):
            why += f"; {len(frames) - len(full)} frames show less than {config.coverage_min:.0%} of the surface"
        ranked.append(replace(candidate, why=why))
    return ranked


def doubt_of_asked(clouds: Sequence[np.ndarray], config: KeyframeConfig, places: np.ndarray | None = None) -> str:
    """What speaks against the keyframe that the user named, beside all others; else nothing.

    Args:
        clouds, config, places: as in ``rank_keyframes``.
    """
    if config.choice == "auto":
        return ""
    asked = rank_keyframes(clouds, config, places)[0].frame
    ranked = rank_keyframes(clouds, replace(config, choice="auto"), places)
    seen = next(c for c in ranked if c.frame == asked)
    if seen is ranked[0]:
        return ""
    usual = float(np.median([len(cloud) for cloud in clouds if len(cloud)]))
    better = f"--keyframe auto would take frame {ranked[0].frame}"
    if not seen.full and ranked[0].full:
        shown = f"shows {seen.coverage:.0%} of the surface that the fullest frame shows"
        return f"frame {asked}, the keyframe asked for, {shown}: the template lacks or guesses the rest; {better}"
    if len(clouds[asked]) < FEW_POINTS * usual:
        shown = f"has {len(clouds[asked]):,} points, where frames have {usual:,.0f}"
        return f"frame {asked}, the keyframe asked for, {shown}: the template may lack thin parts; {better}"
    return ""


def spread_out(ranked: list[KeyframeCandidate], count: int) -> list[KeyframeCandidate]:
    """At most ``count`` of the candidates: the first, then such as are no neighbours in time of those before.

    What spoils one frame (a limb that touches the body, a surface out of sight) spoils its neighbours too. The score
    counts by 1 - exp(-(d / spread)^2), d the frames to the nearest one chosen; coverage and objects still go first.

    Args:
        ranked: by ``rank_keyframes``.
        count: at least 1.
    """
    spread = SPREAD * len(ranked)
    chosen, rest = ranked[:1], list(ranked[1:])
    while rest and len(chosen) < count:
        near = [min(abs(c.frame - other.frame) for other in chosen) for c in rest]
        worth = [
            (*c.standing, -c.score * (1.0 - np.exp(-((d / spread) ** 2)))) for c, d in zip(rest, near, strict=True)
        ]
        chosen.append(rest.pop(worth.index(min(worth))))
    return chosen


def compare_frames(
    clouds: Sequence[np.ndarray], view: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Area that each frame shows, how many of its points were asked, and number of its objects; all of shape (T,).

    Of a large cloud ``SAMPLE`` points speak for all. ``view``: as in ``rank_keyframes``.
    """
    samples = [_sample(cloud) for cloud in clouds]
    area, objects = zip(*map(area_and_objects, samples), strict=True)
    if view is not None:
        objects = [_objects_in_picture(s, view) for s in samples]
    return np.array(area), np.array([len(s) for s in samples]), np.array(objects)


def _objects_in_picture(points: np.ndarray, view: np.ndarray) -> int:
    """Clusters in the picture of one camera, without the small ones: what is in front cuts feet and hands off."""
    if len(points) <= 1:
        return 1
    label = objects_of(points - np.outer(points @ view, view))
    return max(int((np.bincount(label[label >= 0]) >= PICTURE_SHARE * len(points)).sum()), 1)


def _sample(points: np.ndarray) -> np.ndarray:
    if len(points) <= SAMPLE:
        return points
    return points[np.random.default_rng(0).choice(len(points), SAMPLE, replace=False)]


def occupied_voxels(points: np.ndarray, voxels: int) -> int:
    """Number of cells of a ``voxels``^3 grid over [-1, 1]^3 that hold at least one of the points (N, 3)."""
    cell = np.clip(np.floor((np.asarray(points) + 1.0) * (voxels / 2.0)).astype(np.int64), 0, voxels - 1)
    x, y, z = cell.T
    return len(np.unique((x * voxels + y) * voxels + z))


def _why(choice: str, rank: int, count: int, occupied: int, weight: float) -> str:
    if choice != "auto":
        return "the frame asked for" if choice.isdecimal() else f"the {choice} frame, as asked"
    place = "best" if rank == 0 else f"number {rank + 1}"
    return f"{place} of {count} frames by coverage: {occupied} occupied voxels times {weight:.3f} for its place in time"
