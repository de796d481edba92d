"""The PLY format of 3DGS, as its reference implementation writes it.

A binary-little-endian file that is read and written without changes keeps every byte: the Scene carries
further vertex properties, their order and types, and the comments of the header. Values are raw, as stored;
repair.py repairs them.
"""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np

from ..scene.gaussians import SH_COEFFICIENTS, Scene
from ..system import memory
from ..system.errors import FormatError, SceneError
from . import compressed_ply
from .atomic import atomic_write, check_space, start_writeback
from .ply_body import BLOCK_ROWS, MAX_ASCII_BYTES, Body, blocks, empty_arrays, named_columns
from .ply_header import (
    MAX_HEADER_BYTES,
    TYPE_NAMES,
    Element,
    Header,
    format_header,
    is_mip,
    parse_header,
    written_comments,
)
from .quantised import small_scale
from .reading import MAX_COUNT, open_splat, refuse_many, size_of
from .splat_format import SplatFormat

COARSE = 4  # steps of positions of double precision in the scale of a small Gaussian, at least
NORMALS = ("nx", "ny", "nz")  # 3DGS writes these properties; they are always 0

log = logging.getLogger(__name__)


def read_ply(path: str | os.PathLike, max_count: int = MAX_COUNT) -> Scene:
    """Reads a 3DGS PLY of SH degree 0 to 3: binary in either byte order, or ASCII up to 64 MiB.

    Values are as stored, non-finite ones included; coordinate frame and units are those of the file. Elements
    after the vertices are ignored, with a warning in the log. max_count: largest number of Gaussians. Raises
    FormatError, which names the file.
    """
    return next(_parts(path, max_count, max_count))


def read_ply_parts(path: str | os.PathLike, max_count: int = MAX_COUNT) -> Iterator[Scene]:
    """As read_ply, in parts of a few thousand Gaussians in file order, so that little memory is needed
    (ASCII: one part).

    Each part overwrites the arrays of the previous one. There is at least one part; it is empty if the file
    has no Gaussian.
    """
    return _parts(path, max_count, BLOCK_ROWS)


def _parts(path: str | os.PathLike, max_count: int, most: int) -> Iterator[Scene]:
    """As read_ply_parts, in parts of at most so many Gaussians."""
    with open_splat(path) as file:
        body = _checked_body(file, path, max_count)
        for number, part in enumerate(body.parts(most)):
            if not number:
                _tell_of_steps(path, body, part)
            yield part


def _tell_of_steps(path: str | os.PathLike, body: Body, scene: Scene):
    """A warning where positions of double precision, as of a map, are too far away for float32."""
    if not body.has_double_positions or not scene.count:
        return
    step, small = float(np.spacing(np.abs(scene.means).max())), small_scale(scene)
    if step > small / COARSE:
        log.warning(
            "%s: positions of double precision are rounded to steps of %g, and small Gaussians have a scale"
            " of %g: move the scene to the origin before it is exported",
            path,
            step,
            small,
        )


def write_ply(path: str | os.PathLike, scene: Scene) -> None:
    """Writes a binary-little-endian 3DGS PLY atomically. Columns are in scene.property_order, or in the order
    of 3DGS if it is empty. Raises SceneError, also if a PLY cannot store an attribute or comment."""
    columns = _file_columns(scene)
    header, dtype = _layout(scene, columns)
    check_space(path, len(header) + scene.count * dtype.itemsize)
    with atomic_write(path) as file:
        file.write(header)
        for rows, part in blocks(scene.count, np.empty(BLOCK_ROWS, dtype)):
            for name, column in columns.items():
                rows[name] = column[part]
            file.write(rows.view(np.uint8).data)
            start_writeback(file, rows.nbytes)


def file_size(scene: Scene) -> int:
    """Size in bytes of the file that write_ply would make."""
    header, dtype = _layout(scene, _file_columns(scene))
    return len(header) + scene.count * dtype.itemsize


def _layout(scene: Scene, columns: dict[str, np.ndarray]) -> tuple[bytes, np.dtype]:
    """The header, and the dtype of one row (one Gaussian) of the body."""
    properties = [(name, column.dtype.str[1:]) for name, column in columns.items()]
    header = format_header(written_comments(scene), ("vertex", scene.count, properties))
    return header, np.dtype([(name, "<" + code) for name, code in properties])


