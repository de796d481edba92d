"""The job of the active splat: start, stop, resume, discard, load the result. job_watch.py follows the jobs;
job_list.py lists them all."""

from __future__ import annotations

import datetime
import os
import re
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as tr
from bpy.app.translations import pgettext_n as n_

from ...svrgs_addon.finetune.methods import METHODS
from ...svrgs_addon.jobs.job_folder import TRAIN, JobFolder
from ...svrgs_addon.jobs.job_process import Job
from ...svrgs_addon.scene.camera import Camera
from ...svrgs_addon.system.errors import SplatError
from ..data import edit_guard, splat_object, views_of_file
from ..data.job_paths import JOBS_FOLDER
from ..data.native_check import native_problem
from ..data.preferences import PACKAGE, threads
from ..data.reporting import ReportingOperator
from ..scene import dataset_paths
from . import depths, goals, job_queue, job_result
from .job_watch import current, delete_job, is_busy, is_resumable, job_of, link, load_result, start_timer

SMALLEST = 0.1  # share of a nested result down to which smaller numbers of Gaussians are trained
STOP_NOW = n_(
    "End the process at once, without waiting for a checkpoint. What was learned since the last one is lost"
)


def options_of(context, obj: bpy.types.Object) -> dict:
    """The settings of the panel as the options of a job."""
    s, depth = context.scene.svrgs_prune, depths.chosen(context)
    if depth == depths.QUICK:
        return {"quick": True, "seed": s.seed, "threads": threads(context)} | goals.options(
            s, obj, merges=True
        )
    colmap, images = dataset_paths.dataset_of(context) if depth == depths.PHOTOGRAPHS else ("", "")
    options = {
        "colmap": colmap, "images": images, "method": "merge" if depths.merges(context) else s.method,
        "seed": s.seed, "threads": threads(context),
        "holdout": s.holdout, "visible_mask": s.visible_mask, "views_by_loss": s.views_by_loss,
    }  # fmt: skip
    options |= {"time": s.time} if s.use_time else {"iterations": s.iterations, "recovery": s.recovery}
    if depth == depths.TUNED and s.views == "ONLY":
        options["seen_from_only"] = True
    if s.nested and not depths.merges(context):
        options["nested"] = SMALLEST
    if METHODS[s.method].first_cut:
        options["min_contribution"] = s.min_contribution
    return options | goals.options(s, obj, depths.merges(context))


def given_views(context, obj: bpy.types.Object) -> list[Camera]:
    """The cameras of the file that count in a job of the splat; mostly none. Raises SceneError."""
    given = depths.chosen(context) == depths.TUNED and context.scene.svrgs_prune.views != "PLACED"
    return views_of_file.views(context, obj) if given else []


def start_problem(context) -> str:
    """Why the active object cannot be pruned now; empty if it can."""
    if not splat_object.is_splat(context.object):
        return tr("Select a Gaussian splat first")
    if problem := edit_guard.problem(context, context.object):
        return problem
    job = job_of(context.object)
    if job is not None and is_busy(job):
        return job_queue.waiting_text(job) or tr("A job is running on this splat")
    if job is not None and is_resumable(job):
        return tr("Resume or discard this splat's job first")
    _, pruned = job_result.pair_of(context.object)
    if job_result.undecided(pruned):
        return tr("Apply or discard the result first")
    settings = context.scene.svrgs_prune
    if settings.nested and not depths.merges(context) and not settings.use_time and not settings.recovery:
        return tr("Train Smaller Sizes needs steps of recovery: set Recovery above 0 under Advanced")
    return depths.problem(context) or goals.problem(settings) or native_problem()


def new_folder(context, name: str) -> Path:
    """The folder of a new job: in the chosen folder, or next to the .blend file, or in the extension's
    folder."""
    parent = Path(job_folders(context)[0])
    stamp = datetime.datetime.now().strftime("%Y%m%d-%H%M%S-%f")
    return parent / f"{re.sub('[^0-9A-Za-z_-]+', '_', name)[:40]}-{stamp}"


def job_folders(context) -> list[str]:
    """The folders in which jobs are made: the chosen one, that next to the .blend file, that of the
    extension. The first is for new jobs."""
    chosen = bpy.path.abspath(context.scene.svrgs_prune.folder)
    beside = bpy.path.abspath(JOBS_FOLDER) if bpy.data.filepath else ""
    own = bpy.utils.extension_path_user(PACKAGE, path="jobs", create=False)
    return [os.path.normpath(folder) for folder in (chosen, beside, own) if folder]


class SVRGS_OT_job_start(ReportingOperator):
    bl_idname = "svrgs.job_start"
    bl_label = "Prune"
    bl_description = (
        "Prune the active splat in the background with the settings of the panel. The original stays"
    )
    # with a step of undo: after undo back to it, the splat still knows its job
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        problem = start_problem(context)
        if problem:
            cls.poll_message_set(problem)
        return not problem

    def work(self, context) -> str:
        obj = context.object
        scene, options, cameras = (
            splat_object.scene_from_object(obj),
            options_of(context, obj),
            given_views(context, obj),
        )
        folder = JobFolder.create(new_folder(context, obj.name), scene, options, obj.name, cameras)
        link(obj, str(folder.path))
        waits = job_queue.start(Job(folder))
        start_timer()
        return waits or tr("Pruning {count:,} Gaussians in the background").format(
            count=splat_object.count(obj)
        )


