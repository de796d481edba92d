"""The memory of this computer and of this process, as the system reports it. All values are in bytes."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from . import here, macos, windows

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

CGROUP, OWN_CGROUPS = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")
# files with limit and use, and name of the cached files in memory.stat
CGROUP_2 = ("memory.max", "memory.current", "inactive_file")
CGROUP_1 = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")


def available() -> int | None:
    """Bytes that this process can still allocate without swapping; None if the system does not report it.

    Limits are included: of containers (cgroups), of the process (ulimit -v), of the job object of a process
    on Windows.
    """
    sources = (
        (_windows_available, _job_available)
        if here.WINDOWS
        else (_system_available, _cgroup_available, _addresses_available)
    )
    limits = [limit for source in sources if (limit := source()) is not None]
    return min(limits) if limits else None


def peak() -> int | None:
    """Largest resident set size of this process so far in bytes; None if the system does not report it."""
    if here.WINDOWS:
        memory = windows.process_memory()
        return memory.peak_working_set if memory else None
    try:  # VmHWM counts this program only; on Linux, getrusage starts with the size of the parent process
        return proc_bytes("self/status", "VmHWM")
    except (OSError, ValueError):
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return most if here.MACOS else most * 1024


def address_limit() -> int | None:
    """Largest number of bytes of addresses of this process (ulimit -v); None without a limit."""
    if resource is None or here.WINDOWS:
        return None
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    return None if limit == resource.RLIM_INFINITY else limit


# --- Windows


def _windows_available() -> int | None:
    """Bytes of memory that are free, as far as they can be committed."""
    status = windows.memory_status()
    return min(status.available, status.available_page_file) if status else None


def _job_available() -> int | None:
    """Bytes below the limit of the job object; None without one. Of a limit on all its processes, other ones
    may have used a part."""
    job, memory = windows.own_job_limits(), windows.process_memory()
    if job is None or memory is None:
        return None
    limits = (
        (windows.LIMITS_PROCESS_MEMORY, job.process_memory),
        (windows.LIMITS_JOB_MEMORY, job.job_memory),
    )
    return min((max(0, limit - memory.private) for flag, limit in limits if job.flags & flag), default=None)


# --- Linux and macOS


def _system_available() -> int | None:
    """Available bytes of the whole system; None if it does not report them."""
    if here.MACOS:
        return macos.available_memory()
    try:
        return proc_bytes("meminfo", "MemAvailable")
    except (OSError, ValueError):
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def proc_bytes(file: str, name: str) -> int:
    """Bytes in the line `name` of /proc/`file`. Raises OSError or ValueError if it is not there."""
    text = Path("/proc", file).read_text(encoding="utf-8", errors="surrogateescape")
    return 1024 * int(text.partition(f"{name}:")[2].partition("kB")[0])


def _cgroup_available() -> int | None:
    """Bytes below the nearest limit of the cgroups, cached files being free; None without a limit."""
    left = [_below_limit(folder, *names) for folder, names in _cgroups()]
    return min((value for value in left if value is not None), default=None)


def _cgroups() -> Iterator[tuple[Path, tuple[str, str, str]]]:
    """The folders of the cgroups of this process and of those around them, and the names of their files.

    In a container, the path of the process in /proc may not exist below /sys/fs/cgroup; then only the root,
    which is the container's, does.
    """
    try:
        text = OWN_CGROUPS.read_text(encoding="utf-8", errors="surrogateescape")
    except OSError:
        text = ""
    paths = {controllers: path for _, controllers, path in (line.split(":", 2) for line in text.splitlines())}
    own_2 = paths.get("", "/")
    own_1 = next((path for controllers, path in paths.items() if "memory" in controllers.split(",")), "/")
    for root, own, names in (
        (CGROUP, own_2, CGROUP_2),
        (CGROUP / "unified", own_2, CGROUP_2),
        (CGROUP / "memory", own_1, CGROUP_1),
    ):
        inner = PurePosixPath(own.lstrip("/"))
        for part in (inner, *inner.parents):
            if ".." not in part.parts:  # above the root of a namespace
                yield root / part, names


def _below_limit(folder: Path, limit_file: str, use_file: str, cached_name: str) -> int | None:
    """Bytes that may still be used in one cgroup; None if it has no limit or does not exist."""
    try:
        limit, used, stat = (
            (folder / name).read_text(encoding="utf-8").strip()
            for name in (limit_file, use_file, "memory.stat")
        )
        facts = dict(line.split() for line in stat.splitlines())
        return None if limit == "max" else max(0, int(limit) - int(used) + int(facts.get(cached_name, 0)))
    except (OSError, ValueError):
        return None


def _addresses_available() -> int | None:
    """Bytes of addresses that this process can still have; None without a limit."""
    limit = address_limit()
    try:
        return None if limit is None else max(0, limit - proc_bytes("self/status", "VmSize"))
    except (OSError, ValueError):
        return None
