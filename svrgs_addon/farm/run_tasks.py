"""Runs tasks of a farm job. Each may be run again at any time: what is done stays, and what was interrupted goes on from its last checkpoint."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..errors import SceneError, SplatError
from ..finetune.loop import Progress
from ..jobs.context import JobContext
from ..jobs.run_job import prune_scene
from .engine_messages import Messages
from .farm_job import FarmJob, Task, write_json


def run_tasks(job: FarmJob, numbers: Sequence[int], messages: Messages) -> list[dict[str, Any]]:
    """Runs the tasks with these numbers, one after the other. Returns for each its name, output and SHA-256, and whether it was done before. Raises
    SplatError, with the name of the task; Cancelled if stopped, after a checkpoint."""
    return [_run(job, job.tasks[number], messages.within(place, len(numbers))) for place, number in enumerate(numbers)]


def numbers_of(words: str, count: int) -> list[int]:
    """Whole numbers of tasks below `count`, from a text such as '3', '0-7' or '0-3,8'. Raises SceneError."""
    numbers: list[int] = []
    for part in words.split(","):
        first, _, last = part.strip().partition("-")
        if not first.isdecimal() or not (last or first).isdecimal() or not int(first) <= int(last or first) < count:
            raise SceneError(f"--tasks {words}: is no list of tasks such as 0-3,8; the job has the tasks 0 to {count - 1}")
        numbers += range(int(first), int(last or first) + 1)
    return numbers


def _run(job: FarmJob, task: Task, messages: Messages) -> dict[str, Any]:
    out, done = job.out(task), job.result(task)
    if done and done.get("sha256") == sha256(out):
        messages.tell(f"{task.name}: is done already", 1.0)
        return {"name": task.name, "out": str(out), "sha256": done["sha256"], "done_before": True}
    job.result_path(task).unlink(missing_ok=True)
    messages.tell(f"{task.name}: reads {task.scene}", 0.0)

    def observed(context: JobContext) -> JobContext:
        def observe(progress: Progress):
            messages.progress(f"{task.name}: {progress.phase}", progress.iteration / progress.total)

        return replace(context, observe=observe)

    try:
        result = prune_scene(job.options(task), observed)
    except SplatError as error:
        raise type(error)(f"task {task.name}: {error}") from None
    digest = sha256(out)
    write_json(job.result_path(task), {"task": {"scene": task.scene, "options": task.options}, "sha256": digest, "result": result})
    messages.tell(f"{task.name}: keeps {result['after']['count']:,} of {result['before']['count']:,} Gaussians", 1.0)
    return {"name": task.name, "out": str(out), "sha256": digest, "done_before": False}


def sha256(path: Path) -> str:
    """Of a file, in hexadecimal digits."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
