"""Memory foreseen from sizes: what would not fit is refused before it starts, with the number."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from .camera import Camera
from .errors import SceneError

# Bytes, measured as the growth of the process (docs/reliability.md).
READING = 1.3  # times a file's size: its arrays, and copies of some while they are mended
ROW_FLOATS = 13  # of a Gaussian beside its SH coefficients: place, size, turn, opacity, mask, origin
MOMENTS = 2  # arrays of the optimiser for each of them
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
    pixels = max(camera.width * camera.height for camera in cameras)
    photographs = min(kept_photographs, 3 * sum(camera.width * camera.height for camera in cameras))
    row = 4 * (ROW_FLOATS + 3 * coefficients)
    return int((1 + MOMENTS) * row + PROJECTED) * count + (TUNED_PIXEL + MEASURED_PIXEL) * pixels + photographs


def refuse_excess(what: str, needed: int) -> None:
    """Raises SceneError where `needed` bytes are more than are available. what: the sentence's subject, as 'pruning a.ply'."""
    free = available()
    if free is not None and needed > free:
        raise SceneError(f"{what} needs about {_gigabytes(needed)} of memory, but only {_gigabytes(free)} are available")


def available() -> int | None:
    """Bytes this process may still take without swapping; None where the system does not tell."""
    limits = [limit for limit in (_system(), _cgroup()) if limit is not None]
    return min(limits) if limits else None


def _gigabytes(value: int) -> str:
    return f"{value / 1e9:.1f} GB" if value >= 1e8 else f"{value / 1e6:.1f} MB"


def _system() -> int | None:
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        return next(1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:"))
    except (OSError, StopIteration, ValueError):  # macOS tells its whole memory only, Windows nothing without ctypes
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else None


def _cgroup() -> int | None:
    """What is left of a container's limit; files that are only cached count as free."""
    try:
        limit = (CGROUP / "memory.max").read_text().strip()
        used = int((CGROUP / "memory.current").read_text())
        facts = dict(line.split() for line in (CGROUP / "memory.stat").read_text().splitlines())
        return None if limit == "max" else max(0, int(limit) - used + int(facts.get("inactive_file", 0)))
    except (OSError, ValueError):
        return None
