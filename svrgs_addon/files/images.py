"""Photographs and pictures through OpenImageIO, in the training colour space: display sRGB, 0 to 1.

OpenImageIO is imported inside functions only, so that commands that need no pictures start without it.
"""

from __future__ import annotations

import os
import sys
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from ..errors import FormatError, SceneError
from .atomic import atomic_path

if TYPE_CHECKING:
    from OpenImageIO import ImageInput, ImageSpec

MAX_SIDE = 16_384
LINEAR_FORMATS = ("openexr", "hdr")  # their numbers are scene-linear; every other format holds display values
PICTURE_SUFFIXES = (".png", ".exr")
PNG_BEGIN, PNG_END = b"\x89PNG", b"IEND\xaeB`\x82"

# EXIF orientation: (transpose first, flip rows, flip columns) that turn the stored pixels upright
ORIENTATIONS = {
    1: (False, False, False), 2: (False, False, True), 3: (False, True, True), 4: (False, True, False),
    5: (True, False, False), 6: (True, False, True), 7: (True, True, True), 8: (True, True, False),
}  # fmt: skip


def image_size(path: str | os.PathLike, upright: bool = True) -> tuple[int, int]:
    """(width, height) in pixels, from the header alone; upright as in read_pixels. Raises FormatError."""
    source = _open(path)
    try:
        spec = source.spec()
        turned = upright and ORIENTATIONS[_orientation(spec)][0]
        return (spec.height, spec.width) if turned else (spec.width, spec.height)
    finally:
        source.close()


def read_image(path: str | os.PathLike, background: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
    """The upright image, (H, W, 3) float32 in 0..1, display sRGB. Raises FormatError."""
    return to_float(read_pixels(path, background))


def read_pixels(path: str | os.PathLike, background: tuple[float, float, float] = (0, 0, 0), upright: bool = True) -> np.ndarray:
    """The image, (H, W, 3), display sRGB: uint8 where the file has 8 bits, float32 in 0..1 elsewhere.

    Grey becomes RGB; alpha is composited over `background` (display sRGB, 0..1); scene-linear files are converted;
    `upright` applies the EXIF orientation. Raises FormatError.
    """
    source = _open(path)
    try:
        spec = source.spec()
        pixels = _read_channels(source, spec, path)
        colour = _composite(pixels, source, background)
        return _turn(colour, _orientation(spec)) if upright else colour
    finally:
        source.close()


def to_float(pixels: np.ndarray) -> np.ndarray:
    """uint8 0..255 to float32 0..1; float32 passes unchanged."""
    return pixels if pixels.dtype == np.float32 else pixels / np.float32(255)


def to_bytes(pixels: np.ndarray) -> np.ndarray:
    """float 0..1 to the nearest uint8, clipped; uint8 passes unchanged."""
    return pixels if pixels.dtype == np.uint8 else np.rint(np.clip(pixels, 0, 1) * 255).astype(np.uint8)


def write_image(path: str | os.PathLike, pixels: np.ndarray) -> None:
    """Write a picture atomically: .png (8 bits, clipped, rounded) or .exr (float32, unclamped).

    (H, W, 3) is colour, display sRGB, uint8 or float 0..1; in an EXR it becomes scene-linear, so read_image returns
    it. (H, W) is data (mask, depth, alpha) and keeps its numbers. Raises SceneError.
    """
    suffix = os.path.splitext(path)[1].lower()
    if suffix not in PICTURE_SUFFIXES:
        raise SceneError(f"{path}: pictures are written as {' or '.join(PICTURE_SUFFIXES)}")
    if suffix == ".png":
        pixels = to_bytes(pixels)
    else:
        pixels = to_float(np.asarray(pixels, np.uint8 if pixels.dtype == np.uint8 else np.float32))
        pixels = srgb_to_linear(pixels) if pixels.ndim == 3 else pixels
    with atomic_path(path) as temporary:
        _write(temporary, path, pixels)


def srgb_to_linear(values: np.ndarray) -> np.ndarray:
    """The sRGB transfer function undone, float32; continued as it stands above 1 and below 0."""
    curve = ((np.maximum(values, 0) + 0.055) / 1.055) ** 2.4
    return np.where(values <= 0.04045, values / 12.92, curve).astype(np.float32)


def linear_to_srgb(values: np.ndarray) -> np.ndarray:
    """The sRGB transfer function, float32; continued as it stands above 1 and below 0."""
    curve = 1.055 * np.maximum(values, 0) ** (1 / 2.4) - 0.055
    return np.where(values <= 0.0031308, values * 12.92, curve).astype(np.float32)


def _library() -> ModuleType:
    try:
        import OpenImageIO
    except ImportError as error:
        raise SceneError(f"reading and writing images needs the package OpenImageIO: run {sys.executable} -m pip install OpenImageIO") from error
    return OpenImageIO


def _open(path: str | os.PathLike) -> ImageInput:
    """An open image whose header is within the limits."""
    oiio = _library()
    config = oiio.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)  # as stored: multiplied by alpha, 8 bits would lose colour
    source = oiio.ImageInput.open(os.fspath(path), config)
    if source is None:
        raise FormatError(f"{path}: cannot be read as an image ({_first_line(oiio.geterror())})")
    spec = source.spec()
    if not (0 < spec.width <= MAX_SIDE and 0 < spec.height <= MAX_SIDE and spec.depth <= 1):
        raise FormatError(f"{path}: has {spec.width} x {spec.height} pixels; the limit is {MAX_SIDE} a side")
    return source


