"""Available memory on each system, from what the system's calls report."""

from __future__ import annotations

import os
import struct

import pytest

from svrgs_addon.system import here, macos, memory_limits

GB = 10**9
PROCESS_LIMIT, JOB_LIMIT, TIME_LIMIT = 0x100, 0x200, 0x2


@pytest.fixture
def model(windows):
    """The model of Windows; its own figures are known."""
    if windows is None:
        pytest.skip("this is Windows, which has figures of its own")
    windows.memory = {"available": 6 * GB, "available_page_file": 9 * GB, "private": 1 * GB, "peak": 2 * GB}
    return windows


def test_this_system_reports_its_memory():
    assert 10**8 < memory_limits.available() < 10**14
    assert 10**6 < memory_limits.peak() < memory_limits.available() + 10**11


def test_windows_reports_what_is_free_and_can_be_committed(model):
    assert memory_limits.available() == 6 * GB and memory_limits.peak() == 2 * GB
    model.memory["available_page_file"] = 4 * GB
    assert memory_limits.available() == 4 * GB
    assert memory_limits.address_limit() is None


@pytest.mark.parametrize(
    "limits, available",
    [
        ((PROCESS_LIMIT, 3 * GB, 0), 2 * GB),
        ((JOB_LIMIT, 0, 5 * GB), 4 * GB),
        ((PROCESS_LIMIT | JOB_LIMIT, 3 * GB, 2 * GB), 1 * GB),
        ((PROCESS_LIMIT, GB // 2, 0), 0),
        ((PROCESS_LIMIT, 90 * GB, 0), 6 * GB),
        ((TIME_LIMIT, 0, 0), 6 * GB),
        (None, 6 * GB),
    ],
)
def test_the_limits_of_a_job_object_count(model, limits, available):
    model.limits = limits
    assert memory_limits.available() == available


class FakeKernel:
    """libSystem of macOS: fills vm_statistics64 at the places that mach/vm_statistics.h gives."""

    def __init__(self, status: int = 0):
        self.status = status

        def mach_host_self():
            return 0x1203

        self.mach_host_self = mach_host_self

    def host_statistics64(self, host, kind, statistics, count):
        assert (host.value, kind, count._obj.value) == (0x1203, 4, 38)
        struct.pack_into("<IIII", statistics._obj, 0, 1000, 7, 500, 11)  # free, active, inactive, wired
        # purgeable, speculative: they are in the inactive and the free ones
        struct.pack_into("<II", statistics._obj, 88, 300, 200)
        return self.status


@pytest.mark.parametrize("status, available", [(0, 1500), (5, None)])
def test_macos_reports_free_and_inactive_pages(monkeypatch, status, available):
    kernel = FakeKernel(status)
    monkeypatch.setattr(here, "MACOS", True)
    monkeypatch.setattr(here, "WINDOWS", False)
    monkeypatch.setattr(macos, "system_library", lambda: kernel)
    monkeypatch.setattr(os, "sysconf", {"SC_PAGE_SIZE": 16384}.__getitem__, raising=False)
    macos._host.cache_clear()
    assert memory_limits._system_available() == (available and available * 16384)
    macos._host.cache_clear()


def test_the_peak_of_macos_is_in_bytes(monkeypatch):
    resource = pytest.importorskip("resource")
    known = resource.getrusage(resource.RUSAGE_SELF)
    monkeypatch.setattr(here, "WINDOWS", False)
    monkeypatch.setattr(memory_limits, "proc_bytes", lambda *_: int("no such file"))
    monkeypatch.setattr(memory_limits.resource, "getrusage", lambda _: known)
    for macos_, factor in ((True, 1), (False, 1024)):
        monkeypatch.setattr(here, "MACOS", macos_)
        assert memory_limits.peak() == known.ru_maxrss * factor
