"""Opens a splat file for a reader: every error that follows names the file."""

from __future__ import annotations

import contextlib
import json
import math
import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, BinaryIO, TypeGuard

import numpy as np

from ..system import memory
from ..system.errors import FormatError, TooMany, system_errors
from ..system.foreign import open_regular

MAX_COUNT, MAX_IN_PARTS = 20_000_000, 2**32 - 1  # Gaussians of a file that is read as a whole, in parts
BROKEN, INCOMPLETE = "; export it again", "; copy or export it again"  # ends of sentences
SHORTER = "became shorter while it was read; try again when no program writes it"


def readable(path: str | os.PathLike) -> AbstractContextManager[None]:
    """An OSError of the block becomes a FormatError that names the file."""
    return system_errors(FormatError, f"{path}: cannot be read")


@contextlib.contextmanager
def open_splat(path: str | os.PathLike) -> Iterator[BinaryIO]:
    """Yields the file. FormatErrors of the block get its name in front; an OSError becomes a FormatError."""
    with readable(path):
        try:
            if not Path(path).is_file():
                raise FormatError("is not a file")
            with open_regular(path) as file:
                yield file
        except FormatError as error:
            raise type(error)(f"{path} {error}") from None


def read_json(path: Path, most: int, what: str) -> Any:
    """The value in a JSON file of at most so many bytes, which should be `what`. Raises FormatError."""
    with readable(path), open_regular(path) as file:
        if size_of(file) > most:
            raise FormatError(f"{path}: is larger than {most // 2**20} MiB, so it is not {what}")
        data = file.read()
    try:
        return json.loads(data)
    except (ValueError, RecursionError):
        raise FormatError(f"{path}: is not JSON; give {what}") from None


def usable(path: Path, what: str, read: Callable[[], Any]) -> Any:
    """read() of a value that is part of a JSON file. Raises FormatError, naming the file and `what`, if that
    is not usable."""
    try:
        return read()
    except (KeyError, TypeError, ValueError, OverflowError, FormatError) as error:
        reason = f"lacks {error}" if isinstance(error, KeyError) else str(error)
        raise FormatError(f"{path}: {what} is not usable ({reason})") from None


def json_object(path: Path, most: int) -> dict[str, Any] | None:
    """The JSON object in a file of at most so many bytes; None if it holds none. Raises OSError."""
    with open_regular(path) as file:
        data = file.read(most + 1)
    try:
        found = json.loads(data) if len(data) <= most else None
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def is_whole(value: Any, most: float = math.inf) -> TypeGuard[int]:
    """Whether a value out of a JSON is a whole number of 0 to `most`."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= most


def size_of(file: BinaryIO) -> int:
    """The size of an open file in bytes."""
    return os.fstat(file.fileno()).st_size


def refuse_many(count: int, most: int = MAX_COUNT):
    """Raises TooMany (without the name of the file) for more Gaussians than a file may hold."""
    if count > most:
        raise TooMany(f"holds {count} Gaussians, more than the limit of {most}")


def refuse_unpacking(count: int, coefficients: int, most: int = MAX_COUNT):
    """As refuse_many(), and if memory is too short for so many Gaussians out of a compressed file: for their
    values, or, if more than MAX_COUNT may be read, which is done in parts, for what these are made of.
    coefficients: SH coefficients per channel."""
    refuse_many(count, most)
    needed = memory.unpacking if most <= MAX_COUNT else memory.unpacking_in_parts
    if sentence := memory.shortage("", needed(count, coefficients)):
        raise TooMany(sentence.lstrip())


def refuse_whole(count: int, coefficients: int, most: int = MAX_COUNT):
    """As refuse_unpacking(), for a file that cannot be read in parts: raises a FormatError that is not
    TooMany, so that nobody tries it by blocks."""
    try:
        refuse_unpacking(count, coefficients, min(most, MAX_COUNT))
    except TooMany as error:
        raise FormatError(
            f"{error}; this kind of file cannot be read in parts: save it as PLY or SPZ"
        ) from error


def rows_at(file: BinaryIO, offset: int, dtype: np.dtype, count: int) -> np.ndarray:
    """`count` values of this type from a place of the file on. Raises FormatError (without the name of the
    file) if it ends before."""
    rows = np.empty(count, dtype)
    file.seek(offset)
    readable: Any = file  # typing.BinaryIO lacks readinto
    if readable.readinto(rows.view(np.uint8).reshape(-1)) != rows.nbytes:
        raise FormatError(SHORTER)
    return rows
