"""Files that other programs have open, and owners that were killed, on Windows; most of it against a model of
Windows on other systems."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from svrgs_addon.files.atomic import atomic_path, atomic_write, check_space, check_writable, reserved
from svrgs_addon.system import locks, replacing
from svrgs_addon.system import windows as system_calls
from svrgs_addon.system.errors import SceneError

ROOT = Path(__file__).resolve().parents[1]


def viewer(windows, path):
    """A program that has the file open."""
    return open(path, "rb") if windows is None else windows.viewer(path)


@pytest.fixture
def old(tmp_path, monkeypatch) -> Path:
    """A result of an earlier run. Nobody is waited for long."""
    monkeypatch.setattr(replacing, "PATIENCE_S", 0.3)
    monkeypatch.setattr(locks, "PATIENCE_S", 0.2)
    (tmp_path / "größe (1).ply").write_bytes(b"old")
    return tmp_path / "größe (1).ply"


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def write(path: Path, content: bytes, **more):
    with atomic_write(path, **more) as file:
        file.write(content)


def test_a_file_is_replaced(windows, old):
    check_writable(old)
    write(old, b"new")
    assert old.read_bytes() == b"new" and names(old.parent) == [old.name]


def test_an_output_that_a_viewer_has_open_is_refused_before_the_work(windows, old):
    with (
        viewer(windows, old),
        pytest.raises(
            SceneError,
            match=r"größe \(1\).ply: is open in another program and cannot be replaced; close it there, or",
        ),
    ):
        check_writable(old)
    check_writable(old)
    assert names(old.parent) == [old.name]


def test_a_result_is_kept_under_another_name_while_a_viewer_has_the_old_one_open(windows, old):
    for number in ("", " 2"):
        with viewer(windows, old):
            check_space(old, 10)
            with pytest.raises(
                SceneError,
                match=(
                    r"was not replaced, probably because another program has it open; .* next to it as"
                    rf" 'größe \(1\) \(new{number}\).ply'$"
                ),
            ):
                write(old, b"new" + number.encode())
        assert old.read_bytes() == b"old"
        assert old.with_stem(f"{old.stem} (new{number})").read_bytes() == b"new" + number.encode()
    assert len(names(old.parent)) == 3


def test_a_file_that_is_written_again_soon_is_not_kept(windows, old):
    with viewer(windows, old), pytest.raises(SceneError, match=r"größe \(1\).ply: cannot be written \("):
        write(old, b"new", keep=False)
    assert names(old.parent) == [old.name] and old.read_bytes() == b"old"


def test_a_viewer_that_closes_the_file_soon_is_waited_for(windows, old, monkeypatch):
    monkeypatch.setattr(replacing, "PATIENCE_S", 20)
    with contextlib.ExitStack() as stack:
        stack.enter_context(viewer(windows, old))
        timer = threading.Timer(0.3, stack.close)
        timer.start()
        write(old, b"new")
        timer.join()
    assert old.read_bytes() == b"new" and names(old.parent) == [old.name]


def test_a_reader_waits_while_a_file_is_being_replaced(windows, old):
    closed = threading.Event()
    descriptor = system_calls.create_file(
        old, system_calls.GENERIC_READ, system_calls.SHARE_NOTHING, system_calls.OPEN_EXISTING
    )
    timer = threading.Timer(0.1, lambda: (closed.set(), os.close(descriptor)))
    timer.start()
    assert replacing.patiently(old.read_bytes) == b"old" and closed.is_set()
    timer.join()


def test_no_result_is_lost_to_a_program_that_lets_others_rename_the_file(windows, old):
    """The check before the work cannot see what will happen: Windows 7 to 10 refuse, later versions may
    replace the file."""
    descriptor = system_calls.create_file(
        old, system_calls.GENERIC_READ, system_calls.SHARE_ALL, system_calls.OPEN_EXISTING
    )
    check_writable(old)
    with contextlib.suppress(SceneError):
        write(old, b"new")
    os.close(descriptor)
    assert [
        path.read_bytes() for path in old.parent.iterdir() if path != old or path.read_bytes() == b"new"
    ] == [b"new"]


def test_a_missing_file_is_not_waited_for(windows, tmp_path):
    began = time.monotonic()
    with pytest.raises(FileNotFoundError):
        replacing.patiently((tmp_path / "none").read_bytes)
    assert replacing.may_be_replaced(tmp_path / "none") and time.monotonic() < began + 0.3


# --- owners


def test_a_file_of_a_living_writer_is_left_alone(windows, tmp_path):
    with atomic_path(tmp_path / "a.bin") as temporary:
        temporary.write_bytes(b"content")
        check_writable(tmp_path / "b.bin")
        assert names(tmp_path) == [temporary.name]
    assert names(tmp_path) == ["a.bin"] and (tmp_path / "a.bin").read_bytes() == b"content"


def test_what_nobody_owns_is_removed(windows, tmp_path):
    (tmp_path / ".svrgs-0123456789abcdef.ply").write_bytes(b"left by a killed writer")
    (tmp_path / ".svrgs-0123456789abcdef.lock").touch()
    check_writable(tmp_path / "a.ply")
    assert names(tmp_path) == []


def test_what_a_virus_scanner_reads_is_removed_later(windows, tmp_path):
    left = tmp_path / ".svrgs-0123456789abcdef.ply"
    left.touch()
    with viewer(windows, left):
        check_writable(tmp_path / "a.ply")
        assert names(tmp_path) == [left.name]
    check_writable(tmp_path / "a.ply")
    assert names(tmp_path) == []


def test_an_output_has_one_owner(windows, tmp_path):
    with reserved(tmp_path / "o.ply"):
        check_writable(tmp_path / "o.ply")
        with (
            pytest.raises(SceneError, match="o.ply: another job is writing this file"),
            reserved(tmp_path / "o.ply"),
        ):
            pass
        with reserved(tmp_path / "other.ply"):
            pass
    with reserved(tmp_path / "o.ply"):
        pass
    assert names(tmp_path) == []


def test_a_folder_that_may_not_be_written_is_no_other_job(windows, tmp_path, monkeypatch):
    if windows is None:
        pytest.skip("an administrator may write everywhere")

    def denied(*_):
        windows.error = 5
        return 2**64 - 1

    windows.CreateFileW = denied
    monkeypatch.setattr(locks, "PATIENCE_S", 0)
    with pytest.raises(SceneError, match="o.ply: cannot be written"), reserved(tmp_path / "o.ply"):
        pass


KILLED = """
import os, sys
from svrgs_addon.files.atomic import atomic_path
with atomic_path(sys.argv[1]) as temporary:
    temporary.write_bytes(b"half")
    os._exit(9)
"""


def test_what_a_killed_process_left_is_removed_on_this_system(tmp_path):
    assert subprocess.run([sys.executable, "-c", KILLED, str(tmp_path / "o.ply")], cwd=ROOT).returncode == 9
    assert len(names(tmp_path)) == 1
    check_writable(tmp_path / "o.ply")
    assert names(tmp_path) == []
