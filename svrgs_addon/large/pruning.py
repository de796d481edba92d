"""Writes what is left of a divided scene, and measures it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

from ..camera import Camera
from ..files.registry import size_on_disk, write_scene
from ..files.spooled import spooled
from ..metrics.evaluate import render_options, rounded_to_8_bits
from ..metrics.psnr import psnr
from ..native import Rasterizer
from .blocks import Divided, Tell
from .merging import merged
from .scoring import seen

EQUAL = 100.0  # dB, counts as the PSNR of equal pictures


def write_merged(divided: Divided, kept: Sequence[int], out: Path, tell: Tell = lambda *_: None):
    """Writes what is left, block by block, in the format of the output. kept: how many Gaussians of each block. Raises SplatError."""
    with spooled(merged(divided, kept, tell), out) as scene:
        write_scene(out, scene)


def likeness(one: Divided, other: Divided, cameras: Sequence[Camera], tell: Tell = lambda *_: None) -> float:
    """Mean PSNR in dB of a divided scene against another one, over the views. Raises SplatError."""
    rasterizer, values = Rasterizer(), []
    for number, camera in enumerate(cameras):
        tell(f"measures the view {camera.name or number}", number / len(cameras))
        scenes = (seen(divided, camera, rasterizer)[0] for divided in (one, other))
        pictures = [rounded_to_8_bits(rasterizer.forward(scene, camera, render_options(scene))["rgb"]) for scene in scenes]
        values.append(min(psnr(*pictures), EQUAL))
    return fmean(values) if values else math.nan


def result_of(divided: Divided, result: Divided, quality: float, views: int, out: Path) -> dict[str, Any]:
    """The JSON result of a pruned scene."""
    return {
        "scene": str(divided.source), "out": str(out), "method": "merge", "views": views, "blocks": len(divided.blocks), "psnr": quality,
        "before": {"count": divided.count, "bytes": divided.source_bytes}, "after": {"count": result.count, "bytes": size_on_disk(out)},
    }  # fmt: skip
