"""Scenes and arrays larger than memory should hold: their values lie in files without a name, which the
system maps into memory as needed and forgets again, and which are gone when this process ends."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import numpy as np

from ..scene.gaussians import PARAMETERS, Scene
from ..system.errors import SceneError, system_errors
from .disk_space import existing_parent

LARGE = 1 << 29  # bytes of an array that array_for() puts into a file
BLOCK = 1 << 18  # Gaussians of in_blocks()


@contextlib.contextmanager
def mapped_scene(parts: Iterable[Scene], out: str | os.PathLike) -> Iterator[Scene]:
    """Yields the scene of parts with the same columns, at least one; each is done with before the next one is
    asked for. out: the output, in whose folder there is space. Raises SceneError if there is not."""
    with contextlib.ExitStack() as stack:
        files: dict[str, IO[bytes]] = {}
        count, first = 0, None
        for part in parts:
            first, columns = first or part.select(np.arange(0)), _columns(part)
            for name, column in columns.items():
                if name not in files:
                    files[name] = stack.enter_context(_file_beside(out))
                with _errors_of(out):
                    files[name].write(np.ascontiguousarray(column).data.cast("B") if column.size else b"")
            count += part.count
        assert first is not None
        arrays: dict[str, Any] = {}
        for name, column in _columns(first).items():
            shape = (count, *column.shape[1:])
            files[name].flush()
            if np.prod(shape):
                arrays[name] = np.asarray(np.memmap(files[name], column.dtype, "r", shape=shape))
            else:
                arrays[name] = np.empty(shape, column.dtype)
        yield replace(
            first,
            **{name: arrays[name] for name in PARAMETERS},
            attributes={name: arrays[name] for name in first.attributes},
        )


def array_for(shape: tuple[int, ...], dtype: Any, out: str | os.PathLike) -> np.ndarray:
    """An array to be filled, in memory or, if LARGE, in a file beside the output. Raises SceneError."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    if size < LARGE:
        return np.empty(shape, dtype)
    file = _file_beside(out)
    with file, _errors_of(out):
        file.truncate(size)
        return np.asarray(np.memmap(file, dtype, "r+", shape=shape))


def in_blocks(work: Callable[[Scene], np.ndarray], scene: Scene) -> np.ndarray:
    """work(part) of the whole scene, joined; the temporary arrays of `work` are those of one BLOCK."""
    starts = range(0, max(scene.count, 1), BLOCK)
    return np.concatenate([work(scene.select(slice(start, start + BLOCK))) for start in starts])


def _columns(scene: Scene) -> dict[str, np.ndarray]:
    return {name: getattr(scene, name) for name in PARAMETERS} | scene.attributes


def _file_beside(out: str | os.PathLike) -> Any:
    with _errors_of(out):
        return tempfile.TemporaryFile(dir=existing_parent(Path(out).absolute().parent))  # noqa: SIM115 (callers close it)


def _errors_of(out: str | os.PathLike) -> contextlib.AbstractContextManager[None]:
    return system_errors(SceneError, f"{out}: needs more space in its folder while the scene is converted")
