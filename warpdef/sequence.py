"""A sequence of point clouds, checked and cleaned, and the one similarity that takes it into the cube."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from warpdef.cloud import LARGEST_COORDINATE, MIN_POINTS, FramePoints, check_cloud, draw_points
from warpdef.errors import InputError, MissingPackageError

MIN_FRAMES = 2


@dataclass(frozen=True)
class Gap:
    """A frame of the input that has no usable points: its mesh is interpolated.

    number: index from 0 in the input. name: what it is called. why: one sentence.
    points: (N, 3) of a frame that has some and was left out all the same: its mesh is judged by them; else None.
    """

    number: int
    name: str
    why: str
    points: np.ndarray | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True)
class PointSequence:
    """Raw point clouds without correspondences, one a frame; frames without usable points are ``gaps``.

    points:   positions, input units            T arrays, each (N_t, 3) float64
    normals:  unit normals, None where unknown  T entries, each (N_t, 3) float64 or None
    names:    what a frame is called in errors  T strings: a file name or "frame 7"
    merged:   duplicate points merged           T integers
    dropped:  points that are no numbers        T integers
    disowned: normals given but not usable      T truth values
    colors:   sRGB, None where unknown          T entries, each (N_t, 3) uint8 or None; or empty for none at all
    gaps:     the input's other frames; ``len(sequence)`` is T, ``frame_count`` counts them all
    notes:    further warnings about the input, one line each
    columns:  what was taken of the columns in the files and what was passed over; empty where they have none
    times:    of the input's frames, ascending, in usual steps, where these are uneven; else empty: one apart
    order:    the input's frame number of each cloud where they are not ascending, T integers; else empty

    Build one with ``PointSequence.from_arrays``, which checks every frame.
    """

    points: tuple[np.ndarray, ...]
    normals: tuple[np.ndarray | None, ...]
    names: tuple[str, ...]
    merged: tuple[int, ...] = ()
    dropped: tuple[int, ...] = ()
    disowned: tuple[bool, ...] = ()
    gaps: tuple[Gap, ...] = ()
    notes: tuple[str, ...] = ()
    columns: str = ""
    colors: tuple[np.ndarray | None, ...] = ()
    order: tuple[int, ...] = ()
    times: tuple[float, ...] = ()

    def __len__(self) -> int:
        return len(self.points)

    @property
    def frame_count(self) -> int:
        """Frames of the input, those without usable points included; a result has as many."""
        return len(self.points) + len(self.gaps)

    @property
    def numbers(self) -> tuple[int, ...]:
        """The input's frame number of each cloud, shape (T,); ascending but for scans ``in_order`` of their poses."""
        if self.order:
            return self.order
        missing = {gap.number for gap in self.gaps}
        return tuple(n for n in range(self.frame_count) if n not in missing)

    @property
    def places(self) -> np.ndarray | None:
        """Place of each of the input's frames among scans ``in_order``, shape (frame_count,); None for a film."""
        if not self.order:
            return None
        places = np.full(self.frame_count, self.frame_count)  # a gap's is never asked
        places[list(self.order)] = np.arange(len(self.order))
        return places

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Names of all frames of the input, gaps included."""
        names = dict(zip(self.numbers, self.names, strict=True)) | {gap.number: gap.name for gap in self.gaps}
        return tuple(names[n] for n in range(self.frame_count))

    def all_frames(self, clouds: Sequence[np.ndarray] | None = None) -> list[np.ndarray]:
        """A cloud for every frame of the input, shape (0, 3) for gaps; ``clouds``, if given, in place of the points."""
        frames = [np.zeros((0, 3))] * self.frame_count
        for number, cloud in zip(self.numbers, self.points if clouds is None else clouds, strict=True):
            frames[number] = cloud
        return frames

    def judged_frames(self) -> list[np.ndarray]:
        """What every frame of the input is judged by: ``all_frames``, and those left out as unlike the others."""
        left_out = {gap.number: gap.points for gap in self.gaps if gap.points is not None}
        return [left_out.get(t, cloud) for t, cloud in enumerate(self.all_frames())]

    def all_normals(self) -> list[np.ndarray | None]:
        """Normals for every frame of the input; None for gaps and where unknown."""
        normals: list[np.ndarray | None] = [None] * self.frame_count
        for number, given in zip(self.numbers, self.normals, strict=True):
            normals[number] = given
        return normals

    def all_colors(self) -> list[np.ndarray | None]:
        """Colours for every frame of the input; None for gaps and where unknown."""
        colors: list[np.ndarray | None] = [None] * self.frame_count
        for number, cloud in zip(self.numbers, self.clouds, strict=True):
            colors[number] = cloud.colors
        return colors

    @property
    def clouds(self) -> list[FramePoints]:
        """The frames with usable points, each with all that its points carry."""
        colors = self.colors or (None,) * len(self.points)
        return [FramePoints(*arrays) for arrays in zip(self.points, self.normals, colors, strict=True)]

    def with_clouds(self, clouds: Sequence[FramePoints]) -> PointSequence:
        """The sequence with other clouds in the same frames."""
        points, normals, colors = zip(*clouds, strict=True)
        return replace(self, points=points, normals=normals, colors=_or_none(colors))

    def keep(self, masks: Sequence[np.ndarray], note: str) -> PointSequence:
        """The points of the masks, T of shape (N_t,), with all that they carry, and a note of what was done."""
        kept = [cloud.keep(mask) for cloud, mask in zip(self.clouds, masks, strict=True)]
        return replace(self.with_clouds(kept), notes=(*self.notes, note))

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was done to the input, a line each, with the numbers of the frames."""
        lines = list(self.notes)
        numbers = self.numbers
        inner = [g for g in self.gaps if min(numbers) < g.number < max(numbers)]
        outer = [g for g in self.gaps if g not in inner]
        for gaps, done in ((inner, "interpolated between the neighbours"), (outer, "that of the nearest frame")):
            if gaps:
                which, several = name_frames([g.number for g in gaps]), len(gaps) > 1
                meshes, first = ("their meshes are", " The first") if several else ("its mesh is", " Why")
                lines.append(f"{which} of {self.frame_count} cannot be used; {meshes} {done}.{first}: {gaps[0].why}")
        for counts, what in (
            (self.dropped, f"points left out that are not finite, beyond {LARGEST_COORDINATE:g} or all at one place"),
            (self.merged, "duplicate points merged"),
        ):
            found = [n for n, count in zip(numbers, counts, strict=False) if count]
            if found:
                lines.append(f"{what}: {sum(counts)} in {name_frames(found)}")
        found = [n for n, disowned in zip(numbers, self.disowned, strict=False) if disowned]
        if found:
            lines.append(f"normals of length 0 or not finite: those of {name_frames(found)} are estimated instead")
        return tuple(lines)

    @classmethod
    def from_arrays(
        cls,
        points: np.ndarray | Sequence[np.ndarray],
        normals: np.ndarray | Sequence[np.ndarray | None] | None = None,
        names: Sequence[str] | None = None,
        *,
        strict: bool = False,
        colors: np.ndarray | Sequence[np.ndarray | None] | None = None,
    ) -> PointSequence:
        """Check every frame, merge duplicate points, leave out those that are no numbers, make normals unit length.

        Args:
            points: shape (T, N, 3), or a list of T arrays of shape (N_t, 3). Input units.
            normals: as ``points``, any length above zero; None, or None for single frames, where unknown.
            names: T names used in error messages; "frame i" if not given.
            strict: refuse a frame that cannot be used; else it becomes a gap.
            colors: as ``points``, bytes or fractions of 1; a fourth column is left out. None where unknown.

        Raises:
            InputError: fewer than 2 frames, more than half of the frames (with ``strict``: one) with fewer than 10
                points, a wrong shape, all points equal, or normals or colours of another length than the points.
        """
        frame_count = len(points)
        names = tuple(names) if names is not None else tuple(f"frame {i}" for i in range(frame_count))
        normals = [None] * frame_count if normals is None else normals
        colors = [None] * frame_count if colors is None else colors
        for what, given in (("normals", normals), ("colours", colors)):
            if len(given) != frame_count:
                raise InputError(
                    f"{what}: expected {frame_count} frames as in points, got {len(given)}; give them for all, or none"
                )
        frames = zip(names, points, normals, colors, strict=True)
        return cls.from_frames(
            ((name, lambda p=p, n=n, c=c: FramePoints(p, n, c)) for name, p, n, c in frames), strict=strict
        )

    @classmethod
    def from_frames(
        cls,
        frames: Iterable[tuple[str, Callable[[], FramePoints]]],
        *,
        strict: bool = False,
        at_most: int = 0,
        seed: int = 0,
        notes: Sequence[str] = (),
    ) -> PointSequence:
        """As ``from_arrays``, from a name and a function that reads it for each frame, one after the other.

        Args:
            frames: what to read; an ``InputError`` of the function makes the frame a gap.
            strict: as in ``from_arrays``.
            at_most: points kept of a frame, as ``subsample`` does; 0: all. Then no more than one frame is held whole.
            seed: of that choice.
            notes: warnings to carry along.

        Raises:
            InputError: as ``from_arrays``.
        """
        kept: list[tuple[FramePoints, str, int, int, bool]] = []
        gaps: list[Gap] = []
        count = 0
        for number, (name, read) in enumerate(frames):
            count += 1
            try:
                cloud, merged, dropped, disowned = check_cloud(FramePoints(*read()), name)
            except MissingPackageError:
                raise
            except InputError as error:
                if strict:
                    raise
                gaps.append(Gap(number, name, str(error)))
                continue
            cloud = draw_points(cloud, at_most, seed, number) if at_most else cloud
            kept.append((cloud, name, merged, dropped, disowned))
        if count < MIN_FRAMES:
            raise InputError(
                f"the sequence: expected at least {MIN_FRAMES} frames, got {count}; "
                "give a folder of numbered clouds or an npz with points (T, N, 3)"
            )
        if len(kept) < MIN_FRAMES or len(gaps) > len(kept):
            others = f" ({len(gaps)} of {count} frames cannot be used)" if len(gaps) > 1 else ""
            raise InputError(gaps[0].why + others)
        clouds, *told = zip(*kept, strict=True)
        points, normals, colors = zip(*clouds, strict=True)
        return cls(points, normals, *told, gaps=tuple(gaps), notes=tuple(notes), colors=_or_none(colors))

    def select(self, frames: slice) -> PointSequence:
        """The input's frames of a slice, in order, numbered from 0 anew.

        Raises:
            InputError: fewer than 2 frames, or fewer than 2 with usable points, are left.
        """
        order = range(self.frame_count)[frames]
        if order == range(self.frame_count):
            return self
        place = {number: place for place, number in enumerate(self.numbers)}
        chosen = [place[number] for number in order if number in place]
        if len(chosen) < MIN_FRAMES:
            usable = " with usable points" if len(order) > len(chosen) else ""
            raise InputError(
                f"--frames: expected at least {MIN_FRAMES} of {self.frame_count} frames{usable}, got {len(chosen)}; "
                "widen the range"
            )
        gaps = {gap.number: gap for gap in self.gaps}
        kept = tuple(replace(gaps[old], number=new) for new, old in enumerate(order) if old in gaps)
        times = tuple(abs(self.times[old] - self.times[order[0]]) for old in order) if self.times else ()
        return replace(self._chosen(chosen), gaps=kept, order=(), times=times)

    def without(self, reasons: Mapping[int, str], judged: bool = False) -> PointSequence:
        """The sequence with further gaps: why by frame number, one sentence each.

        ``judged``: their meshes are judged by their points all the same.

        Raises:
            InputError: fewer than 2 frames are left.
        """
        left = [t for t, number in enumerate(self.numbers) if number not in reasons]
        if len(left) < MIN_FRAMES:
            raise InputError(f"the sequence: expected at least {MIN_FRAMES} usable frames, got {len(left)}")
        names = self.frame_names
        points = dict(zip(self.numbers, self.points, strict=True)) if judged else {}
        gaps = [*self.gaps, *(Gap(t, names[t], why, points.get(t)) for t, why in reasons.items())]
        return replace(self._chosen(left), gaps=tuple(sorted(gaps, key=lambda gap: gap.number)))

    def in_order(self, order: Sequence[int], note: str) -> PointSequence:
        """The clouds in another order, that of their places (T,); each keeps its number. With a note that says so."""
        moved = replace(self, order=self.numbers)._chosen(order)
        return replace(moved, notes=(*self.notes, note))

    def _chosen(self, frames: Sequence[int]) -> PointSequence:
        """The clouds at these places, with the gaps as they are."""
        columns = ("points", "normals", "colors", "names", "merged", "dropped", "disowned", "order")
        return replace(
            self,
            **{name: tuple(values[t] for t in frames) if (values := getattr(self, name)) else () for name in columns},
        )

    def subsample(self, count: int, seed: int) -> PointSequence:
        """At most ``count`` points a frame, drawn without replacement; order kept; repeatable by ``seed``.

        Raises:
            InputError: ``count`` is below 10.
        """
        if count < MIN_POINTS:
            raise InputError(f"--points: expected at least {MIN_POINTS}, got {count}")
        frames = zip(self.clouds, self.numbers, strict=True)
        return self.with_clouds([draw_points(cloud, count, seed, number) for cloud, number in frames])


