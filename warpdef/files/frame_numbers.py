"""What the numbers in file names say of time: which files are one series, in which order, and which are missing.

    numbering = read_names(["scan_000", "scan_001", "scan_004"])
    numbering.order, numbering.missing        # [0, 1, 2], {2: 2}: two are missing before the third

Dates and times of day sort as time (day first or year first, months by name, past midnight, 12 hours with am and pm).
Numbers are negative where some names have a minus before theirs and others none.
A number is missing where all steps are multiples of the usual one, give or take a fifth as stamps of clocks have it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta

import numpy as np

from warpdef.errors import InputError

_MONTHS: tuple[str, ...] = tuple("jan feb mar apr may jun jul aug sep oct nov dec".split())
_MONTH = re.compile(
    r"(?<![a-z])(january|february|march|april|june|july|august|september|october|november|december|"
    + "|".join(_MONTHS)
    + r")(?![a-z])"
)
_MINUS = re.compile(r"(^|[\W_])-$")
_HALF_DAY = re.compile(r"(?<=[0-9])[ _.-]?([ap])\.?m\.?(?![a-z0-9])")
_UNEVEN = 0.2  # of the usual step
_MISSING_MOST = 0.5  # frames missing for one that is there, beyond which a jump is no gap
_DAY = 86400.0


@dataclass(frozen=True)
class Numbering:
    """What names say.

    order:   places of the names, in the order of time
    missing: how many frames are missing before a place of that order
    numbers: the number of each name, in that order, where one number counts the frames; else None
    notes:   what was concluded that could be wrong, a line each
    times:   of the names, in that order, in usual steps from the first, where steps are uneven; else None
    """

    order: list[int]
    missing: dict[int, int] = field(default_factory=dict)
    numbers: list[int] | None = None
    notes: tuple[str, ...] = ()
    times: list[float] | None = None


def natural_key(name: str) -> tuple:
    """Sort key under which ``f2`` comes before ``f10``, padded or not, upper and lower case alike."""
    parts = re.split(r"([0-9]+)", name.casefold())
    return tuple((1, int(p), len(p)) if i % 2 else (0, p, 0) for i, p in enumerate(parts)), name


def pattern(stem: str) -> tuple[str, ...]:
    """The text between the numbers of a name, separators alike: equal for the names of one series."""
    first, *others = _split(stem)[0::2]
    return tuple(re.sub(r"[\W_]+", " ", part) for part in ("" if first == "-" else first, *others))


def read_names(stems: Sequence[str], where: str = "") -> Numbering:
    """Order the names of one series, and tell where frames are missing.

    Args:
        stems: file names without suffix. where: folder for errors.

    Raises:
        InputError: two series, the same number twice, or dates that may be read in two ways.
    """
    natural = sorted(range(len(stems)), key=lambda i: natural_key(stems[i]))
    rows = [_split(stem)[1::2] for stem in stems]
    if len({pattern(stem) for stem in stems}) > 1 or not rows or not rows[0]:
        return Numbering(natural)
    table = np.array([[min(int(word), 2**62) for word in row] for row in rows], dtype=np.int64)
    time, notes, leading = _times(stems, rows, table, where)
    if time is not None:
        rest = [tuple(table[i, leading:]) for i in range(len(stems))]
        order = sorted(range(len(stems)), key=lambda i: (time[i], rest[i], natural_key(stems[i])))
        missing, uneven, times = _missing([time[i] for i in order])
        return Numbering(order, missing, None, notes + uneven, times)
    minus = _minus(stems)
    # Some names with and some without: f_-1, f_0, f_1.
    table = np.where(minus & ~minus.all(axis=0), -table, table)
    moving = [c for c in range(table.shape[1]) if len(set(table[:, c])) > 1]
    if not moving:
        if len(stems) > 1:
            raise InputError(f"{where}: expected different numbers in the names, got '{stems[0]}' and '{stems[1]}'")
        return Numbering(natural)
    if moving[-1] == table.shape[1] - 1 and moving[0] >= table.shape[1] - 2 and _are_decimals(stems, rows):
        order = sorted(range(len(stems)), key=lambda i: (int(rows[i][-2]), float(f"0.{rows[i][-1]}")))
        missing, uneven, times = _missing([float(f"{rows[i][-2]}.{rows[i][-1]}") for i in order])
        return Numbering(order, missing, None, uneven, times)
    if len(moving) == 1:
        values = table[:, moving[0]]
        order = sorted(range(len(stems)), key=lambda i: values[i])
        numbers = [int(values[i]) for i in order]
        twice = next((i for i in range(1, len(order)) if numbers[i] == numbers[i - 1]), None)
        if twice is not None:
            pair = f"'{stems[order[twice - 1]]}' and '{stems[order[twice]]}'"
            raise InputError(f"{where}: two files have the number {numbers[twice]}: {pair}; keep one of them")
        missing, uneven, times = _missing(numbers)
        if minus[:, moving[0]].all():
            dash = f"the '-' before the numbers in the file names is taken for a dash: '{stems[order[0]]}' is the first"
            uneven = (*uneven, dash)
        return Numbering(order, missing, numbers, uneven, times)
    _refuse_two_series(stems, table, moving, where)
    return Numbering(natural)


def refuse_several(names: Sequence[Sequence[str]], where: str) -> None:
    """Refuse series of names that are told apart by their text.

    Raises:
        InputError: there is more than one; it names one file of each of the first two.
    """
    if len(names) > 1:
        first, second = (min(series, key=natural_key) for series in names[:2])
        raise InputError(_two(where, first, second, len(names)))


def _split(stem: str) -> list[str]:
    """Text and numbers by turns, months by name as numbers, without am and pm."""
    text = _HALF_DAY.sub("", stem.casefold())
    text = _MONTH.sub(lambda m: f"-{_MONTHS.index(m[1][:3]) + 1:02d}-", text)
    return re.split(r"([0-9]+)", text)


def _minus(stems: Sequence[str]) -> np.ndarray:
    """Whether a minus stands before each number of each name; between letters or digits it is a dash."""
    before = [_split(stem)[0:-1:2] for stem in stems]
    return np.array([[bool(_MINUS.search(f"{'0' * (i > 0)}{text}")) for i, text in enumerate(row)] for row in before])


def _two(where: str, first: str, second: str, count: int) -> str:
    return (
        f"{where}: expected one series of frames, got {count}, as '{first}' and '{second}' show; put each into a "
        "folder of its own"
    )


def _refuse_two_series(stems: Sequence[str], table: np.ndarray, moving: list[int], where: str) -> None:
    """Two numbers that change independently are a camera and a frame, not one time."""
    for column in sorted(moving, key=lambda c: len(set(table[:, c]))):
        others = [c for c in moving if c != column]
        sets: dict[int, dict[tuple, int]] = {}
        for i, row in enumerate(table):
            sets.setdefault(int(row[column]), {})[tuple(row[others])] = i
        groups = sorted(sets.items())
        for (_, a), (_, b) in zip(groups[:-1], groups[1:], strict=True):
            common = a.keys() & b.keys()
            if len(common) >= 2 and len(common) >= 0.5 * min(len(a), len(b)):
                shared = min(common)
                raise InputError(_two(where, stems[a[shared]], stems[b[shared]], len(groups)))


def _are_decimals(stems: Sequence[str], rows: Sequence[Sequence[str]]) -> bool:
    """Whether all names end in seconds with decimals: a counter has no leading 0 where widths differ, no billions."""
    if not all(re.search(r"[0-9]\.[0-9]+$", stem) for stem in stems):
        return False
    uneven = len({len(row[-1]) for row in rows}) > 1
    return uneven and (any(row[-1].startswith("0") for row in rows) or all(len(row[-2]) >= 9 for row in rows))


def _missing(values: Sequence[float]) -> tuple[dict[int, int], tuple[str, ...], list[float] | None]:
    """Frames missing before each place of ascending values; a note where their steps are not regular, and the times."""
    steps = np.diff(np.asarray(values, dtype=np.float64))
    if len(steps) < 2 or not (steps > 0).all():
        return {}, (), None
    usual = float(np.sort(steps)[(len(steps) - 1) // 2])
    times = steps / usual
    missing = {i + 1: int(np.rint(t)) - 1 for i, t in enumerate(times) if np.rint(t) > 1}
    regular = (np.abs(times - np.rint(times)) <= _UNEVEN).all() and (np.rint(times) == 1).mean() >= 0.5
    if regular and sum(missing.values()) <= _MISSING_MOST * len(values):
        return missing, (), None
    widest = int(steps.argmax())
    jump = f"from {values[widest]:.12g} to {values[widest + 1]:.12g} at once"
    note = f"the numbers in the file names are uneven, {jump}: frames are taken at these times, without others between"
    return {}, (note,), np.concatenate([[0.0], np.cumsum(times)]).tolist()


def _times(
    stems: Sequence[str], rows: Sequence[Sequence[str]], table: np.ndarray, where: str
) -> tuple[list[float] | None, tuple[str, ...], int]:
    """Seconds of each name if it holds a date or a time of day that changes; notes; numbers used up from the left."""
    count = table.shape[1]
    date, at = _date_columns(stems, rows, table, where)
    if date is None:
        at = next((i for i in range(count - 2) if _is_clock(rows, table, i)), count)
        if at == count or not (table[:, at : at + 3] != table[0, at : at + 3]).any():
            return None, (), 0
    seconds = np.zeros(len(rows))
    used = at
    if used < count and _is_clock(rows, table, used, two=True):
        three = _is_clock(rows, table, used)
        halves = [_HALF_DAY.search(stem.casefold()) for stem in stems]
        for i, half in enumerate(halves):
            hour = int(table[i, used])
            if all(halves) and half is not None:
                hour = hour % 12 + (12 if half[1] == "p" else 0)
            seconds[i] = 3600 * hour + 60 * table[i, used + 1] + (table[i, used + 2] if three else 0)
        used += 3 if three else 2
        if three and used < count and all(len(row[used]) in (3, 6, 9) for row in rows):
            seconds += [float(f"0.{row[used]}") for row in rows]
            used += 1
    if date is not None:
        seconds = seconds + date
        return (list(seconds), (), used) if len(set(seconds)) > 1 else (None, (), 0)
    notes: tuple[str, ...] = ()
    ordered = np.sort(seconds)
    between = np.diff(ordered)
    # Times of day without a date: what is left out of the day is the longest stretch without frames.
    if len(between) and between.max() > _DAY / 2 > ordered[0] + _DAY - ordered[-1]:
        start = ordered[int(between.argmax()) + 1]
        seconds = np.where(seconds >= start, seconds, seconds + _DAY)
        first = stems[int(np.argmin(seconds))]
        notes = (f"the times in the file names go past midnight: '{first}' is taken for the first",)
    return list(seconds), notes, used


def _is_clock(rows: Sequence[Sequence[str]], table: np.ndarray, at: int, two: bool = False) -> bool:
    """Whether hours, minutes and seconds (``two``: perhaps no seconds) begin at a column: two digits each."""
    columns = 2 if two else 3
    if at + columns > table.shape[1] or any(len(row[at + c]) != 2 for row in rows for c in range(columns)):
        return False
    return bool((table[:, at : at + columns] <= np.array([23, 59, 60])[:columns]).all())


def _date_columns(
    stems: Sequence[str], rows: Sequence[Sequence[str]], table: np.ndarray, where: str
) -> tuple[np.ndarray | None, int]:
    """Seconds of the day that each name tells, and the column behind the date."""
    for at in range(table.shape[1] - 2):
        three = table[:, at : at + 3]
        widths = [{len(row[at + c]) for row in rows} for c in range(3)]
        if widths[0] == {4} and max(widths[1] | widths[2]) <= 2 and _days(three) is not None:
            return _days(three), at + 3
        if widths[2] == {4} and max(widths[0] | widths[1]) <= 2:
            day_first, month_first = _days(three[:, ::-1]), _days(three[:, [2, 0, 1]])
            named = any(_MONTH.search(stem.casefold()) for stem in stems)
            changing = [len(set(three[:, c])) > 1 for c in (0, 1)]
            if day_first is not None and month_first is not None and not named and all(changing):
                if list(np.argsort(day_first, kind="stable")) != list(np.argsort(month_first, kind="stable")):
                    raise InputError(
                        f"{where}: the date in '{stems[0]}' may begin with the day or with the month; name the files "
                        "year first"
                    )
            found = day_first if day_first is not None else month_first
            if found is not None:
                return found, at + 3
    return None, 0


def _days(dates: np.ndarray) -> np.ndarray | None:
    """Seconds of year, month, day, shape (N, 3); None if one of them is no date."""
    try:
        start = datetime(1970, 1, 1)
        days = [datetime(int(row[0]), int(row[1]), int(row[2])) - start for row in dates]
    except (ValueError, OverflowError):
        return None
    if not ((dates[:, 0] >= 1900) & (dates[:, 0] <= 2100)).all():
        return None
    return np.array([day / timedelta(seconds=1) for day in days])