def _checked_body(file: BinaryIO, path: str | os.PathLike, max_count: int) -> Body:
    """Checks header and size; the file is then at its first Gaussian. Raises FormatError without its name."""
    header = parse_header(file.read(MAX_HEADER_BYTES))
    vertex = _vertex_element(header)
    coefficients = _check_properties(vertex)
    refuse_many(vertex.count, max_count)
    _check_size(header, vertex, size_of(file))
    if len(header.elements) > 1:
        others = ", ".join(element.name for element in header.elements[1:])
        log.warning("%s: elements after the Gaussians are ignored: %s", path, others)
    file.seek(header.size)
    return Body(file, header, coefficients, is_mip(header.comments))


def _vertex_element(header: Header) -> Element:
    """The vertex element, which holds the Gaussians and must be the first. Raises FormatError."""
    names = [element.name for element in header.elements]
    if "vertex" not in names:
        raise FormatError("has no vertex element, so it is not a 3DGS splat")
    vertex = header.elements[names.index("vertex")]
    if "chunk" in names or any(name.startswith("packed_") for name, _ in vertex.properties):
        raise FormatError("is a compressed PLY with a header that is not understood; export it again")
    if names[0] != "vertex":
        raise FormatError(
            f"has the element {names[0]} before its vertices, which is not supported; export it with the"
            " vertices first"
        )
    if vertex.list_property:
        raise FormatError(
            f"has the list property {vertex.list_property} on its vertices, so it is not a 3DGS splat"
        )
    return vertex


def _check_properties(vertex: Element) -> int:
    """Checks the 3DGS properties. Returns K, SH coefficients per channel. Raises FormatError."""
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
    """Compares count and size of the file in bytes, before memory is allocated. Raises FormatError."""
    available = file_size - header.size
    if header.encoding == "ascii":
        if available > MAX_ASCII_BYTES:
            raise FormatError(
                f"is an ASCII PLY of more than {MAX_ASCII_BYTES // 2**20} MiB; convert it to binary first"
            )
        # at least one digit and one separator per value
        if available + 1 < 2 * vertex.count * len(vertex.properties):
            raise FormatError(
                f"is incomplete: {vertex.count:,} Gaussians do not fit into {memory.size_text(available)} of"
                " text; copy or export it again"
            )
        return
    needed = vertex.count * sum(int(code[1]) for _, code in vertex.properties)
    if available < needed:
        raise FormatError(
            f"is incomplete: {memory.part_text(file_size, header.size + needed)}; copy or export it again"
        )
    if available > needed and len(header.elements) == 1:
        raise FormatError(
            f"has {available - needed} bytes more than its header declares; copy or export the file again"
        )


def _file_columns(scene: Scene) -> dict[str, np.ndarray]:
    """{property name: (N,) array} in file order. Raises SceneError for an attribute that no PLY can store."""
    columns = named_columns(vars(scene))
    for name, column in scene.attributes.items():
        if name in columns or not re.fullmatch("[!-~]+", name) or column.dtype.str[1:] not in TYPE_NAMES:
            raise SceneError(
                f"attribute {name!r} of type {column.dtype} cannot be stored in a PLY; remove or rename it"
                " first"
            )
    columns |= scene.attributes
    order = scene.property_order
    if not order:
        zeros = np.broadcast_to(np.float32(0), scene.count)
        columns |= {name: zeros for name in NORMALS if name not in columns}
        order = ("x", "y", "z", *NORMALS)
    kept = {name: columns[name] for name in order if name in columns}
    return kept | columns


FORMAT = SplatFormat(
    name="ply",
    label="3D Gaussian Splat",
    suffixes=(".ply",),
    sniff=lambda head: head.startswith(b"ply") and not compressed_ply.sniff(head),
    read=read_ply,
    read_parts=read_ply_parts,
    write=write_ply,
    size=file_size,
    lossless=True,
    carries=("attributes", "antialiased", "order"),
)
