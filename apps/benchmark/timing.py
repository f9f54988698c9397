"""How ``warpdef bench`` takes a time: warm-up, many launches, median and quartiles, a null test of the clock."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from warpdef.device import is_cuda

NULL_RATIO = (2.5, 6.0)
"""Four times the work must cost between these many times as much, or no figure of the run is to be believed."""


@dataclass(frozen=True)
class Timing:
    """Seconds of one launch: median, quartiles, mean, and how many were taken."""

    median: float
    low: float
    high: float
    mean: float
    count: int

    @classmethod
    def of(cls, seconds: Sequence[float]) -> Timing:
        """Statistics of single times.

        Raises:
            ValueError: none given.
        """
        if len(seconds) == 0:
            raise ValueError("times: expected at least one, got none")
        low, median, high = np.percentile(seconds, [25, 50, 75])
        return cls(float(median), float(low), float(high), float(np.mean(seconds)), len(seconds))

    def to_json(self) -> dict[str, float]:
        """In milliseconds."""
        return {
            "ms": 1e3 * self.median,
            "ms_low": 1e3 * self.low,
            "ms_high": 1e3 * self.high,
            "ms_mean": 1e3 * self.mean,
            "launches": self.count,
        }


class DeviceTimer:
    """Seconds of a call on one device: CUDA by events on the device, the CPU by the performance counter."""

    def __init__(self, device: wp.Device) -> None:
        self.device = device
        if is_cuda(device):
            self._start, self._end = (wp.Event(device=device, enable_timing=True) for _ in range(2))

    def seconds(self, run: Callable[[], object], count: int = 1) -> float:
        """Seconds of ``count`` calls together."""
        if is_cuda(self.device):
            # Not the default device's stream, which this need not be.
            stream = wp.get_stream(self.device)
            stream.record_event(self._start)
            for _ in range(count):
                run()
            stream.record_event(self._end)
            wp.synchronize_event(self._end)
            return 1e-3 * wp.get_event_elapsed_time(self._start, self._end)
        start = time.perf_counter()
        for _ in range(count):
            run()
        return time.perf_counter() - start


@dataclass(frozen=True)
class Effort:
    """How long to measure one row: seconds to spend, and bounds on the number of samples."""

    seconds: float = 0.6
    least: int = 9
    most: int = 200


QUICK = Effort(seconds=0.01, least=3, most=10)
SHORTEST_SAMPLE = 5e-4  # seconds: shorter calls are timed several at a time, so that the clock's own cost vanishes


def measure(
    run: Callable[[], object],
    seconds: Callable[[Callable[[], object], int], float],
    effort: Effort,
    before: Callable[[], None] | None = None,
) -> Timing:
    """Time ``run`` after two calls to warm up.

    Args:
        seconds: ``DeviceTimer.seconds``, or a stand-in: (run, count) -> seconds.
        before: called untimed ahead of every timed call, which then is one call a sample.
    """

    def ready() -> None:
        if before is not None:
            before()

    for _ in range(2):
        ready()
        once = seconds(run, 1)
    batch = 1 if before is not None else max(1, math.ceil(SHORTEST_SAMPLE / max(once, 1e-7)))
    samples = int(min(max(effort.seconds / max(once * batch, 1e-7), effort.least), effort.most))
    times = []
    for _ in range(samples):
        ready()
        times.append(seconds(run, batch) / batch)
    return Timing.of(times)


def null_test(cost: Callable[[int], float], sizes: tuple[int, int], rounds: int = 7) -> dict:
    """Does four times the work cost about four times as much?

    Args:
        cost: seconds of work of a size. sizes: the smaller and four times it; the two are timed in turn, so that a
            change in the machine's load meets both.

    Raises:
        ValueError: the second size is not four times the first.
    """
    if sizes[1] != 4 * sizes[0]:
        raise ValueError(f"null test: expected the second size to be four times the first, got {sizes}")
    for size in sizes:
        cost(size)
    pairs = [(cost(sizes[0]), cost(sizes[1])) for _ in range(rounds)]
    small, large = (float(np.median(times)) for times in zip(*pairs, strict=True))
    ratio = large / small if small > 0 else math.inf
    low, high = NULL_RATIO
    return {"sizes": list(sizes), "seconds": [small, large], "ratio": ratio, "passed": bool(low <= ratio <= high)}


def fit_exponent(sizes: Sequence[float] | np.ndarray, values: Sequence[float] | np.ndarray) -> float:
    """Exponent p of values ~ sizes^p: the slope of a least-squares line through the logarithms.

    Raises:
        ValueError: fewer than two different sizes, or a number that is not above 0.
    """
    x, y = np.asarray(sizes, dtype=float), np.asarray(values, dtype=float)
    if len(np.unique(x)) < 2 or x.shape != y.shape:
        raise ValueError(f"growth: expected at least two different sizes and a value each, got {list(x)} and {list(y)}")
    if not ((x > 0).all() and (y > 0).all()):
        raise ValueError("growth: expected sizes and values above 0")
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])
