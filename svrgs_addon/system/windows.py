"""The functions of Windows that Python does not offer, through ctypes. Nothing here is called on another
system.

kernel32(), failure() and descriptor() are the only ways out; a test replaces them by a model of Windows.
"""

from __future__ import annotations

import ctypes
import functools
import os
import weakref
from collections.abc import Callable
from typing import Any

from .structs import fields

GENERIC_READ, GENERIC_WRITE, DELETE = 0x80000000, 0x40000000, 0x00010000
SHARE_NOTHING, SHARE_ALL = 0, 7  # what others may do with the file meanwhile: read, write, delete or rename
CREATE_NEW, OPEN_EXISTING, OPEN_ALWAYS = 1, 3, 4
SHARING_VIOLATION = 32  # OSError.winerror: the file is open in another program, or in this one
# the system removes the file when the handle is closed, also when the process is killed
DELETE_ON_CLOSE = 0x04000000
CREATE_NEW_PROCESS_GROUP, CREATE_NO_WINDOW = 0x00000200, 0x08000000
KILL_ON_JOB_CLOSE, LIMITS_PROCESS_MEMORY, LIMITS_JOB_MEMORY = 0x2000, 0x100, 0x200
_EXTENDED_LIMITS = 9  # JobObjectExtendedLimitInformation
_NO_HANDLE = 2**64 - 1


class MemoryStatus(ctypes.Structure):
    """MEMORYSTATUSEX, in bytes. page_file: what can still be committed, in memory or in the page file."""

    _fields_ = fields(
        (ctypes.c_uint32, "length load"),
        (ctypes.c_uint64, "total available total_page_file available_page_file"),
        (ctypes.c_uint64, "total_virtual available_virtual available_extended"),
    )


class ProcessMemory(ctypes.Structure):
    """PROCESS_MEMORY_COUNTERS_EX, in bytes. private: what the process has committed."""

    _fields_ = fields(
        (ctypes.c_uint32, "length faults"),
        (ctypes.c_size_t, "peak_working_set working_set"),
        (ctypes.c_size_t * 4, "pools"),
        (ctypes.c_size_t, "page_file peak_page_file private"),
    )


class JobLimits(ctypes.Structure):
    """JOBOBJECT_EXTENDED_LIMIT_INFORMATION."""

    _fields_ = fields(
        (ctypes.c_int64, "process_time job_time"),
        (ctypes.c_uint32, "flags"),
        (ctypes.c_size_t, "smallest_working_set largest_working_set"),
        (ctypes.c_uint32, "processes"),
        (ctypes.c_size_t, "affinity"),
        (ctypes.c_uint32, "priority scheduling"),
        (ctypes.c_uint64 * 6, "transfers"),
        (ctypes.c_size_t, "process_memory job_memory peak_process_memory peak_job_memory"),
    )


@functools.cache
def kernel32() -> Any:
    """The library kernel32. Results that are handles are declared: their default type would cut them."""
    module: Any = ctypes
    library = module.WinDLL("kernel32", use_last_error=True)
    handle, number, text, pointer = ctypes.c_void_p, ctypes.c_uint32, ctypes.c_wchar_p, ctypes.c_void_p
    for name, result, arguments in (
        ("CreateFileW", handle, (text, number, number, pointer, number, number, handle)),
        ("CloseHandle", ctypes.c_int, (handle,)),
        ("GetCurrentProcess", handle, ()),
        ("GetConsoleWindow", handle, ()),
        ("GlobalMemoryStatusEx", ctypes.c_int, (pointer,)),
        ("K32GetProcessMemoryInfo", ctypes.c_int, (handle, pointer, number)),
        ("CreateJobObjectW", handle, (pointer, text)),
        ("AssignProcessToJobObject", ctypes.c_int, (handle, handle)),
        ("SetInformationJobObject", ctypes.c_int, (handle, ctypes.c_int, pointer, number)),
        ("QueryInformationJobObject", ctypes.c_int, (handle, ctypes.c_int, pointer, number, pointer)),
        ("TerminateJobObject", ctypes.c_int, (handle, number)),
    ):
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


def failure(path: str | os.PathLike | None = None) -> OSError:
    """The error of the last call, such as PermissionError if a file is held by another program."""
    module: Any = ctypes
    number = module.get_last_error()
    return OSError(0, module.FormatError(number).strip(), None if path is None else os.fspath(path), number)


def descriptor(handle: int) -> int:
    """The file descriptor of a handle. Closing it closes the handle."""
    import msvcrt

    module, flags = vars(msvcrt), vars(os)
    return module["open_osfhandle"](handle, flags["O_RDWR"] | flags["O_BINARY"])


def create_file(path: str | os.PathLike, access: int, share: int, disposition: int, flags: int = 0) -> int:
    """CreateFileW. Returns a descriptor, which child processes do not inherit. Raises OSError:
    FileExistsError, PermissionError if another program holds the file in a way that excludes this one."""
    handle = kernel32().CreateFileW(os.fspath(path), access, share, None, disposition, flags, None)
    if handle in (None, _NO_HANDLE):
        raise failure(path)
    return descriptor(handle)


def memory_status() -> MemoryStatus | None:
    """GlobalMemoryStatusEx; None if it fails."""
    status = MemoryStatus(length=ctypes.sizeof(MemoryStatus))
    return status if kernel32().GlobalMemoryStatusEx(ctypes.byref(status)) else None


def process_memory() -> ProcessMemory | None:
    """GetProcessMemoryInfo of this process; None if it fails."""
    memory = ProcessMemory(length=ctypes.sizeof(ProcessMemory))
    good = kernel32().K32GetProcessMemoryInfo(
        kernel32().GetCurrentProcess(), ctypes.byref(memory), ctypes.sizeof(memory)
    )
    return memory if good else None


def own_job_limits() -> JobLimits | None:
    """The limits of the job object that this process is in; None if it is in none."""
    limits = JobLimits()
    good = kernel32().QueryInformationJobObject(
        None, _EXTENDED_LIMITS, ctypes.byref(limits), ctypes.sizeof(limits), None
    )
    return limits if good else None


class Job:
    """A job object: a process with all the children it will start. end() ends them all at once.
    dies_with_parent: they end with this process too, however it ends. Raises OSError if Windows refuses."""

    def __init__(self, process: int, dies_with_parent: bool):
        library = kernel32()
        job = library.CreateJobObjectW(None, None)
        if not job:
            raise failure()
        weakref.finalize(self, library.CloseHandle, job)
        self.end: Callable[[], Any] = lambda: library.TerminateJobObject(job, 1)
        if dies_with_parent:
            limits = JobLimits(flags=KILL_ON_JOB_CLOSE)
            library.SetInformationJobObject(
                job, _EXTENDED_LIMITS, ctypes.byref(limits), ctypes.sizeof(limits)
            )
        if not library.AssignProcessToJobObject(job, process):
            raise failure()


def has_console() -> bool:
    """Whether this process has a console, shown or hidden, which a child would share."""
    return bool(kernel32().GetConsoleWindow())
