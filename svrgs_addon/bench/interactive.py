"""Frames per second of a large scene under an orbiting camera."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .. import native
from .preview import Preview
from .scenes import orbit_camera, room
from .timing import WARMUPS, seconds

COUNT, SIZE = 1_000_000, (640, 360)
FRAMES, STEP = 30, 1.0  # number of frames; degrees per frame


def measure_interactive(tell: Callable[[str], None], count: int = COUNT, size: tuple[int, int] = SIZE, frames: int = FRAMES) -> dict:
    """The entry `interactive` of the result: milliseconds of the median and of the slowest frame, frames per second, and `rest_ms`, the
    milliseconds of a frame whose camera has not moved."""
    tell(f"orbiting around {count:,} Gaussians")
    preview = Preview(room(count), native.RenderOptions())
    cameras = [orbit_camera(*size, turn=STEP * k) for k in range(WARMUPS + frames)]
    ms = [1e3 * seconds(preview.image, camera) for camera in cameras][WARMUPS:]
    median = float(np.median(ms))
    return {
        "count": count,
        "width": size[0],
        "height": size[1],
        "threads": native.threads(),
        "frame_ms": median,
        "slowest_ms": max(ms),
        "frames_per_second": 1e3 / median,
        "rest_ms": 1e3 * seconds(preview.image, cameras[-1]),
    }
