"""Arrays <-> Blender's images. An image is found by its name and reused; it has a preview for panels."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Color

from ...svrgs_addon.files.images import linear_to_srgb
from ...svrgs_addon.render.passes import SRGB_PRIMARIES

_written: set[str] = set()  # names of images that were written since the file was saved
FIGURES = "svrgs_figures"  # property of an image: what was measured when it was drawn
PREVIEW = 512  # pixels on the longer side: a wide sidebar shows that many


def write_image(
    name: str,
    pixels: np.ndarray,
    preview: np.ndarray | None = None,
    data: bool = False,
    figures: dict | None = None,
) -> bpy.types.Image:
    """Writes `pixels` (H, W, 3), float or uint8, rows from the top, into the image of that name, which is
    created if needed.

    data: 32-bit numbers in the colour space Non-Color; else 8 bits in display sRGB. preview: (h, w, 3)
    display sRGB; default: pixels. figures: stored with the image, see figures_of().
    """
    image = _write(name, pixels.shape, _rgba(pixels), data)
    if figures is not None:
        image[FIGURES] = figures
    _preview(image, pixels if preview is None else preview)
    return image


def write_tint(name: str, where: np.ndarray, color: tuple[float, ...]) -> bpy.types.Image:
    """Writes a colour (4,), display sRGB and alpha, into the image of that name where `where` (H, W) is True,
    and nothing elsewhere."""
    pixels = np.where(where[::-1, :, None], np.array(color, np.float32), np.float32(0))
    return _write(name, where.shape, pixels.ravel(), alpha=True)


def _write(
    name: str, shape: tuple[int, ...], values: np.ndarray, data: bool = False, alpha: bool = False
) -> bpy.types.Image:
    """Writes RGBA in Blender's order into the image of that name, of this shape (H, W, …). One of that name
    that is not ours, or of another depth, gets another name."""
    (height, width), image = shape[:2], bpy.data.images.get(name)
    if image is not None and (image.is_float != data or not _is_ours(image)):
        image.name, image = f"{name} (former)", None
    if image is None:
        image = bpy.data.images.new(name, width, height, alpha=alpha, float_buffer=data, is_data=data)
    if tuple(image.size) != (width, height):
        image.scale(width, height)
    image.pixels.foreach_set(values)
    image.update()
    _written.add(name)
    return image


def read_image(image: bpy.types.Image) -> np.ndarray | None:
    """(H, W, 3) float32 display sRGB, rows from the top, composited over black; None if the image's file is
    missing."""
    values = stored_pixels(image)
    if values is None:
        return None
    rgb, alpha = values[::-1, :, :3], values[::-1, :, 3:]
    rgb = linear_to_srgb(rgb) if image.is_float and not image.colorspace_settings.is_data else rgb
    return np.ascontiguousarray(rgb * alpha if image.channels == 4 and not image.is_float else rgb)


def stored_pixels(image: bpy.types.Image) -> np.ndarray | None:
    """(H, W, 3 or 4) float32 as the image stores them, rows from the bottom, grey three times; None if the
    image's file is missing."""
    width, height = image.size
    if not width or not height:
        return None
    values = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(values)
    values = values.reshape(height, width, image.channels)
    return values if image.channels >= 3 else np.repeat(values[..., :1], 3, axis=2)


def figures_of(name: str) -> dict:
    """What was measured when the image of that name was drawn; {} without such an image."""
    image = bpy.data.images.get(name)
    return image[FIGURES].to_dict() if image is not None and FIGURES in image else {}


def _before_save(*_):
    """Stores the pixels of images that were written since the last time in the .blend file: Blender saves
    those of generated images only if they are packed."""
    for name in _written:
        image = bpy.data.images.get(name)
        if image is not None and _is_ours(image):
            image.use_fake_user = True  # else Blender drops images that nothing shows
            values = np.empty(len(image.pixels), np.float32)
            image.pixels.foreach_get(values)
            # an image that the user has packed, and that was not written since, would lose its pixels
            image.pixels.foreach_set(values)
            image.pack()
    _written.clear()


def _after_load(*_):
    _written.clear()


def _is_ours(image: bpy.types.Image) -> bool:
    """Whether the image is generated, or was and has been packed: not a file that the user has opened in its
    place."""
    return image.source == "GENERATED" or (image.packed_file is not None and not image.filepath)


def flattened(pixels: np.ndarray) -> np.ndarray:
    """(H, W) or (H, W, channels) with rows from the top -> float32 numbers in Blender's order, rows from the
    bottom."""
    return np.ascontiguousarray(pixels[::-1], np.float32).reshape(-1)


def working_space() -> list[tuple[float, float, float]]:
    """The linear red, green and blue of sRGB in the file's working colour space."""
    return [tuple(Color(axis).from_srgb_to_scene_linear()) for axis in SRGB_PRIMARIES]


def _rgba(pixels: np.ndarray) -> np.ndarray:
    rgba = np.ones((*pixels.shape[:2], 4), np.float32)
    rgba[..., :3] = pixels[::-1] / np.float32(255) if pixels.dtype == np.uint8 else pixels[::-1]
    return rgba.reshape(-1)


def _preview(image: bpy.types.Image, pixels: np.ndarray):
    step = max(1, -(-max(pixels.shape[:2]) // PREVIEW))
    small = pixels[::step, ::step]
    preview = image.preview_ensure()
    preview.image_size = small.shape[1], small.shape[0]
    preview.image_pixels_float.foreach_set(_rgba(small))


HANDLERS = {"save_pre": _before_save, "load_post": _after_load}
