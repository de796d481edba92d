"""Atomic file writes: whatever happens, a path holds its old file or the complete new one, never a part."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from .errors import SceneError

FREE_SPACE_MARGIN = 1.1
REPLACE_ATTEMPTS = 20
REPLACE_PAUSE_S = 0.05


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
    temporary = None
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary = _create_beside(target)
        yield temporary
        _sync(temporary, os.O_RDWR)
        _replace(temporary, target)
    except OSError as error:
        raise SceneError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
    _sync_folder(target.parent)


def check_writable(path: str | os.PathLike, needed_bytes: int = 0) -> None:
    """Raise SceneError if a file of needed_bytes cannot be written at `path`; leaves nothing behind.

    Called before work starts. Folders that do not exist yet are judged by the nearest one that does.
    """
    target = Path(os.path.realpath(path))
    _check_target(path, target)
    folder = next(parent for parent in target.parents if os.path.lexists(parent))
    if not os.path.isdir(folder):
        raise SceneError(f"{path}: cannot be written because {folder} is not a folder")
    try:
        _create_beside(folder / target.name).unlink()
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


def _create_beside(target: Path) -> Path:
    """A new empty hidden file in the target's folder: os.replace is atomic only within one file system."""
    temporary = target.with_name(f".svrgs-{secrets.token_hex(8)}{target.suffix}")
    os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    return temporary


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
