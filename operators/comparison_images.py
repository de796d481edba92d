"""The images of a comparison: original, pruned, difference, and a wipe between original and pruned."""

from __future__ import annotations

import bpy

from ..svrgs_addon.report.pictures import difference_image, wipe
from . import bridge_images

ORIGINAL, PRUNED, DIFFERENCE, WIPE = (f"SVR-GS {name}" for name in ("Original", "Pruned", "Difference", "Wipe"))


def show(original, pruned, share: float):
    """Writes all four images. original, pruned: (H, W, 3) display sRGB in [0, 1]."""
    bridge_images.write_image(ORIGINAL, original)
    bridge_images.write_image(PRUNED, pruned)
    bridge_images.write_image(DIFFERENCE, difference_image(original, pruned))
    bridge_images.write_image(WIPE, wipe(original, pruned, share))


def redraw(settings, context):
    """Draws the wipe again from the two images."""
    images = [bpy.data.images.get(name) for name in (ORIGINAL, PRUNED)]
    pixels = [bridge_images.read_image(image) if image is not None else None for image in images]
    if all(part is not None for part in pixels) and pixels[0].shape == pixels[1].shape:
        bridge_images.write_image(WIPE, wipe(*pixels, settings.wipe))
