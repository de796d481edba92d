"""The parent's side of a background job: it starts the child process (job_main.py), reads its messages, and
ends it. It never waits.

The child's stdout is a file in the job folder, messages.jsonl, with one JSON object per line. The parent
reads it from the position where it stopped the last time. So no pipe can fill up or block, and no message is
lost if the parent reads late.

The child's stdin is a pipe that the parent never writes to. Its end tells the child that the parent is gone.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import time

from ..system import subprocess_python
from ..system.errors import FormatError, SceneError, system_errors
from ..system.processes import ProcessGroup, killed_from_outside
from .job_folder import ENDED, JobFolder, facts_of

START_SECONDS = 60.0  # a process that has sent no message after so many seconds is killed
REFRESH_EVERY = 2.0  # seconds between two reads of the state of a job that another Blender started
NO_REACTION = 10.0  # seconds without a renewed state after stop(); then the process is killed
MODULE = "svrgs_addon.jobs.job_main"


class Job:
    """A job and, if this object started it, its process. facts: state, text, and the values of the last
    PROGRESS message."""

    def __init__(self, folder: JobFolder):
        self.folder = folder
        self.facts: dict = folder.state()
        self.result: dict | None = None
        self._why = ""
        self._read_request: dict = {}
        self._process: ProcessGroup | None = None
        self._log_begin = 0  # bytes of log.txt when the process was started
        self._read = 0  # bytes of messages.jsonl that were read
        self._stopping: float | None = None  # time of stop() or kill(), of time.monotonic()
        self._refreshed = time.monotonic()
        self._stamp = self._state_stamp()

    @property
    def state(self) -> str:
        return self.facts["state"]

    @property
    def running(self) -> bool:
        """Whether this object has a process that has not ended."""
        return self._process is not None

    @property
    def seconds_silent(self) -> float:
        """Seconds since the state was last written."""
        with contextlib.suppress(OSError):
            return time.time() - (self.folder / "state.json").stat().st_mtime
        return 0.0

    @property
    def stopping(self) -> bool:
        """Whether it was asked to stop and has not ended yet."""
        return self._process is not None and self._stopping is not None

    @property
    def name(self) -> str:
        """The name of the splat, or of the cameras, when the job was made; the folder's name if job.json
        cannot be read."""
        return self.request.get("name") or self.folder.path.name

    @property
    def kind(self) -> str:
        """PRUNE or TRAIN; '' if job.json cannot be read."""
        return self.request.get("kind", "")

    @property
    def request(self) -> dict:
        """job.json, read once; {} if it cannot be read."""
        if not self._read_request:
            with contextlib.suppress(FormatError):
                self._read_request = self.folder.request()
        return self._read_request

    @property
    def knows_progress(self) -> bool:
        """Whether a step or a task by blocks has begun."""
        return bool(self.facts.get("total")) or "share" in self.facts

    @property
    def progress(self) -> float:
        """The share of the steps that are done, 0..1; of a job by blocks, of its tasks."""
        done, total = self.facts.get("share", 0.0), 1
        if "total" in self.facts:
            done, total = self.facts.get("iteration", 0), self.facts["total"]
        return max(0, min(done, total)) / max(1, total)

    def resume_point(self) -> tuple[str, dict]:
        """From where a job that has not ended well would be continued: a sentence with named fields, and
        their values."""
        if not (self.folder / "job.json").is_file():
            return "Resume cannot continue it, as its files are gone: discard it", {}
        tasks, of = self.folder.tasks()
        if tasks and of:
            text = "Resume continues: {done} of {tasks} tasks by blocks are done"
            return text, {"done": tasks, "tasks": of}
        saved, done = self.folder.checkpoint(), self.facts.get("iteration", 0)
        total = self.facts.get("total", 0) or self._steps()
        if not saved:
            return (
                "Resume starts it from the beginning: no checkpoint was saved"
                if done > 0
                else "Resume starts it from the beginning"
            ), {}
        if total:
            text = (
                "Resume continues at {share:.0%}: the steps after it were not saved"
                if saved < done
                else "Resume continues at {share:.0%}"
            )
            return text, {"share": saved / total}
        text = (
            "Resume continues at step {step:,}: the steps after it were not saved"
            if saved < done
            else "Resume continues at step {step:,}"
        )
        return text, {"step": saved}

    def _steps(self) -> int:
        """The steps that were asked for; 0 if the time was."""
        options = self.request.get("options", {})
        steps = [options.get(name, 0) for name in ("iterations", "recovery")]
        return sum(one for one in steps if isinstance(one, int)) if not options.get("time") else 0

    def refresh(self):
        """Reads the state of a job that another Blender started or continued, at most every REFRESH_EVERY
        seconds."""
        if self._process is not None or time.monotonic() <= self._refreshed + REFRESH_EVERY:
            return
        self._refreshed, stamp = time.monotonic(), self._state_stamp()
        if self.state not in ENDED or stamp not in (0, self._stamp):
            self._stamp, self.facts = stamp, self.folder.state()

    def _state_stamp(self) -> int:
        """Changes whenever state.json is written; 0 if there is none."""
        with contextlib.suppress(OSError):
            return (self.folder / "state.json").stat().st_mtime_ns
        return 0

    def queue(self):
        """Notes that the job waits for another one to end. start() ends the waiting. Raises FormatError as
        start(), SceneError if the disk is full."""
        self.folder.refuse_links()
        self.folder.request()
        self.facts = {**self.facts, "state": "queued", "text": ""}
        self.folder.write_json("state.json", self.facts)
        self._stamp = self._state_stamp()

    def start(self):
        """Starts the job, or continues it from its last checkpoint. Raises FormatError if the folder holds no
        job, or links."""
        self.folder.refuse_links()
        self.folder.request()  # raises FormatError
        self.folder.lower_flag()
        (self.folder / "messages.jsonl").write_bytes(b"")
        self.folder.write_json("state.json", {"state": "starting"})
        self.facts = {"state": "starting", "text": "Starting"}
        self.result, self._read, self._stopping, self._why = None, 0, None, ""
        with (
            open(self.folder / "messages.jsonl", "ab") as messages,
            open(self.folder / "log.txt", "ab") as log,
        ):
            self._log_begin = log.tell()
            self._process = ProcessGroup(
                [sys.executable, "-m", MODULE, str(self.folder.path)],
                stdin=subprocess.PIPE,
                stdout=messages,
                stderr=log,
                env=subprocess_python.environment() | {"PYTHONIOENCODING": "utf-8"},
            )
        self._started = time.monotonic()

    def poll(self) -> list[dict]:
        """The messages since the last call. To be called a few times per second; it never waits. Raises
        FormatError if the folder is gone."""
        if self._process is None:
            return []
        status = self._process.poll()  # before reading, so that all messages of an ended process are read
        messages = self._messages()
        for message in messages:
            self.facts |= facts_of(message)
            if message["type"] == "DONE":
                self.result = message.get("result")
        if status is not None:
            self._ended(status)
        elif self.facts["state"] == "starting" and time.monotonic() > self._started + START_SECONDS:
            self._process.kill()
            text = f"the process did not start within {START_SECONDS:.0f} s"
            self.facts |= {"state": "failed", "text": text}
        elif (
            self._stopping is not None
            and min(time.monotonic() - self._stopping, self.seconds_silent) > NO_REACTION
        ):
            self.kill("It gave no sign of life and was ended")
        return messages

    def stop(self):
        """Asks the process to save a checkpoint and to end. If it gives no sign of life for NO_REACTION
        seconds, poll() kills it."""
        try:
            self.folder.raise_flag()
        except OSError:  # the disk is full: the end of stdin has the same effect
            self._close_stdin()
        self._stopping = time.monotonic()
        if "share" in self.facts:  # by blocks: not every job can be continued
            self.facts["text"] = "Stopping"
        elif self.facts.get("iteration"):
            self.facts["text"] = "Stopping: a checkpoint is being saved"
        else:
            self.facts["text"] = "Stopping: no step was done yet"

    def kill(self, why: str = ""):
        """Ends the process at once. Its last checkpoint stays. why: a sentence for the user."""
        self._stopping, self._why = time.monotonic(), why
        if self._process is not None:
            self._process.kill()

    def abort(self, why: str):
        """Ends the process by force and marks the job as failed. For a job whose messages can no longer be
        read."""
        if self._process is not None:
            self._close_stdin()
            self._process.kill()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(1)
            self._process = None
        # what the process wrote before its end says nothing new
        self.facts, self._stamp = {"state": "failed", "text": why}, self._state_stamp()

    def detach(self):
        """To be called before the parent ends: the child saves a checkpoint and ends."""
        self._close_stdin()

    def _close_stdin(self):
        """Tells the child that its parent is gone."""
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.close()

    def _messages(self) -> list[dict]:
        """The messages in whole lines since the last call; lines that are no message are skipped. Raises
        FormatError if the file is gone."""
        path = self.folder / "messages.jsonl"
        with system_errors(FormatError, f"{path}: cannot be read"), open(path, "rb") as file:
            file.seek(self._read)
            data = file.read()
        data = data[: data.rfind(b"\n") + 1]
        self._read += len(data)
        return [message for line in data.splitlines() if (message := _message(line)) is not None]

    def _log_size(self) -> int:
        with contextlib.suppress(OSError):
            return (self.folder / "log.txt").stat().st_size
        return 0

    def _ended(self, status: int):
        self._close_stdin()
        self._process = None
        log = self.folder.log_tail(1)
        if self.facts["state"] in ENDED:
            pass
        elif self._stopping is not None:
            self.facts |= {"state": "stopped", "text": self._why}
        elif killed_from_outside(status, silent=self._log_size() == self._log_begin):
            text = "the process was killed from outside; if memory ran out, use fewer or smaller photographs"
            self.facts |= {"state": "interrupted", "text": text}
        else:
            why = log[0] if log else f"exit status {status}"
            self.facts |= {"state": "failed", "text": f"the job's process ended early: {why}"}
        # if the disk is full: a state that is not renewed counts as interrupted
        with contextlib.suppress(SceneError):
            self.folder.write_json("state.json", self.facts)
        self._stamp = self._state_stamp()


def _message(line: bytes) -> dict | None:
    try:
        message = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return message if isinstance(message, dict) and isinstance(message.get("type"), str) else None
