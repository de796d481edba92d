"""The list of all jobs that this Blender knows: those of the open file, and those in the folders in which
jobs are made.

The owner of a job is the splat that it prunes, or the root of the cameras from which it trains one. A job
without its owner in the file is an orphan. It can be stopped, continued and opened like the others
(orphan_jobs.py: if its splat comes back).

The folders are read again every SCAN_EVERY seconds while a panel asks.
"""

from __future__ import annotations

import contextlib
import os
import time

import bpy
from bpy.app.handlers import persistent
from bpy.app.translations import pgettext_iface as tr
from bpy.app.translations import pgettext_n as n_
from bpy.props import StringProperty

from ...svrgs_addon.files.registry import read_scene
from ...svrgs_addon.jobs.job_folder import TRAIN, JobFolder
from ...svrgs_addon.jobs.job_process import Job
from ...svrgs_addon.system.errors import SplatError
from ...svrgs_addon.system.memory import size_text
from ..data import edit_guard, splat_object
from ..data.job_paths import folder_of
from ..data.reporting import ReportingOperator
from ..data.select import select
from ..scene import dataset_paths
from . import applied_jobs, job_queue, job_result
from .job import job_folders, resume, stop, stop_problem
from .job_queue import jobs
from .job_watch import delete_job, is_busy, is_resumable, load_result

SCAN_EVERY = 3.0  # seconds between two readings of the folders
STATES = {  # state -> its words, and those with a progress
    "stopped": (n_("Stopped"), n_("Stopped at {share:.0%}")), "interrupted": (n_("Interrupted"),
    n_("Interrupted at {share:.0%}")),
    "failed": (n_("Failed"), n_("Failed at {share:.0%}")), "queued": (n_("Not started yet"),
    n_("Not started yet")),
    "running": (n_("Running"), n_("Running at {share:.0%}")), "stopping": (n_("Stopping"),
    n_("Stopping at {share:.0%}")),
}  # fmt: skip
UNKNOWN = n_("In an unknown state"), n_("In an unknown state")
# others: PAUSE, or PLAY while it runs
ICONS = {"done": "CHECKMARK", "failed": "ERROR", "interrupted": "ERROR"}

_read: dict[str, Job] = {}  # by folder: jobs that were found in a folder and have no splat in the file
_sizes: dict[str, int] = {}  # by folder: bytes on disk
_scanned = [0.0]  # time.monotonic() of the last reading


def all_jobs(context) -> list[Job]:
    """Every job that is known. Those that run come first, then those that wait, then the newest."""
    if time.monotonic() > _scanned[0] + SCAN_EVERY:
        _scan(context)
    found = [job for folder in _sizes.keys() | jobs.keys() if (job := job_in(folder)).state != "missing"]
    return sorted(found, key=lambda job: (not job.running, not is_busy(job), -_begun(job)))


@persistent
def _after_load(*_):
    forget()


def forget():
    """The folders are read again when a panel asks the next time."""
    _scanned[0] = 0.0


def _scan(context):
    _scanned[0] = time.monotonic()
    folders = {folder_of(obj) for obj in bpy.data.objects} - {""} | jobs.keys()
    for parent in job_folders(context):
        with contextlib.suppress(OSError), os.scandir(parent) as entries:  # mostly there is none yet
            folders |= {
                entry.path
                for entry in entries
                if entry.is_dir() and os.path.isfile(os.path.join(entry.path, "job.json"))
            }
    _sizes.clear()
    _sizes.update({folder: JobFolder(folder).size() for folder in folders})
    for folder in _read.keys() - folders:
        del _read[folder]


def job_in(folder: str) -> Job:
    """The job in a folder."""
    if folder not in jobs and folder not in _read:
        _read[folder] = Job(JobFolder(folder))
    job = jobs.get(folder) or _read[folder]
    job.refresh()
    return job


def _begun(job: Job) -> float:
    try:
        return os.path.getmtime(job.folder / "job.json")
    except OSError:
        return 0.0


