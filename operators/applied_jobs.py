"""The files of a job whose result was applied are deleted when the .blend file is saved: from then on the result is in it.

Until then they stay, so that a crash loses nothing. An undo of Apply needs no files: marks and ranks are in the scene. After it, the
job belongs to its original again. If the file is never saved, the job list shows the job as finished.
"""

from __future__ import annotations

import os

import bpy
from bpy.app.handlers import persistent

from . import job_result
from .job import delete_job
from .job_queue import jobs
from .job_watch import job_of, owner_of, unlink

_folders: dict[int, str] = {}  # by session_uid of the applied splat: the folder of its job


def note(original: bpy.types.Object | None, pruned: bpy.types.Object):
    """After Apply: the original has no job any more. The files go when the file is saved."""
    job = job_of(original)
    if original is not None and job is not None and job.state == "done":
        _folders[pruned.session_uid] = str(job.folder.path)
        unlink(original)


def is_applied(folder: str) -> bool:
    """Whether the result of the job in this folder was applied, and is in the file."""
    return any(_folders.get(obj.session_uid) == folder for obj in _applied())


def _applied() -> list[bpy.types.Object]:
    """The applied splats in the file that have a job."""
    return [obj for obj in bpy.data.objects if obj.session_uid in _folders and obj.users_collection and not job_result.undecided(obj)]


@persistent
def _after_undo(*_):
    """After a redo of Apply, the original has no job again."""
    for obj in _applied():
        owner = owner_of(_folders[obj.session_uid])
        if owner is not None:
            unlink(owner)


@persistent
def _after_save(path: str = "", *_):
    """Deletes the files, unless only a copy was saved."""
    if not bpy.data.filepath or (path and os.path.abspath(path) != os.path.abspath(bpy.data.filepath)):
        return
    for obj in _applied():
        job = jobs.get(_folders.pop(obj.session_uid))
        if job is not None and job.state == "done":
            try:
                delete_job(job)
            except OSError as error:  # the job list shows the job
                print(f"SVR-GS: {error}", flush=True)


@persistent
def _after_load(*_):
    _folders.clear()


HANDLERS = {"save_post": _after_save, "load_post": _after_load, "undo_post": _after_undo, "redo_post": _after_undo}


def register():
    for event, handler in HANDLERS.items():
        getattr(bpy.app.handlers, event).append(handler)


def unregister():
    for event, handler in HANDLERS.items():
        getattr(bpy.app.handlers, event).remove(handler)
    _folders.clear()
