"""Which tasks of a job by blocks are finished, and the share of the job that is done.

tasks.json, beside the blocks, holds the finished tasks. A job that was stopped or killed does only the others
when it is continued.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from ...files.atomic import write_json
from ...files.reading import json_object
from ...system.errors import OtherRun

if TYPE_CHECKING:  # jobs of Blender need no more of it
    from .divided import Progress, ProgressOf

FILE, LARGEST = "tasks.json", 1 << 22
# Where steps begin and end, as shares from 0 to 1, roughly as with the town of 5 million in docs/farm.md.
# ONCE: steps at the start of a job that removes and merges, of the job. EACH: its other steps, of the time
# for the result or for one level of detail. OF_TASK: steps of a method on photographs, of their task.
ONCE = {"divide": (0.0, 0.03), "score": (0.03, 0.35), "merge": (0.35, 0.45)}
OF_TASK = {
    "score": (0.0, 0.8),
    "merge": (0.8, 1.0),
    "compare": (0.0, 0.4),
    "read": (0.4, 0.5),
    "measure": (0.5, 1.0),
}
EACH = {
    "cut": (0.0, 0.1),
    "tune": (0.1, 0.7),
    "compare": (0.7, 0.8),
    "read": (0.8, 0.85),
    "measure": (0.85, 1.0),
}


class Tasks:
    """done: the tasks that are done, and the number that each has found, if any; empty in a job that begins.
    total: how many tasks the job has, 0 as long as that is not known."""

    def __init__(self, folder: Path, identity: str, resume: bool):
        """identity: of settings and inputs. Raises FormatError if the job in the folder is another one."""
        self._path, self._identity = folder / FILE, identity
        self.total, self.done = 0, dict[str, int | None]()
        found = _read(self._path) if resume else None
        if found is None:
            self._path.unlink(missing_ok=True)
        elif found["identity"] != identity:
            raise OtherRun(
                f"{self._path}: this job is one with other settings or inputs; delete {folder} to start again"
            )
        else:
            self.done = found["done"]

    def span(self, step: str) -> tuple[float, float]:
        """The shares of the job at which a step of the next task begins and ends. Measuring the result counts
        as one more task. Zeros while `total` is 0."""
        done, tasks = len(self.done), self.total + 1
        start, end = OF_TASK.get(step, (0.0, 1.0))
        return ((done + start) / tasks, (done + end) / tasks) if self.total else (0.0, 0.0)

    def once(self, name: str, work: Callable[[], int | None]) -> int | None:
        """Does a task, unless it is done. Returns what it finds, or has found."""
        if name not in self.done:
            self.done[name] = work()
            write_json(self._path, {"identity": self._identity, "total": self.total, "done": self.done})
        return self.done[name]


class Rounds:
    """The steps of a job that removes and merges, which come in rounds."""

    def __init__(self, rounds: int):
        """rounds: how often a scene is cut, tuned and measured: for the result and for each level of
        detail."""
        self._rounds, self._round = rounds, -1

    def span(self, step: str) -> tuple[float, float]:
        """The shares of the job at which a step begins and ends; zeros for one that comes at different
        times."""
        self._round += step == "cut"
        if step in ONCE or step not in EACH:
            return ONCE.get(step, (0.0, 0.0))
        first = max(ends for _, ends in ONCE.values())
        start, end = (
            first + (1 - first) * (max(0, self._round) + share) / self._rounds for share in EACH[step]
        )
        return start, end


class Overall:
    """Reports the share of the whole job instead of that of a step. It never falls, because steps come
    again."""

    def __init__(self, progress_of: ProgressOf, span: Callable[[str], tuple[float, float]]):
        """progress_of: of the name of a step. span: Tasks.span or Rounds.span."""
        self._progress_of, self._span, self._most = progress_of, span, 0.0

    def __call__(self, step: str) -> Progress:
        progress, (start, end) = self._progress_of(step), self._span(step)

        def of_job(text: str, share: float):
            self._most = max(self._most, start + (end - start) * share)
            progress(text, self._most)

        return of_job


def progress(folder: Path) -> tuple[int, int]:
    """How many tasks of the job in a folder are done, and how many it has, 0 if that is not known."""
    found = _read(folder / FILE)
    return (len(found["done"]), found["total"]) if found else (0, 0)


def _read(path: Path) -> dict | None:
    """None if there is none, or if it is damaged: then the job begins again."""
    try:
        found = json_object(path, LARGEST) or {}
    except OSError:
        return None
    done = found.get("done")
    numbers = isinstance(done, dict) and all(isinstance(one, int | None) for one in done.values())
    whole = numbers and isinstance(found.get("identity"), str) and isinstance(found.get("total"), int)
    return found if whole else None
