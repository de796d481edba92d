"""A model of Windows for tests on another system: open files and who may share them, memory, job objects.

It follows Microsoft's documentation of each function, and fills structures byte by byte at the documented
places. On Windows itself the fixture `windows` changes nothing, so that the same tests show whether the model
is right.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import itertools
import os
import struct
from collections.abc import Iterator
from pathlib import Path

READ, WRITE, DELETE = 1, 2, 4  # of the share mode
ACCESS = {0x80000000: READ, 0x40000000: WRITE, 0x00010000: DELETE}
NEW, EXISTING, ALWAYS = 1, 3, 4
ON_CLOSE = 0x04000000
NOT_FOUND, DENIED, SHARING, EXISTS = 2, 5, 32, 80
ERRNO = {NOT_FOUND: errno.ENOENT, DENIED: errno.EACCES, SHARING: errno.EACCES, EXISTS: errno.EEXIST}
INVALID = 2**64 - 1


class FakeWindows:
    """kernel32, and the errors and descriptors of its calls. memory, limits: what the next calls report, in
    bytes."""

    def __init__(self):
        self.opened: dict[int, list] = {}  # handle: path, what it does, what others may do
        self.numbers = itertools.count(600)  # of handles and descriptors, none is used twice
        self.error = 0
        self.memory = {"available": 0, "available_page_file": 0, "private": 0, "peak": 0}
        # flags, of the process, of the job; None: the process is in no job
        self.limits: tuple[int, int, int] | None = None
        self.console = 1
        self.jobs: dict[int, dict] = {}
        self.system_replace, self.system_read_bytes = os.replace, Path.read_bytes

    # --- files

    def failure(self, path=None) -> OSError:
        error = OSError(ERRNO[self.error], "another program has it", path)
        error.winerror = self.error  # type: ignore[attr-defined]
        return error

    def descriptor(self, handle: int) -> int:
        return handle

    def users(self, path) -> list[list]:
        """Handles on the file that are not closed."""
        for handle in list(self.opened):
            try:
                os.fstat(handle)
            except OSError:
                del self.opened[handle]
        return [user for user in self.opened.values() if user[0] == os.path.realpath(path)]

    def CreateFileW(self, path, access, share, _security, disposition, flags, _template):
        does = sum(bit for right, bit in ACCESS.items() if access & right)
        there = os.path.exists(path) or bool(self.users(path))
        wrong = {NEW: EXISTS if there else 0, EXISTING: 0 if there else NOT_FOUND, ALWAYS: 0}[disposition]
        if not wrong and any(does & ~others or used & ~share for _, used, others in self.users(path)):
            wrong = SHARING
        if wrong:
            self.error = wrong
            return INVALID
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT)
        handle = fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, next(self.numbers))
        os.close(descriptor)
        self.opened[handle] = [os.path.realpath(path), does, share]
        if flags & ON_CLOSE:
            os.unlink(path)  # at once: meanwhile nobody can open it
        return handle

    def replace(self, source, target):
        """os.replace: refused while the target is open, or the source so that others may not rename it."""
        if self.users(target) or any(not others & DELETE for _, _, others in self.users(source)):
            self.error = DENIED
            raise self.failure(target)
        moved = self.users(source)
        self.system_replace(source, target)
        for user in moved:
            user[0] = os.path.realpath(target)

    def read_bytes(self, path) -> bytes:
        """Path.read_bytes: refused while a file is open for which others may not read."""
        if any(not others & READ for _, _, others in self.users(path)):
            self.error = SHARING
            raise self.failure(path)
        return self.system_read_bytes(path)

    @contextlib.contextmanager
    def viewer(self, path) -> Iterator[None]:
        """A program that has the file open for reading, as most do: others may read and write it, and not
        delete it."""
        handle = self.CreateFileW(path, 0x80000000, READ | WRITE, None, EXISTING, 0, None)
        assert handle != INVALID
        try:
            yield
        finally:
            os.close(handle)

    # --- memory, at the places that the headers of Windows give

    def GlobalMemoryStatusEx(self, status):
        assert struct.unpack_from("<I", status._obj)[0] == 64, "dwLength"
        struct.pack_into("<Q", status._obj, 16, self.memory["available"])
        struct.pack_into("<Q", status._obj, 32, self.memory["available_page_file"])
        return 1

    def GetCurrentProcess(self):
        return INVALID

    def K32GetProcessMemoryInfo(self, _process, memory, size):
        assert size == struct.unpack_from("<I", memory._obj)[0] == 80
        struct.pack_into("<Q", memory._obj, 8, self.memory["peak"])
        struct.pack_into("<Q", memory._obj, 72, self.memory["private"])
        return 1

    def QueryInformationJobObject(self, job, kind, limits, size, _length):
        assert (job, kind, size) == (None, 9, 144)
        if self.limits is None:
            return 0
        flags, process, whole = self.limits
        struct.pack_into("<I", limits._obj, 16, flags)
        struct.pack_into("<QQ", limits._obj, 112, process, whole)
        return 1

    # --- processes

    def GetConsoleWindow(self):
        return self.console

    def CreateJobObjectW(self, _security, _name):
        job = next(self.numbers)
        self.jobs[job] = {"processes": [], "flags": 0, "ended": False}
        return job

    def SetInformationJobObject(self, job, kind, limits, size):
        assert (kind, size) == (9, 144)
        self.jobs[job]["flags"] = struct.unpack_from("<I", ctypes.string_at(limits, size), 16)[0]
        return 1

    def AssignProcessToJobObject(self, job, process):
        self.jobs[job]["processes"].append(process)
        return 1

    def TerminateJobObject(self, job, _status):
        self.jobs[job]["ended"] = True
        return 1

    def CloseHandle(self, handle):
        job = self.jobs.pop(handle)
        job["ended"] |= bool(job["flags"] & 0x2000)
        return 1
