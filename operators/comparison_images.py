"""The pictures of a comparison by name, and the wipe between two of them."""

from __future__ import annotations

import bpy

from ..svrgs_addon.report.pictures import difference_image, wipe
from . import bridge_images

ORIGINAL, PRUNED, DIFFERENCE, WIPE = (f"SVR-GS {name}" for name in ("Original", "Pruned", "Difference", "Wipe"))


def show(original, pruned, share: float):
    """Writes all four images. original, pruned: (H, W, 3) display sRGB in [0, 1]."""
    bridge_images.put(ORIGINAL, original)
    bridge_images.put(PRUNED, pruned)
    bridge_images.put(DIFFERENCE, difference_image(original, pruned))
    bridge_images.put(WIPE, wipe(original, pruned, share))


def redraw(settings, context):
    """Makes the wipe anew from the images there are."""
    images = [bpy.data.images.get(name) for name in (ORIGINAL, PRUNED)]
    pixels = [bridge_images.read(image) if image is not None else None for image in images]
    if all(part is not None for part in pixels) and pixels[0].shape == pixels[1].shape:
        bridge_images.put(WIPE, wipe(*pixels, settings.wipe))
