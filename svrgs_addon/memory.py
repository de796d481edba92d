"""Memory foreseen from sizes: what would not fit is refused before it starts, with the number. And what was taken."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from .camera import Camera
from .errors import SceneError

# Bytes, measured as the growth of the process (docs/reliability.md).
READING = 1.3  # times a file's size: its arrays, and copies of some while they are mended
ROW_FLOATS = 13  # of a Gaussian beside its SH coefficients: place, size, turn, opacity, mask, origin
SH_MOMENT = 2  # bytes of a coefficient: what the optimiser keeps of it; of other values as much as they take
BORN_COPIES = 2  # of a new Gaussian's values while it joins the others
PROJECTED = 150  # of a Gaussian on the screen
RENDERED_PIXEL, TUNED_PIXEL, MEASURED_PIXEL = 100, 200, 400
CGROUP = Path("/sys/fs/cgroup")


def reading(file_bytes: int) -> int:
    """To read a splat file of that size."""
    return int(READING * file_bytes)


def rendering(count: int, width: int, height: int) -> int:
    """To draw a scene that is in memory."""
    return PROJECTED * count + RENDERED_PIXEL * width * height


def tuning(count: int, coefficients: int, cameras: Sequence[Camera], kept_photographs: int) -> int:
    """To fine-tune and measure `count` Gaussians with K coefficients a channel, photographs (bytes) beside them."""
    photographs = min(kept_photographs, 3 * sum(camera.width * camera.height for camera in cameras))
    row, moments = _trained_row(coefficients)
    return int(row + moments + PROJECTED) * count + (TUNED_PIXEL + MEASURED_PIXEL) * _pixels(cameras) + photographs


def growing(count: int, born: int, coefficients: int, cameras: Sequence[Camera]) -> int:
    """To add `born` Gaussians to `count` in training, one array after the other copied, and still to measure a view in the end."""
    (row, moments), largest = _trained_row(coefficients), 4 * 3 * coefficients
    new = (1 + BORN_COPIES) * row + moments + PROJECTED
    return new * born + largest * (count + born) + MEASURED_PIXEL * _pixels(cameras)


def _trained_row(coefficients: int) -> tuple[int, int]:
    """Bytes of a Gaussian with K coefficients a channel, and of its moments."""
    other = 4 * ROW_FLOATS
    return other + 4 * 3 * coefficients, other + SH_MOMENT * 3 * coefficients


def shortage(what: str, needed: int) -> str:
    """The sentence that `needed` bytes are more than are available, or ''. what: its subject, as 'pruning a.ply'."""
    free = available()
    if free is None or needed <= free:
        return ""
    return f"{what} needs about {_gigabytes(needed)} of memory, but only {_gigabytes(free)} are available"


def refuse_excess(what: str, needed: int) -> None:
    """Raises SceneError where there is a shortage."""
    if sentence := shortage(what, needed):
        raise SceneError(sentence)


def available() -> int | None:
    """Bytes this process may still take without swapping; None where the system does not tell."""
    limits = [limit for limit in (_system(), _cgroup()) if limit is not None]
    return min(limits) if limits else None


def peak() -> int | None:
    """Largest resident size of this process so far, bytes; None where the system does not tell."""
    try:  # of this program alone: what getrusage tells on Linux is no less than what the process held that started it
        return _kernel_says("self/status", "VmHWM")
    except (OSError, ValueError):
        pass
    try:
        import resource
    except ImportError:
        return None
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else most * 1024


def _pixels(cameras: Sequence[Camera]) -> int:
    """Of the largest view."""
    return max(camera.width * camera.height for camera in cameras)


def _gigabytes(value: int) -> str:
    return f"{value / 1e9:.1f} GB" if value >= 1e8 else f"{value / 1e6:.1f} MB"


def _system() -> int | None:
    try:
        return _kernel_says("meminfo", "MemAvailable")
    except (OSError, ValueError):  # macOS tells its whole memory only, Windows nothing without ctypes
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else None


def _kernel_says(file: str, name: str) -> int:
    """Bytes in the line of that name; OSError or ValueError where there is none."""
    text = Path("/proc", file).read_text()
    return 1024 * int(text.partition(f"{name}:")[2].partition("kB")[0])


def _cgroup() -> int | None:
    """What is left of a container's limit; files that are only cached count as free."""
    try:
        limit = (CGROUP / "memory.max").read_text().strip()
        used = int((CGROUP / "memory.current").read_text())
        facts = dict(line.split() for line in (CGROUP / "memory.stat").read_text().splitlines())
        return None if limit == "max" else max(0, int(limit) - used + int(facts.get("inactive_file", 0)))
    except (OSError, ValueError):
        return None