class SVRGS_OT_set_lambda(bpy.types.Operator):
    bl_idname = "svrgs.set_lambda"
    bl_label = "Set Strength"
    bl_description = "Set λ_F to one of the values in the SVR-GS paper"
    bl_options = {"REGISTER", "UNDO"}

    value: bpy.props.FloatProperty(
        name="λ_F",
        min=1e-7,
        max=1,
        default=1e-4,
        precision=6,
        description="A higher λ_F keeps fewer Gaussians",
    )

    def execute(self, context):
        context.scene.svrgs_prune.lambda_f = self.value
        return {"FINISHED"}


class CurrentJobOperator(ReportingOperator):
    """Works on the job that the panel shows."""

    @classmethod
    def problem(cls, context, obj: bpy.types.Object, job: Job) -> str:
        """Why this cannot be done with the job, in a sentence; '' if it can."""
        raise NotImplementedError

    @classmethod
    def poll(cls, context):
        found = current(context)
        problem = cls.problem(context, *found) if found is not None else tr("There is no job")
        if problem:
            cls.poll_message_set(problem)
        return not problem

    def work(self, context) -> str:
        found = current(context)
        if found is None:
            raise SplatError(tr("There is no job"))
        return self.work_on(context, *found)


class SVRGS_OT_job_stop(CurrentJobOperator):
    bl_idname = "svrgs.job_stop"
    bl_label = "Stop"
    bl_description = (
        "Finish the present step, save what was learned as a checkpoint, and stop. Resume continues there."
        " Nothing is lost"
    )

    now: bpy.props.BoolProperty(name="Now", options={"SKIP_SAVE"}, description=STOP_NOW)

    @classmethod
    def description(cls, context, properties):
        return tr(STOP_NOW if properties.now else cls.bl_description)

    @classmethod
    def problem(cls, context, obj: bpy.types.Object, job: Job) -> str:
        return stop_problem(job)

    def work_on(self, context, obj: bpy.types.Object, job: Job) -> str:
        return stop(job, self.now)


class SVRGS_OT_job_resume(CurrentJobOperator):
    bl_idname = "svrgs.job_resume"
    bl_label = "Resume"
    bl_description = "Continue the job from its last checkpoint. While another job runs, it waits"

    @classmethod
    def problem(cls, context, obj: bpy.types.Object, job: Job) -> str:
        return "" if is_resumable(job) else tr("No job waits to be resumed")

    def work_on(self, context, obj: bpy.types.Object, job: Job) -> str:
        return resume(job, dataset_paths.dataset_of_job(context, obj))


class SVRGS_OT_job_discard(CurrentJobOperator):
    bl_idname = "svrgs.job_discard"
    bl_label = "Discard"
    bl_description = (
        "Delete the job's files: what it has learned, and its result if it has ended. Splat and cameras stay."
        " This cannot be undone"
    )

    @classmethod
    def problem(cls, context, obj: bpy.types.Object, job: Job) -> str:
        return tr("Stop the job first") if is_busy(job) else ""

    def work_on(self, context, obj: bpy.types.Object, job: Job) -> str:
        delete_job(job)
        return tr("Discarded the job of '{name}'").format(name=obj.name)


class SVRGS_OT_job_load(CurrentJobOperator):
    bl_idname = "svrgs.job_load"
    bl_label = "Load Result"
    bl_description = "Add the result of the finished job to the scene"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def problem(cls, context, obj: bpy.types.Object, job: Job) -> str:
        return edit_guard.problem(context, obj) if job.state == "done" else tr("There is no finished job")

    def work_on(self, context, obj: bpy.types.Object, job: Job) -> str:
        loaded = load_result(context, obj, job)
        if not splat_object.is_splat(obj):
            return tr("Loaded {count:,} Gaussians").format(count=splat_object.count(loaded))
        return tr("Loaded {kept:,} of {count:,} Gaussians").format(
            kept=splat_object.count(loaded), count=splat_object.count(obj)
        )


# --- what the buttons of the panel and of the list do


def stop_problem(job: Job) -> str:
    """Why the job cannot be stopped, in a sentence; '' if it can."""
    if job.running and job.facts.get("finishing"):
        return tr("The result is being measured: the job ends by itself")
    return "" if is_busy(job) else tr("No job is running")


def stop(job: Job, now: bool = False) -> str:
    """Stops the job, or takes it out of the queue. now: without a checkpoint. Returns what was done, in a
    sentence."""
    if job_queue.is_queued(job):
        job_queue.leave(job)
        return tr("'{name}' does not wait any more: Resume starts it").format(name=job.name)
    if now and job.running:
        job.kill()
        return ". ".join((tr("Stopped at once"), resume_sentence(job)))
    job.stop()
    return tr(job.facts["text"])


def resume(job: Job, dataset: str = "") -> str:
    """Continues the job, or lets it wait. dataset: another place to look for its dataset. Returns a sentence.
    Raises SplatError, OSError."""
    colmap = job.folder.request()["options"].get("colmap", "")
    if colmap and not os.path.exists(colmap):
        if not os.path.exists(dataset):
            text = tr(
                "{folder}: the dataset of this job is not there: with its splat active, find it in step 1 or"
                " choose it in step 2, then resume"
            )
            raise SplatError(text.format(folder=colmap))
        job.folder.set_dataset(dataset)
    waits = job_queue.start(job)
    start_timer()
    text = (
        tr("Training of '{name}' continues")
        if job.folder.kind == TRAIN
        else tr("Pruning of '{name}' continues")
    )
    return waits or text.format(name=job.name)


def resume_sentence(job: Job) -> str:
    """From where a job that has not ended well would be continued."""
    template, values = job.resume_point()
    return tr(template).format(**values)


CLASSES = (
    SVRGS_OT_job_start, SVRGS_OT_set_lambda, SVRGS_OT_job_stop, SVRGS_OT_job_resume, SVRGS_OT_job_discard,
    SVRGS_OT_job_load,
)  # fmt: skip
