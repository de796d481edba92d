"""The Gaussians of a PLY: which column is which array, and how their bytes become arrays, a cache-sized block at a time."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, BinaryIO

import numpy as np

from ..errors import FormatError
from ..scene import Scene
from .ply_header import ENCODINGS, Header

MAX_ASCII_BYTES = 64 * 2**20
BLOCK_ROWS = 4096  # rows converted at a time: about 1 MB, which stays in the cache


def empty_arrays(count: int, coefficients: int) -> dict[str, np.ndarray]:
    """The arrays of a Scene of `count` Gaussians with K SH coefficients per channel, their values not set."""
    shapes = {"means": (3,), "log_scales": (3,), "quats": (4,), "opacity_logits": (), "sh": (coefficients, 3)}
    return {name: np.empty((count, *shape), np.float32) for name, shape in shapes.items()}


def named_columns(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Property name: (N,) view into the arrays of a Scene, in the 3DGS order. f_rest is channel-major in the file."""
    sh = arrays["sh"]
    rest = sh.shape[1] - 1
    columns = {name: arrays["means"][:, i] for i, name in enumerate("xyz")}
    columns |= {f"f_dc_{channel}": sh[:, 0, channel] for channel in range(3)}
    columns |= {f"f_rest_{c * rest + k}": sh[:, 1 + k, c] for c in range(3) for k in range(rest)}
    columns |= {"opacity": arrays["opacity_logits"]}
    columns |= {f"scale_{i}": arrays["log_scales"][:, i] for i in range(3)}
    return columns | {f"rot_{i}": arrays["quats"][:, i] for i in range(4)}


def blocks(count: int, dtype: np.dtype) -> Iterator[tuple[np.ndarray, slice]]:
    """One reused buffer of rows, and the part of the columns it stands for."""
    buffer = np.empty(min(count, BLOCK_ROWS), dtype)
    for start in range(0, count, BLOCK_ROWS):
        part = slice(start, min(start + BLOCK_ROWS, count))
        yield buffer[: part.stop - part.start], part


@dataclass(frozen=True)
class Body:
    """A checked file, open at its first Gaussian; to be read once."""

    file: BinaryIO
    header: Header
    coefficients: int  # K
    antialiased: bool

    @property
    def count(self) -> int:
        return self.header.elements[0].count

    def whole(self) -> Scene:
        """Every Gaussian."""
        scene = self._empty_scene(self.count)
        with np.errstate(over="ignore", invalid="ignore"):  # doubles beyond float32 become infinite, as documented: raw
            if self.header.encoding == "ascii":
                self._convert_text(scene)
                return scene
            for rows, part in self._blocks():
                self._convert(rows, scene, part)
        return scene

    def parts(self) -> Iterator[Scene]:
        """Every Gaussian, BLOCK_ROWS at a time (ASCII: all at once), in arrays that the next part overwrites; at least one part."""
        if self.header.encoding == "ascii" or not self.count:
            yield self.whole()
            return
        scene = self._empty_scene(min(self.count, BLOCK_ROWS))
        for rows, _ in self._blocks():
            if len(rows) < scene.count:
                scene = self._empty_scene(len(rows))
            with np.errstate(over="ignore", invalid="ignore"):
                self._convert(rows, scene, slice(None))
            yield scene

    def _empty_scene(self, count: int) -> Scene:
        attributes = {name: np.empty(count, code) for name, code in self._further}
        return Scene(
            **empty_arrays(count, self.coefficients), antialiased=self.antialiased, attributes=attributes,
            comments=self.header.comments, property_order=tuple(self._types),
        )  # fmt: skip

    @cached_property
    def _types(self) -> dict[str, str]:
        """Every property's type with its byte order, in file order."""
        order = ENCODINGS[self.header.encoding]
        return {name: order + code for name, code in self.header.elements[0].properties}

    @cached_property
    def _order(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self._types)}

    @cached_property
    def _further(self) -> list[tuple[str, str]]:
        """Properties that a Scene has no array for, with their type in memory."""
        known = named_columns(empty_arrays(0, self.coefficients))
        return [(name, code) for name, code in self.header.elements[0].properties if name not in known]

    @cached_property
    def _all_float32(self) -> bool:
        return all(np.dtype(kind) == np.float32 for kind in self._types.values())

    @cached_property
    def _places(self) -> dict[str, np.ndarray]:
        """Where in a row of the file the values of one Gaussian's arrays lie, in the order of memory."""
        places = empty_arrays(1, self.coefficients)
        for name, column in named_columns(places).items():
            column[0] = self._order[name]
        return {name: array.ravel().astype(np.intp) for name, array in places.items()}

    def _blocks(self) -> Iterator[tuple[np.ndarray, slice]]:
        """The rows of a binary file: (n, properties) float32 where all are, else structured."""
        floats = np.dtype((np.float32, len(self._types)))
        dtype = floats if self._all_float32 else np.dtype(list(self._types.items()))
        file: Any = self.file  # typing.BinaryIO lacks readinto
        for rows, part in blocks(self.count, dtype):
            if file.readinto(rows.view(np.uint8)) != rows.nbytes:
                raise FormatError("became shorter while it was read")
            yield rows, part

    def _convert(self, rows: np.ndarray, scene: Scene, part: slice):
        """Set `part` of the scene from the rows of the file."""
        if not self._all_float32:
            for name, column in _columns(scene).items():
                column[part] = rows[name]
            return
        for name, places in self._places.items():  # an array gathers its values row by row: twice as fast as by column
            np.take(rows, places, axis=1, out=getattr(scene, name)[part].reshape(len(rows), -1), mode="clip")
        for name, column in scene.attributes.items():
            column[part] = rows[:, self._order[name]]

    def _convert_text(self, scene: Scene):
        columns, wanted = _columns(scene), self.count * len(self._types)
        left = os.fstat(self.file.fileno()).st_size - self.file.tell()
        values = _parse_numbers(self.file.read(min(left, MAX_ASCII_BYTES)))[:wanted]  # read(n) takes n bytes of memory, however short the file
        if len(values) != wanted:
            raise FormatError(f"does not hold {self.count} lines of {len(columns)} numbers after its header")
        for name, column in zip(self._types, values.reshape(-1, len(columns)).T, strict=True):
            columns[name][:] = column
            if columns[name].dtype.kind in "iu" and not np.array_equal(columns[name], column):
                raise FormatError(f"has a value of {name} that does not fit its type")


def _columns(scene: Scene) -> dict[str, np.ndarray]:
    return named_columns(vars(scene)) | scene.attributes


def _parse_numbers(text: bytes) -> np.ndarray:
    """Numbers between white space, float64; NumPy stops at the first that is none, with a warning or an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, dtype=np.float64, sep=" ")
        except (ValueError, DeprecationWarning):
            raise FormatError("holds text that is not a number after its header") from None
