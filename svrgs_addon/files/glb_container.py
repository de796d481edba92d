"""The container of a .glb: 12 bytes, a chunk of JSON, a chunk of bytes with the arrays of accessors."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np

from ..system.errors import FormatError, SceneError
from .reading import INCOMPLETE, is_whole, size_of

HEAD, CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")
MAX_JSON = 16_000_000  # bytes
KINDS = {"5120": "<i1", "5121": "<u1", "5122": "<i2", "5123": "<u2", "5126": "<f4"}  # types of components
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
ARRAY_BUFFER = 34962


@dataclass(frozen=True)
class Glb:
    """The JSON and the bytes of a file. Its methods raise FormatError (without the name of the file)."""

    contents: dict[str, Any]
    data: bytes

    @classmethod
    def read(cls, file: BinaryIO) -> Glb:
        size = size_of(file)
        head = file.read(HEAD.size + CHUNK.size)
        if len(head) < HEAD.size + CHUNK.size or head[:4] != b"glTF":
            raise FormatError(f"is no .glb, or incomplete{INCOMPLETE}")
        _, version, length = HEAD.unpack_from(head)
        json_length, kind = CHUNK.unpack_from(head, HEAD.size)
        if version != 2 or kind != b"JSON" or json_length > MAX_JSON or length > size:
            raise FormatError(
                f"is no glTF of version 2, or incomplete: {size:,} of {length:,} bytes{INCOMPLETE}"
            )
        try:
            contents = json.loads(file.read(json_length))
        except (ValueError, RecursionError):
            contents = None
        if not isinstance(contents, dict):
            raise FormatError(f"has no JSON that can be read{INCOMPLETE}")
        chunk = file.read(CHUNK.size)
        if len(chunk) < CHUNK.size or CHUNK.unpack(chunk)[1] != b"BIN\0":
            raise FormatError("keeps its values in another file, which is not read; export it as one .glb")
        return cls(contents, file.read(min(CHUNK.unpack(chunk)[0], size)))

    def items(self, name: str) -> list:
        """A list of the JSON, empty if it is not there."""
        found = self.contents.get(name, [])
        if not isinstance(found, list):
            raise FormatError(f"has {name} that are no list{INCOMPLETE}")
        return found

    @staticmethod
    def of(found: list, number: Any) -> dict:
        """The object of a list with this number."""
        if not is_whole(number, len(found) - 1) or not isinstance(found[number], dict):
            raise FormatError(f"names an object that it does not have{INCOMPLETE}")
        return found[number]

    def view(self, number: Any) -> bytes:
        """The bytes of a buffer view."""
        view = self.of(self.items("bufferViews"), number)
        start, length = view.get("byteOffset", 0), view.get("byteLength")
        whole = is_whole(start, len(self.data)) and is_whole(length, len(self.data))
        if not whole or start + length > len(self.data) or view.get("buffer", 0) != 0:
            raise FormatError(f"is incomplete: a packed splat lies beyond its end{INCOMPLETE}")
        return self.data[start : start + length]

    def count(self, number: Any) -> int:
        """Number of elements of an accessor."""
        count = self.of(self.items("accessors"), number).get("count")
        if not is_whole(count, len(self.data)):
            raise FormatError(f"names more elements than it holds{INCOMPLETE}")
        return count

    def values(self, number: Any, width: int, count: int | None = None) -> np.ndarray:
        """The elements of an accessor, (count, width) float32; normalised whole numbers as shares."""
        accessor = self.of(self.items("accessors"), number)
        found, kind = self.count(number), KINDS.get(str(accessor.get("componentType")))
        if (
            kind is None
            or WIDTHS.get(str(accessor.get("type"))) != width
            or (count is not None and found != count)
            or "sparse" in accessor
        ):
            raise FormatError(f"has an attribute of another kind or length than its splat needs{INCOMPLETE}")
        view = self.of(self.items("bufferViews"), accessor.get("bufferView"))
        element = width * np.dtype(kind).itemsize
        stride = view.get("byteStride", element)
        start = [one.get("byteOffset", 0) for one in (view, accessor)]
        whole = all(is_whole(one, len(self.data)) for one in (*start, stride))
        if (
            not whole
            or stride < element
            or sum(start) + stride * max(found - 1, 0) + element * bool(found) > len(self.data)
            or view.get("buffer", 0) != 0
        ):
            raise FormatError(f"is incomplete: an attribute lies beyond its end{INCOMPLETE}")
        rows: np.ndarray = np.ndarray(
            (found, width), kind, self.data, sum(start), (stride, np.dtype(kind).itemsize)
        )
        if not accessor.get("normalized") or kind == "<f4":
            return rows.astype(np.float32)
        return np.maximum(rows.astype(np.float32) / np.iinfo(kind).max, -1)


def glb_of(contents: dict[str, Any], lengths: list[int], arrays: bool = True) -> bytes:
    """The file up to its bytes, to which zeros are added until their length is a multiple of 4. contents:
    JSON without buffers; lengths: of what follows, a buffer view for each; of arrays, multiples of 4; or
    arrays=False. Raises SceneError for more than 4 GiB."""
    starts = np.cumsum([0, *lengths])
    kind = {"target": ARRAY_BUFFER} if arrays else {}
    views = [
        {"buffer": 0, "byteOffset": int(start), "byteLength": length} | kind
        for start, length in zip(starts, lengths, strict=False)
    ]
    text = json.dumps(
        contents | {"buffers": [{"byteLength": int(starts[-1])}], "bufferViews": views}, separators=(",", ":")
    ).encode()
    text += b" " * (-len(text) % 4)
    padded = int(starts[-1]) + int(-starts[-1]) % 4
    total = HEAD.size + 2 * CHUNK.size + len(text) + padded
    if total >= 2**32:
        raise SceneError(
            f"a GLB has at most 4 GiB, and this one would have {total / 2**30:.1f}: write another format"
        )
    return b"".join(
        [HEAD.pack(b"glTF", 2, total), CHUNK.pack(len(text), b"JSON"), text, CHUNK.pack(padded, b"BIN\0")]
    )
