"""What more cores would give: the serial part of a picture and of a step, and how evenly their tasks can be
shared.

With one thread, the library says how long each task of its thread pool takes. What a call takes beyond its
tasks is serial. From both follows a lower bound of the time with any number of threads: each task goes to the
thread that is free first, as in the pool. It knows nothing of memory and of caches that threads share, nor of
the microseconds in which a thread wakes. The speed-up is also measured, with as many threads as there are
cores at most. So is the speed-up of multiply-adds in registers: busy neighbours of a virtual machine, and a
clock rate that falls as more cores work, slow both down.
"""

from __future__ import annotations

import heapq
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from svrgs_addon.native import library
from svrgs_addon.native.library import traced

from .cases import Case
from .measure import PEAK_READINGS
from .scenes import orbit_camera, room
from .timing import ratio, seconds
from .trial import Trial

COUNTS = (1, 2, 4, 8, 16, 32, 64)  # of threads
TOPOLOGY = Path("/sys/devices/system/cpu")
CASES = ((100_000, (1280, 720)), (500_000, (640, 360)))  # Gaussians, image size


def measure_cores(repeat: int, progress: Callable[[str], None], cases=CASES) -> dict:
    """The entry `cores` of the result."""
    entries = []
    for count, size in cases:
        progress(f"cores: {count:,} Gaussians, {size[0]} x {size[1]}")
        library.set_threads(1)
        trial = Trial(Case("room", room(count, 3), orbit_camera(*size)))
        for name, call in (("picture", trial.forward), ("step", trial.step)):
            facts = {"count": count, "width": size[0], "height": size[1], "what": name}
            entries.append(facts | _foreseen(call, repeat) | _measured(call, repeat))
    library.set_threads(0)
    return dict(cores=physical_cores(), threads=library.threads(), arithmetic=_arithmetic(), entries=entries)


def physical_cores() -> int | None:
    """The number of cores that this process may use. Two threads of one core (SMT) count once. None if that
    is not known, which it is on Linux alone."""
    try:
        siblings = {
            (TOPOLOGY / f"cpu{number}/topology/thread_siblings_list").read_text().strip()
            for number in os.sched_getaffinity(0)
        }
    except (AttributeError, OSError):
        return None
    return len(siblings)


def _foreseen(call: Callable[[], object], repeat: int) -> dict:
    """Medians over the repeats: milliseconds with one thread, the serial share, jobs, and the best speed-up
    with each number of threads."""
    call()
    total: list[float] = []
    serial: list[float] = []
    bounds: dict[int, list[float]] = {threads: [] for threads in COUNTS}
    jobs: list[np.ndarray] = []
    for _ in range(repeat):
        jobs = traced(lambda: total.append(seconds(call)))
        serial.append(total[-1] - sum(float(job.sum()) for job in jobs))
        for threads in COUNTS:
            bounds[threads].append(serial[-1] + sum(makespan(job, threads) for job in jobs))
    return {
        "ms": 1e3 * float(np.median(total)),
        "serial": ratio(serial, total),
        "jobs": len(jobs),
        "speed_up": {str(threads): ratio(total, bounds[threads]) for threads in COUNTS},
    }


def makespan(tasks: np.ndarray, threads: int) -> float:
    """Seconds until tasks of so many seconds, (n,), are done, when a thread that is free takes the next
    one."""
    free = [0.0] * min(threads, max(1, len(tasks)))
    for task in tasks.tolist():
        heapq.heapreplace(free, free[0] + task)
    return max(free)


def _thread_counts() -> list[int]:
    library.set_threads(0)
    return [count for count in COUNTS if count <= library.threads()]


def _arithmetic() -> dict[str, float]:
    """The speed-up of multiply-adds in registers with each number of threads for which there are cores."""
    rates: dict[int, list[float]] = {count: [] for count in _thread_counts()}
    for _ in range(PEAK_READINGS):
        for count in rates:
            library.set_threads(count)
            rates[count].append(library.peaks(library.best_level())["fma"])
    library.set_threads(0)
    return {str(count): ratio(rates[count], rates[1]) for count in rates}


def _measured(call: Callable[[], object], repeat: int) -> dict:
    """The speed-up over one thread and the milliseconds, with each number of threads for which there are
    cores. All are measured in each round."""
    counts = _thread_counts()
    readings: dict[int, list[float]] = {count: [] for count in counts}
    for _ in range(repeat):
        for count in counts:
            library.set_threads(count)
            call()
            readings[count].append(seconds(call))
    library.set_threads(1)
    return {
        "measured": {str(count): ratio(readings[1], readings[count]) for count in counts},
        "measured_ms": {str(count): 1e3 * float(np.median(readings[count])) for count in counts},
    }
