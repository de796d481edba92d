"""From where the Gaussians of a scene are seen: formats round by it, and bands are left out by it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..files.registry import format_to_write
from ..files.sh_rounding import SeenFrom, without_bands
from ..files.splat_format import SplatFormat
from ..native.rasterizer import Rasterizer
from ..render.metrics.evaluate import render_options
from ..scene.camera import Camera, evenly
from ..scene.gaussians import Scene
from ..views.reduced_photos import reduction_to

FEWEST_VIEWS, MOST_VIEWS = 8, 64
LARGEST = 640  # pixels of the longer side of a view; larger ones are reduced


def seen_from(scene: Scene, cameras: Sequence[Camera], out: Path | SplatFormat) -> SeenFrom | None:
    """What some of the views show of each Gaussian. None where the format (of `out`) does not round by it,
    nothing depends on the view, or views are too few to say where one will look from."""
    splat_format = out if isinstance(out, SplatFormat) else format_to_write(out)
    return _shown(scene, cameras) if scene.sh_degree and splat_format.quantises else None


def fewer_bands(scene: Scene, degree: int, cameras: Sequence[Camera]) -> Scene:
    """The scene with SH up to this degree, fitted to what all bands show in the views. With fewer than
    FEWEST_VIEWS, or none, the higher bands are cut."""
    return without_bands(scene, degree, _shown(scene, cameras)) if scene.sh_degree > degree else scene


def cut_notes(scene: Scene, degree: int, cameras: Sequence[Camera]) -> list[str]:
    """A sentence where fewer_bands() cuts bands because the views are too few."""
    if scene.sh_degree <= degree or len(cameras) >= FEWEST_VIEWS:
        return []
    return [
        f"{len(cameras)} views are too few to tell what spherical harmonics above degree {degree} show, so"
        f" these are cut; from {FEWEST_VIEWS} views on, the others take them up"
    ]


def _shown(scene: Scene, cameras: Sequence[Camera]) -> SeenFrom | None:
    """What at most MOST_VIEWS of the views show of each Gaussian. None if they are too few."""
    if len(cameras) < FEWEST_VIEWS:
        return None
    chosen, rasterizer = evenly(cameras, MOST_VIEWS), Rasterizer()
    weights = np.zeros((len(chosen), scene.count), np.float16)
    for row, camera in zip(weights, chosen, strict=True):
        sums = np.zeros(scene.count)
        small = camera.reduced(reduction_to(LARGEST, camera))
        rasterizer.forward(scene, small, render_options(scene), outputs=())
        rasterizer.add_scores(sums)
        row[:] = np.minimum(sums, np.finfo(np.float16).max)
    return SeenFrom(np.stack([camera.position for camera in chosen]).astype(np.float32), weights)


def bytes_of(count: int, cameras: Sequence[Camera]) -> int:
    """What seen_from() holds of so many Gaussians."""
    return np.dtype(np.float16).itemsize * count * min(len(cameras), MOST_VIEWS)
