"""The process of one job: `python -m svrgs_addon.jobs.job_main FOLDER`.

Messages on stdout, one JSON object a line: STATUS {state, text}, PROGRESS {iteration, total, phase, count, loss, psnr,
seconds_left}, PREVIEW {path}, DONE {result}, ERROR {text}. Flag files in the folder end it: `cancel` at once, `pause` after a
checkpoint. So does the end of stdin, which is that of whoever started it; the job is then interrupted and can go on.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

from ..errors import Cancelled
from ..exit_status import guarded
from .job_folder import CANCEL, HEARTBEAT, PAUSE, JobFolder

LOOK_EVERY = 0.05  # seconds between two looks for flags
TELL_EVERY = 0.25  # seconds between two reports of progress


class JobMain:
    """The job's state, told to the folder and to stdout; the main thread prunes, another one looks for flags and for orphanhood."""

    def __init__(self, folder: JobFolder):
        self.folder = folder
        self.ending = ""  # state the job shall end in before it is done
        self._state = {"state": "running", "pid": os.getpid()}
        self._stage = "preparing"  # then "looping", "finishing"
        self._lock = threading.Lock()
        self._parent_gone = threading.Event()
        self._written = self._told = 0.0

    def run(self) -> int:
        """The whole job; returns the exit status."""
        self.tell("STATUS", state="running", text="Reading the scene and its photographs")
        threading.Thread(target=self._wait_for_orphanhood, daemon=True).start()
        threading.Thread(target=self._watch, daemon=True).start()
        problems: list[str] = []
        status = guarded(self._prune, problems.append)
        if status:
            self.tell("ERROR", state="failed", text=problems[-1])
        return status

    def tell(self, kind: str, **facts):
        """One message; `state` and what else the panel shows of a job that another Blender started go into state.json too."""
        with self._lock:
            self._state |= facts
            if kind != "PROGRESS":
                self._write_state()
            _say(kind, facts)

    def _prune(self) -> int:
        from .job_recorder import JobRecorder
        from .run_job import prune_scene

        recorder = JobRecorder(self.folder, self)
        try:
            options = self.folder.options()
            result = prune_scene(
                options, lambda job: replace(job, begin=recorder.begin, observe=recorder.observe, stop=lambda: job.stop() or bool(self.ending))
            )
        except Cancelled:
            self.tell("STATUS", state=self.ending or "interrupted", text="")
            return 0
        self.tell("DONE", state="done", text="", result=recorder.finish(result))
        return 0

    def progress(self, stage: str, label: str, **facts):
        """The loop's progress, told now and then; stage: "looping", or "finishing" when nothing can be taken up again."""
        self._stage = stage
        now = time.monotonic()
        if now > self._told + TELL_EVERY or stage == "finishing":
            self._told = now
            self.tell("PROGRESS", **facts, text="Measuring the result" if stage == "finishing" else label)

    def _watch(self):
        while True:
            time.sleep(LOOK_EVERY)
            with self._lock:
                if time.monotonic() > self._written + HEARTBEAT:
                    self._write_state()
            if self._stage == "finishing":
                continue
            if (self.folder / CANCEL).exists():
                self._end_now("cancelled")
            if self.ending:
                continue
            asked = "paused" if (self.folder / PAUSE).exists() else "interrupted" if self._parent_gone.is_set() else ""
            if asked and self._stage == "preparing":
                self._end_now(asked)
            elif asked:
                self.tell("STATUS", text="Saving what is done so far")
                self.ending = asked

    def _end_now(self, state: str):
        """Nothing is lost: all files are replaced as a whole, and the last checkpoint stays."""
        self.tell("STATUS", state=state, text="")
        os._exit(0)

    def _wait_for_orphanhood(self):
        while os.read(sys.stdin.fileno(), 1):  # not sys.stdin, which this thread would hold: Python then aborts when it ends
            pass
        self._parent_gone.set()

    def _write_state(self):
        self._written = time.monotonic()
        self.folder.write_json("state.json", {name: value for name, value in self._state.items() if name != "result"})


def _say(kind: str, facts: dict):
    try:
        print(json.dumps({"type": kind, **facts}), flush=True)
    except OSError:  # nobody listens any more
        pass


def main(arguments: list[str]) -> int:
    return JobMain(JobFolder(Path(arguments[0]))).run()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
