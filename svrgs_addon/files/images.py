"""Reads and writes images with OpenImageIO, in the colour space of training: display sRGB, 0 to 1.

OpenImageIO is imported inside functions only. So commands that use no images start faster and do not need it.
"""

from __future__ import annotations

import contextlib
import os
import threading
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from ..system import packages
from ..system.errors import FormatError, SceneError
from .atomic import atomic_path
from .image_kinds import has_right_suffix

if TYPE_CHECKING:
    from OpenImageIO import ImageInput, ImageSpec

MAX_SIDE = 16_384  # pixels
PICTURES = ("", "Combined", "Image", "Composite")  # layers of an EXR that are the picture
LINEAR_FORMATS = ("openexr", "hdr")  # scene-linear formats; all others store display values
PICTURE_SUFFIXES = (".png", ".exr")
# methods above 3 take six times as long for 0.3 % less
LOSSLESS = {"compression": "lossless:50", "webp:method": 3, "oiio:UnassociatedAlpha": 1}
# OpenImageIO 3.0.7. Older ones, as in Blender 4.2, multiply colours of WebP by alpha and lose some
EXACT_WEBP = 3_00_07
PNG_BEGIN, PNG_END = b"\x89PNG", b"IEND\xaeB`\x82"

# while the option "try_all_readers" of OpenImageIO, which all threads share, is changed
_OPENING = threading.Lock()


def image_size(path: str | os.PathLike) -> tuple[int, int]:
    """(width, height) in pixels, as stored; reads only the header. Raises FormatError."""
    with contextlib.closing(_open(path)) as source:
        spec = source.spec()
        return spec.width, spec.height


