"""Estimates of the memory that a job needs, and the memory that is available.

A job whose estimate exceeds the available memory is refused before it starts; the message names both numbers. peak() measures
the memory that was used.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from .byte_units import size_text
from .camera import Camera
from .errors import SceneError

# Measured as the growth of the process in bytes (docs/reliability.md).
READING = 1.3  # bytes per byte of a splat file: its arrays, and copies of some of them during repair
ROW_FLOATS = 13  # 4-byte values per Gaussian without SH: mean 3, log-scale 3, quaternion 4, opacity logit, existence logit, source row
SH_MOMENT = 2  # bytes of Adam moments per SH coefficient; other values have moments of their own size, 4 bytes
STATISTICS = 8  # bytes per Gaussian: the statistics of densification
ADDED_COPIES = 2  # temporary copies of the values of a Gaussian that densification adds
PROJECTED = 150  # bytes per projected Gaussian
RENDERED_PIXEL, TUNED_PIXEL, MEASURED_PIXEL = 100, 200, 400  # bytes per pixel of a view: rendering, fine-tuning, metrics
CGROUP = Path("/sys/fs/cgroup")


def reading(file_bytes: int) -> int:
    """Bytes of memory needed to read a splat file of file_bytes bytes."""
    return int(READING * file_bytes)


def rendering(count: int, width: int, height: int) -> int:
    """Bytes of memory needed to render one view of width x height pixels of `count` Gaussians that are in memory already."""
    return PROJECTED * count + RENDERED_PIXEL * width * height


def tuning(count: int, coefficients: int, cameras: Sequence[Camera], kept_photographs: int) -> int:
    """Bytes of memory needed to fine-tune and evaluate `count` Gaussians.

    coefficients: SH coefficients per channel, K. cameras: all views; the largest one counts. kept_photographs: memory budget of
    cached photographs in bytes; at most 3 bytes per pixel of all views are counted.
    """
    photographs = min(kept_photographs, 3 * sum(camera.width * camera.height for camera in cameras))
    row, moments = _trained_row(coefficients)
    return int(row + moments + PROJECTED) * count + (TUNED_PIXEL + MEASURED_PIXEL) * _pixels(cameras) + photographs


def growing(count: int, added: int, coefficients: int, cameras: Sequence[Camera]) -> int:
    """Further bytes of memory needed to add `added` Gaussians to `count` ones during training.

    The arrays are copied one after the other, so one copy of the largest array counts. Metrics of a view at the end must fit as well.
    """
    (row, moments), largest = _trained_row(coefficients), 4 * 3 * coefficients
    new = (1 + ADDED_COPIES) * row + moments + PROJECTED
    return new * added + largest * (count + added) + MEASURED_PIXEL * _pixels(cameras)


def checkpoint(count: int, coefficients: int) -> int:
    """Bytes on disk of a checkpoint of `count` Gaussians. coefficients: SH coefficients per channel."""
    return (sum(_trained_row(coefficients)) + STATISTICS) * count


def _trained_row(coefficients: int) -> tuple[int, int]:
    """Bytes of the parameters and of the Adam moments of one Gaussian with K SH coefficients per channel."""
    other = 4 * ROW_FLOATS
    return other + 4 * 3 * coefficients, other + SH_MOMENT * 3 * coefficients


def shortage(what: str, needed: int) -> str:
    """A sentence if `needed` bytes exceed the available memory, else ''. what: subject of the sentence, such as 'pruning a.ply'."""
    free = available()
    if free is None or needed <= free:
        return ""
    return f"{what} needs about {size_text(needed)} of memory, but only {size_text(free)} are available"


def refuse_excess(what: str, needed: int) -> None:
    """Raises SceneError with the sentence of shortage() if there is one."""
    if sentence := shortage(what, needed):
        raise SceneError(sentence)


def available() -> int | None:
    """Bytes that this process can still allocate without swapping, a container's limit included; None if the system does not report it."""
    limits = [limit for limit in (_system_available(), _cgroup_available()) if limit is not None]
    return min(limits) if limits else None


def peak() -> int | None:
    """Largest resident set size of this process so far in bytes; None if the system does not report it."""
    try:  # VmHWM counts this program only; on Linux, getrusage starts with the size of the parent process
        return _proc_bytes("self/status", "VmHWM")
    except (OSError, ValueError):
        pass
    try:
        import resource
    except ImportError:
        return None
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else most * 1024


def _pixels(cameras: Sequence[Camera]) -> int:
    """Number of pixels of the largest view."""
    return max(camera.width * camera.height for camera in cameras)


def _system_available() -> int | None:
    """Available bytes of the whole system; None if it does not report them."""
    try:
        return _proc_bytes("meminfo", "MemAvailable")
    except (OSError, ValueError):  # macOS reports only its total memory, Windows nothing without ctypes
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else None


def _proc_bytes(file: str, name: str) -> int:
    """Bytes in the line `name` of /proc/`file`. Raises OSError or ValueError if there is no such file or line."""
    text = Path("/proc", file).read_text()
    return 1024 * int(text.partition(f"{name}:")[2].partition("kB")[0])


def _cgroup_available() -> int | None:
    """Bytes below the limit of the container (cgroup v2), where cached files count as free; None without a limit."""
    try:
        limit = (CGROUP / "memory.max").read_text().strip()
        used = int((CGROUP / "memory.current").read_text())
        facts = dict(line.split() for line in (CGROUP / "memory.stat").read_text().splitlines())
        return None if limit == "max" else max(0, int(limit) - used + int(facts.get("inactive_file", 0)))
    except (OSError, ValueError):
        return None