def _or_none(colors: tuple[np.ndarray | None, ...]) -> tuple[np.ndarray | None, ...]:
    return () if all(c is None for c in colors) else colors


def name_frames(numbers: Sequence[int]) -> str:
    """``frame 3``, or ``frames 3, 5-7, ...`` with at most eight runs written out."""
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    words = [f"{first}" if first == last else f"{first}-{last}" for first, last in runs]
    if len(words) > 8:
        words = [*words[:7], f"... {words[-1]}"]
    return f"frame{'s' if len(numbers) > 1 else ''} {', '.join(words)}"


@dataclass(frozen=True)
class Similarity:
    """The one map of a whole sequence into the cube: ``unit = (x - centre) * scale``.

    centre: input units, shape (3,) float64
    scale:  cube units per input unit
    """

    centre: np.ndarray
    scale: float

    @classmethod
    def into_cube(cls, clouds: Sequence[np.ndarray], fill: float) -> Similarity:
        """Joint bounding box of all frames to the centre of [-1, 1]^3, its largest side to 2 * ``fill``.

        Raises:
            InputError: the box is too small for its size to be told from 0.
        """
        low = np.min([c.min(axis=0) for c in clouds], axis=0)
        high = np.max([c.max(axis=0) for c in clouds], axis=0)
        extent = float((high - low).max())
        if not extent > 1.0 / LARGEST_COORDINATE:
            raise InputError(
                f"the sequence: expected an extent above {1.0 / LARGEST_COORDINATE:g}, got {extent:g}; check the units"
            )
        return cls((low + high) / 2.0, 2.0 * fill / extent)

    def to_cube(self, x: np.ndarray) -> np.ndarray:
        """Input units to cube units, float64."""
        return (np.asarray(x, dtype=np.float64) - self.centre) * self.scale

    def from_cube(self, x: np.ndarray) -> np.ndarray:
        """Cube units back to input units, float64."""
        return np.asarray(x, dtype=np.float64) / self.scale + self.centre
