"""Child processes: ended with their own children, asked to stop, without a console window."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from svrgs_addon.prune.stop_request import StopRequest
from svrgs_addon.system import here, processes
from svrgs_addon.system import windows as system_calls
from svrgs_addon.system.processes import ChildProcess, ProcessGroup, killed_from_outside, stop_signals

ROOT = Path(__file__).resolve().parents[1]
ALIVE = "import sys, time\nwhile True:\n    open(sys.argv[1], 'ab').write(b'.')\n    time.sleep(0.02)"
PARENT = (
    "import subprocess, sys, time\nsubprocess.Popen([sys.executable, '-c', sys.argv[1],"
    " sys.argv[2]])\ntime.sleep(60)"
)
SLEEP = "import time; print(1, flush=True); time.sleep(60)"


def wait_for(condition, seconds: float = 30):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.02)


def grows(file: Path) -> bool:
    before = file.stat().st_size
    time.sleep(0.3)
    return file.stat().st_size > before


def test_a_group_is_ended_with_the_children_of_the_child(tmp_path):
    file = tmp_path / "alive"
    with ProcessGroup([sys.executable, "-c", PARENT, ALIVE, str(file)]) as group:
        wait_for(file.exists)
        assert grows(file)
        group.kill()
    wait_for(lambda: not grows(file))
    group.kill()  # there is nothing to end any more


def test_who_was_killed_is_told_by_the_exit_status():
    group = ProcessGroup([sys.executable, "-c", SLEEP], stdout=subprocess.PIPE)
    group.stdout.readline()
    subprocess.Popen.kill(group)  # as the Task Manager does
    assert killed_from_outside(group.wait(), silent=True)
    group.stdout.close()
    failed = subprocess.run([sys.executable, "-c", "1 / 0"], capture_output=True)
    assert not killed_from_outside(failed.returncode, silent=not failed.stderr)
    assert not killed_from_outside(0, silent=True) and not killed_from_outside(2, silent=True)


def test_an_output_line_and_a_status_of_windows_are_told_apart(monkeypatch):
    monkeypatch.setattr(here, "WINDOWS", True)
    assert [
        killed_from_outside(status, silent)
        for status, silent in ((1, True), (1, False), (0, True), (130, True))
    ] == [True, False, False, False]


@pytest.mark.skipif(sys.platform == "win32", reason="there the console asks")
def test_a_child_is_asked_to_stop():
    with ChildProcess([sys.executable, "-c", SLEEP], stdout=subprocess.PIPE) as child:
        child.stdout.readline()
        child.ask_to_stop()
    assert child.returncode == -signal.SIGTERM


class Started:
    """What Popen of Windows was asked for, in place of the process."""

    def __init__(self, monkeypatch):
        self.options: dict = {}

        def start(process, command, **options):
            self.options, process._handle, process.pid, process.returncode = options, 77, 1, None

        monkeypatch.setattr(subprocess.Popen, "__init__", start)
        monkeypatch.setattr(subprocess.Popen, "__del__", lambda *_: None)


@pytest.fixture
def started(windows, monkeypatch):
    if windows is None:
        pytest.skip("this is Windows, where processes are started")
    return Started(monkeypatch)


@pytest.mark.parametrize("console, flags", [(1, 0), (0, 0x08000000)])
def test_a_child_shares_the_console_or_has_none(windows, started, console, flags):
    windows.console = console
    child = ChildProcess(["svrgs"])
    (job,) = windows.jobs.values()
    assert started.options == {"creationflags": flags}
    assert job == dict(processes=[77], flags=0x2000, ended=False)
    child.ask_to_stop()
    assert not job["ended"], "the console has asked it"
    del child
    assert job["ended"], "it must not outlive this process"


def test_a_group_has_no_console_and_outlives_this_process(windows, started):
    group = ProcessGroup(["svrgs"])
    (job,) = windows.jobs.values()
    assert started.options == {"creationflags": 0x08000200}
    assert job == dict(processes=[77], flags=0, ended=False)
    group.kill()
    assert job["ended"]
    job["ended"] = False
    del group
    assert not job["ended"] and not windows.jobs


def test_a_process_that_no_job_object_takes_is_ended_alone(windows, started, monkeypatch):
    ended = []
    windows.AssignProcessToJobObject = lambda *_: 0
    windows.error = 5
    monkeypatch.setattr(subprocess.Popen, "kill", lambda process: ended.append(process))
    group = ProcessGroup(["svrgs"])
    group.kill()
    assert ended == [group] and not windows.jobs


def test_ctrl_break_is_a_stop_request(monkeypatch):
    """Windows has it, and no SIGHUP. It also comes when the console is told to end its processes."""
    if sys.platform != "win32":
        monkeypatch.setattr(signal, "SIGBREAK", signal.SIGUSR1, raising=False)
        monkeypatch.delattr(signal, "SIGHUP")
    ctrl_break = signal.SIGBREAK
    assert set(stop_signals()) == {signal.SIGINT, signal.SIGTERM, ctrl_break}
    told, before = [], signal.getsignal(ctrl_break)
    with StopRequest(lambda: told.append(1)) as stop:
        signal.raise_signal(ctrl_break)
        assert stop()
    assert told == [1] and signal.getsignal(ctrl_break) == before


CTRL_BREAK = """
import signal, sys, time
sys.path.insert(0, sys.argv[1])
from svrgs_addon.prune.stop_request import StopRequest
with StopRequest() as stop:
    print("ready", flush=True)
    while not stop():
        time.sleep(0.01)
print("stopped", flush=True)
"""


@pytest.mark.skipif(
    sys.platform != "win32" or not system_calls.has_console(),
    reason="only a console of Windows sends Ctrl-Break",
)
def test_ctrl_break_from_the_console_stops_a_process():
    group = subprocess.CREATE_NEW_PROCESS_GROUP
    with subprocess.Popen(
        [sys.executable, "-c", CTRL_BREAK, str(ROOT)], stdout=subprocess.PIPE, text=True, creationflags=group
    ) as process:
        assert process.stdout.readline() == "ready\n"
        process.send_signal(signal.CTRL_BREAK_EVENT)
        assert process.communicate(timeout=20)[0] == "stopped\n" and process.returncode == 0


def test_nothing_else_asks_for_the_system():
    """Each branch for a system is in svrgs_addon/system."""
    words = (
        "sys.platform",
        "os.name",
        "fcntl",
        "msvcrt",
        "import resource",
        "creationflags",
        "WinDLL",
        "killpg",
        "start_new_session",
    )
    others = [
        path
        for folder in ("svrgs_addon", "operators", "panels")
        for path in (ROOT / folder).rglob("*.py")
        if path.parent.name != "system"
    ]
    found = [
        f"{path.relative_to(ROOT)}: {word}"
        for path in others
        for word in words
        if word in path.read_text(encoding="utf-8")
    ]
    assert not found and processes.__file__
