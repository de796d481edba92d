"""Some Gaussians of a file that is larger than memory, in the place of all: to place cameras, and to see
whether given ones belong to the scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...files.registry import load_parts
from ...scene.camera import Camera
from ...scene.concatenate import concatenated
from ...scene.gaussians import Scene

MAX_SAMPLED = 500_000  # Gaussians


def sample_of(source: Path) -> tuple[Scene, float]:
    """Evenly spread rows of the file, MAX_SAMPLED at most, in one colour each (SH degree 0), enlarged so
    that they cover about what all do; and by how much. Raises SplatError."""
    parts, step, start = list[Scene](), 1, 0
    for part in load_parts(source):
        some = part.select(np.arange(-start % step, part.count, step))
        sh = np.ascontiguousarray(some.sh[:, :1])
        parts.append(replace(some, sh=sh, attributes={}, comments=(), property_order=()))
        start += part.count
        while sum(one.count for one in parts) > MAX_SAMPLED:
            whole = concatenated(parts, columns=True)
            parts, step = [whole.select(np.arange(0, whole.count, 2))], 2 * step
    scene = concatenated(parts, columns=True)
    enlarged = step**0.5
    return replace(scene, log_scales=scene.log_scales + np.float32(np.log(enlarged))), enlarged


def finer(cameras: Sequence[Camera]) -> list[Camera]:
    """The views at twice their size: scores and fine-tuning halve all views, and pictures of placed cameras
    are just large enough."""
    return [camera.resized(2 * camera.width, 2 * camera.height) for camera in cameras]
