"""Which job belongs to which splat, and a timer that follows the jobs that run.

The .blend file stores only the path of a job's folder, as a property of its splat. Undo may remove this
property, and a copy of the splat has it too. So data/known.py remembers which splat has which folder: after
an undo the property is put back, and it is removed from a copy. Undo takes no job away; a copy of a splat has
no job.

An error with one job fails that job alone; the timer goes on with the others.
"""

from __future__ import annotations

import contextlib

import bpy
from bpy.app.handlers import persistent
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.jobs.job_folder import TRAIN, JobFolder
from ...svrgs_addon.jobs.job_process import Job
from ...svrgs_addon.system.errors import FormatError, SplatError
from ..data import edit_guard, known, splat_object
from ..data.child_work import redraw_panels
from ..data.job_paths import FOLDER, folder_of
from ..data.select import in_view_layer
from . import job_pictures, job_queue, job_result, train_result
from .job_queue import jobs

INTERVAL = 0.2  # seconds between two calls of the timer
# states in which a job can be resumed, unless it is in the queue
RESUMABLE = ("queued", "stopped", "interrupted", "failed")
BUSY = ("new", "starting", "running")


# --- the job of a splat


def is_busy(job: Job) -> bool:
    """Whether the job runs, in any Blender, or waits in the queue."""
    return job.state in BUSY or job_queue.is_queued(job)


def is_resumable(job: Job) -> bool:
    return job.state in RESUMABLE and not job_queue.is_queued(job)


def job_of(obj: bpy.types.Object | None) -> Job | None:
    """The splat's job; None if it has none, or if the job's folder is gone."""
    path = folder_of(obj)
    if not path:
        return None
    if path not in jobs:
        jobs[path] = Job(JobFolder(path))
    job = jobs[path]
    job.refresh()
    return job if job.state != "missing" else None


def keeps(obj: bpy.types.Object) -> str:
    """Why the splat must keep its Gaussians for a job or its result, in a sentence; '' if it need not."""
    _, pruned = job_result.pair_of(obj)
    if job_result.undecided(pruned):
        return tr("Apply or discard the pruning result of '{name}' first").format(name=obj.name)
    job = job_of(obj)
    if job is not None and (is_busy(job) or is_resumable(job)):
        text = tr("A pruning job belongs to '{name}': wait for it, or discard it first")
        return text.format(name=obj.name)
    return ""


def current(context) -> tuple[bpy.types.Object, Job] | None:
    """(splat, its job): of the active object, or of the original it was pruned from. If no splat is active:
    the first job that is not done.

    None if there is no such job.
    """
    original, pruned = job_result.pair_of(context.object)
    for obj in (context.object, original if job_result.undecided(pruned) else None):
        if (job := job_of(obj)) is not None and (
            job.state != "done" or not job_result.undecided(job_result.pruned_of(obj))
        ):
            return obj, job
    if splat_object.is_splat(context.object):
        return None
    for obj in context.scene.objects:
        if FOLDER in obj and (job := job_of(obj)) is not None and job.state != "done":
            return obj, job
    return None


# --- links between splats and jobs


def link(obj: bpy.types.Object, folder: str):
    """Gives the splat the job in this folder."""
    obj[FOLDER] = known.of(obj).job = folder


def unlink(obj: bpy.types.Object):
    """Takes the splat's job away."""
    obj.pop(FOLDER, None)
    known.of(obj).job = ""


def delete_job(job: Job):
    """Deletes the files of a job that has ended or waits, and takes it from its splat or its cameras. Raises
    OSError."""
    job_queue.leave(job)
    with contextlib.suppress(FormatError):  # the files are gone already
        job.folder.discard()
    jobs.pop(str(job.folder.path), None)
    for obj in bpy.data.objects:
        if folder_of(obj) == str(job.folder.path):
            unlink(obj)


@persistent
def _after_undo(*_):
    """Gives splats back the jobs that they had before the undo."""
    for obj in bpy.data.objects:
        folder = known.of(obj).job
        if folder and folder_of(obj) != folder:
            obj[FOLDER] = folder


