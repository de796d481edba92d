"""Functions of macOS that Python does not offer, through ctypes. Not called on another system."""

from __future__ import annotations

import ctypes
import functools
import os
from typing import Any

from .structs import fields

_HOST_VM_INFO64 = 4


class VirtualMemory(ctypes.Structure):
    """vm_statistics64: numbers of pages. free includes the speculative ones."""

    _fields_ = fields(
        (ctypes.c_uint32, "free active inactive wired"),
        (ctypes.c_uint64 * 9, "events"),
        (ctypes.c_uint32, "purgeable speculative"),
        (ctypes.c_uint64 * 4, "compressions"),
        (ctypes.c_uint32, "compressor throttled external internal"),
        (ctypes.c_uint64, "uncompressed"),
    )


@functools.cache
def system_library() -> Any:
    """The system's library, in which every process finds its functions."""
    return ctypes.CDLL(None)


@functools.cache
def _host() -> int:
    """The port of the kernel; each call of mach_host_self() would count as one more user of it."""
    function = system_library().mach_host_self
    function.restype = ctypes.c_uint32
    return function()


def available_memory() -> int | None:
    """Bytes that are free, or can be dropped or written elsewhere; None if the kernel does not say."""
    pages, size = VirtualMemory(), ctypes.c_uint32(ctypes.sizeof(VirtualMemory) // 4)
    if system_library().host_statistics64(
        ctypes.c_uint32(_host()), _HOST_VM_INFO64, ctypes.byref(pages), ctypes.byref(size)
    ):
        return None
    return (pages.free + pages.inactive) * os.sysconf("SC_PAGE_SIZE")