def owners() -> dict[str, bpy.types.Object]:
    """The splats and roots in the file that have a job, by its folder."""
    return {folder: obj for obj in bpy.data.objects if obj.users_collection and (folder := folder_of(obj))}


# --- what the panel shows


def row(job: Job, splat: bpy.types.Object | None) -> dict:
    """Of a job and its owner in the file: folder, name of the splat, the state in words, size and what is
    missing, icon, and the buttons that fit."""
    folder = str(job.folder.path)
    applied = applied_jobs.is_applied(folder)
    buttons = ["stop"] if is_busy(job) and not stop_problem(job) else ["resume"] if is_resumable(job) else []
    buttons += ["open"] * (job.state == "done" and not applied and not _is_loaded(splat))
    buttons += ["delete"] * (not is_busy(job))
    missing = (
        tr("its cameras are not in this file") if job.kind == TRAIN else tr("its splat is not in this file")
    )
    where = "" if splat is not None or applied else missing
    icon = (
        ("PLAY" if not job_queue.is_queued(job) else "SORTTIME")
        if is_busy(job)
        else ICONS.get(job.state, "PAUSE")
    )
    loaded = tr("its result is in this file") if _is_loaded(splat) else ""
    state = (
        tr("Finished: its files are deleted when the file is saved")
        if applied
        else ", ".join(filter(None, (state_text(job), loaded)))
    )
    size = ", ".join(filter(None, (size_text(_sizes[folder]) if _sizes.get(folder) else "", where)))
    return {
        "folder": folder,
        "name": splat.name if splat is not None else job.name,
        "state": state,
        "size": size,
        "icon": icon,
        "buttons": buttons,
    }


def state_text(job: Job) -> str:
    """The state of the job in words, with its progress."""
    if job_queue.is_queued(job):
        return job_queue.waiting_text(job)
    if job.state == "done":
        return tr("Finished")
    state = ("stopping" if job.stopping else "running") if is_busy(job) else job.state
    text = tr(STATES.get(state, UNKNOWN)[job.knows_progress]).format(share=job.progress)
    if is_busy(job):
        return text if job.running else ", ".join((text, tr("in another Blender")))
    reason = job.facts.get("text") if job.state == "failed" else ""
    return ": ".join((text, tr(reason))) if reason else text


def _is_loaded(splat: bpy.types.Object | None, orphan: bool = False) -> bool:
    """Whether the result is beside the splat. orphan: the answer without a splat."""
    return orphan if splat is None else job_result.undecided(job_result.pruned_of(splat))


# --- operators


class ListedJobOperator(ReportingOperator):
    """Works on the job in a folder."""

    folder: StringProperty(name="Folder", options={"HIDDEN", "SKIP_SAVE"}, description="Folder of the job")

    def work(self, context) -> str:
        job = job_in(self.folder)
        if job.state == "missing":
            forget()
            raise SplatError(tr("{folder}: holds no job any more").format(folder=self.folder))
        try:
            return self.work_on(context, job)
        finally:
            forget()


class SVRGS_OT_listed_job_stop(ListedJobOperator):
    bl_idname = "svrgs.listed_job_stop"
    bl_label = "Stop Job"
    bl_description = "Save a checkpoint and stop this job, or take it out of the queue. Resume continues it"

    def work_on(self, context, job: Job) -> str:
        if problem := stop_problem(job):
            raise SplatError(problem)
        return stop(job, now=job.stopping)


class SVRGS_OT_listed_job_resume(ListedJobOperator):
    bl_idname = "svrgs.listed_job_resume"
    bl_label = "Resume Job"
    bl_description = "Continue this job from its last checkpoint. While another job runs, it waits"

    def work_on(self, context, job: Job) -> str:
        if not is_resumable(job):
            raise SplatError(tr("'{name}' does not wait to be resumed").format(name=job.name))
        return resume(job, dataset_paths.dataset_of_job(context, owners().get(self.folder)))


