"""The images of a comparison: original, pruned, difference, and a wipe between original and pruned."""

from __future__ import annotations

import bpy

from ..svrgs_addon.prune.report.pictures import difference_image, wipe
from . import bridge_images

ORIGINAL, PRUNED, DIFFERENCE, WIPE = (
    f"SVR-GS {name}" for name in ("Original", "Pruned", "Difference", "Wipe")
)


def show(original, pruned, share: float):
    """Writes all four images. original, pruned: (H, W, 3) display sRGB in [0, 1]."""
    bridge_images.write_image(ORIGINAL, original)
    bridge_images.write_image(PRUNED, pruned)
    bridge_images.write_image(DIFFERENCE, difference_image(original, pruned))
    bridge_images.write_image(WIPE, wipe(original, pruned, share))


def redraw(settings, context):
    """Draws the wipe again from the two images."""
    original, pruned = (_pixels(name) for name in (ORIGINAL, PRUNED))
    if original is not None and pruned is not None and original.shape == pruned.shape:
        bridge_images.write_image(WIPE, wipe(original, pruned, settings.wipe))


def _pixels(name: str):
    image = bpy.data.images.get(name)
    return bridge_images.read_image(image) if image is not None else None
