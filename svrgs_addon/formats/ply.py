"""3DGS PLY: reads and writes splats as the reference implementation stores them.

A binary-little-endian file read and written unchanged keeps every byte: further vertex properties, their order and
types, and header comments travel with the Scene. Data is kept raw: see finite.py for repair.
"""

from __future__ import annotations

import logging
import os
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..atomic import atomic_write, check_writable
from ..errors import FormatError, SceneError
from ..scene import SH_COEFFICIENTS, Scene
from .ply_header import ENCODINGS, MAX_HEADER_BYTES, TYPE_NAMES, Element, Header, format_header, parse_header

MAX_COUNT = 20_000_000
MAX_ASCII_BYTES = 64 * 2**20
BLOCK_ROWS = 4096  # rows converted at a time: about 1 MB, which stays in the cache
NORMALS = ("nx", "ny", "nz")  # 3DGS writes them, always zero
MIP_COMMENT = "SplatRenderMode: mip"
MIP_PATTERN = re.compile(r"\s*(SplatRenderMode:\s*mip|antialiased\s+1)\s*", re.IGNORECASE)  # Brush; Postshot
MODE_PATTERN = re.compile(r"\s*(SplatRenderMode:|antialiased\s).*", re.IGNORECASE)

log = logging.getLogger(__name__)


def read_ply(path: str | os.PathLike, max_count: int = MAX_COUNT) -> Scene:
    """Read a 3DGS PLY of SH degree 0-3: binary of either byte order, or small ASCII. Frame and units: the file's.

    Values are kept as stored, non-finite ones included. Elements after the vertices are not kept (logged).
    Raises FormatError, naming the file and the reason.
    """
    try:
        if not Path(path).is_file():
            raise FormatError("is not a file")
        with open(path, "rb") as file:
            return _read(file, path, max_count)
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from None
    except OSError as error:
        raise FormatError(f"{path}: cannot be read ({error.strerror or error})") from error


def write_ply(path: str | os.PathLike, scene: Scene) -> None:
    """Write a binary-little-endian 3DGS PLY atomically, columns in scene.property_order or else in the 3DGS order.

    Raises SceneError if the file cannot be written or an attribute does not fit into a PLY.
    """
    columns = _file_columns(scene)
    properties = [(name, column.dtype.str[1:]) for name, column in columns.items()]
    header = format_header(_file_comments(scene), scene.count, properties)
    dtype = np.dtype([(name, "<" + code) for name, code in properties])
    check_writable(path, len(header) + scene.count * dtype.itemsize)
    with atomic_write(path) as file:
        file.write(header)
        for rows, part in _blocks(scene.count, dtype):
            for name, column in columns.items():
                rows[name] = column[part]
            file.write(rows.view(np.uint8))


def _read(file: BinaryIO, path: str | os.PathLike, max_count: int) -> Scene:
    header = parse_header(file.read(MAX_HEADER_BYTES))
    vertex = _vertex_element(header)
    coefficients = _check_properties(vertex)
    if vertex.count > max_count:
        raise FormatError(f"holds {vertex.count} Gaussians, more than the limit of {max_count}")
    _check_size(header, vertex, os.fstat(file.fileno()).st_size)
    if len(header.elements) > 1:
        others = ", ".join(element.name for element in header.elements[1:])
        log.warning("%s: elements after the Gaussians are not kept: %s", path, others)

    arrays = _empty_arrays(vertex.count, coefficients)
    columns = _named_columns(arrays)
    attributes = {name: np.empty(vertex.count, code) for name, code in vertex.properties if name not in columns}
    fill = _fill_ascii if header.encoding == "ascii" else _fill_binary
    file.seek(header.size)
    with np.errstate(over="ignore", invalid="ignore"):  # doubles beyond float32 become infinite, as documented: raw
        fill(file, vertex, ENCODINGS[header.encoding], columns | attributes)
    return Scene(
        **arrays,
        antialiased=_says_mip(header.comments),
        attributes=attributes,
        comments=header.comments,
        property_order=tuple(name for name, _ in vertex.properties),
    )


def _vertex_element(header: Header) -> Element:
    """The element of the Gaussians, which must be the first."""
    names = [element.name for element in header.elements]
    if "vertex" not in names:
        raise FormatError("has no vertex element")
    vertex = header.elements[names.index("vertex")]
    if "chunk" in names or any(name.startswith("packed_") for name, _ in vertex.properties):
        raise FormatError("is a PlayCanvas compressed PLY, which is not read; convert it to a plain 3DGS PLY first")
    if names[0] != "vertex":
        raise FormatError(f"has the element {names[0]} before its vertices, which is not read")
    if vertex.list_property:
        raise FormatError(f"has the list property {vertex.list_property} on its vertices; a splat file has none")
    return vertex


def _check_properties(vertex: Element) -> int:
    """Check the 3DGS properties by name and type; returns K, the SH coefficients per channel."""
    types = dict(vertex.properties)
    rest = [name for name in types if name.startswith("f_rest_")]
    coefficients = 1 + len(rest) // 3
    if len(rest) % 3 or coefficients not in SH_COEFFICIENTS:
        raise FormatError(f"has {len(rest)} f_rest properties; SH degrees 0 to 3 have 0, 9, 24 or 45")
    for name in _named_columns(_empty_arrays(0, coefficients)):
        if name not in types:
            raise FormatError(f"lacks the property {name}, so it is not a 3DGS splat")
        if types[name] not in ("f4", "f8"):
            raise FormatError(f"stores {name} as {TYPE_NAMES[types[name]]}; float is expected")
    return coefficients


