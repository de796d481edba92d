"""The pictures of a comparison by name, and the wipe between two of them."""

from __future__ import annotations

import bpy
import numpy as np

from ..svrgs_addon.pictures import difference_image, wipe
from . import image_blocks

ORIGINAL, PRUNED, DIFFERENCE, WIPE = (f"SVR-GS {name}" for name in ("Original", "Pruned", "Difference", "Wipe"))


def show(original: np.ndarray, pruned: np.ndarray, share: float):
    """Writes all four images. original, pruned: (H, W, 3) display sRGB in [0, 1]."""
    image_blocks.put(ORIGINAL, original)
    image_blocks.put(PRUNED, pruned)
    image_blocks.put(DIFFERENCE, difference_image(original, pruned) / np.float32(255))
    image_blocks.put(WIPE, wipe(original, pruned, share))


def redraw(settings, context):
    """Makes the wipe anew from the images there are."""
    images = [bpy.data.images.get(name) for name in (ORIGINAL, PRUNED)]
    pixels = [image_blocks.read(image) if image is not None else None for image in images]
    if all(part is not None for part in pixels) and pixels[0].shape == pixels[1].shape:
        image_blocks.put(WIPE, wipe(*pixels, settings.wipe))
