"""What the registry knows of a splat format."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ..scene import Scene


@dataclass(frozen=True)
class SplatFormat:
    """One format; read and read_parts raise FormatError, write raises SceneError, each with one sentence that names the file."""

    name: str  # in `svrgs info`
    label: str  # in menus
    suffixes: tuple[str, ...]  # lower case, with the dot
    sniff: Callable[[bytes], bool]  # whether a file that begins with these bytes may be of this format
    read: Callable[[Path], Scene]  # the scene as stored, not repaired
    read_parts: Callable[[Path], Iterator[Scene]]  # the same, a few thousand Gaussians at a time; each part overwrites the last
    write: Callable[[Path, Scene], None] | None = None  # atomic; None: the format is read only
    size: Callable[[Scene], int] | None = None  # bytes of the file that write would make