def read_image(path: str | os.PathLike, background: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
    """Reads an image as (H, W, 3) float32 in 0..1, display sRGB. background, errors: as of read_pixels."""
    return to_float(read_pixels(path, background))


def read_pixels(path: str | os.PathLike, background: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
    """Reads an image as (H, W, 3) display sRGB: uint8 if the file has 8 bits per channel, else float32 in
    0..1.

    Grey is converted to RGB, scene-linear files to display sRGB. Transparent pixels are composited over
    `background` (display sRGB, 0..1). The EXIF orientation is ignored, as COLMAP does. Raises FormatError.
    """
    with contextlib.closing(_open(path)) as source:
        channels, alpha = _picture(source.spec(), path)
        return _composite(_read_channels(source, channels, path), alpha, source, background)


def read_alpha(path: str | os.PathLike) -> np.ndarray | None:
    """The alpha of an image, (H, W) float32 in 0..1, as stored; None if it has none. Raises FormatError."""
    with contextlib.closing(_open(path)) as source:
        channels, alpha = _picture(source.spec(), path)
        return to_float(_read_channels(source, channels, path)[:, :, alpha]) if alpha >= 0 else None


def read_texture(path: str | os.PathLike, most: int) -> np.ndarray:
    """The four channels of an 8-bit image as stored, (H, W, 4) uint8; 255 for an alpha that it does not have.
    most: pixels. Raises FormatError."""
    with contextlib.closing(_open(path)) as source:
        spec = source.spec()
        if spec.width * spec.height > most:
            raise FormatError(
                f"{path}: has {spec.width} x {spec.height} pixels, more than its file needs; export it again"
            )
        pixels = _read_channels(source, _picture(spec, path)[0], path)
    if pixels.dtype != np.uint8 or pixels.shape[2] < 3:
        raise FormatError(f"{path}: is not an image of three or four channels of 8 bits; export it again")
    opaque = np.full((*pixels.shape[:2], 1), 255, np.uint8)
    return pixels if pixels.shape[2] == 4 else np.concatenate([pixels, opaque], axis=2)


def to_float(pixels: np.ndarray) -> np.ndarray:
    """Converts uint8 0..255 to float32 0..1; float32 is returned unchanged."""
    return pixels if pixels.dtype == np.float32 else pixels / np.float32(255)


def to_bytes(pixels: np.ndarray) -> np.ndarray:
    """Converts floats 0..1 to the nearest uint8, with clipping; uint8 is returned unchanged."""
    return pixels if pixels.dtype == np.uint8 else np.rint(np.clip(pixels, 0, 1) * 255).astype(np.uint8)


def write_image(path: str | os.PathLike, pixels: np.ndarray) -> None:
    """Writes an image atomically as .png (8 bits, clipped and rounded) or .exr (float32, not clipped).

    pixels (H, W, 3) are colours in display sRGB, uint8 or float 0..1; an EXR stores them scene-linear, and
    read_image converts them back. pixels (H, W) are data (mask, depth, alpha); an EXR stores them unchanged.
    Raises SceneError.
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


def write_texture(temporary: str | os.PathLike, path: str | os.PathLike, pixels: np.ndarray) -> None:
    """Writes the channels of a texture, (H, W, 3 or 4) uint8, as lossless WebP; colours where alpha is 0 are
    lost. temporary: where to, with the suffix .webp; path: the file of which errors speak. Raises
    SceneError."""
    # WebP leaves out an alpha of 255 itself
    _write(temporary, path, pixels if (pixels[:, :, 3:] < 255).any() else pixels[:, :, :3], LOSSLESS)


def srgb_to_linear(values: np.ndarray) -> np.ndarray:
    """Inverse of the sRGB transfer function, float32. The same formulas are used above 1 and below 0."""
    curve = ((np.maximum(values, 0) + 0.055) / 1.055) ** 2.4
    return np.where(values <= 0.04045, values / 12.92, curve).astype(np.float32)


def linear_to_srgb(values: np.ndarray) -> np.ndarray:
    """The sRGB transfer function (IEC 61966-2-1), float32. The same formulas are used above 1 and below 0."""
    curve = 1.055 * np.maximum(values, 0) ** (1 / 2.4) - 0.055
    return np.where(values <= 0.0031308, values * 12.92, curve).astype(np.float32)


def _library() -> ModuleType:
    """OpenImageIO. Raises SceneError if it is not installed, NativeError if it cannot be loaded."""
    return packages.load("OpenImageIO", "reading and writing images")


def lack() -> str:
    """Why WebP with alpha is not read or written exactly, or "". Raises SceneError, NativeError."""
    oiio = _library()
    if oiio.VERSION >= EXACT_WEBP:
        return ""
    return (
        "because WebP with alpha needs OpenImageIO 3.0.7 or later, and this Python has"
        f" {oiio.VERSION_STRING}: use a newer one, as in Blender 5.0, or choose another format"
    )


def library_path(path: str | os.PathLike) -> Any:
    """The path as OpenImageIO takes it: bytes if it is not UTF-8, which not every version takes; else str."""
    text = os.fspath(path)
    try:
        text.encode()
    except UnicodeEncodeError:
        return os.fsencode(path)
    return text


def _open(path: str | os.PathLike) -> ImageInput:
    """Opens an image and checks the size in its header. Raises FormatError."""
    oiio = _library()
    config = oiio.ImageSpec()
    # colours as stored; 8-bit colours multiplied by alpha would lose precision
    config.attribute("oiio:UnassociatedAlpha", 1)
    right_suffix = has_right_suffix(path)
    with _OPENING:
        oiio.attribute("try_all_readers", int(not right_suffix))  # not only the one of the suffix
        try:
            source = oiio.ImageInput.open(library_path(path), config)
        except TypeError:
            raise FormatError(
                f"{path}: this version of OpenImageIO reads only paths in UTF-8; rename the file or its"
                " folder"
            ) from None
        finally:
            oiio.attribute("try_all_readers", 1)
    if source is None:
        raise FormatError(f"{path}: cannot be read as an image ({_error_of(oiio) or 'no reason given'})")
    spec = source.spec()
    if not (0 < spec.width <= MAX_SIDE and 0 < spec.height <= MAX_SIDE and spec.depth <= 1):
        raise FormatError(
            f"{path}: has {spec.width} x {spec.height} pixels; the limit is {MAX_SIDE} per side"
        )
    if source.format_name() == "webp" and spec.nchannels == 4 and (reason := lack()):
        raise FormatError(f"{path}: cannot be read, {reason}")
    return source


def _picture(spec: ImageSpec, path: str | os.PathLike) -> tuple[list[int], int]:
    """The channels of the picture, in the order R, G, B, A, and the place of A among them, -1: there is none.
    They are the first four, but in an EXR of several layers those of the only one with colours, or of the one
    that Blender calls the picture. Raises FormatError."""
    layers: dict[str, dict[str, int]] = {}
    for number, name in enumerate(spec.channelnames):
        layer, _, channel = name.rpartition(".")
        layers.setdefault(layer, {})[channel.upper()] = number
    found = {layer: of for layer, of in layers.items() if {"R", "G", "B"} <= of.keys()}
    if len(layers) == 1 or not found:
        alpha = spec.alpha_channel if 0 <= spec.alpha_channel < min(spec.nchannels, 4) else -1
        return list(range(min(spec.nchannels, 4))), alpha
    pictures = {layer: of for layer, of in found.items() if layer.rpartition(".")[2] in PICTURES}
    chosen = found if len(found) == 1 else pictures
    if len(chosen) != 1:
        raise FormatError(f"{path}: has the layers {', '.join(found)}; export one picture")
    ((_, of),) = chosen.items()
    return [of[name] for name in "RGBA" if name in of], 3 if "A" in of else -1


def _read_channels(source: ImageInput, channels: list[int], path: str | os.PathLike) -> np.ndarray:
    """Reads these channels, (H, W, C): uint8 if the file has 8 bits, else float32. Raises FormatError."""
    oiio, spec = _library(), source.spec()
    kind = oiio.UINT8 if spec.format == oiio.TypeDesc("uint8") else oiio.FLOAT
    pixels = source.read_image(0, 0, 0, max(channels) + 1, kind)
    if pixels is not None and channels != list(range(pixels.shape[2])):
        pixels = pixels[:, :, channels]
    error = _error_of(source)
    # OpenImageIO returns what it could read of a damaged file, and says only here that something is wrong.
    if pixels is None or error:
        raise FormatError(f"{path}: cannot be read as an image ({error or 'no reason given'})")
    if pixels.dtype != np.uint8 and np.isnan(pixels).any():
        raise FormatError(f"{path}: has pixels that are not numbers (NaN); export the image again")
    return pixels


def _composite(
    pixels: np.ndarray, alpha_channel: int, source: ImageInput, background: tuple[float, float, float]
) -> np.ndarray:
    """Colours over the background in display sRGB, as Gaussians are blended. (H, W, 3), uint8 or float32."""
    linear = source.format_name() in LINEAR_FORMATS
    colour = pixels[:, :, :3] if pixels.shape[2] >= 3 else pixels[:, :, :1].repeat(3, axis=2)
    if alpha_channel >= 0:
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
    """Whether colours are multiplied by alpha. The reader of WebP does not report that they are not."""
    return source.format_name() != "webp" and not source.spec().get_int_attribute("oiio:UnassociatedAlpha", 0)


def _write(
    temporary: str | os.PathLike,
    path: str | os.PathLike,
    pixels: np.ndarray,
    settings: dict[str, Any] | None = None,
) -> None:
    """Writes pixels to the temporary file and checks it. Raises SceneError, which names `path`."""
    oiio = _library()
    height, width, channels = (*pixels.shape, 1)[:3]
    # OpenImageIO takes the last of two axes for channels
    pixels = np.ascontiguousarray(pixels).reshape(height, width, channels)
    spec = oiio.ImageSpec(width, height, channels, "uint8" if pixels.dtype == np.uint8 else "float")
    for setting, value in (settings or {}).items():
        spec.attribute(setting, value)
    name = library_path(temporary)
    output = oiio.ImageOutput.create(name)
    good = output is not None and output.open(name, spec) and output.write_image(pixels)
    if not (good and output.close()):
        reason = (_error_of(output) if output is not None else "") or _error_of(oiio)
        raise SceneError(f"{path}: cannot be written ({reason or 'no reason given'})")
    if not _stored_correctly(temporary, pixels):
        raise SceneError(f"{path}: cannot be written (the file on disk is not complete; is the disk full?)")


def _stored_correctly(path: str | os.PathLike, pixels: np.ndarray) -> bool:
    """Whether the file has these pixels and, a PNG, its end. OpenImageIO does not report a full disk."""
    with open(path, "rb") as file:
        if file.read(len(PNG_BEGIN)) == PNG_BEGIN and not file.read().endswith(PNG_END):
            return False
    oiio = _library()
    config = oiio.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(library_path(path), config)
    stored = source.read_image("uint8" if pixels.dtype == np.uint8 else "float") if source else None
    if stored is None:
        _error_of(source or oiio)  # a message that nobody asks for would be printed when the program ends
    return (
        stored is not None
        and stored.size == pixels.size
        and _visible(stored.reshape(pixels.shape)).tobytes() == _visible(pixels).tobytes()
    )


def _visible(pixels: np.ndarray) -> np.ndarray:
    """Pixels (H, W, C), black where their alpha, if there is one, is 0: WebP stores no colours there."""
    return pixels if pixels.shape[2] < 4 else pixels * (pixels[:, :, 3:] > 0)


def _error_of(source: Any) -> str:
    """The first line of the message of OpenImageIO, of a reader or of a writer; '' if there is none."""
    try:
        message = source.geterror()
    except UnicodeDecodeError as error:  # it holds a path that is not UTF-8
        message = error.object.decode(errors="replace")
    return (message.strip().splitlines() or [""])[0]
