"""Child processes: their group, their console window, how they are asked to stop and how they are ended.

Windows has no signals for processes. What takes their place there: Ctrl-C and Ctrl-Break, which the console
sends to every process in it, and job objects, which end a process with all its children.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from . import here, windows


class ChildProcess(subprocess.Popen):
    """A child in the group of this process: Ctrl-C in a terminal reaches both. It opens no console window. On
    Windows it ends with this process, however that ends."""

    def __init__(self, command: Sequence[str | os.PathLike], **options: Any):
        super().__init__(
            command,
            **options,
            **_flags(0 if here.WINDOWS and windows.has_console() else windows.CREATE_NO_WINDOW),
        )
        self._job = _job_of(self, dies_with_parent=True)

    def ask_to_stop(self):
        """Requests a clean stop (SIGTERM). On Windows the console has told the child already."""
        if not here.WINDOWS:
            self.terminate()


class ProcessGroup(subprocess.Popen):
    """A child without a console window that Ctrl-C does not reach and that outlives this process."""

    def __init__(self, command: Sequence[str | os.PathLike], **options: Any):
        own_group = _flags(windows.CREATE_NO_WINDOW | windows.CREATE_NEW_PROCESS_GROUP) or {
            "start_new_session": True
        }
        super().__init__(command, **options, **own_group)
        self._job = _job_of(self, dies_with_parent=False)

    def kill(self):
        """Ends the child and its own children at once."""
        if self._job is not None:
            self._job.end()
        elif here.WINDOWS:
            super().kill()
        elif self.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.pid, signal.SIGKILL)


def killed_from_outside(status: int, silent: bool) -> bool:
    """Whether the exit status is that of a process that was killed, by a user or because memory ran out.
    silent: it wrote nothing to stderr.

    On Windows, the status 1 is that of a process that was ended by the Task Manager, and of a Python that
    failed. But that says why.
    """
    return silent and status == 1 if here.WINDOWS else status == -signal.SIGKILL


def stop_signals() -> tuple[int, ...]:
    """The signals that request a clean stop: SIGINT and SIGTERM; SIGHUP where it is not ignored, as under
    nohup; Ctrl-Break on Windows."""
    names: Mapping[str, Any] = vars(signal)
    hangup, ctrl_break = names.get("SIGHUP"), names.get("SIGBREAK")  # each system has one of them
    heard = hangup is not None and signal.getsignal(hangup) != signal.SIG_IGN
    return (
        signal.SIGINT,
        signal.SIGTERM,
        *((hangup,) if heard else ()),
        *((ctrl_break,) if ctrl_break is not None else ()),
    )


@contextlib.contextmanager
def interrupting() -> Iterator[None]:
    """Within its block, each of the stop_signals() raises KeyboardInterrupt, as Ctrl-C does."""
    old = {number: signal.signal(number, signal.default_int_handler) for number in stop_signals()}
    try:
        yield
    finally:
        for number, handler in old.items():
            signal.signal(number, handler)


def _flags(number: int) -> dict[str, Any]:
    return {"creationflags": number} if here.WINDOWS else {}


def _job_of(process: Any, dies_with_parent: bool) -> windows.Job | None:
    if not here.WINDOWS:
        return None
    with contextlib.suppress(OSError):  # the process has ended already
        return windows.Job(int(process._handle), dies_with_parent)
    return None
