"""Writes what is left of a divided scene, and measures it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np

from ..camera import Camera
from ..files.registry import size_on_disk, write_scene
from ..files.spooled import spooled
from ..metrics.evaluate import render_options, rounded_to_8_bits
from ..metrics.psnr import psnr
from ..native import Rasterizer
from .blocks import Divided, Tell, scene_of
from .views import seen

EQUAL = 100.0  # dB, counts as the PSNR of equal pictures


def write_joined(divided: Divided, out: Path):
    """Writes all blocks, one after the other, in the format of the output. Raises SplatError."""
    with spooled((scene_of(divided, block) for block in divided.blocks), out) as scene:
        write_scene(out, scene)


def pictures_of(divided: Divided, cameras: Sequence[Camera], tell: Tell = lambda *_: None) -> Iterator[np.ndarray]:
    """What each view shows, (H, W, 3), rounded to 8 bits. Raises SplatError."""
    rasterizer = Rasterizer()
    for number, camera in enumerate(cameras):
        tell(f"looks at the view {camera.name or number}", number / len(cameras))
        scene, _ = seen(divided, camera, rasterizer)
        yield rounded_to_8_bits(rasterizer.forward(scene, camera, render_options(scene))["rgb"])


def likeness(divided: Divided, cameras: Sequence[Camera], pictures: Sequence[np.ndarray], tell: Tell = lambda *_: None) -> float:
    """Mean PSNR in dB over the views, against their pictures. NaN without views. Raises SplatError."""
    pairs = zip(pictures_of(divided, cameras, tell), pictures, strict=True)
    values = [min(psnr(one, other), EQUAL) for one, other in pairs]
    return fmean(values) if values else math.nan


def result_of(divided: Divided, left: Divided, facts: dict[str, float | None], views: int, out: Path) -> dict[str, Any]:
    """The JSON result of a pruned scene. left: the Gaussians that stay."""
    return {
        "scene": str(divided.source), "out": str(out), "method": "merge", "views": views, "blocks": len(divided.blocks), **facts,
        "before": {"count": divided.count, "bytes": divided.source_bytes}, "after": {"count": left.count, "bytes": size_on_disk(out)},
    }  # fmt: skip