@persistent
def _after_update(scene, *_):
    """Takes the job away from a copy of a splat. A splat that was loaded or appended with its job keeps
    it."""
    for obj in scene.objects:
        folder = folder_of(obj)
        if folder and not obj.library and known.of(obj).job != folder:
            if owner_of(folder) is not None:
                del obj[FOLDER]
            else:
                known.of(obj).job = folder


def owner_of(folder: str) -> bpy.types.Object | None:
    """The splat in the file that is known to have the job in this folder."""
    return next(
        (obj for obj in bpy.data.objects if known.of(obj).job == folder and obj.users_collection),
        None,
    )


# --- the timer


def tick() -> float | None:
    """Reads the messages of every running job, and starts the next one of the queue. Returns the seconds
    until the next call; None if no job is left."""
    for job in [job for job in jobs.values() if job.running]:
        try:
            _update(job)
        # any error: Blender removes a timer that raises, and then no job would be followed
        except Exception as error:
            job.abort(str(error) or type(error).__name__)
            redraw_panels()
    return INTERVAL if job_queue.advance() else None


def _update(job: Job):
    if job.poll() or not job.running:
        job_pictures.redraw(job.folder)
        redraw_panels()
    if not job.running and job.state == "done":
        _load_if_possible(job)


def start_timer():
    """Follows the running jobs from now on. Without a window there are no timers."""
    if not bpy.app.background and not bpy.app.timers.is_registered(tick):
        bpy.app.timers.register(tick, first_interval=INTERVAL, persistent=True)


def _load_if_possible(job: Job):
    """Loads the result if its splat is there and can be changed. If not, the panel offers Load Result."""
    splats = [
        obj for obj in bpy.data.objects if obj.users_collection and folder_of(obj) == str(job.folder.path)
    ]
    if not splats or edit_guard.problem(bpy.context, splats[0]):
        return
    with contextlib.suppress(SplatError, OSError):  # the button Load Result reports the error
        load_result(bpy.context, splats[0], job)
        if not bpy.app.background:
            bpy.ops.ed.undo_push(message="Train Splat" if job.folder.kind == TRAIN else "Prune Splat")


def load_result(context, obj: bpy.types.Object, job: Job) -> bpy.types.Object:
    """Adds the result of a finished job to the scene. obj: the splat that was pruned, or the root of the
    cameras that a splat was trained from."""
    if job.folder.kind == TRAIN:
        trained = train_result.load(context, obj, job.folder)
        known.of(trained).result_of = str(job.folder.path)
        unlink(obj)
        return trained
    pruned = job_result.load(context, obj, job.folder)
    result = job.folder.result()
    psnr = [result[side].get("psnr") for side in ("before", "after")]
    if all(isinstance(value, float) for value in psnr):  # null if images and photographs are identical
        pruned[job_result.PSNR] = psnr
    elif isinstance(psnr[1], float):  # the photographs were pictures of the original
        pruned[job_result.OWN_PSNR] = psnr[1]
    if notes := result.get("notes"):
        pruned[job_result.NOTES] = "\n".join(map(str, notes))
    pruned.svrgs_share = 100 * pruned[job_result.KEPT] / job.folder.request()["count"]
    if context.view_layer.objects.active == obj and in_view_layer(context, pruned):
        obj.select_set(False)
        pruned.select_set(True)
        context.view_layer.objects.active = pruned
    return pruned


@persistent
def _after_load(*_):
    """Another file has been opened: only the jobs that run or wait in this Blender stay."""
    job_queue.forget_ended()


HANDLERS = {
    "load_post": _after_load,
    "undo_post": _after_undo,
    "redo_post": _after_undo,
    "depsgraph_update_post": _after_update,
}
TIMERS = (tick,)


def register():
    edit_guard.reasons.append(keeps)


def unregister():
    edit_guard.reasons.remove(keeps)
    job_queue.forget_all()
