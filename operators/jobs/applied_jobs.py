"""The files of a job are deleted when the .blend file is saved and its result, applied or trained, is in it.

Until then they stay, so that a crash loses nothing. An undo of Apply needs no files: marks and ranks are in
the scene. After it, the job belongs to its original again. If the file is never saved, the job list shows the
job as finished.
"""

from __future__ import annotations

import os

import bpy

from ..data import known
from ..data.job_paths import owners, unlink
from . import job_result
from .job_queue import jobs
from .job_watch import delete_job, job_of


def note(original: bpy.types.Object | None, pruned: bpy.types.Object):
    """After Apply: the original has no job any more. The files go when the file is saved."""
    job = job_of(original)
    if original is not None and job is not None and job.state == "done":
        known.of(pruned).result_of = str(job.folder.path)
        unlink(original)


def is_applied(folder: str) -> bool:
    """Whether the result of the job in this folder is in the file, and its files are deleted when that is
    saved."""
    return any(known.of(obj).result_of == folder for obj in _applied())


def _applied() -> list[bpy.types.Object]:
    """The applied and the trained splats in the file that still have a job."""
    results = (obj for obj in bpy.data.objects if known.of(obj).result_of and obj.users_collection)
    return [obj for obj in results if not job_result.undecided(obj)]


def _after_undo(*_):
    """After a redo, what had the job does not have it again."""
    known_owners = owners()
    for obj in _applied():
        if (owner := known_owners.get(known.of(obj).result_of)) is not None:
            unlink(owner)


def _after_save(path: str = "", *_):
    """Deletes the files, unless only a copy was saved."""
    if not bpy.data.filepath or (path and os.path.abspath(path) != os.path.abspath(bpy.data.filepath)):
        return
    for obj in _applied():
        job = jobs.get(known.of(obj).result_of)
        known.of(obj).result_of = ""
        if job is not None and job.state == "done":
            try:
                delete_job(job)
            except OSError as error:  # the job list shows the job
                print(f"SVR-GS: {error}", flush=True)


HANDLERS = {"save_post": _after_save, "undo_post": _after_undo, "redo_post": _after_undo}
