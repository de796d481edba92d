"""Pictures to look at: colour-mapped spatial masks, amplified differences, and their encoding for a web page.

`svrgs render`, `svrgs compare` and the report use it. It contains no HTML.
"""

from __future__ import annotations

import base64
import struct
import tempfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from ...files.images import library_path, to_bytes
from ...render.color_maps import colored

DIFFERENCE_GAIN = 4
WEBP_QUALITY = 92


def mask_to_rgb(mask: np.ndarray, vmax: float | None = None) -> np.ndarray:
    """A spatial mask F (H, W), finite and ≥ 0, as colours (H, W, 3) uint8: black at 0, yellow at vmax and
    above.

    vmax: the value of F with the brightest colour; None: the largest value of the mask. Masks that are
    compared need the same vmax.
    """
    return to_bytes(colored(mask, float(np.max(mask, initial=0)) if vmax is None else vmax))


def difference_image(a: np.ndarray, b: np.ndarray, gain: float = DIFFERENCE_GAIN) -> np.ndarray:
    """gain · |a - b| per channel, clipped to 0..1, as (H, W, 3) uint8. a, b: (H, W, 3) floats in 0..1."""
    return to_bytes(np.abs(np.asarray(a, np.float32) - b) * gain)


def wipe(left: np.ndarray, right: np.ndarray, share: float) -> np.ndarray:
    """An image whose first columns, the share `share`, are those of `left` and whose other columns are those
    of `right`; both (H, W, ...)."""
    image = right.copy()
    edge = round(share * image.shape[1])
    image[:, :edge] = left[:, :edge]
    return image


def contact_sheet(rows: list[list[np.ndarray]], columns: int = 2, gap: int = 4) -> np.ndarray:
    """All pictures on one picture (H, W, 3). rows: lists of pictures (h, w, 3), which may differ in size; a
    list is placed from left to right, `columns` lists side by side. gap: pixels between pictures, which are
    black."""
    strips = [_side_by_side(row, gap) for row in rows]
    lines = [_side_by_side(strips[i : i + columns], 3 * gap) for i in range(0, len(strips), columns)]
    return _side_by_side([line.swapaxes(0, 1) for line in lines], gap).swapaxes(0, 1)


def _side_by_side(images: list[np.ndarray], gap: int) -> np.ndarray:
    height = max(image.shape[0] for image in images)
    padded = [np.pad(image, ((0, height - image.shape[0]), (0, gap), (0, 0))) for image in images]
    return np.concatenate(padded, axis=1)[:, :-gap]


def with_color_bar(rgb: np.ndarray, name: str) -> np.ndarray:
    """The picture (H, W, 3), in 0..1, with a bar of the colour map `name` below it, from low to high."""
    height, width, _ = rgb.shape
    bar = colored(np.broadcast_to(np.linspace(0, 1, width), (max(1, height // 16), width)), 1, name)
    return np.concatenate([rgb, np.zeros((max(1, height // 40), width, 3)), bar])


def data_uri(rgb: np.ndarray) -> str:
    """A picture (H, W, 3) uint8 as a data URI: WebP if OpenImageIO can write it, otherwise PNG, which is
    larger."""
    encoded = _webp(rgb)
    kind = "webp" if encoded else "png"
    return f"data:image/{kind};base64,{base64.b64encode(encoded or png_bytes(rgb)).decode()}"


def png_bytes(rgb: np.ndarray) -> bytes:
    """A picture (H, W, 3) uint8 as the bytes of a PNG file.

    It needs only zlib, so that a long run does not lose its report because a module is missing.
    """
    height, width, _ = rgb.shape
    above = np.vstack([np.zeros_like(rgb[:1]), rgb[:-1]])
    # each row starts with the number of its filter: 2, the difference to the row above
    rows = np.full((height, 1 + 3 * width), 2, np.uint8)
    rows[:, 1:] = (rgb - above).reshape(height, -1)  # uint8 wraps around, as PNG defines it
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes(), 6)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_png_chunk(name, data) for name, data in chunks)


def _png_chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def _webp(rgb: np.ndarray) -> bytes | None:
    """The picture as the bytes of a WebP file; None if OpenImageIO is missing or was built without WebP."""
    try:
        import OpenImageIO
    except ImportError:
        return None
    spec = OpenImageIO.ImageSpec(rgb.shape[1], rgb.shape[0], 3, OpenImageIO.UINT8)
    spec["compression"] = f"webp:{WEBP_QUALITY}"
    with tempfile.TemporaryDirectory() as folder:  # OpenImageIO's Python interface writes only to files
        path = Path(folder) / "picture.webp"
        name = library_path(path)
        output: Any = OpenImageIO.ImageOutput.create(name)
        if output is None:
            return None
        written = output.open(name, spec) and output.write_image(np.ascontiguousarray(rgb))
        output.close()
        return path.read_bytes() if written else None