def _check_size(header: Header, vertex: Element, file_size: int) -> None:
    """Hold the declared count against the bytes that exist, before anything is allocated for it."""
    available = file_size - header.size
    if header.encoding == "ascii":
        if available > MAX_ASCII_BYTES:
            raise FormatError(
                f"is an ASCII PLY of more than {MAX_ASCII_BYTES // 2**20} MiB; convert it to binary first"
            )
        if available + 1 < 2 * vertex.count * len(vertex.properties):  # a digit and a separator for each value
            raise FormatError(f"is truncated: {vertex.count} Gaussians cannot fit into {available} bytes of text")
        return
    needed = vertex.count * sum(int(code[1]) for _, code in vertex.properties)
    if available < needed:
        raise FormatError(f"is truncated: its header announces {needed} bytes of Gaussians, {available} are there")
    if available > needed and len(header.elements) == 1:
        raise FormatError(f"has {available - needed} bytes more than its header announces")


def _empty_arrays(count: int, coefficients: int) -> dict[str, np.ndarray]:
    shapes = {"means": (3,), "log_scales": (3,), "quats": (4,), "opacity_logits": (), "sh": (coefficients, 3)}
    return {name: np.empty((count, *shape), np.float32) for name, shape in shapes.items()}


def _named_columns(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Property name: (N,) view into the arrays of a Scene, in the 3DGS order. f_rest is channel-major in the file."""
    sh = arrays["sh"]
    rest = sh.shape[1] - 1
    columns = {name: arrays["means"][:, i] for i, name in enumerate("xyz")}
    columns |= {f"f_dc_{channel}": sh[:, 0, channel] for channel in range(3)}
    columns |= {f"f_rest_{c * rest + k}": sh[:, 1 + k, c] for c in range(3) for k in range(rest)}
    columns |= {"opacity": arrays["opacity_logits"]}
    columns |= {f"scale_{i}": arrays["log_scales"][:, i] for i in range(3)}
    return columns | {f"rot_{i}": arrays["quats"][:, i] for i in range(4)}


def _blocks(count: int, dtype: np.dtype) -> Iterator[tuple[np.ndarray, slice]]:
    """One reused buffer of rows, and the part of the columns it stands for."""
    buffer = np.empty(min(count, BLOCK_ROWS), dtype)
    for start in range(0, count, BLOCK_ROWS):
        part = slice(start, min(start + BLOCK_ROWS, count))
        yield buffer[: part.stop - part.start], part


def _fill_binary(file: BinaryIO, vertex: Element, byte_order: str, columns: dict[str, np.ndarray]) -> None:
    dtype = np.dtype([(name, byte_order + code) for name, code in vertex.properties])
    for rows, part in _blocks(vertex.count, dtype):
        if file.readinto(rows.view(np.uint8)) != rows.nbytes:
            raise FormatError("became shorter while it was read")
        for name, column in columns.items():
            column[part] = rows[name]


def _fill_ascii(file: BinaryIO, vertex: Element, _byte_order: str, columns: dict[str, np.ndarray]) -> None:
    names = [name for name, _ in vertex.properties]
    wanted = vertex.count * len(names)
    values = _parse_numbers(file.read(MAX_ASCII_BYTES))[:wanted]
    if len(values) != wanted:
        raise FormatError(f"does not hold {vertex.count} lines of {len(names)} numbers after its header")
    for name, column in zip(names, values.reshape(-1, len(names)).T, strict=True):
        columns[name][:] = column
        if columns[name].dtype.kind in "iu" and not np.array_equal(columns[name], column):
            raise FormatError(f"has a value of {name} that does not fit its type")


def _parse_numbers(text: bytes) -> np.ndarray:
    """Numbers between white space, float64; NumPy stops at the first that is none, with a warning or an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, dtype=np.float64, sep=" ")
        except (ValueError, DeprecationWarning):
            raise FormatError("holds text that is not a number after its header") from None


def _file_columns(scene: Scene) -> dict[str, np.ndarray]:
    """Every column to write, by property name and in file order."""
    columns = _named_columns(vars(scene))
    for name, column in scene.attributes.items():
        if name in columns or not re.fullmatch("[!-~]+", name) or column.dtype.str[1:] not in TYPE_NAMES:
            raise SceneError(f"attribute {name!r} of type {column.dtype} cannot be stored in a PLY")
    columns |= scene.attributes
    order = scene.property_order
    if not order:
        columns |= {name: np.broadcast_to(np.float32(0), scene.count) for name in NORMALS if name not in columns}
        order = ("x", "y", "z", *NORMALS)
    kept = {name: columns[name] for name in order if name in columns}
    return kept | columns


def _file_comments(scene: Scene) -> list[str]:
    """The comments as read, with the antialiasing mark put right if the flag has changed since."""
    comments = list(scene.comments)
    if scene.antialiased != _says_mip(comments):
        comments = [text for text in comments if not MODE_PATTERN.fullmatch(text)]
        comments += [MIP_COMMENT] * scene.antialiased
    if any("\n" in text or not text.isascii() for text in comments):
        raise SceneError("a comment of the scene is not one line of ASCII, so it cannot be stored in a PLY")
    return comments


def _says_mip(comments: Iterable[str]) -> bool:
    return any(MIP_PATTERN.fullmatch(text) for text in comments)
