"""The child process of one background job: `python -m svrgs_addon.jobs.job_main FOLDER`. The parent's side is
job_process.py.

stdout: messages, one JSON object per line: STATUS {state, text}, PROGRESS {iteration, total, phase, count,
loss, psnr, seconds_left, or by blocks share}, PREVIEW {path}, DONE {result}, ERROR {text}.

The main thread prunes or trains. A second thread looks for the flag file every 0.05 s and renews state.json
every 2 s. Two things end the job:

- The flag file `stop`: the job saves a checkpoint and ends as "stopped".
- The end of stdin: the parent, for example Blender, is gone. The job saves a checkpoint and ends as
  "interrupted".

Both can be continued. Before the first step there is nothing to save, so both end the process at once; an
earlier checkpoint stays. While the result is measured, neither has an effect.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..system.errors import Cancelled, SceneError
from ..system.exit_status import guarded
from .job_folder import HEARTBEAT, PRUNE, STOP, TRAIN, JobFolder

POLL_EVERY = 0.05  # seconds between two checks for the flag file
TELL_EVERY = 0.25  # seconds between two PROGRESS messages


class JobMain:
    """Runs the job and writes its state to the folder and its messages to stdout. The main thread works; two
    others wait for the flag file and for the end of stdin."""

    def __init__(self, folder: JobFolder):
        self.folder = folder
        self.ending = ""  # state in which the job is to end before it is done; empty: go on
        self._state = {"state": "running", "pid": os.getpid()}
        self._stage = "preparing"  # then "looping", "finishing"
        self._lock = threading.Lock()
        self._parent_gone = threading.Event()
        self._written = self._told = 0.0

    def run(self) -> int:
        """The whole job; returns the exit status."""
        self.tell("STATUS", state="running", text="Reading the photographs")
        threading.Thread(target=self._wait_for_end_of_stdin, daemon=True).start()
        threading.Thread(target=self._poll_flag, daemon=True).start()
        problems: list[str] = []
        status = guarded(self._work, problems.append)
        if status:
            self.tell("ERROR", state="failed", text=problems[-1])
        return status

    def tell(self, kind: str, **facts):
        """Sends one message. All messages but PROGRESS are also written to state.json, which another Blender
        can read."""
        with self._lock:
            self._state |= facts
            if kind != "PROGRESS":
                self._write_state()
            _say(kind, facts)

    def _work(self) -> int:
        from ..prune.pipeline import prune_scene, train_scene
        from .job_recorder import RECORDERS

        kind, options = self.folder.kind, self.folder.options()
        if options.data is None:
            self.tell("STATUS", text="Rendering pictures of the splat")
        recorder = RECORDERS[kind](self.folder, self)
        run: Any = {PRUNE: prune_scene, TRAIN: train_scene}[kind]
        adapt = lambda job: replace(recorder.attached(job), stop=lambda: job.stop() or bool(self.ending))
        try:
            result = run(options, adapt)
        except Cancelled:
            recorder.flush()
            self.tell("STATUS", state=self.ending or "interrupted", text="")
            return 0
        self.tell("DONE", state="done", text="", result=recorder.finish(result))
        return 0

    def progress(self, stage: str, label: str, **facts):
        """The loop's progress, told now and then; stage: "looping", or "finishing" when nothing can be taken
        up again."""
        self._stage, now, finishing = stage, time.monotonic(), stage == "finishing"
        if finishing or now > self._told + TELL_EVERY:
            self._told = now
            facts["finishing"] = finishing
            self.tell("PROGRESS", **facts, text="Measuring the result" if finishing else label)

    def _poll_flag(self):
        while True:
            time.sleep(POLL_EVERY)
            with self._lock:
                if time.monotonic() > self._written + HEARTBEAT:
                    # the disk is full, or a program holds the file: this thread must go on
                    with contextlib.suppress(SceneError):
                        self._write_state()
            if self._stage == "finishing" or self.ending:
                continue
            stopped = (self.folder / STOP).exists()
            asked = "stopped" if stopped else "interrupted" if self._parent_gone.is_set() else ""
            if asked and self._stage == "preparing":
                self.tell("STATUS", state=asked, text="")
                os._exit(0)  # no file is damaged: every file is replaced as a whole
            elif asked:
                self.tell("STATUS", text="Saving what is done so far")
                self.ending = asked

    def _wait_for_end_of_stdin(self):
        # not sys.stdin.read(): it would hold a lock, and Python would abort when it ends
        while os.read(sys.stdin.fileno(), 1):
            pass
        self._parent_gone.set()

    def _write_state(self):
        self._written = time.monotonic()
        state = {name: value for name, value in self._state.items() if name != "result"}
        self.folder.write_json("state.json", state)


def _say(kind: str, facts: dict):
    try:
        print(json.dumps({"type": kind, **facts}), flush=True)
    except OSError:  # the reader of stdout is gone
        pass


def main(arguments: list[str]) -> int:
    folder = JobFolder(Path(arguments[0]))
    return guarded(lambda: _run(folder), lambda sentence: print(sentence, file=sys.stderr))


def _run(folder: JobFolder) -> int:
    folder.refuse_links()  # before anything is written
    return JobMain(folder).run()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
