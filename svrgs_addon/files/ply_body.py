"""The body of a 3DGS PLY: its properties, and rows converted to arrays in blocks that fit into the cache."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, BinaryIO

import numpy as np

from ..scene.gaussians import Scene, parameter_shapes
from ..system.errors import FormatError
from .ply_header import ENCODINGS, Header
from .reading import SHORTER, size_of

MAX_ASCII_BYTES = 64 * 2**20
BLOCK_ROWS = 4096  # rows per block, about 1 MB; it stays in the cache


def empty_arrays(count: int, coefficients: int) -> dict[str, np.ndarray]:
    """Uninitialised arrays of a Scene, by name; see parameter_shapes()."""
    return {n: np.empty(shape, np.float32) for n, shape in parameter_shapes(count, coefficients).items()}


def named_columns(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """{property name: (N,) view of the arrays of a Scene} in the order of 3DGS; f_rest is channel-major."""
    sh = arrays["sh"]
    rest = sh.shape[1] - 1
    columns = {name: arrays["means"][:, i] for i, name in enumerate("xyz")}
    columns |= {f"f_dc_{channel}": sh[:, 0, channel] for channel in range(3)}
    columns |= {f"f_rest_{c * rest + k}": sh[:, 1 + k, c] for c in range(3) for k in range(rest)}
    columns |= {"opacity": arrays["opacity_logits"]}
    columns |= {f"scale_{i}": arrays["log_scales"][:, i] for i in range(3)}
    return columns | {f"rot_{i}": arrays["quats"][:, i] for i in range(4)}


def blocks(count: int, buffer: np.ndarray) -> Iterator[tuple[np.ndarray, slice]]:
    """Yields (rows, slice) for each block of at most BLOCK_ROWS: of the buffer, which is reused, and its part
    of the columns."""
    for start in range(0, count, BLOCK_ROWS):
        part = slice(start, min(start + BLOCK_ROWS, count))
        yield buffer[: part.stop - part.start], part


@dataclass(frozen=True)
class Body:
    """A PLY whose header was checked. The file is at its first Gaussian and can be read once."""

    file: BinaryIO
    header: Header
    coefficients: int  # K, SH coefficients per channel
    antialiased: bool

    @property
    def count(self) -> int:
        """Number of Gaussians."""
        return self.header.elements[0].count

    @property
    def has_double_positions(self) -> bool:
        """Whether x, y or z has 64 bits in the file."""
        return any(np.dtype(self._types[name]).itemsize > 4 for name in "xyz")

    def parts(self, most: int) -> Iterator[Scene]:
        """Yields all Gaussians in parts of at most so many (ASCII: in one part), at least one part. Each
        overwrites the arrays of the previous one. Raises FormatError (without the name of the file)."""
        text = self.header.encoding == "ascii"
        size = max(1, self.count if text else most)
        scene = self._empty_scene(min(size, self.count))
        for start in range(0, max(1, self.count), size):
            if self.count - start < scene.count:
                scene = self._empty_scene(self.count - start)
            # doubles beyond the range of float32 become infinite
            with np.errstate(over="ignore", invalid="ignore"):
                if text:
                    self._convert_text(scene)
                else:
                    self._convert(scene)
            yield scene

    def _empty_scene(self, count: int) -> Scene:
        """A scene with uninitialised arrays, and the comments and property order of the file."""
        attributes = {name: np.empty(count, code) for name, code in self._extra_properties}
        return Scene(
            **empty_arrays(count, self.coefficients), antialiased=self.antialiased, attributes=attributes,
            comments=self.header.comments, property_order=tuple(self._types),
        )  # fmt: skip

    @cached_property
    def _types(self) -> dict[str, str]:
        """NumPy type of each property, with byte order, in file order."""
        order = ENCODINGS[self.header.encoding]
        return {name: order + code for name, code in self.header.elements[0].properties}

    @cached_property
    def _column_index(self) -> dict[str, int]:
        """Position of each property in a row of the file."""
        return {name: i for i, name in enumerate(self._types)}

    @cached_property
    def _extra_properties(self) -> list[tuple[str, str]]:
        """(name, NumPy type code) of the properties that become attributes of the Scene."""
        known = named_columns(empty_arrays(0, self.coefficients))
        return [(name, code) for name, code in self.header.elements[0].properties if name not in known]

    @cached_property
    def _all_float32(self) -> bool:
        return all(np.dtype(kind) == np.float32 for kind in self._types.values())

    @cached_property
    def _row_positions(self) -> dict[str, np.ndarray]:
        """For each array of a Scene: the places of its values in a row of the file, as in memory."""
        places = empty_arrays(1, self.coefficients)
        for name, column in named_columns(places).items():
            column[0] = self._column_index[name]
        return {name: array.ravel().astype(np.intp) for name, array in places.items()}

    @cached_property
    def _buffer(self) -> np.ndarray:
        """Of rows of a binary file: (n, properties) float32, else structured."""
        floats = np.dtype((np.float32, len(self._types)))
        return np.empty(BLOCK_ROWS, floats if self._all_float32 else list(self._types.items()))

    def _convert(self, scene: Scene):
        """Reads the next rows of a binary file into the scene. Raises FormatError."""
        file: Any = self.file  # typing.BinaryIO lacks readinto
        for rows, part in blocks(scene.count, self._buffer):
            if file.readinto(rows.view(np.uint8)) != rows.nbytes:
                raise FormatError(SHORTER)
            if not self._all_float32:
                for name, column in _columns(scene).items():
                    column[part] = rows[name]
                continue
            # one gather per array: twice as fast as one copy per column
            for name, places in self._row_positions.items():
                out = getattr(scene, name)[part].reshape(len(rows), -1)
                np.take(rows, places, axis=1, out=out, mode="clip")
            for name, column in scene.attributes.items():
                column[part] = rows[:, self._column_index[name]]

    def _convert_text(self, scene: Scene):
        """Reads the numbers of an ASCII file into the scene. Raises FormatError."""
        columns, wanted = _columns(scene), self.count * len(self._types)
        values = numbers_in(self.file, wanted)
        if len(values) != wanted:
            raise FormatError(
                f"does not hold {self.count} lines of {len(columns)} numbers after its header; copy or export"
                " the file again"
            )
        for name, column in zip(self._types, values.reshape(-1, len(columns)).T, strict=True):
            columns[name][:] = column
            if columns[name].dtype.kind in "iu" and not np.array_equal(columns[name], column):
                raise FormatError(f"has a value of {name} that does not fit its type; export the file again")


def _columns(scene: Scene) -> dict[str, np.ndarray]:
    """All columns of a scene by property name, attributes included."""
    return named_columns(vars(scene)) | scene.attributes


def numbers_in(file: BinaryIO, count: int) -> np.ndarray:
    """Up to `count` numbers, float64, from here on in an ASCII file. Raises FormatError where NumPy warns or
    fails."""
    # read(n) allocates n bytes even if the file is shorter
    text = file.read(min(size_of(file) - file.tell(), MAX_ASCII_BYTES))
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, dtype=np.float64, sep=" ")[:count]
        except (ValueError, DeprecationWarning):
            raise FormatError(
                "has text that is not a number after its header; export the file again"
            ) from None
