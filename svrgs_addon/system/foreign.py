"""Folders that another program wrote, or that came from the web: jobs, farm jobs, splats of several files,
photographs. What they name and where their links lead is not trusted.

Only regular files are opened. What is read lies in the folder; of photographs alone, links are followed. What
is written, replaced or deleted is reached through no link.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import BinaryIO

from .errors import FormatError
from .file_names import is_link, real

# a pipe is not waited for
_FLAGS = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)


def open_regular(path: str | os.PathLike) -> BinaryIO:
    """Opens a regular file to read it. Raises OSError, also for a pipe, a device or a folder."""
    descriptor = os.open(path, _FLAGS)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "it is a pipe, a device or a folder", os.fspath(path))
    return os.fdopen(descriptor, "rb")


def check_name(name: str, kind: str = "file") -> None:
    """Raises FormatError if a name cannot be a file's, or leads out of its folder. kind: of the file."""
    try:
        possible = b"\0" not in os.fsencode(name)
    except UnicodeEncodeError:  # half of a pair of surrogates
        possible = False
    if not possible:
        raise FormatError(f"{kind} name {name!r} cannot be the name of a file")
    for path in (PurePosixPath(name), PureWindowsPath(name)):
        if not path.name or path.anchor or ".." in path.parts:
            raise FormatError(f"{kind} name {name!r} does not stay inside its folder")


def inside(folder: Path, name: str) -> Path:
    """A path in the folder, to read it. Raises FormatError, without the folder, if it leads out of it."""
    check_name(name)
    path = folder / name
    if not real(path).is_relative_to(real(folder)):
        raise FormatError(
            f"has a link that leads out of the folder, {name}: put the file itself in place of the link"
        )
    return path


def own(folder: Path, *names: str) -> Path:
    """A path in the folder, to write, replace or delete it. Raises FormatError if a link is on the way."""
    path = folder
    for name in names:
        path /= name
        if os.path.lexists(path) and is_link(path):
            raise FormatError(f"{path}: is a link; the folder must hold its files itself: remove it")
    return path


def refuse_entry(entry: os.DirEntry) -> None:
    """Raises FormatError for a link, pipe or device: writing to it would change something elsewhere."""
    own(Path(entry.path).parent, entry.name)
    if not (entry.is_file(follow_symlinks=False) or entry.is_dir(follow_symlinks=False)):
        raise FormatError(f"{entry.path}: is a pipe or a device; remove it")
