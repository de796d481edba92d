"""Pictures for people: colour-mapped spatial masks, amplified differences, and their encoding for a web page.

Shared by `svrgs render`, `svrgs compare` and the report. Knows no HTML.
"""

from __future__ import annotations

import base64
import struct
import tempfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from ..render.color_maps import colored

DIFFERENCE_GAIN = 4
WEBP_QUALITY = 92


def mask_to_rgb(mask: np.ndarray, vmax: float | None = None) -> np.ndarray:
    """A spatial mask F (H, W), finite and ≥ 0, as colours (H, W, 3) uint8: black at 0, yellow at vmax and above.

    vmax: the value of the brightest colour; None takes the largest in the mask. Give one vmax to masks to be compared.
    """
    return to_uint8(colored(mask, float(np.max(mask, initial=0)) if vmax is None else vmax))


def difference_image(a: np.ndarray, b: np.ndarray, gain: float = DIFFERENCE_GAIN) -> np.ndarray:
    """gain · |a - b| per channel, clipped, (H, W, 3) uint8: black where equal. a, b: floats in [0, 1]."""
    return to_uint8(np.abs(np.asarray(a, np.float32) - b) * gain)


def wipe(left: np.ndarray, right: np.ndarray, share: float) -> np.ndarray:
    """The first `share` of the columns of `left`, the others of `right`; both (H, W, ...)."""
    image = right.copy()
    edge = round(share * image.shape[1])
    image[:, :edge] = left[:, :edge]
    return image


def contact_sheet(rows: list[list[np.ndarray]], columns: int = 2, gap: int = 4) -> np.ndarray:
    """One picture (H, W, 3) of rows of pictures (h, w, 3) that may differ in size, `columns` rows beside each other; gaps are 0."""
    strips = [_beside(row, gap) for row in rows]
    lines = [_beside(strips[i : i + columns], 3 * gap) for i in range(0, len(strips), columns)]
    return _beside([line.swapaxes(0, 1) for line in lines], gap).swapaxes(0, 1)


def _beside(images: list[np.ndarray], gap: int) -> np.ndarray:
    height = max(image.shape[0] for image in images)
    padded = [np.pad(image, ((0, height - image.shape[0]), (0, gap), (0, 0))) for image in images]
    return np.concatenate(padded, axis=1)[:, :-gap]


def with_color_bar(rgb: np.ndarray, name: str) -> np.ndarray:
    """The picture (H, W, 3) in [0, 1] above a bar of the colour map, from low to high."""
    height, width, _ = rgb.shape
    bar = colored(np.broadcast_to(np.linspace(0, 1, width), (max(1, height // 16), width)), 1, name)
    return np.concatenate([rgb, np.zeros((max(1, height // 40), width, 3)), bar])


def to_uint8(image: np.ndarray) -> np.ndarray:
    """Floats in [0, 1] (clipped) to 0 … 255, rounded; same shape."""
    return np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)


def data_uri(rgb: np.ndarray) -> str:
    """A picture (H, W, 3) uint8 as a data URI: WebP where OpenImageIO can write it, otherwise the larger PNG."""
    encoded = _webp(rgb)
    kind = "webp" if encoded else "png"
    return f"data:image/{kind};base64,{base64.b64encode(encoded or png_bytes(rgb)).decode()}"


def png_bytes(rgb: np.ndarray) -> bytes:
    """A picture (H, W, 3) uint8 as a PNG file.

    Needs nothing but zlib: a long run must not lose its report to a missing module.
    """
    height, width, _ = rgb.shape
    above = np.vstack([np.zeros_like(rgb[:1]), rgb[:-1]])
    rows = np.full((height, 1 + 3 * width), 2, np.uint8)  # every row begins with its filter: 2, minus the row above
    rows[:, 1:] = (rgb - above).reshape(height, -1)  # uint8 wraps, as the filter wants
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes(), 6)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_png_chunk(name, data) for name, data in chunks)


def _png_chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def _webp(rgb: np.ndarray) -> bytes | None:
    """The picture as a WebP file, or None where OpenImageIO is missing or was built without WebP."""
    try:
        import OpenImageIO
    except ImportError:
        return None
    spec = OpenImageIO.ImageSpec(rgb.shape[1], rgb.shape[0], 3, OpenImageIO.UINT8)
    spec["compression"] = f"webp:{WEBP_QUALITY}"
    with tempfile.TemporaryDirectory() as folder:  # its Python interface writes to files only
        path = Path(folder) / "picture.webp"
        output: Any = OpenImageIO.ImageOutput.create(str(path))
        if output is None:
            return None
        written = output.open(str(path), spec) and output.write_image(np.ascontiguousarray(rgb))
        output.close()
        return path.read_bytes() if written else None
