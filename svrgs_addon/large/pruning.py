"""Writes what is left of a divided scene, and measures it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np

from ..camera import Camera, evenly
from ..files.registry import size_on_disk, write_scene
from ..files.spooled import spooled
from ..metrics import flip, psnr, ssim
from ..metrics.evaluate import render_options, rounded_to_8_bits
from ..native import Rasterizer
from .blocks import Divided, Tell, divide, scene_of
from .folder import RESULT
from .tuning import CUT, best_share, mixed, tuned_blocks
from .views import seen

EQUAL = 100.0  # dB, counts as the PSNR of equal pictures
LOOKS = 8  # views on which the result is measured, at most


def finish(divided: Divided, views: Sequence[Camera], out: Path, told: Callable[[str], Tell]) -> dict[str, Any]:
    """Writes what is left of a divided scene, tuned as far as that does good in LOOKS of the views, and measures it there. told: of the name of a step.
    Returns the JSON result. Raises SplatError."""
    left, tuned, views = Divided.read(divided.folder / CUT), tuned_blocks(divided), evenly(views, LOOKS)
    originals = list(pictures_of(divided, views, told("look")))
    facts: dict[str, float | None] = {"psnr_merged": None, "tuned_share": 0.0}
    if tuned:
        share = best_share(divided, tuned, lambda scene: likeness(scene, views, originals, told("compare"))) if views else 1.0
        facts = {"psnr_merged": likeness(left, views, originals), "tuned_share": share}
        left = mixed(divided, tuned, share)
    write_joined(left, out)
    written = divide(out, divided.folder / RESULT, tell=told("read"))
    return _result(divided, written, {**facts, **_measured(written, views, originals, told("measure"))}, len(views), out)


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


def _measured(divided: Divided, cameras: Sequence[Camera], originals: Sequence[np.ndarray], tell: Tell) -> dict[str, float]:
    """Means over the views of psnr (dB), ssim and flip, against the originals. NaN without views."""
    pairs = list(zip(pictures_of(divided, cameras, tell), originals, strict=True))
    metrics: dict[str, Callable[[np.ndarray, np.ndarray], float]] = {"psnr": lambda one, other: min(psnr(one, other), EQUAL), "ssim": ssim, "flip": flip}
    return {name: fmean(metric(*pair) for pair in pairs) if pairs else math.nan for name, metric in metrics.items()}


def _result(divided: Divided, left: Divided, facts: dict[str, float | None], views: int, out: Path) -> dict[str, Any]:
    """The JSON result. left: the Gaussians that stay."""
    return {
        "scene": str(divided.source), "out": str(out), "method": "merge", "views": views, "blocks": len(divided.blocks), **facts,
        "before": {"count": divided.count, "bytes": divided.source_bytes}, "after": {"count": left.count, "bytes": size_on_disk(out)},
    }  # fmt: skip
