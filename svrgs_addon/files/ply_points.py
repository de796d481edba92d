"""Reads point clouds with colours from PLY files, such as the sparse points beside a transforms.json."""

from __future__ import annotations

import os
from typing import BinaryIO

import numpy as np

from ..system.errors import FormatError
from .ply_body import numbers_in
from .ply_header import ENCODINGS, MAX_HEADER_BYTES, parse_header
from .quantised import to_uint8
from .reading import open_splat, size_of

MAX_POINTS = 20_000_000
PLACE, COLOUR = ("x", "y", "z"), ("red", "green", "blue")
GREY = 128  # of points without colours


def read_points(path: str | os.PathLike) -> tuple[np.ndarray, np.ndarray]:
    """Positions (P, 3) float32 and colours (P, 3) uint8 RGB of a PLY point cloud, binary or ASCII up to 64
    MiB; in the file colours are whole numbers 0..255 or floats 0..1. Raises FormatError, which names the
    file."""
    with open_splat(path) as file:
        columns = _columns(file)
        return _positions(columns), _colours(columns)


def _columns(file: BinaryIO) -> dict[str, np.ndarray]:
    """The vertices' columns (P,) by name, in the file's types. Raises FormatError (without its name)."""
    header = parse_header(file.read(MAX_HEADER_BYTES))
    vertices = header.elements[0] if header.elements else None
    known = {name for name, _ in vertices.properties} if vertices and vertices.name == "vertex" else set()
    if vertices is None or vertices.list_property or not set(PLACE) <= known:
        raise FormatError(
            "is no point cloud: its first element must be vertex, with x, y and z and without lists"
        )
    if vertices.count > MAX_POINTS:
        raise FormatError(f"announces {vertices.count:,} points; the limit is {MAX_POINTS:,}")
    names = [name for name, _ in vertices.properties]
    row = np.dtype([(name, ENCODINGS[header.encoding] + code) for name, code in vertices.properties])
    left = size_of(file) - file.seek(header.size)
    if header.encoding == "ascii":
        values = numbers_in(file, vertices.count * len(names))
        if len(values) == vertices.count * len(names):
            return dict(zip(names, values.reshape(-1, len(names)).T, strict=True))
    elif vertices.count * row.itemsize <= left:
        rows = np.frombuffer(file.read(vertices.count * row.itemsize), row)
        return {name: rows[name] for name in names}
    raise FormatError(
        f"is incomplete: it holds fewer than the {vertices.count:,} points that its header announces; copy or"
        " export it again"
    )


def _positions(columns: dict[str, np.ndarray]) -> np.ndarray:
    """(P, 3) float32. Raises FormatError if one is not finite."""
    places = np.stack([columns[name].astype(np.float64) for name in PLACE], axis=1)
    if not (np.abs(places) < np.finfo(np.float32).max).all():
        raise FormatError("has a point that is not at a finite place; export the points again")
    return places.astype(np.float32)


def _colours(columns: dict[str, np.ndarray]) -> np.ndarray:
    """(P, 3) uint8; GREY without colours."""
    if not set(COLOUR) <= columns.keys():
        return np.full((len(columns["x"]), 3), GREY, np.uint8)
    values = np.stack([columns[name].astype(np.float64) for name in COLOUR], axis=1)
    if values.size and np.nanmax(values, initial=0) <= 1 and columns["red"].dtype.kind == "f":
        values = values * 255
    return to_uint8(np.nan_to_num(values))
