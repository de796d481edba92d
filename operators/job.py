"""Background jobs: start, pause, cancel, resume, discard, load the result. job_watch.py follows the jobs that run."""

from __future__ import annotations

import contextlib
import datetime
import re
from pathlib import Path

import bpy

from ..svrgs_addon.errors import FormatError, SplatError
from ..svrgs_addon.finetune.methods import METHODS
from ..svrgs_addon.jobs.job_folder import TRAIN, JobFolder
from ..svrgs_addon.jobs.job_process import Job
from . import bridge, edit_guard, goals
from .job_watch import BUSY, JOBS_FOLDER, WAITING, current, job_of, jobs, link, load_result, start_timer, unlink
from .native_check import native_problem
from .preferences import PACKAGE, threads


def dataset_of(context) -> tuple[str, str]:
    """(dataset, name of its image folder) to prune with: the chosen one, or that of the cameras imported with the splat."""
    settings = context.scene.svrgs_prune
    root = bridge.root_of(context.object)
    if settings.colmap:
        return bpy.path.abspath(settings.colmap), settings.images
    return (root.get(bridge.DATASET, ""), settings.images or root.get(bridge.IMAGES, "")) if root is not None else ("", settings.images)


def options_of(context, obj: bpy.types.Object) -> dict:
    """The settings of the panel as the options of a job."""
    s = context.scene.svrgs_prune
    colmap, images = dataset_of(context)
    options = {
        "colmap": colmap, "images": images, "method": s.method, "iterations": s.iterations, "recovery": s.recovery, "seed": s.seed,
        "threads": threads(context), "holdout": s.holdout, "visible_mask": s.visible_mask, "views_by_loss": s.views_by_loss,
    }  # fmt: skip
    if METHODS[s.method].first_cut:
        options["min_contribution"] = s.min_contribution
    return options | goals.options(s, obj)


def start_problem(context) -> str:
    """Why the active object cannot be pruned now; empty if it can."""
    if not bridge.is_splat(context.object):
        return "Select a Gaussian splat first"
    if problem := edit_guard.problem(context, context.object):
        return problem
    job = job_of(context.object)
    if job is not None and job.state in BUSY:
        return "A job is running on this splat"
    if job is not None and job.state in WAITING:
        return "Resume or discard this splat's job first"
    if not dataset_of(context)[0]:
        return "Choose the dataset of the splat's photographs, or import its cameras"
    return goals.problem(context.scene.svrgs_prune) or native_problem()


def new_folder(context, name: str) -> Path:
    """The folder of a new job: in the chosen folder, or next to the .blend file, or in the extension's folder."""
    folder = bpy.path.abspath(context.scene.svrgs_prune.folder)
    if not folder and bpy.data.filepath:
        folder = bpy.path.abspath(JOBS_FOLDER)
    parent = Path(folder or bpy.utils.extension_path_user(PACKAGE, path="jobs", create=True))
    stamp = datetime.datetime.now().strftime("%Y%m%d-%H%M%S-%f")
    return parent / f"{re.sub('[^0-9A-Za-z_-]+', '_', name)[:40]}-{stamp}"


class JobOperator(bpy.types.Operator):
    """An operator whose work() returns what it did. An error is reported as a sentence."""

    def execute(self, context):
        try:
            message = self.work(context)
        except (SplatError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, message)
        return {"FINISHED"}


class SVRGS_OT_job_start(JobOperator):
    bl_idname = "svrgs.job_start"
    bl_label = "Prune"
    bl_description = "Prune the active splat in the background with the settings of the panel. The original stays"
    bl_options = {"REGISTER", "UNDO"}  # with a step of undo: after undo back to it, the splat still knows its job

    @classmethod
    def poll(cls, context):
        problem = start_problem(context)
        if problem:
            cls.poll_message_set(problem)
        return not problem

    def work(self, context) -> str:
        obj = context.object
        folder = JobFolder.create(new_folder(context, obj.name), bridge.scene_from_object(obj), options_of(context, obj), obj.name)
        job = jobs.setdefault(str(folder.path), Job(folder))
        job.start()
        link(obj, str(folder.path))
        start_timer()
        return f"Pruning {bridge.count(obj):,} Gaussians in the background"


