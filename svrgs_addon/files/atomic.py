"""Atomic file writes: at any moment, a path holds its old file or the complete new one, never a part of it.

A writer fills a hidden temporary file in the same folder, owns it (system/locks.py), and renames it at the
end. A hidden file that nobody owns was left by a writer that was killed.
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import json
import os
import secrets
import shutil
import stat
import zipfile
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ..system import file_names, here, locks, replacing
from ..system.errors import SceneError, SplatError, system_errors
from ..system.memory import size_text

FREE_SPACE_MARGIN = 1.1  # free disk space needed per byte of a file
HIDDEN_PREFIX = ".svrgs-"  # first characters of the names of temporary files
# characters: a longer one is left out of the names of temporary files, whose length is limited
LONGEST_SUFFIX = 16
# set by checked(): a path, and the function that checks a new file before it replaces that path
_check: ContextVar[tuple[Path, Callable[[Path], None]] | None] = ContextVar("check", default=None)


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike, keep: bool = True) -> Iterator[BinaryIO]:
    """Context manager that yields a binary file. Its content replaces `path` when the block ends without an
    error.

    Missing parent folders are created. After an error in the block, the old file is unchanged. Raises
    SceneError if the file cannot be written. If another program has the old file open, so that Windows does
    not replace it, the new file is kept under another name, which the error says. keep=False: it is not kept,
    because it will soon be written again.
    """
    with atomic_path(path, keep) as temporary, open(temporary, "r+b") as file:
        yield file


def write_bytes(path: str | os.PathLike, data: bytes | memoryview, keep: bool = True) -> None:
    """Writes a file whose bytes are all there. keep, errors: as of atomic_write()."""
    with atomic_write(path, keep) as file:
        file.write(data)


def write_json(path: str | os.PathLike, value: Any, *, indented: bool = False, keep: bool = True) -> None:
    """Writes a value as JSON. indented: in lines, for people. keep, errors: as of atomic_write()."""
    text = json.dumps(value, indent=1) + "\n" if indented else json.dumps(value)
    write_bytes(path, text.encode(), keep)


def write_array(path: str | os.PathLike, array: np.ndarray, keep: bool = True) -> None:
    """Writes an array as .npy. keep, errors: as of atomic_write()."""
    with atomic_write(path, keep) as file:
        np.save(file, array)


def write_arrays(path: str | os.PathLike, arrays: dict[str, np.ndarray]) -> None:
    """Writes arrays by name as .npz. Errors: as of atomic_write().

    The archive is always closed here. After an error, np.savez leaves that to the garbage collector, which
    prints a stack trace.
    """
    with atomic_write(path) as file, zipfile.ZipFile(file, "w") as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asanyarray(array), allow_pickle=False)


def start_writeback(file: BinaryIO, size: int) -> None:
    """Asks the system to store the last `size` bytes of the file now, so that the final fsync takes less
    time. With POSIX_FADV_DONTNEED, Linux starts to write dirty pages; it drops only clean ones."""
    if hasattr(os, "posix_fadvise"):
        with contextlib.suppress(OSError):
            os.posix_fadvise(file.fileno(), file.tell() - size, size, os.POSIX_FADV_DONTNEED)


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike, keep: bool = True) -> Iterator[Path]:
    """As atomic_write, for libraries: yields the path of an empty file with the same suffix."""
    target = file_names.real(path)  # if path is a symbolic link, its target is replaced
    _check_target(path, target)
    with _errors_of(path):
        target.parent.mkdir(parents=True, exist_ok=True)
        with _hidden_file_next_to(target) as temporary:
            yield temporary
            with contextlib.suppress(OSError):  # there is no old file, or the file system has no modes
                os.chmod(temporary, stat.S_IMODE(target.stat().st_mode))
            _sync(temporary, os.O_RDWR)
            if (asked := _check.get()) and asked[0] == target:
                _check_new(asked[1], temporary, target)
            _replace(temporary, target, path if keep else None)
    if not here.WINDOWS:  # makes the rename durable
        with contextlib.suppress(OSError):  # some file systems cannot do this
            _sync(target.parent, os.O_RDONLY)


@contextlib.contextmanager
def checked(path: str | os.PathLike, check: Callable[[Path], None]) -> Iterator[None]:
    """Context manager: a new file of its block replaces `path` only after check() of the temporary file. If
    that raises a SplatError, the old file is unchanged, the new one is kept under another name, and a
    SceneError says so."""
    token = _check.set((file_names.real(path), check))
    try:
        yield
    finally:
        _check.reset(token)


def _errors_of(path: str | os.PathLike) -> contextlib.AbstractContextManager[None]:
    return system_errors(SceneError, f"{path}: cannot be written")


@contextlib.contextmanager
def reserved(path: str | os.PathLike) -> Iterator[None]:
    """Context manager: while its block runs, no other one of the same path can begin, in this process or
    another.

    It owns a hidden file next to `path`. Missing folders are created, and removed again if they are still
    empty. Does nothing on file systems without locks. Raises SceneError if the path is reserved.
    """
    target = file_names.real(path)
    digest = hashlib.sha256(os.fsencode(target.name)).hexdigest()
    lock = target.with_name(f"{HIDDEN_PREFIX}{digest[:16]}.lock")
    new_folders = list(itertools.takewhile(lambda folder: not folder.exists(), target.parents))
    try:
        with _errors_of(path):
            target.parent.mkdir(parents=True, exist_ok=True)
        with contextlib.ExitStack() as stack:
            with _errors_of(path):
                free = stack.enter_context(locks.exclusive(lock))
            if not free:
                raise SceneError(
                    f"{path}: another job is writing this file; wait until it has ended, or choose another"
                    " output"
                )
            yield
    finally:
        for folder in new_folders:
            with contextlib.suppress(OSError):
                folder.rmdir()


def check_writable(path: str | os.PathLike) -> None:
    """Raises SceneError if no file can be written at `path`, or if the file there cannot be replaced. Call it
    before long work starts.

    It creates no file and no folder. If the folder of `path` does not exist yet, the nearest existing parent
    is checked. Temporary files that killed writers left in that folder are removed.
    """
    check_space(path, 0)
    if not replacing.may_be_replaced(file_names.real(path)):
        raise SceneError(
            f"{path}: is open in another program and cannot be replaced; close it there, or choose another"
            " output"
        )


def check_space(path: str | os.PathLike, needed_bytes: int) -> None:
    """Raises SceneError if a file of needed_bytes bytes cannot be written into the folder of `path`. As
    check_writable(), but a file that another program has open is no reason: what was worked for is then
    written under another name."""
    if forbidden := file_names.what_is_forbidden(path):
        raise SceneError(f"{path}: cannot be written because {forbidden}; choose another name")
    target = file_names.real(path)
    _check_target(path, target)
    folder = next((parent for parent in target.parents if os.path.lexists(parent)), None)
    if folder is None:  # on Windows
        raise SceneError(
            f"{path}: cannot be written because there is no drive {target.drive}; choose another folder"
        )
    if not os.path.isdir(folder):
        raise SceneError(f"{path}: cannot be written because {folder} is not a folder")
    with system_errors(SceneError, f"{path}: cannot be written into {folder}"):
        with _hidden_file_next_to(folder / target.name):
            remove_abandoned(folder)
        free = shutil.disk_usage(folder).free
    if free < (needed := needed_bytes * FREE_SPACE_MARGIN):
        raise SceneError(
            f"{path}: needs {size_text(needed)}, but only {size_text(free)} are free; free disk space or"
            " choose another folder"
        )


def _check_target(path: str | os.PathLike, target: Path) -> None:
    """Raises SceneError for a folder, a device, a pipe, a write-protected file, a forbidden name."""
    if os.path.isdir(target):
        raise SceneError(f"{path}: is a folder; give the name of a file")
    with _errors_of(path):
        try:
            mode = target.stat().st_mode
        except (FileNotFoundError, NotADirectoryError):
            return
    if not stat.S_ISREG(mode):
        raise SceneError(f"{path}: is a device or a pipe; give the name of a file")
    if not os.access(target, os.W_OK):
        raise SceneError(f"{path}: is write-protected; choose another file or allow writing to it")


@contextlib.contextmanager
def _hidden_file_next_to(target: Path) -> Iterator[Path]:
    """Yields a new empty hidden file that this process owns, removed at the end if it was not renamed. It is
    in the folder of the target, because os.replace is atomic only within one file system."""
    suffix = target.suffix if len(target.suffix) <= LONGEST_SUFFIX else ""
    temporary = file_names.extended(target.with_name(f"{HIDDEN_PREFIX}{secrets.token_hex(8)}{suffix}"))
    owned = locks.create_owned(temporary)
    try:
        yield temporary
    finally:
        owned.close()
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def remove_abandoned(folder: Path) -> None:
    """Removes the temporary files that killed writers left in the folder."""
    for path in folder.glob(f"{HIDDEN_PREFIX}*"):
        with contextlib.suppress(OSError):
            locks.remove_abandoned(path)


def _sync(path: Path, flags: int) -> None:
    """fsync of a file or folder. Without it, a power failure could leave an empty file at the final path."""
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _check_new(check: Callable[[Path], None], temporary: Path, target: Path) -> None:
    try:
        check(temporary)
    except SplatError as error:
        kept = _set_aside(temporary, target)
        raise SceneError(f"{error}; the new file is kept as '{kept}'") from None


def _replace(temporary: Path, target: Path, path: str | os.PathLike | None) -> None:
    """Renames the temporary file. If Windows does not replace the old file, the new one gets another name,
    and SceneError says which. path: how the message names the target; None: the new file is not kept, and the
    OSError is raised."""
    try:
        replacing.replace(temporary, target)
    except PermissionError:
        if path is None or not here.WINDOWS or not os.path.lexists(target):
            raise
        kept = _set_aside(temporary, target)
        raise SceneError(
            f"{path}: was not replaced, probably because another program has it open; the new file is"
            f" complete and lies next to it as '{kept}'"
        ) from None


def _set_aside(temporary: Path, target: Path) -> str:
    """Gives the new file a free name next to the old one, such as 'scene (new).ply', and returns it."""
    names = (
        f"{target.stem} (new{'' if number == 1 else f' {number}'}){target.suffix}"
        for number in itertools.count(1)
    )
    kept = next(path for path in map(target.with_name, names) if not os.path.lexists(path))
    os.replace(temporary, kept)
    return kept.name
