"""The jobs of this Blender: which one is meant, and a timer that follows those that run.

The file knows of a job only the folder it lies in, as a property of its splat. Undo may take that away and copies have it too:
`links` remembers whose it is.
"""

from __future__ import annotations

import contextlib
import os

import bpy
from bpy.app.handlers import persistent

from ..svrgs_addon.errors import SplatError
from ..svrgs_addon.jobs.job_folder import JobFolder
from ..svrgs_addon.jobs.job_process import Job
from . import bridge, edit_guard, job_pictures, job_result
from .select import in_view_layer

FOLDER = "svrgs_job"  # property of a splat
BESIDE = "//svrgs_jobs"  # folder of jobs beside the file
EVERY = 0.2  # seconds between two looks
WAITING = ("paused", "cancelled", "interrupted", "failed")  # states that a job can go on from
BUSY = ("new", "starting", "running")

jobs: dict[str, Job] = {}  # by folder
links: dict[int, str] = {}  # by session_uid of a splat, which undo does not change: its FOLDER


# --- which job is meant


def job_of(obj: bpy.types.Object | None) -> Job | None:
    """The splat's job, as far as its folder is still there."""
    path = folder_of(obj)
    if not path:
        return None
    if path not in jobs:
        jobs[path] = Job(JobFolder(path))
    job = jobs[path]
    job.refresh()
    return job if job.state != "missing" else None


def folder_of(obj: bpy.types.Object | None) -> str:
    """Where the splat's job lies: where it was begun, or beside the file where both have moved; empty: it has none."""
    path = obj.get(FOLDER) if obj is not None else None
    if not isinstance(path, str) or not path:
        return ""
    beside = bpy.path.abspath(f"{BESIDE}/{os.path.basename(path)}") if bpy.data.filepath else path
    return beside if not os.path.exists(path) and os.path.exists(beside) else path


def current(context) -> tuple[bpy.types.Object | None, Job | None]:
    """(splat, its job): of the active object or the original it was pruned from; where that is no splat, the first that is not over."""
    original, _ = job_result.pair_of(context.object)
    for obj in (context.object, original):
        if (job := job_of(obj)) is not None and (job.state != "done" or job_result.pruned_of(obj) is None):
            return obj, job
    if bridge.is_splat(context.object):
        return None, None
    for obj in context.scene.objects:
        if FOLDER in obj and (job := job_of(obj)) is not None and job.state != "done":
            return obj, job
    return None, None


# --- whose job it is


def link(obj: bpy.types.Object, folder: str):
    """Makes the job in the folder the splat's."""
    obj[FOLDER] = links[obj.session_uid] = folder


def unlink(obj: bpy.types.Object):
    """Leaves the splat without a job."""
    obj.pop(FOLDER, None)
    links.pop(obj.session_uid, None)


@persistent
def _after_undo(*_):
    """Splats have the jobs they had before the undo."""
    for obj in bpy.data.objects:
        folder = links.get(obj.session_uid)
        if folder is not None and obj.get(FOLDER) != folder:
            obj[FOLDER] = folder


@persistent
def _after_update(scene, *_):
    """A copy of a splat has no part in its job; a splat that came with a file has its own."""
    for obj in scene.objects:
        if FOLDER in obj and not obj.library and links.get(obj.session_uid) != obj[FOLDER]:
            if _owned(obj[FOLDER]):
                del obj[FOLDER]
            else:
                links[obj.session_uid] = obj[FOLDER]


def _owned(folder: str) -> bool:
    """Whether a splat in the file is known to have this job."""
    return any(links.get(obj.session_uid) == folder and obj.users_collection for obj in bpy.data.objects)


# --- what follows the jobs


def tick() -> float | None:
    """Looks at every running job; None when there is none left."""
    for job in [job for job in jobs.values() if job.running]:
        try:
            _look_at(job)
        except Exception as error:  # of whatever kind: Blender drops a timer that raises, and no job would be followed any more
            job.abort(str(error) or type(error).__name__)
            redraw_panels()
    return EVERY if any(job.running for job in jobs.values()) else None


def _look_at(job: Job):
    if job.poll() or not job.running:
        job_pictures.redraw(job.folder)
        redraw_panels()
    if not job.running and job.state == "done":
        _arrived(job)


def follow():
    if not bpy.app.background and not bpy.app.timers.is_registered(tick):
        bpy.app.timers.register(tick, first_interval=EVERY, persistent=True)


def _arrived(job: Job):
    """Loads the result where its splat is at hand; else the panel offers it."""
    splats = [obj for obj in bpy.data.objects if obj.users_collection and folder_of(obj) == str(job.folder.path)]
    if not splats or edit_guard.problem(bpy.context, splats[0]):
        return
    with contextlib.suppress(SplatError, OSError):  # the Load button says it again
        finish(bpy.context, splats[0], job)
        if not bpy.app.background:
            bpy.ops.ed.undo_push(message="Prune Splat")


def finish(context, obj: bpy.types.Object, job: Job) -> bpy.types.Object:
    """Brings a finished job's result into the scene."""
    pruned = job_result.load(context, obj, job.folder)
    result = job.folder.result()
    psnr = [result[side].get("psnr") for side in ("before", "after")]
    if all(isinstance(value, float) for value in psnr):  # null where pictures and photographs are the same
        pruned[job_result.PSNR] = psnr
    pruned.svrgs_share = 100 * pruned[job_result.KEPT] / job.folder.request()["count"]
    if context.view_layer.objects.active == obj and in_view_layer(context, pruned):
        obj.select_set(False)
        pruned.select_set(True)
        context.view_layer.objects.active = pruned
    return pruned


def redraw_panels():
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


@persistent
def opened(*_):
    """After a file was opened: its jobs are looked at anew, those that run in this Blender stay. Its splats are others."""
    links.clear()
    for path in [path for path, job in jobs.items() if not job.running]:
        del jobs[path]


HANDLERS = {"load_post": opened, "undo_post": _after_undo, "redo_post": _after_undo, "depsgraph_update_post": _after_update}


def register():
    for event, handler in HANDLERS.items():
        getattr(bpy.app.handlers, event).append(handler)


def unregister():
    for event, handler in HANDLERS.items():
        getattr(bpy.app.handlers, event).remove(handler)
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
    for job in jobs.values():
        job.detach()
    jobs.clear()
    links.clear()
