"""Files that belong to a process until it ends, however it ends. Another process sees that, and removes those
whose owner was killed.

POSIX: the owner has locked the file (flock). On file systems without locks, nobody owns a file. Windows: the
owner has the file open. Opening it for oneself alone then fails. No program there can remove a file between
its creation and a lock, and a killed process leaves no lock behind.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from . import here, windows

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

# a virus scanner, or another process that looks for abandoned files, holds a file for a moment only
PATIENCE_S, PAUSE_S = 0.5, 0.05


def create_owned(path: Path) -> BinaryIO:
    """Creates a new empty file that this process owns until the returned file is closed. Meanwhile it can be
    opened, written and renamed. Raises FileExistsError if there is one, OSError if it cannot be created."""
    if here.WINDOWS:
        access = windows.GENERIC_READ | windows.GENERIC_WRITE
        return open(windows.create_file(path, access, windows.SHARE_ALL, windows.CREATE_NEW), "wb")
    while True:
        file = open(path, "xb")  # noqa: SIM115 (owned until it is closed)
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(file, fcntl.LOCK_EX)
        # not 0, so remove_abandoned() of another process did not remove it before it was locked
        if os.fstat(file.fileno()).st_nlink:
            return file
        file.close()


def remove_abandoned(path: Path) -> None:
    """Removes the file unless a process owns it. Raises OSError if it was not removed."""
    if here.WINDOWS:
        how = windows.OPEN_EXISTING, windows.DELETE_ON_CLOSE
        os.close(windows.create_file(path, windows.DELETE, windows.SHARE_NOTHING, *how))
        return
    with open(path, "r+b") as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        path.unlink()


@contextlib.contextmanager
def exclusive(path: Path) -> Iterator[bool]:
    """Context manager: owns the file, which is created if it is missing and removed at the end. Yields False
    if another process, or thread, owns it. Raises OSError if it cannot be created."""
    file = _open_alone(path) if here.WINDOWS else _lock(path)
    if file is None:
        yield False
        return
    with file:
        try:
            yield True
        finally:
            if not here.WINDOWS:  # there the system removes it
                path.unlink(missing_ok=True)


def _lock(path: Path) -> BinaryIO | None:
    """The file, locked; None if another one has locked it."""
    while True:
        file = open(path, "ab")  # noqa: SIM115 (owned until it is closed)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            return None
        except OSError:  # a file system without locks
            pass
        if os.fstat(file.fileno()).st_nlink:  # not 0, so its owner did not remove it between open and flock
            return file
        file.close()


def _open_alone(path: Path) -> BinaryIO | None:
    """The file, open for this process alone; None if another one has it open for longer than PATIENCE_S."""
    end = time.monotonic() + PATIENCE_S
    while True:
        try:
            descriptor = windows.create_file(
                path,
                windows.GENERIC_WRITE | windows.DELETE,
                windows.SHARE_NOTHING,
                windows.OPEN_ALWAYS,
                windows.DELETE_ON_CLOSE,
            )
            return open(descriptor, "wb")
        except PermissionError as error:
            if time.monotonic() > end:
                if getattr(error, "winerror", 0) == windows.SHARING_VIOLATION:
                    return None
                raise
        time.sleep(PAUSE_S)