class SVRGS_OT_listed_job_open(ListedJobOperator):
    bl_idname = "svrgs.listed_job_open"
    bl_label = "Open Result"
    bl_description = (
        "Load the result of this job: beside its splat, or as a new splat if that is not in the file. Of a"
        " training: beside its cameras"
    )
    bl_options = {"REGISTER", "UNDO"}

    def work_on(self, context, job: Job) -> str:
        if job.state != "done":
            raise SplatError(tr("'{name}' has no result yet").format(name=job.name))
        splat = owners().get(str(job.folder.path))
        problem = (
            edit_guard.problem(context, splat)
            if splat is not None
            else tr("Leave Edit Mode first")
            if context.mode != "OBJECT"
            else ""
        )
        if problem:
            raise SplatError(problem)
        if splat is not None:
            loaded = load_result(context, splat, job)
        else:
            name = f"{job.name} {'splat' if job.kind == TRAIN else 'pruned'}"
            loaded = splat_object.object_from_scene(name, read_scene(job.folder.output), context.collection)
        select(context, [loaded])
        return tr("Loaded '{name}' with {count:,} Gaussians").format(
            name=loaded.name, count=splat_object.count(loaded)
        )


class ConfirmedDeletion(ReportingOperator):
    """Asks before it deletes."""

    def invoke(self, context, event):
        return context.window_manager.invoke_confirm(self, event)


class SVRGS_OT_listed_job_delete(ListedJobOperator, ConfirmedDeletion):
    bl_idname = "svrgs.listed_job_delete"
    bl_label = "Delete Job"
    bl_description = (
        "Delete the files of this job: what it has learned, and its result if it has ended. Splats in the"
        " file stay. This cannot be undone"
    )

    def work_on(self, context, job: Job) -> str:
        if is_busy(job):
            raise SplatError(tr("'{name}' runs or waits: stop it first").format(name=job.name))
        delete_job(job)
        return tr("Deleted the job of '{name}'").format(name=job.name)


class SVRGS_OT_delete_finished_jobs(ConfirmedDeletion):
    bl_idname = "svrgs.delete_finished_jobs"
    bl_label = "Delete Finished Jobs"
    bl_description = (
        "Delete the files of all finished jobs, except those whose result still has to be loaded, or saved"
        " after Apply. Results that are in no .blend file are lost. This cannot be undone"
    )

    def work(self, context) -> str:
        finished, size = finished_jobs(context)
        for job in finished:
            delete_job(job)
        forget()
        return tr("Deleted {count:,} jobs, {size}").format(count=len(finished), size=size_text(size))


def finished_jobs(context) -> tuple[list[Job], int]:
    """The jobs that svrgs.delete_finished_jobs deletes, and their bytes on disk."""
    known = owners()
    done = ((job, str(job.folder.path)) for job in all_jobs(context) if job.state == "done")
    found = [
        job
        for job, folder in done
        if _is_loaded(known.get(folder), orphan=True) and not applied_jobs.is_applied(folder)
    ]
    return found, sum(_sizes.get(str(job.folder.path), 0) for job in found)


def rows(context) -> list[dict]:
    """What the panel shows: a row() of each job."""
    known = owners()
    return [row(job, known.get(str(job.folder.path))) for job in all_jobs(context)]


def finished_text(context) -> str:
    """The text of the button that deletes the finished jobs; empty: there are none."""
    found, size = finished_jobs(context)
    text = tr("Delete {count:,} Finished, {size}")
    return text.format(count=len(found), size=size_text(size)) if found else ""


CLASSES = (
    SVRGS_OT_listed_job_stop, SVRGS_OT_listed_job_resume, SVRGS_OT_listed_job_open,
    SVRGS_OT_listed_job_delete, SVRGS_OT_delete_finished_jobs,
)  # fmt: skip
HANDLERS = {"load_post": _after_load}


def unregister():
    _read.clear()
    _sizes.clear()
    forget()
