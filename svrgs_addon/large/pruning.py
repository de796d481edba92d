"""Prunes a divided scene to a share by one threshold on its scores, and measures what that costs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np

from ..camera import Camera
from ..files.registry import load_parts, size_on_disk, write_scene
from ..files.spooled import spooled
from ..metrics.evaluate import render_options, rounded_to_8_bits
from ..metrics.psnr import psnr
from ..native import Rasterizer
from ..scene import Scene
from .blocks import MAX_COUNT, Divided, Tell
from .scoring import seen

EQUAL = 100.0  # dB, counts as the PSNR of equal pictures


def best(scores: np.ndarray, count: int) -> np.ndarray:
    """(N,) bool: the `count` highest scores (N,). Of equal ones, the earlier row stays."""
    count = min(count, len(scores))
    threshold = np.partition(scores, len(scores) - count)[len(scores) - count] if count else scores.max(initial=0)
    kept = scores > threshold
    kept[np.flatnonzero(scores == threshold)[: count - int(kept.sum())]] = True
    return kept


def write_kept(source: Path, kept: np.ndarray, out: Path, tell: Tell = lambda *_: None):
    """Writes the Gaussians that stay, in the order of the file, in the format of the output. kept: (N,) bool. Raises SplatError."""
    with spooled(_kept_parts(source, kept, tell), out) as scene:
        write_scene(out, scene)


def _kept_parts(source: Path, kept: np.ndarray, tell: Tell) -> Iterator[Scene]:
    start = 0
    for part in load_parts(source, MAX_COUNT):
        yield part.select(np.flatnonzero(kept[start : start + part.count]))
        start += part.count
        tell("writes what stays", start / len(kept))


def measured(divided: Divided, kept: np.ndarray, cameras: Sequence[Camera], tell: Tell = lambda *_: None) -> float:
    """Mean PSNR in dB of the Gaussians that stay against all of them, over the views. Raises SplatError."""
    rasterizer, values = Rasterizer(), []
    for number, camera in enumerate(cameras):
        tell(f"measures the view {camera.name or number}", number / len(cameras))
        pictures = []
        for some in (None, kept):
            scene, _ = seen(divided, camera, some)
            pictures.append(rounded_to_8_bits(rasterizer.forward(scene, camera, render_options(scene))["rgb"]))
        values.append(min(psnr(*pictures), EQUAL))
    return fmean(values) if values else math.nan


def result_of(divided: Divided, kept: np.ndarray, quality: float, views: int, out: Path) -> dict[str, Any]:
    """The JSON result of a pruned scene."""
    return {
        "scene": str(divided.source), "out": str(out), "method": "removal", "views": views, "blocks": len(divided.blocks), "psnr": quality,
        "before": {"count": divided.count, "bytes": divided.source_bytes}, "after": {"count": int(kept.sum()), "bytes": size_on_disk(out)},
    }  # fmt: skip
