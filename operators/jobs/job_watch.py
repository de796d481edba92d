"""The jobs of splats, and a timer that follows those that run. An error with one job fails that job alone;
the timer goes on with the others."""

from __future__ import annotations

import contextlib
import traceback

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.jobs.job_folder import TRAIN, JobFolder
from ...svrgs_addon.jobs.job_process import Job
from ...svrgs_addon.system.errors import FormatError
from ..data import edit_guard, splat_object
from ..data.background_work import redraw_panels, watch
from ..data.job_paths import folder_of, link, owners, unlink
from . import job_pictures, job_queue, job_result, job_state
from .job_queue import jobs

# --- the job of a splat


def job_of(obj: bpy.types.Object | None) -> Job | None:
    """The splat's job; None if it has none, or if the job's folder is gone."""
    folder = folder_of(obj)
    job = job_queue.job_in(folder) if folder else None
    return job if job is not None and job.state != "missing" else None


def keeps(obj: bpy.types.Object) -> str:
    """Why the splat must keep its Gaussians for a job or its result, in a sentence; '' if it need not."""
    _, pruned = job_result.pair_of(obj)
    if job_result.undecided(pruned):
        return tr("Apply or discard the pruning result of '{name}' first").format(name=obj.name)
    job = job_of(obj)
    if job is not None and (job_state.is_busy(job) or job_state.is_resumable(job)):
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
        if (job := job_of(obj)) is not None and job.state != "done":
            return obj, job
    return None


def begin(obj: bpy.types.Object, folder: JobFolder) -> str:
    """Gives the splat a new job and starts it, or lets it wait. Returns what it waits for, in a sentence, or
    ''. Raises SplatError, OSError."""
    link(obj, str(folder.path))
    waits = job_queue.start(Job(folder))
    watch(tick)
    return waits


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


# --- the timer


def tick() -> bool:
    """Called by the timer: reads the messages of every running job, and starts the next one of the queue.
    Returns whether a job is left."""
    for job in [job for job in jobs.values() if job.running]:
        try:
            _update(job)
        except Exception as error:  # any error: the other jobs are followed
            job.abort(str(error) or type(error).__name__)
            job_queue.note_end(job)
            redraw_panels()
    return job_queue.advance()


def _update(job: Job):
    if job.poll() or not job.running:
        job_pictures.redraw(job.folder)
        redraw_panels()
    if not job.running:
        job_queue.note_end(job)
    if not job.running and job.state == "done":
        _load_if_possible(job)


def _load_if_possible(job: Job):
    """Loads the result if its splat is there and can be changed. If not, the panel offers Load Result."""
    owner = owners().get(str(job.folder.path))
    if owner is None or edit_guard.problem(bpy.context, owner):
        return
    try:
        job_result.load(bpy.context, owner, job.folder)
        if not bpy.app.background:
            bpy.ops.ed.undo_push(message="Train Splat" if job.folder.kind == TRAIN else "Prune Splat")
    except Exception:  # the job has ended well; the button Load Result reports the error
        traceback.print_exc()


edit_guard.reasons.append(keeps)
