"""Starts a job's process, follows it without ever waiting for it, and ends it.

The process writes its messages to a file in the job's folder, which is read from where the last look ended: no pipe can fill
up or block, and nothing is lost when the reader is late.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import time
from typing import Any

from ..blender import subprocess_python
from ..errors import FormatError, SceneError
from .job_folder import CANCEL, ENDED, PAUSE, JobFolder, facts_of

START_SECONDS = 60.0  # within which a process must say something
LOOK_EVERY = 2.0  # seconds between two looks at the state of a job that another Blender started
CANCEL_LADDER = ((10.0, "terminate"), (15.0, "kill"))  # seconds after cancel()
MODULE = "svrgs_addon.jobs.job_main"


class Job:
    """One job as its starter sees it. `facts`: state, text, and what the last PROGRESS said."""

    def __init__(self, folder: JobFolder):
        self.folder = folder
        self.facts: dict = folder.state()
        self.result: dict | None = None
        self.renamed = ""  # a sentence where start() found a method that is called otherwise now
        self._process: subprocess.Popen | None = None
        self._read = 0  # bytes of messages.jsonl
        self._cancelled: float | None = None  # when
        self._looked = time.monotonic()

    @property
    def state(self) -> str:
        return self.facts["state"]

    @property
    def running(self) -> bool:
        """Whether this object's process has not ended."""
        return self._process is not None

    @property
    def seconds_silent(self) -> float:
        """Since the last sign of life."""
        with contextlib.suppress(OSError):
            return time.time() - (self.folder / "state.json").stat().st_mtime
        return 0.0

    def look(self):
        """Brings a state up to date that another process writes."""
        if self._process is None and self.state not in ENDED and time.monotonic() > self._looked + LOOK_EVERY:
            self._looked, self.facts = time.monotonic(), self.folder.state()

    def start(self):
        """Starts the job, or goes on from its last checkpoint. Raises FormatError where its folder holds none."""
        self.renamed = self.folder.update_schema()
        self.folder.lower_flags()
        (self.folder / "messages.jsonl").write_bytes(b"")
        self.folder.write_json("state.json", {"state": "starting"})
        self.facts, self.result, self._read, self._cancelled = {"state": "starting", "text": "Starting"}, None, 0, None
        group: dict[str, Any] = {"start_new_session": True}
        if sys.platform == "win32":
            group = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
        with open(self.folder / "messages.jsonl", "ab") as messages, open(self.folder / "log.txt", "ab") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", MODULE, str(self.folder.path)],
                stdin=subprocess.PIPE, stdout=messages, stderr=log, env=subprocess_python.environment(), **group,
            )  # fmt: skip
        self._started = time.monotonic()

    def poll(self) -> list[dict]:
        """What was said since the last look; to be called a few times a second. Never waits. Raises FormatError where the folder is gone."""
        if self._process is None:
            return []
        status = self._process.poll()  # before reading: what an ended process said is all there
        messages = self._messages()
        for message in messages:
            self._hear(message)
        if status is not None:
            self._ended(status)
        elif self.facts["state"] == "starting" and time.monotonic() > self._started + START_SECONDS:
            self._process.kill()
            self.facts |= {"state": "failed", "text": f"the process did not start within {START_SECONDS:.0f} s"}
        elif self._cancelled is not None:
            self._climb(time.monotonic() - self._cancelled)
        return messages

    def pause(self):
        """The process will save a checkpoint and end."""
        self.folder.ask(PAUSE)
        self.facts["text"] = "Pausing"

    def cancel(self):
        """The process will end at once; the last checkpoint stays. Where it does not answer, poll() ends it by force."""
        with contextlib.suppress(OSError):  # the disk is full, or the folder gone: by force then
            self.folder.ask(CANCEL)
        self._cancelled = time.monotonic()
        self.facts["text"] = "Cancelling"

    def give_up(self, why: str):
        """For what can no longer be followed: the process is ended by force, the job failed."""
        if self._process is not None:
            self._close_stdin()
            self._process.kill()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(1)
            self._process = None
        self.facts = {"state": "failed", "text": why}

    def leave(self):
        """For who is about to end itself: the process notices, saves a checkpoint and ends by itself."""
        self._close_stdin()

    def _close_stdin(self):
        """Tells the process that its parent is gone."""
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.close()

    def _messages(self) -> list[dict]:
        """Whole lines since the last look; what is no message is left out. Raises FormatError where the file is gone."""
        try:
            with open(self.folder / "messages.jsonl", "rb") as file:
                file.seek(self._read)
                data = file.read()
        except OSError as error:
            raise FormatError(f"{self.folder / 'messages.jsonl'}: cannot be read ({error.strerror})") from None
        data = data[: data.rfind(b"\n") + 1]
        self._read += len(data)
        return [message for line in data.splitlines() if (message := _message(line)) is not None]

    def _hear(self, message: dict):
        self.facts |= facts_of(message)
        if message["type"] == "DONE":
            self.result = message.get("result")

    def _ended(self, status: int):
        self._close_stdin()
        self._process = None
        log = self.folder.log_tail(1)
        if self.facts["state"] in ENDED:
            pass
        elif self._cancelled is not None:
            self.facts |= {"state": "cancelled", "text": ""}
        elif status == -9:
            self.facts |= {"state": "interrupted", "text": "the process was killed from outside; if memory ran out, fewer or smaller photographs help"}
        else:
            self.facts |= {"state": "failed", "text": f"the job's process ended early: {log[0] if log else f'exit status {status}'}"}
        with contextlib.suppress(SceneError):  # a full disk; without a sign of life the job counts as interrupted
            self.folder.write_json("state.json", self.facts)

    def _climb(self, seconds: float):
        for after, action in CANCEL_LADDER:
            if seconds > after:
                getattr(self._process, action)()


def _message(line: bytes) -> dict | None:
    try:
        message = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return message if isinstance(message, dict) and isinstance(message.get("type"), str) else None
