"""Zstandard: the module of Python 3.14, or the package zstandard, as in Blender, loaded when it is needed."""

from __future__ import annotations

import importlib
import importlib.util
import os

from ..system.errors import FormatError

SHARED = 1 << 22  # bytes
# bytes that a core takes at a time; it looks back half as far as one core alone, for 0.2 % more bytes
PIECE, HALF_WINDOW = 1 << 22, 8
MISSING = "because the package zstandard is missing: pip install zstandard"
DAMAGED = "is damaged: a stream cannot be unpacked; copy or export it again"


def available() -> bool:
    """Whether either is installed."""
    return importlib.util.find_spec("zstandard") is not None or _in_python()


def lack() -> str:
    """Why SPZ 4 cannot be written: a part of a sentence; "" if it can."""
    return "" if available() else MISSING


def compress(data: bytes | memoryview, level: int, **parameters: int) -> bytes:
    """One frame that says how long its content is. A long one is compressed by all cores. parameters: of
    Zstandard, other than the level has them."""
    module, workers = importlib.import_module(_module()), (os.cpu_count() or 1) if len(data) > SHARED else 0
    if workers:
        parameters |= {"job_size": PIECE, "overlap_log": HALF_WINDOW}
    if _in_python():
        options = {"compression_level": level, "nb_workers": workers, **parameters}
        return module.compress(
            data,
            options={getattr(module.CompressionParameter, name): value for name, value in options.items()},
        )
    chosen = module.ZstdCompressionParameters.from_level(
        level, source_size=len(data), threads=workers, **parameters
    )
    return module.ZstdCompressor(compression_params=chosen).compress(data)


def decompress(frame: bytes, size: int) -> bytes:
    """The content of a frame, which has `size` bytes. No more memory is used, whatever the frame says. Raises
    FormatError (without the name of the file)."""
    try:
        content = _content(frame, size)
    except (ValueError, EOFError, MemoryError, importlib.import_module(_module()).ZstdError):
        raise FormatError(DAMAGED) from None
    if len(content) != size:
        raise FormatError(DAMAGED)
    return content


def _content(frame: bytes, size: int) -> bytes:
    module = importlib.import_module(_module())
    if _in_python():
        return module.ZstdDecompressor().decompress(frame, size + 1)
    if module.frame_content_size(frame) not in (-1, size):  # it would take so much memory
        raise FormatError(DAMAGED)
    return module.ZstdDecompressor().decompress(frame, max_output_size=size)


def _module() -> str:
    return "compression.zstd" if _in_python() else "zstandard"


def _in_python() -> bool:
    return (
        importlib.util.find_spec("compression") is not None
        and importlib.util.find_spec("compression.zstd") is not None
    )