class SVRGS_OT_set_lambda(bpy.types.Operator):
    bl_idname = "svrgs.set_lambda"
    bl_label = "Set Strength"
    bl_description = "Set λ_F to one of the values in the SVR-GS paper"
    bl_options = {"REGISTER", "UNDO"}

    value: bpy.props.FloatProperty(name="λ_F", min=1e-7, max=1, default=1e-4, precision=6, description="A higher λ_F keeps fewer Gaussians")

    def execute(self, context):
        context.scene.svrgs_prune.lambda_f = self.value
        return {"FINISHED"}


class CurrentJobOperator(JobOperator):
    """Works on the job that the panel shows, while that is in one of `states`."""

    states: tuple[str, ...] = ()
    poll_message = "No job is running"

    @classmethod
    def poll(cls, context):
        found = current(context)
        if found is not None and found[1].state in cls.states:
            return True
        cls.poll_message_set(cls.poll_message)
        return False

    def work(self, context) -> str:
        found = current(context)
        if found is None:
            raise SplatError(self.poll_message)
        return self.work_on(context, *found)


class SVRGS_OT_job_pause(CurrentJobOperator):
    bl_idname = "svrgs.job_pause"
    bl_label = "Pause"
    bl_description = "Save a checkpoint and stop the job. Resume continues it"
    states = BUSY

    def work_on(self, context, obj: bpy.types.Object, job: Job) -> str:
        job.pause()
        return "Pausing: a checkpoint is being saved"


class SVRGS_OT_job_cancel(CurrentJobOperator):
    bl_idname = "svrgs.job_cancel"
    bl_label = "Cancel"
    bl_description = "Stop the job at once. The steps since the last checkpoint are lost"
    states = BUSY

    def work_on(self, context, obj: bpy.types.Object, job: Job) -> str:
        job.cancel()
        return "Cancelled: Resume continues from the last checkpoint"


class SVRGS_OT_job_resume(CurrentJobOperator):
    bl_idname = "svrgs.job_resume"
    bl_label = "Resume"
    bl_description = "Continue the job from its last checkpoint"
    states, poll_message = WAITING, "No job waits to be resumed"

    def work_on(self, context, obj: bpy.types.Object, job: Job) -> str:
        job.start()
        start_timer()
        what = "Training" if job.folder.kind == TRAIN else "Pruning"
        return ". ".join(filter(None, (f"{what} of '{obj.name}' continues", job.renamed)))


class SVRGS_OT_job_discard(CurrentJobOperator):
    bl_idname = "svrgs.job_discard"
    bl_label = "Discard"
    bl_description = "Delete the job's files. Splat and cameras stay as they are"
    states, poll_message = (*WAITING, "done"), "There is no stopped or finished job"

    def work_on(self, context, obj: bpy.types.Object, job: Job) -> str:
        delete_job(obj)
        return f"Discarded the job of '{obj.name}'"


class SVRGS_OT_job_load(CurrentJobOperator):
    bl_idname = "svrgs.job_load"
    bl_label = "Load Result"
    bl_description = "Add the result of the finished job to the scene"
    bl_options = {"REGISTER", "UNDO"}
    states, poll_message = ("done",), "There is no finished job"

    @classmethod
    def poll(cls, context):
        found = current(context)
        if found is None or not super().poll(context):
            return False
        problem = edit_guard.problem(context, found[0])
        if problem:
            cls.poll_message_set(problem)
        return not problem

    def work_on(self, context, obj: bpy.types.Object, job: Job) -> str:
        loaded = load_result(context, obj, job)
        return f"Loaded {bridge.count(loaded):,}{f' of {bridge.count(obj):,}' if bridge.is_splat(obj) else ''} Gaussians"


def delete_job(obj: bpy.types.Object):
    """Deletes the files of the splat's job, if it has one. Raises OSError."""
    job = job_of(obj)
    if job is not None:
        with contextlib.suppress(FormatError):  # the files are gone already
            job.folder.discard()
        jobs.pop(str(job.folder.path), None)
    unlink(obj)


CLASSES = (
    SVRGS_OT_job_start, SVRGS_OT_set_lambda, SVRGS_OT_job_pause, SVRGS_OT_job_cancel, SVRGS_OT_job_resume, SVRGS_OT_job_discard,
    SVRGS_OT_job_load,
)  # fmt: skip


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister():
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
