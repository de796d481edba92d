"""Clock readings and their statistics."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

WARMUPS = 2  # rounds that are run first and not counted


def seconds(call: Callable, *arguments, **named) -> float:
    """The seconds of one call."""
    start = time.perf_counter()
    call(*arguments, **named)
    return time.perf_counter() - start


def rounds(once: Callable[[], dict[str, float]], repeat: int) -> dict[str, list[float]]:
    """`repeat` readings of every name that once() returns, after WARMUPS rounds that are not counted."""
    readings: dict[str, list[float]] = {}
    for number in range(-WARMUPS, repeat):
        reading = once()
        if number >= 0:
            for name, value in reading.items():
                readings.setdefault(name, []).append(value)
    return readings


def summary(readings: list[float]) -> dict[str, float]:
    """The median, and half the distance between the 10th and the 90th percentile. Readings are seconds, the
    result is milliseconds."""
    low, high = np.percentile(readings, (10, 90))
    return {"ms": 1e3 * float(np.median(readings)), "spread_ms": 1e3 * float(high - low) / 2}


def ratio(above: list[float], below: list[float]) -> float:
    """The median of above / below. Both were read in the same rounds, so a temporary slowdown of the machine
    cancels."""
    return float(np.median(np.divide(above, below)))
