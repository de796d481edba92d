"""Free disk space: how much there is, and space that is held for files that are written later."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections import Counter
from pathlib import Path

from ..system.errors import SceneError, system_errors
from ..system.file_names import real
from ..system.memory import size_text

# the disk, the largest file, the quota of the user
FULL = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC))
CAN_HOLD = hasattr(os, "posix_fallocate")


class HeldSpace:
    """Bytes on the disk of a folder that no other program can use until release().

    They are in a file without a name, so that they are free again when this process ends, however it ends.
    Where files cannot be allocated in advance, nothing is held. Raises OSError if the disk has less space.
    """

    def __init__(self, folder: Path, size: int):
        self._file = tempfile.TemporaryFile(dir=folder) if CAN_HOLD and size else None  # noqa: SIM115 (until release)
        try:
            if self._file is not None:
                os.posix_fallocate(self._file.fileno(), 0, size)
        except OSError as error:
            self.release()
            if error.errno in FULL:
                raise

    def release(self):
        if self._file is not None:
            self._file.close()
            self._file = None


def refuse_shortage(path: str | os.PathLike, needed: dict[Path, int], purpose: str):
    """Raises SceneError, naming `path`, if a disk lacks the bytes needed in its folders for a purpose."""
    totals: Counter[int] = Counter()
    for folder, size in needed.items():
        place = existing_parent(folder)
        with system_errors(SceneError, f"{path}: cannot be written into {place}"):
            device, free = os.stat(place).st_dev, shutil.disk_usage(place).free
        totals[device] += size
        if free < totals[device]:
            raise SceneError(shortage(path, sum(needed.values()), purpose, place, free))


def shortage(path: str | os.PathLike, size: int, purpose: str, folder: Path, free: int) -> str:
    """The sentence that `folder` has too little space."""
    return (
        f"{path}: needs {size_text(size)} of disk space for {purpose}, but only {size_text(free)} are free in"
        f" {folder}; free disk space or choose another folder"
    )


def existing_parent(folder: Path) -> Path:
    """The folder, or the nearest one above that exists; itself if none does, as on a missing drive."""
    folder = real(folder)
    return next((place for place in (folder, *folder.parents) if place.is_dir()), folder)
