"""The description of a splat format for the registry."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from ..scene.concatenate import concatenated
from ..scene.gaussians import Scene
from ..system.errors import SceneError

PART = 2**16  # Gaussians that are converted together


@dataclass(frozen=True)
class SplatFormat:
    """One splat format.

    read and read_parts raise FormatError, write raises SceneError, each with one sentence that names the
    file.
    """

    name: str  # shown by `svrgs info`
    label: str  # shown in menus
    suffixes: tuple[str, ...]  # lower case, with the dot; the first one is written
    # of path and the most Gaussians; values as stored, not repaired, in parts of some thousand, at least one
    read_parts: Callable[..., Iterator[Scene]]
    # whether a file that begins with these bytes may be of this format
    sniff: Callable[[bytes], bool] = lambda head: True
    # the same as one scene, if each part overwrites the arrays of the previous one
    read: Callable[[Path], Scene] | None = None
    # of path, scene and, by name, what there is of version, quantise and seen; atomic. None: read only
    write: Callable[..., None] | None = None
    versions: tuple[int, ...] = ()  # that are written, if there are several
    # whether write takes quantise, a factor on the error that it may make in SH, 1 is the usual one; and from
    # where the scene is seen (sh_rounding.py)
    quantises: bool = False
    # size in bytes of the file that write would make; None: it depends on the values
    size: Callable[[Scene], int] | None = None
    # a sentence on each limit of the format that the scene is beyond
    limits: Callable[[Scene], list[str]] | None = None
    most_degree: int = 3  # of SH that it can hold
    lossless: bool = False  # whether all values are stored as they are
    index: str = ""  # name of the file that stands for a splat of several files, in a folder
    parts: Callable[[Path], list[Path]] | None = None  # all files of such a splat, by its index
    # what it can hold besides: attributes, antialiased, order (of the Gaussians)
    carries: tuple[str, ...] = ()

    # whether the packages that writing needs are there: a reason why not, or ""; may also raise SceneError
    needs: Callable[[], str] = lambda: ""

    def check_packages(self, path: Path):
        """Raises SceneError if a package is missing without which the file `path` cannot be written."""
        if missing := self.needs():
            raise SceneError(f"{path}: cannot be written, {missing}")

    def whole(self, path: Path) -> Scene:
        """The scene with values as stored, not repaired. Raises FormatError."""
        return self.read(path) if self.read else concatenated(list(self.read_parts(path)), columns=True)


def by_parts(work: Callable[[slice], Scene], count: int) -> Iterator[Scene]:
    """work(rows) of each PART of `count` Gaussians in order, at least one, by all cores, a few ahead."""
    ahead = os.cpu_count() or 1
    parts = [slice(start, start + PART) for start in range(0, max(count, 1), PART)]
    with ThreadPoolExecutor(ahead) as threads:
        for first in range(0, len(parts), ahead):
            yield from threads.map(work, parts[first : first + ahead])
