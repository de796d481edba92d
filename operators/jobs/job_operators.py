"""What can be done with a job: stop, resume, discard, load its result. For the prune panel and for the list
of jobs."""

from __future__ import annotations

import os

import bpy
from bpy.app.translations import pgettext_iface as tr
from bpy.app.translations import pgettext_n as n_

from ...svrgs_addon.files.registry import read_scene
from ...svrgs_addon.jobs.job_folder import TRAIN
from ...svrgs_addon.jobs.job_process import Job
from ...svrgs_addon.system.errors import SplatError
from ...svrgs_addon.system.memory import size_text
from ..data import edit_guard, splat_object
from ..data.background_work import watch
from ..data.job_paths import owners
from ..data.reporting import ReportingOperator
from ..data.select import open_collection, select
from ..scene import dataset_paths
from . import job_list, job_queue, job_result, job_state
from .job_watch import current, delete_job, tick

STOP_NOW = n_(
    "End the process at once, without waiting for a checkpoint. What was learned since the last one is lost"
)


class JobOperator(ReportingOperator):
    """Works on the job in a folder; without a folder on the job that the prune panel shows.

    A panel draws it only where job_state allows it. So there is no poll, which would not know the folder.
    """

    bl_options = set()
    refused = ""  # what is said of a job that does not allow it
    folder: bpy.props.StringProperty(
        name="Folder", options={"HIDDEN", "SKIP_SAVE"}, description="Folder of the job"
    )

    def work(self, context) -> str:
        owner, job = self.chosen(context)
        if type(self).__name__.removeprefix("SVRGS_OT_job_") not in job_state.of(job).actions:
            raise SplatError(self.refusal(job))
        try:
            return self.work_on(context, owner, job)
        finally:
            job_list.forget()

    def refusal(self, job: Job) -> str:
        return tr(self.refused).format(name=job.name)

    def chosen(self, context) -> tuple[bpy.types.Object | None, Job]:
        """(the splat or the root of the job if it is in the file, the job). Raises SplatError."""
        if not self.folder:
            found = current(context)
            if found is None:
                raise SplatError(tr("There is no job"))
            return found
        job = job_queue.job_in(self.folder)
        if job.state == "missing":
            job_list.forget()
            raise SplatError(tr("{folder}: holds no job any more").format(folder=self.folder))
        return owners().get(str(job.folder.path)), job


class SVRGS_OT_job_stop(JobOperator):
    bl_label = "Stop"
    bl_description = (
        "Finish the present step, save what was learned as a checkpoint, and stop. Resume continues there."
        " Nothing is lost"
    )

    now: bpy.props.BoolProperty(name="Now", options={"SKIP_SAVE"}, description=STOP_NOW)

    @classmethod
    def description(cls, context, properties):
        return tr(STOP_NOW if properties.now else cls.bl_description)

    def refusal(self, job: Job) -> str:
        if job_state.is_busy(job):
            return tr("The result is being measured: the job ends by itself")
        return tr("No job is running")

    def work_on(self, context, owner: bpy.types.Object | None, job: Job) -> str:
        if job_queue.is_queued(job):
            job_queue.leave(job)
            return tr("'{name}' does not wait any more: Resume starts it").format(name=job.name)
        job_queue.leave(job)  # Run Now of another job may have let it wait to go on
        if self.now and job.running:
            job.kill()
            return ". ".join((tr("Stopped at once"), job_state.resume_sentence(job)))
        job.stop()
        return tr(job.facts["text"])


class SVRGS_OT_job_run_now(JobOperator):
    refused = n_("'{name}' does not wait for another job")
    bl_label = "Run Now"
    bl_description = (
        "Run this job next: the one that it waits for saves a checkpoint, stops, and goes on after it"
    )

    def work_on(self, context, owner: bpy.types.Object | None, job: Job) -> str:
        job_queue.run_now(job)
        return tr("'{name}' runs next").format(name=job.name)


class SVRGS_OT_job_resume(JobOperator):
    refused = n_("'{name}' does not wait to be resumed")
    bl_label = "Resume"
    bl_description = "Continue the job from its last checkpoint. While another job runs, it waits"

    def work_on(self, context, owner: bpy.types.Object | None, job: Job) -> str:
        dataset = job.folder.request()["options"].get("data", "")
        if dataset and not os.path.exists(dataset):
            moved = dataset_paths.dataset_of_job(context, owner)
            if not os.path.exists(moved):
                text = tr(
                    "{folder}: the dataset of this job is not there: with its splat active, find it in Scene"
                    " or choose it in step 2, then resume"
                )
                raise SplatError(text.format(folder=moved or dataset))
            job.folder.set_dataset(moved)
        waits = job_queue.start(job)
        watch(tick)
        if waits:
            return waits
        training = job.kind == TRAIN
        text = tr("Training of '{name}' continues") if training else tr("Pruning of '{name}' continues")
        return text.format(name=job.name)


class SVRGS_OT_job_load(JobOperator):
    refused = n_("'{name}' has no result yet")
    bl_label = "Load Result"
    bl_description = (
        "Load the result of this job: beside its splat, or as a new splat if that is not in the file. Of a"
        " training: beside its cameras"
    )
    bl_options = {"REGISTER", "UNDO"}

    def work_on(self, context, owner: bpy.types.Object | None, job: Job) -> str:
        if problem := edit_guard.problem(context, owner):
            raise SplatError(problem)
        if owner is not None:
            loaded = job_result.load(context, owner, job.folder)
        else:
            name = f"{job.name} {'splat' if job.kind == TRAIN else 'pruned'}"
            scene, collection = read_scene(job.folder.output), open_collection(context)
            loaded = splat_object.object_from_scene(name, scene, collection)
        select(context, [loaded])
        return tr("Loaded '{name}' with {count:,} Gaussians").format(
            name=loaded.name, count=splat_object.count(loaded)
        )


class ConfirmedDeletion(ReportingOperator):
    """Asks before it deletes."""

    bl_options = set()

    def invoke(self, context, event):
        return context.window_manager.invoke_confirm(self, event)


class SVRGS_OT_job_discard(JobOperator, ConfirmedDeletion):
    refused = n_("'{name}' runs or waits: stop it first")
    bl_label = "Discard"
    bl_description = (
        "Delete the job's files: what it has learned, and its result if it has ended. Splat and cameras stay."
        " This cannot be undone"
    )

    def work_on(self, context, owner: bpy.types.Object | None, job: Job) -> str:
        delete_job(job)
        return tr("Discarded the job of '{name}'").format(name=job.name)


class SVRGS_OT_delete_finished_jobs(ConfirmedDeletion):
    bl_label = "Delete Finished Jobs"
    bl_description = (
        "Delete the files of all finished jobs, except those whose result still has to be loaded, or saved"
        " after Apply. Results that are in no .blend file are lost. This cannot be undone"
    )

    def work(self, context) -> str:
        finished, size = job_list.finished_jobs(context)
        for job in finished:
            delete_job(job)
        job_list.forget()
        return tr("Deleted {count:,} jobs, {size}").format(count=len(finished), size=size_text(size))
