"""The description of a splat format for the registry."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ..scene import Scene


@dataclass(frozen=True)
class SplatFormat:
    """One splat format.

    read and read_parts raise FormatError, write raises SceneError, each with one sentence that names the file.
    """

    name: str  # shown by `svrgs info`
    label: str  # shown in menus
    suffixes: tuple[str, ...]  # lower case, with the dot
    sniff: Callable[[bytes], bool]  # whether a file that begins with these bytes may be of this format
    read: Callable[[Path], Scene]  # the scene with values as stored, not repaired
    read_parts: Callable[[Path], Iterator[Scene]]  # the same in parts of a few thousand Gaussians; each part overwrites the arrays of the previous one
    write: Callable[[Path, Scene], None] | None = None  # atomic; None: the format is read only
    size: Callable[[Scene], int] | None = None  # size in bytes of the file that write would make
