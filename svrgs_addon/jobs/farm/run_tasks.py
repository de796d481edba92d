"""Runs tasks of a farm job. Each may be run again at any time: what is done stays, and what was interrupted
goes on from its last checkpoint."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ...files.atomic import write_json
from ...files.digests import scene_sha256, sha256
from ...prune.context import JobContext
from ...prune.pipeline import prune_scene
from ...prune.plans import mask_options
from ...system.errors import OtherRun, SceneError, SplatError
from ...views.colmap_files import MODEL_FILES
from ...views.sources import read_source
from ...views.transforms_json import PARSER_NAME
from ...views.valid_pixels import MaskOptions, masks_of
from .engine_messages import Messages
from .farm_job import FarmJob, Task


def run_tasks(job: FarmJob, numbers: Sequence[int], messages: Messages) -> list[dict[str, Any]]:
    """Runs the tasks with these numbers, one after the other. Returns for each its name, output and SHA-256,
    and whether it was done before. Raises SplatError after the last one, with the name of the task that
    failed; Cancelled if stopped, after a checkpoint."""
    done, failed = list[dict[str, Any]](), list[SplatError]()
    for place, number in enumerate(numbers):
        try:
            done.append(_run(job, job.tasks[number], messages.within(place, len(numbers))))
        except SplatError as error:  # the others are done all the same
            failed.append(error)
            logging.error("%s", error)
    if len(failed) > 1:
        raise SceneError(f"{len(failed)} of {len(numbers)} tasks failed; the first one: {failed[0]}")
    if failed:
        raise failed[0]
    return done


def numbers_of(words: str, count: int) -> list[int]:
    """Whole numbers of tasks below `count`, from a text such as '3', '0-7' or '0-3,8'. Raises SceneError."""
    numbers: list[int] = []
    for part in words.split(","):
        first, _, last = part.strip().partition("-")
        if (
            not first.isdecimal()
            or not (last or first).isdecimal()
            or not int(first) <= int(last or first) < count
        ):
            raise SceneError(
                f"--tasks {words}: is no list of tasks such as 0-3,8; the job has the tasks 0 to {count - 1}"
            )
        numbers += range(int(first), int(last or first) + 1)
    return numbers


def _run(job: FarmJob, task: Task, messages: Messages) -> dict[str, Any]:
    out, done, options = job.out(task), job.result(task), job.options(task)
    assert options.scene is not None
    inputs = {
        "scene_sha256": scene_sha256(options.scene),
        "dataset_sha256": dataset_sha256(options.data, options.images, mask_options(options)),
        "cameras_sha256": sha256(options.cameras) if options.cameras and options.cameras.is_file() else "",
    }
    if (
        done
        and done.get("sha256") == sha256(out)
        and all(done.get(name) == digest for name, digest in inputs.items())
    ):
        messages.tell(f"{task.name}: is done already", 1.0)
        return {"name": task.name, "out": str(out), "sha256": done["sha256"], "done_before": True}
    messages.tell(f"{task.name}: reads {task.scene}", 0.0)

    def observed(context: JobContext) -> JobContext:  # after the door
        job.result_path(task).unlink(missing_ok=True)
        part = lambda text, share: messages.progress(f"{task.name}: {text}", share)
        observe = lambda reached: part(reached.phase, reached.iteration / reached.total)
        return replace(context, observe=observe, part=part)

    try:
        try:
            result = prune_scene(options, observed)
        except OtherRun:
            messages.tell(f"{task.name}: begins again, as its settings or inputs have changed", 0.0)
            result = prune_scene(replace(options, resume=False), observed)
    except SplatError as error:
        raise type(error)(f"task {task.name}: {error}") from None
    digest = sha256(out)
    facts = {"task": {"scene": task.scene, "options": task.options}, **inputs, "sha256": digest}
    write_json(job.result_path(task), facts | {"result": result}, indented=True)
    before, after = result["before"]["count"], result["after"]["count"]
    messages.tell(f"{task.name}: keeps {after:,} of {before:,} Gaussians", 1.0)
    return {"name": task.name, "out": str(out), "sha256": digest, "done_before": False}


def dataset_sha256(folder: Path | None, images: str, options: MaskOptions = MaskOptions()) -> str:
    """Of a dataset, in hexadecimal digits: of the files of its cameras, and of its photographs and their
    masks. Empty if there is none, or if it cannot be read; the task then says so."""
    if folder is None:
        return ""
    try:
        source = read_source(folder, images or None)
        masks = source.image_folder and masks_of(options, source.image_folder, source.masks)
    except SplatError:
        return ""
    files = (
        [source.location]
        if source.location.is_file()
        else sorted(one for one in source.location.iterdir() if one.stem in MODEL_FILES)
    )
    parser = source.location.with_name(PARSER_NAME)  # of Nerfstudio, beside a transforms.json
    files += [parser] if source.location.is_file() and parser.is_file() else []
    facts = [sha256(one) for one in files]
    if source.image_folder is not None:
        photographs = sorted(one for one in source.image_folder.rglob("*") if one.is_file())
        facts += [f"{one.relative_to(source.image_folder).as_posix()} {sha256(one)}" for one in photographs]
    if masks:
        found = (masks.file(view.name) for view in source.model.views)
        facts += [sha256(one) if one is not None else "" for one in found]
    return hashlib.sha256("\n".join(facts).encode(errors="surrogateescape")).hexdigest()
