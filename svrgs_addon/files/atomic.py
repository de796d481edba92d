"""Atomic file writes: whatever happens, a path holds its old file or the complete new one, never a part.

A writer works on a hidden file beside the path and holds a lock on it; one without a lock was left by a writer that was killed.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from ..errors import SceneError

try:
    import fcntl
except ImportError:  # Windows, which renames no open file: there what a killed writer left stays
    fcntl = None  # type: ignore[assignment]

HAS_LOCKS = os.name == "posix"
FREE_SPACE_MARGIN = 1.1
REPLACE_ATTEMPTS = 20
REPLACE_PAUSE_S = 0.05
HIDDEN = ".svrgs-"  # how names of unfinished files begin


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike) -> Iterator[BinaryIO]:
    """A binary file object whose content replaces `path` when the block ends without an error.

    Missing parent folders are created. Raises SceneError if the file cannot be written; any error in the
    block leaves the old file as it was.
    """
    with atomic_path(path) as temporary, open(temporary, "r+b") as file:
        yield file


def start_storing(file: BinaryIO, size: int) -> None:
    """Have the system store the last `size` bytes already while the next ones are made: the final fsync waits less.

    Linux begins to write dirty pages when told that they are not needed, and drops only clean ones.
    """
    if hasattr(os, "posix_fadvise"):
        with contextlib.suppress(OSError):
            os.posix_fadvise(file.fileno(), file.tell() - size, size, os.POSIX_FADV_DONTNEED)


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike) -> Iterator[Path]:
    """As atomic_write, for libraries that write by file name: yields a temporary name with the same suffix."""
    target = Path(os.path.realpath(path))  # a link keeps pointing at the new file
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with _hidden_beside(target) as temporary:
            yield temporary
            _sync(temporary, os.O_RDWR)
            _replace(temporary, target)
    except OSError as error:
        raise SceneError(f"{path}: cannot be written ({error.strerror or error})") from error
    _sync_folder(target.parent)


def check_writable(path: str | os.PathLike, needed_bytes: int = 0) -> None:
    """Raise SceneError if a file of needed_bytes cannot be written at `path`; leaves nothing behind, and removes from its folder
    what killed writers left there.

    Called before work starts. Folders that do not exist yet are judged by the nearest one that does.
    """
    target = Path(os.path.realpath(path))
    _check_target(path, target)
    folder = next(parent for parent in target.parents if os.path.lexists(parent))
    if not os.path.isdir(folder):
        raise SceneError(f"{path}: cannot be written because {folder} is not a folder")
    try:
        with _hidden_beside(folder / target.name):
            _remove_abandoned(folder)
        free = shutil.disk_usage(folder).free
    except OSError as error:
        raise SceneError(f"{path}: cannot be written into {folder} ({error.strerror or error})") from error
    if free < needed_bytes * FREE_SPACE_MARGIN:
        raise SceneError(f"{path}: needs {needed_bytes / 1e6:.1f} MB, but only {free / 1e6:.1f} MB are free")


def _check_target(path: str | os.PathLike, target: Path) -> None:
    """Refuse a folder, a write-protected file, and a name the file system cannot hold."""
    if os.path.isdir(target):
        raise SceneError(f"{path}: is a folder, not a file")
    try:
        target.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return
    except OSError as error:
        raise SceneError(f"{path}: cannot be written ({error.strerror or error})") from error
    if not os.access(target, os.W_OK):
        raise SceneError(f"{path}: is write-protected")


@contextlib.contextmanager
def _hidden_beside(target: Path) -> Iterator[Path]:
    """A new empty hidden file in the target's folder, locked, and removed in the end if it was not renamed: os.replace is atomic only
    within one file system."""
    temporary, file = _create_locked(target)
    try:
        yield temporary
    finally:
        file.close()
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _create_locked(target: Path) -> tuple[Path, BinaryIO]:
    while True:
        path = target.with_name(f"{HIDDEN}{secrets.token_hex(8)}{target.suffix}")
        file = open(path, "xb")  # noqa: SIM115 (the lock lives as long as it)
        if not HAS_LOCKS:
            file.close()
            return path, file
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(file, fcntl.LOCK_EX)
        if os.fstat(file.fileno()).st_nlink:  # or else it was taken for abandoned before it was locked
            return path, file
        file.close()


def _remove_abandoned(folder: Path) -> None:
    """Removes the hidden files that no writer holds any more, where the system can tell."""
    for path in folder.glob(f"{HIDDEN}*") if HAS_LOCKS else ():
        with contextlib.suppress(OSError), open(path, "r+b") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.unlink()


def _sync(path: Path, flags: int) -> None:
    """Push a file or folder to the disk: without it a power cut can leave an empty file under the final name."""
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _sync_folder(folder: Path) -> None:
    """Make the rename itself durable. The new file is in place already, so a file system without it is tolerated."""
    if os.name == "posix":
        with contextlib.suppress(OSError):
            _sync(folder, os.O_RDONLY)


def _replace(temporary: Path, target: Path) -> None:
    """os.replace; on Windows a virus scanner or viewer may hold the old file for a moment, so try again."""
    for _ in range(REPLACE_ATTEMPTS if os.name == "nt" else 0):
        try:
            os.replace(temporary, target)
            return
        except PermissionError:
            time.sleep(REPLACE_PAUSE_S)
    os.replace(temporary, target)
