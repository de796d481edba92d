"""What the picture of `svrgs view` shows, drawn by the native renderer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..files.images import to_bytes
from ..native.rasterizer import Rasterizer
from ..prune.report.pictures import difference_image, mask_to_rgb, wipe
from ..render.metrics.evaluate import picture_options
from ..scene.camera import Camera
from ..scene.gaussians import Scene

COLORS, MASK, DIFFERENCE = "Colors", "Spatial mask F", "Difference × 4"


@dataclass(frozen=True)
class Shown:
    """One scene, or the original and the pruned one.

    colors: COLORS, MASK, or DIFFERENCE of both. share: of the width, which shows the original. background:
    display sRGB 0..1.
    """

    scenes: tuple[Scene, ...]
    colors: str = COLORS
    share: float = 0.5
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)


def drawn(rasterizer: Rasterizer, shown: Shown, camera: Camera) -> np.ndarray:
    """The picture of a camera in the coordinates of the scenes, (H, W, 3) uint8. Each scene is drawn where
    the picture shows it. Raises Cancelled when rasterizer.cancel[0] is set."""
    mask = shown.colors == MASK
    output, kind = ("mask", "svr") if mask else ("rgb", "none")
    whole = len(shown.scenes) == 1 or shown.colors == DIFFERENCE
    edge = round(shown.share * camera.width)
    images = []
    for number, scene in enumerate(shown.scenes):
        columns = np.arange(camera.width)
        part = (
            None if whole else np.tile(columns < edge if number == 0 else columns >= edge, (camera.height, 1))
        )
        options = picture_options(scene, shown.background, kind)
        images.append(rasterizer.forward(scene, camera.masked(part), options, outputs=(output,))[output])
    if shown.colors == DIFFERENCE:
        return difference_image(*(np.clip(image, 0, 1) for image in images))
    top = max(float(image.max(initial=0)) for image in images)
    pictures = [mask_to_rgb(image, top) if mask else to_bytes(image) for image in images]
    return pictures[0] if whole else wipe(pictures[0], pictures[1], shown.share)
