"""PLY headers. Those of untrusted files are parsed: all limits are checked before the body is read. One of
the comments may say that the scene is antialiased."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field

from ..scene.gaussians import Scene
from ..system.errors import FormatError, SceneError

MAX_HEADER_BYTES = 64 * 1024
MAX_HEADER_LINES = 1000

ENCODINGS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}  # {name: NumPy byte order}
TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2",
    "int": "i4", "uint": "u4", "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip
# {NumPy code: the short name, which 3DGS writes}
TYPE_NAMES = {code: name for name, code in reversed(TYPES.items())}
MIP_COMMENT = "SplatRenderMode: mip"
# written by Brush; by Postshot
MIP_PATTERN = re.compile(r"\s*(SplatRenderMode:\s*mip|antialiased\s+1)\s*", re.IGNORECASE)
MODE_PATTERN = re.compile(r"\s*(SplatRenderMode:|antialiased\s).*", re.IGNORECASE)


@dataclass
class Element:
    """One element of the header. properties: (name, NumPy type code) in file order."""

    name: str
    count: int
    properties: list[tuple[str, str]] = field(default_factory=list)
    # name of the first list property, or ""; with one, the rows of the element differ in size
    list_property: str = ""


@dataclass(frozen=True)
class Header:
    """A parsed header. size: its size in bytes, the end_header line included."""

    encoding: str
    elements: tuple[Element, ...]
    comments: tuple[str, ...]
    size: int


def parse_header(data: bytes) -> Header:
    """The header in the first MAX_HEADER_BYTES of a file. Raises FormatError (without its name)."""
    lines, size = _split_lines(data)
    encodings: list[str] = []
    elements: list[Element] = []
    comments: list[str] = []
    for line in lines:
        keyword, _, rest = line.partition(" ")
        if keyword == "comment":
            comments.append(rest)
        elif keyword != "obj_info" and not line.isascii():
            raise FormatError(
                f"has a header line with other letters than those of ASCII: {line[:60]!r}; export the file"
                " again"
            )
        elif keyword == "format":
            encodings.append(_parse_encoding(rest))
        elif keyword == "element":
            elements.append(_parse_element(rest.split(), elements))
        elif keyword == "property":
            _add_property(rest.split(), elements)
        elif keyword != "obj_info":
            raise FormatError(
                f"has a header line that is not understood: {line[:60]!r}; export the file again"
            )
    if len(encodings) != 1:
        raise FormatError("needs exactly one format line in its header; export the file again")
    return Header(encodings[0], tuple(elements), tuple(comments), size)


def format_header(comments: list[str], *elements: tuple[str, int, list[tuple[str, str]]]) -> bytes:
    """A binary-little-endian header. elements: name, rows, and (name, NumPy type code) of properties."""
    lines = ["ply", "format binary_little_endian 1.0"]
    lines += [f"comment {text}" for text in comments]
    for element, count, properties in elements:
        lines += [
            f"element {element} {count}",
            *(f"property {TYPE_NAMES[code]} {name}" for name, code in properties),
        ]
    return "\n".join([*lines, "end_header", ""]).encode(errors="surrogateescape")


def written_comments(scene: Scene) -> list[str]:
    """The comments to write: those that were read, with the antialiasing comment corrected if the flag has
    changed. Raises SceneError for a comment that a PLY cannot store."""
    comments = list(scene.comments)
    if scene.antialiased != is_mip(comments):
        comments = [text for text in comments if not MODE_PATTERN.fullmatch(text)]
        comments += [MIP_COMMENT] * scene.antialiased
    if not all(is_comment(text) for text in comments):
        raise SceneError(
            "a comment of the scene is not one line of text, so it cannot be stored in a PLY; remove it first"
        )
    return comments


def is_mip(comments: Iterable[str]) -> bool:
    """Whether a comment marks the scene as antialiased."""
    return any(MIP_PATTERN.fullmatch(text) for text in comments)


def is_comment(text: str) -> bool:
    """Whether it can be stored as a comment: one line of UTF-8, or of any bytes of a header that was read."""
    try:
        return b"\n" not in text.encode(errors="surrogateescape")
    except UnicodeEncodeError:
        return False


def _split_lines(data: bytes) -> tuple[list[str], int]:
    """The lines between 'ply' and 'end_header', and the size of the header in bytes. Raises FormatError."""
    if not re.match(rb"ply[ \t]*\r?\n", data):
        raise FormatError("is not a PLY file; give a 3DGS .ply")
    end = re.search(rb"\nend_header[ \t]*\r?\n", data[:MAX_HEADER_BYTES])
    if end is None:
        raise FormatError(
            f"is incomplete or not a PLY file: its header does not end within {MAX_HEADER_BYTES // 1024} KiB;"
            " copy or export it again"
        )
    # Comments may hold any bytes, which are written back as they were read.
    lines = [line.rstrip("\r") for line in data[: end.start()].decode(errors="surrogateescape").split("\n")]
    if len(lines) > MAX_HEADER_LINES:
        raise FormatError(f"has {len(lines)} header lines, more than the limit of {MAX_HEADER_LINES}")
    return lines[1:], end.end()


def _parse_encoding(text: str) -> str:
    """The encoding in a format line. Raises FormatError."""
    encoding, _, version = text.strip().partition(" ")
    if encoding not in ENCODINGS or version.strip() != "1.0":
        raise FormatError(f"has an unknown format: {text[:60]!r}")
    return encoding


def _parse_element(words: list[str], elements: list[Element]) -> Element:
    """The element of an element line. Raises FormatError, also if its name is not new."""
    if len(words) != 2 or not re.fullmatch(r"[0-9]{1,10}", words[1]):
        raise FormatError(f"has an element line that is not a name and a count: {' '.join(words)[:60]!r}")
    if any(element.name == words[0] for element in elements):
        raise FormatError(f"declares the element {words[0]} twice")
    return Element(words[0], int(words[1]))


def _add_property(words: list[str], elements: list[Element]) -> None:
    """Adds a property to the last element. Raises FormatError."""
    if not elements:
        raise FormatError("declares a property before any element")
    element = elements[-1]
    is_list = words[:1] == ["list"]
    *types, name = words[is_list:] or [""]
    if len(types) != 1 + is_list or any(word not in TYPES for word in types):
        raise FormatError(f"has a property line that is not understood: {' '.join(words)[:60]!r}")
    if name == element.list_property or any(name == other for other, _ in element.properties):
        raise FormatError(f"declares the property {name} of {element.name} twice")
    if is_list:
        element.list_property = element.list_property or name
    else:
        element.properties.append((name, TYPES[types[0]]))
