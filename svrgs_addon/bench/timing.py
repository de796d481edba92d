"""Clock readings and what is said of them."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

WARMUPS = 2


def seconds(call: Callable, *arguments, **named) -> float:
    """How long one call takes."""
    start = time.perf_counter()
    call(*arguments, **named)
    return time.perf_counter() - start


def rounds(once: Callable[[], dict[str, float]], repeat: int) -> dict[str, list[float]]:
    """`repeat` readings of every name that once() returns, after a few rounds that do not count."""
    readings: dict[str, list[float]] = {}
    for number in range(-WARMUPS, repeat):
        reading = once()
        if number >= 0:
            for name, value in reading.items():
                readings.setdefault(name, []).append(value)
    return readings


def summary(readings: list[float]) -> dict[str, float]:
    """Median and half the distance between the 10th and 90th percentile, seconds in, milliseconds out."""
    low, high = np.percentile(readings, (10, 90))
    return {"ms": 1e3 * float(np.median(readings)), "spread_ms": 1e3 * float(high - low) / 2}


def ratio(above: list[float], below: list[float]) -> float:
    """Median of above / below, read in the same rounds: what slows the machine for a while cancels."""
    return float(np.median(np.divide(above, below)))
