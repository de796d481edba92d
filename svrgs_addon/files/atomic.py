"""Atomic file writes: at any moment, a path holds its old file or the complete new one, never a part of it.

A writer fills a hidden temporary file in the same folder, holds a lock on it, and renames it at the end. A hidden file without a
lock was left by a writer that was killed.
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import os
import secrets
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from ..errors import SceneError
from ..memory import size_text

try:
    import fcntl
except ImportError:  # Windows cannot rename open files, so there is no lock, and files of killed writers are not removed
    fcntl = None  # type: ignore[assignment]

HAS_LOCKS = os.name == "posix"
FREE_SPACE_MARGIN = 1.1  # free disk space needed per byte of a file
REPLACE_ATTEMPTS = 20
REPLACE_PAUSE_S = 0.05
HIDDEN_PREFIX = ".svrgs-"  # first characters of the names of temporary files


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike) -> Iterator[BinaryIO]:
    """Context manager that yields a binary file. Its content replaces `path` when the block ends without an error.

    Missing parent folders are created. After an error in the block, the old file is unchanged. Raises SceneError if the file
    cannot be written.
    """
    with atomic_path(path) as temporary, open(temporary, "r+b") as file:
        yield file


def start_writeback(file: BinaryIO, size: int) -> None:
    """Asks the system to store the last `size` bytes of the file now, so that the final fsync takes less time.

    With POSIX_FADV_DONTNEED, Linux starts to write dirty pages; it drops only clean ones.
    """
    if hasattr(os, "posix_fadvise"):
        with contextlib.suppress(OSError):
            os.posix_fadvise(file.fileno(), file.tell() - size, size, os.POSIX_FADV_DONTNEED)


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike) -> Iterator[Path]:
    """As atomic_write, for libraries that write by file name: yields the path of an empty temporary file with the same suffix."""
    target = Path(os.path.realpath(path))  # if path is a symbolic link, its target is replaced
    with _errors_of(path):
        target.parent.mkdir(parents=True, exist_ok=True)
        with _hidden_file_next_to(target) as temporary:
            yield temporary
            _sync(temporary, os.O_RDWR)
            _replace(temporary, target)
    _sync_folder(target.parent)


@contextlib.contextmanager
def _errors_of(path: str | os.PathLike) -> Iterator[None]:
    """Turns an OSError of its block into a SceneError that names `path`."""
    try:
        yield
    except OSError as error:
        raise SceneError(f"{path}: cannot be written ({error.strerror or error})") from error


@contextlib.contextmanager
def reserved(path: str | os.PathLike) -> Iterator[None]:
    """Context manager: while its block runs, no other one of the same path can begin, in this process or another.

    It locks a hidden file next to `path`. Missing folders are created, and removed again if they are still empty. Does nothing on
    systems without locks. Raises SceneError if the path is reserved.
    """
    target = Path(os.path.realpath(path))
    lock = target.with_name(f"{HIDDEN_PREFIX}{hashlib.sha256(os.fsencode(target.name)).hexdigest()[:16]}.lock")
    new_folders = list(itertools.takewhile(lambda folder: not folder.exists(), target.parents))
    try:
        with _errors_of(path):
            target.parent.mkdir(parents=True, exist_ok=True)
        with _locked(lock, path) if HAS_LOCKS else contextlib.nullcontext():
            yield
    finally:
        for folder in new_folders:
            with contextlib.suppress(OSError):
                folder.rmdir()


@contextlib.contextmanager
def _locked(lock: Path, path: str | os.PathLike) -> Iterator[None]:
    """Holds the lock on a file, which is removed at the end. Raises SceneError, which names `path`, if another process or thread holds it."""
    while True:
        with _errors_of(path):
            file = open(lock, "ab")  # noqa: SIM115 (closed below)
        with file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise SceneError(f"{path}: another job is writing this file; wait until it has ended, or choose another output") from None
            except OSError:  # a file system without locks
                pass
            if not os.fstat(file.fileno()).st_nlink:  # its holder removed it between open and flock
                continue
            try:
                yield
            finally:
                lock.unlink(missing_ok=True)
            return


def check_writable(path: str | os.PathLike, needed_bytes: int = 0) -> None:
    """Raises SceneError if a file of needed_bytes bytes cannot be written at `path`. Call it before long work starts.

    It creates no file and no folder. If the folder of `path` does not exist yet, the nearest existing parent is checked. Temporary
    files that killed writers left in that folder are removed.
    """
    target = Path(os.path.realpath(path))
    _check_target(path, target)
    folder = next(parent for parent in target.parents if os.path.lexists(parent))
    if not os.path.isdir(folder):
        raise SceneError(f"{path}: cannot be written because {folder} is not a folder")
    try:
        with _hidden_file_next_to(folder / target.name):
            _remove_abandoned(folder)
        free = shutil.disk_usage(folder).free
    except OSError as error:
        raise SceneError(f"{path}: cannot be written into {folder} ({error.strerror or error})") from error
    if free < (needed := needed_bytes * FREE_SPACE_MARGIN):
        raise SceneError(f"{path}: needs {size_text(needed)}, but only {size_text(free)} are free; free disk space or choose another folder")


def _check_target(path: str | os.PathLike, target: Path) -> None:
    """Raises SceneError for a folder, a write-protected file, and a name that the file system does not allow."""
    if os.path.isdir(target):
        raise SceneError(f"{path}: is a folder; give the name of a file")
    try:
        target.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return
    except OSError as error:
        raise SceneError(f"{path}: cannot be written ({error.strerror or error})") from error
    if not os.access(target, os.W_OK):
        raise SceneError(f"{path}: is write-protected; choose another file or allow writing to it")


@contextlib.contextmanager
def _hidden_file_next_to(target: Path) -> Iterator[Path]:
    """Yields a new empty hidden file that is locked; it is removed at the end if it was not renamed.

    It is in the folder of the target, because os.replace is atomic only within one file system.
    """
    temporary, file = _create_locked(target)
    try:
        yield temporary
    finally:
        file.close()
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _create_locked(target: Path) -> tuple[Path, BinaryIO]:
    """Creates a hidden file in the folder of the target. Returns its path and the open file that holds the lock."""
    while True:
        path = target.with_name(f"{HIDDEN_PREFIX}{secrets.token_hex(8)}{target.suffix}")
        file = open(path, "xb")  # noqa: SIM115 (the lock lasts until it is closed)
        if not HAS_LOCKS:
            file.close()
            return path, file
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(file, fcntl.LOCK_EX)
        if os.fstat(file.fileno()).st_nlink:  # not 0, so _remove_abandoned of another process did not delete it before it was locked
            return path, file
        file.close()


def _remove_abandoned(folder: Path) -> None:
    """Removes hidden files in the folder that no writer has locked. Does nothing on systems without locks."""
    for path in folder.glob(f"{HIDDEN_PREFIX}*") if HAS_LOCKS else ():
        with contextlib.suppress(OSError), open(path, "r+b") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.unlink()


def _sync(path: Path, flags: int) -> None:
    """fsync of a file or folder. Without it, a power failure could leave an empty file at the final path."""
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _sync_folder(folder: Path) -> None:
    """Makes the rename durable (POSIX). Errors are ignored, because the new file is complete and some file systems cannot do this."""
    if os.name == "posix":
        with contextlib.suppress(OSError):
            _sync(folder, os.O_RDONLY)


def _replace(temporary: Path, target: Path) -> None:
    """os.replace. On Windows it is repeated, because a virus scanner or viewer can keep the old file open for a moment."""
    for _ in range(REPLACE_ATTEMPTS if os.name == "nt" else 0):
        try:
            os.replace(temporary, target)
            return
        except PermissionError:
            time.sleep(REPLACE_PAUSE_S)
    os.replace(temporary, target)