def _read_channels(source: ImageInput, spec: ImageSpec, path: str | os.PathLike) -> np.ndarray:
    """The first four channels at most, (H, W, C), uint8 or float32 as stored."""
    oiio = _library()
    kind = oiio.UINT8 if spec.format == oiio.TypeDesc("uint8") else oiio.FLOAT
    pixels = source.read_image(0, 0, 0, min(spec.nchannels, 4), kind)
    error = source.geterror()
    # A JPEG cut short is returned with grey below the cut and only this note; other notes on it are harmless.
    if pixels is None or "Premature end" in error:
        raise FormatError(f"{path}: cannot be read as an image ({_first_line(error)})")
    if pixels.dtype != np.uint8 and np.isnan(pixels).any():
        raise FormatError(f"{path}: has pixels that are not numbers")
    return pixels


def _composite(pixels: np.ndarray, source: ImageInput, background: tuple[float, float, float]) -> np.ndarray:
    """Colour over background, (H, W, 3), in display space, where Gaussians are blended too."""
    alpha_channel = source.spec().alpha_channel
    linear = source.format_name() in LINEAR_FORMATS
    colour = pixels[:, :, :3] if pixels.shape[2] >= 3 else pixels[:, :, :1].repeat(3, axis=2)
    if 0 <= alpha_channel < pixels.shape[2]:
        alpha = to_float(pixels[:, :, alpha_channel, None])
        colour = to_float(colour) / np.where((alpha > 0) & _is_associated(source), alpha, 1)
        colour = (linear_to_srgb(colour) if linear else colour).clip(0, 1)
        colour = colour * alpha + np.asarray(background, np.float32) * (1 - alpha)
    elif linear:
        colour = linear_to_srgb(to_float(colour))
    if pixels.dtype == np.uint8:
        return np.ascontiguousarray(to_bytes(colour))
    return np.ascontiguousarray(colour.clip(0, 1))


def _is_associated(source: ImageInput) -> bool:
    """Whether colours are multiplied by alpha. WebP's never are, on our request, though its reader does not say so."""
    return source.format_name() != "webp" and not source.spec().get_int_attribute("oiio:UnassociatedAlpha", 0)


def _orientation(spec: ImageSpec) -> int:
    value = spec.get_int_attribute("Orientation", 1)
    return value if value in ORIENTATIONS else 1


def _turn(image: np.ndarray, orientation: int) -> np.ndarray:
    transpose, flip_rows, flip_columns = ORIENTATIONS[orientation]
    image = image.swapaxes(0, 1) if transpose else image
    return np.ascontiguousarray(image[:: -1 if flip_rows else 1, :: -1 if flip_columns else 1])


def _write(temporary: os.PathLike, path: str | os.PathLike, pixels: np.ndarray) -> None:
    oiio = _library()
    height, width, channels = (*pixels.shape, 1)[:3]
    pixels = np.ascontiguousarray(pixels).reshape(height, width, channels)  # of two axes it would make channels
    spec = oiio.ImageSpec(width, height, channels, "uint8" if pixels.dtype == np.uint8 else "float")
    output = oiio.ImageOutput.create(os.fspath(temporary))
    good = output is not None and output.open(os.fspath(temporary), spec) and output.write_image(pixels)
    if not (good and output.close()):
        reason = (output.geterror() if output is not None else "") or oiio.geterror()
        raise SceneError(f"{path}: cannot be written ({_first_line(reason)})")
    if not _holds(temporary, pixels):
        raise SceneError(f"{path}: cannot be written (the disk took only part of it)")


def _holds(path: str | os.PathLike, pixels: np.ndarray) -> bool:
    """Whether the file holds these pixels and ends as it should: OpenImageIO's writers do not tell of a full disk."""
    with open(path, "rb") as file:
        if file.read(len(PNG_BEGIN)) == PNG_BEGIN and not file.read().endswith(PNG_END):
            return False
    source = _library().ImageInput.open(os.fspath(path))
    stored = source.read_image("uint8" if pixels.dtype == np.uint8 else "float") if source else None
    return stored is not None and stored.reshape(-1).tobytes() == pixels.tobytes()


def _first_line(message: str) -> str:
    return (message.strip().splitlines() or ["no reason given"])[0]
