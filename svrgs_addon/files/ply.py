"""3DGS PLY: reads and writes splats as the reference implementation stores them.

A binary-little-endian file read and written unchanged keeps every byte: further vertex properties, their order and
types, and header comments travel with the Scene. Data is kept raw: see finite.py for repair.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..errors import FormatError, SceneError
from ..scene import SH_COEFFICIENTS, Scene
from .atomic import atomic_write, check_writable, start_storing
from .ply_body import MAX_ASCII_BYTES, Body, blocks, empty_arrays, named_columns
from .ply_header import MAX_HEADER_BYTES, TYPE_NAMES, Element, Header, format_header, parse_header
from .splat_format import SplatFormat

MAX_COUNT = 20_000_000
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
    with _opened(path, max_count) as body:
        return body.whole()


def read_ply_parts(path: str | os.PathLike, max_count: int = MAX_COUNT) -> Iterator[Scene]:
    """As read_ply, a few thousand Gaussians at a time and in file order, without ever holding all of them.

    The next part overwrites the arrays of the one before. There is at least one, which is empty if the file is.
    """
    with _opened(path, max_count) as body:
        yield from body.parts()


def write_ply(path: str | os.PathLike, scene: Scene) -> None:
    """Write a binary-little-endian 3DGS PLY atomically, columns in scene.property_order or else in the 3DGS order.

    Raises SceneError if the file cannot be written or an attribute does not fit into a PLY.
    """
    columns = _file_columns(scene)
    header, dtype = _layout(scene, columns)
    check_writable(path, len(header) + scene.count * dtype.itemsize)
    with atomic_write(path) as file:
        file.write(header)
        for rows, part in blocks(scene.count, dtype):
            for name, column in columns.items():
                rows[name] = column[part]
            file.write(rows.view(np.uint8).data)
            start_storing(file, rows.nbytes)


def file_size(scene: Scene) -> int:
    """Bytes of the file write_ply would make."""
    header, dtype = _layout(scene, _file_columns(scene))
    return len(header) + scene.count * dtype.itemsize


def _layout(scene: Scene, columns: dict[str, np.ndarray]) -> tuple[bytes, np.dtype]:
    """Header, and one Gaussian's row behind it."""
    properties = [(name, column.dtype.str[1:]) for name, column in columns.items()]
    return format_header(_file_comments(scene), scene.count, properties), np.dtype([(name, "<" + code) for name, code in properties])


@contextlib.contextmanager
def _opened(path: str | os.PathLike, max_count: int) -> Iterator[Body]:
    """The file with its header checked. What is wrong with it, then or in the block, becomes a FormatError that names it."""
    try:
        if not Path(path).is_file():
            raise FormatError("is not a file")
        with open(path, "rb") as file:
            yield _checked(file, path, max_count)
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from None
    except OSError as error:
        raise FormatError(f"{path}: cannot be read ({error.strerror or error})") from error


def _checked(file: BinaryIO, path: str | os.PathLike, max_count: int) -> Body:
    header = parse_header(file.read(MAX_HEADER_BYTES))
    vertex = _vertex_element(header)
    coefficients = _check_properties(vertex)
    if vertex.count > max_count:
        raise FormatError(f"holds {vertex.count} Gaussians, more than the limit of {max_count}")
    _check_size(header, vertex, os.fstat(file.fileno()).st_size)
    if len(header.elements) > 1:
        others = ", ".join(element.name for element in header.elements[1:])
        log.warning("%s: elements after the Gaussians are not kept: %s", path, others)
    file.seek(header.size)
    return Body(file, header, coefficients, _says_mip(header.comments))


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
    for name in named_columns(empty_arrays(0, coefficients)):
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
            raise FormatError(f"is an ASCII PLY of more than {MAX_ASCII_BYTES // 2**20} MiB; convert it to binary first")
        if available + 1 < 2 * vertex.count * len(vertex.properties):  # a digit and a separator for each value
            raise FormatError(f"is truncated: {vertex.count} Gaussians cannot fit into {available} bytes of text")
        return
    needed = vertex.count * sum(int(code[1]) for _, code in vertex.properties)
    if available < needed:
        raise FormatError(f"is truncated: its header announces {needed} bytes of Gaussians, {available} are there")
    if available > needed and len(header.elements) == 1:
        raise FormatError(f"has {available - needed} bytes more than its header announces")


def _file_columns(scene: Scene) -> dict[str, np.ndarray]:
    """Every column to write, by property name and in file order."""
    columns = named_columns(vars(scene))
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


FORMAT = SplatFormat(
    name="ply",
    label="3D Gaussian Splat",
    suffixes=(".ply",),
    sniff=lambda head: head.startswith(b"ply"),
    read=read_ply,
    read_parts=read_ply_parts,
    write=write_ply,
    size=file_size,
)
