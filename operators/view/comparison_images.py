"""The images of a comparison: original, pruned, difference, and a wipe between original and pruned."""

from __future__ import annotations

import bpy

from ...svrgs_addon.prune.report.pictures import difference_image, wipe
from ..data import image_pixels

ORIGINAL, PRUNED, DIFFERENCE, WIPE = (
    f"SVR-GS {name}" for name in ("Original", "Pruned", "Difference", "Wipe")
)


def show(original, pruned, share: float):
    """Writes all four images. original, pruned: (H, W, 3) display sRGB in [0, 1]."""
    image_pixels.write_image(ORIGINAL, original)
    image_pixels.write_image(PRUNED, pruned)
    image_pixels.write_image(DIFFERENCE, difference_image(original, pruned))
    image_pixels.write_image(WIPE, wipe(original, pruned, share))


def redraw(settings, context):
    """Draws the wipe again from the two images."""
    original, pruned = (_pixels(name) for name in (ORIGINAL, PRUNED))
    if original is not None and pruned is not None and original.shape == pruned.shape:
        image_pixels.write_image(WIPE, wipe(original, pruned, settings.wipe))


def _pixels(name: str):
    image = bpy.data.images.get(name)
    return image_pixels.read_image(image) if image is not None else None
