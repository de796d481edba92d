"""Pruning in the background: start, pause, cancel, go on, discard, load. job_watch.py follows what runs."""

from __future__ import annotations

import contextlib
import datetime
import re
from pathlib import Path

import bpy

from ..svrgs_addon.errors import FormatError, SplatError
from ..svrgs_addon.finetune.methods import METHODS
from ..svrgs_addon.jobs.job_folder import JobFolder
from ..svrgs_addon.jobs.job_process import Job
from . import bridge, edit_guard
from .job_watch import BESIDE, BUSY, WAITING, current, finish, follow, job_of, jobs, link, unlink
from .native_check import native_problem
from .preferences import PACKAGE, threads

BYTES = {0: 68, 1: 104, 2: 164, 3: 248}  # of a Gaussian in a file, by SH degree


def dataset_of(context) -> tuple[str, str]:
    """(dataset, images) to prune with: as chosen, else those of the cameras that share the splat's coordinates."""
    chosen = context.scene.svrgs_prune
    root = bridge.root_of(context.object)
    if chosen.colmap:
        return bpy.path.abspath(chosen.colmap), chosen.images
    return (root.get(bridge.DATASET, ""), chosen.images or root.get(bridge.IMAGES, "")) if root is not None else ("", chosen.images)


def options_of(context, obj: bpy.types.Object) -> dict:
    """The settings of the panel as options of a job."""
    s, total = context.scene.svrgs_prune, bridge.count(obj)
    colmap, images = dataset_of(context)
    options = {
        "colmap": colmap, "images": images, "method": s.method, "iterations": s.iterations, "recovery": s.recovery, "seed": s.seed,
        "threads": threads(context), "holdout": s.holdout, "visible_mask": s.visible_mask, "views_by_loss": s.views_by_loss,
    }  # fmt: skip
    method = METHODS[s.method]
    if method.lambda_f:
        options["lambda_f"] = s.lambda_f
    if method.first_cut:
        options["min_contribution"] = s.min_contribution
    targets = {"SHARE": s.share / 100 * total, "COUNT": s.count, "SIZE": s.size * 1e6 / bytes_each(obj)}
    if s.goal in targets:
        options["target_count"] = min(total, max(1, round(targets[s.goal])))
    elif s.goal == "DROP":
        options["max_drop"] = round(s.drop, 4)
    return options


def bytes_each(obj: bpy.types.Object) -> int:
    """Bytes that one Gaussian of the splat takes in a file."""
    return BYTES[bridge.sh_degree(obj)]


def file_size(obj: bpy.types.Object, count: int) -> str:
    """What so many of the splat's Gaussians take in a file."""
    size = count * bytes_each(obj)
    return f"{size / 1e6:.1f} MB" if size >= 1e5 else f"{size / 1e3:.1f} kB"


def mismatch(settings) -> str:
    """Why the chosen method cannot reach the chosen goal; empty where it can."""
    method, learns = METHODS[settings.method], settings.iterations > 0
    if settings.goal == "LAMBDA" and method.ranks and not method.share:
        return f"'{settings.method}' only ranks the Gaussians: choose a percentage, a count or a size as goal"
    if settings.goal == "DROP" and not (method.supports_max_drop and learns):
        return f"'{settings.method}' cannot hold a loss: choose another goal or method" if learns else "To hold a loss it takes iterations"
    return ""


def obstacle(context) -> str:
    """Why the active object cannot be pruned now; empty where it can."""
    if not bridge.is_splat(context.object):
        return "Select a Gaussian splat first"
    if said := edit_guard.problem(context, context.object):
        return said
    job = job_of(context.object)
    if job is not None and job.state in BUSY:
        return "A job is at work on this splat"
    if job is not None and job.state in WAITING:
        return "Resume or discard this splat's job first"
    if not dataset_of(context)[0]:
        return "Choose the dataset of the splat's photographs, or import its cameras"
    return mismatch(context.scene.svrgs_prune) or native_problem()


def new_folder(context, name: str) -> Path:
    """Where a new job of this splat goes: as chosen, else beside the file, else in the extension's folder."""
    chosen = bpy.path.abspath(context.scene.svrgs_prune.folder)
    if not chosen and bpy.data.filepath:
        chosen = bpy.path.abspath(BESIDE)
    parent = Path(chosen or bpy.utils.extension_path_user(PACKAGE, path="jobs", create=True))
    stamp = datetime.datetime.now().strftime("%Y%m%d-%H%M%S-%f")
    return parent / f"{re.sub('[^0-9A-Za-z_-]+', '_', name)[:40]}-{stamp}"


class JobOperator(bpy.types.Operator):
    """Reports what it did, or in a sentence why it could not."""

    def execute(self, context):
        try:
            said = self.work(context)
        except (SplatError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, said)
        return {"FINISHED"}


class SVRGS_OT_job_start(JobOperator):
    bl_idname = "svrgs.job_start"
    bl_label = "Prune"
    bl_description = "Prune the active splat in the background, with the settings of the panel. The original stays"
    bl_options = {"REGISTER", "UNDO"}  # a step of undo: going back to it, the splat still knows its job

    @classmethod
    def poll(cls, context):
        problem = obstacle(context)
        if problem:
            cls.poll_message_set(problem)
        return not problem

    def work(self, context) -> str:
        obj = context.object
        folder = JobFolder.create(new_folder(context, obj.name), bridge.scene_from_object(obj), options_of(context, obj), obj.name)
        job = jobs.setdefault(str(folder.path), Job(folder))
        job.start()
        link(obj, str(folder.path))
        follow()
        return f"Pruning {bridge.count(obj):,} Gaussians in the background"


class SVRGS_OT_set_lambda(bpy.types.Operator):
    bl_idname = "svrgs.set_lambda"
    bl_label = "Set Strength"
    bl_description = "Prune with this weight of the spatial mask, one that the paper uses"
    bl_options = {"REGISTER", "UNDO"}

    value: bpy.props.FloatProperty(name="λ_F", min=1e-7, max=1, default=1e-4, precision=6, description="Weight of the spatial mask")

    def execute(self, context):
        context.scene.svrgs_prune.lambda_f = self.value
        return {"FINISHED"}


class CurrentJobOperator(JobOperator):
    """On the job that the panel shows, while it is in one of `states`."""

    states: tuple[str, ...] = ()
    why = "No job is running"

    @classmethod
    def poll(cls, context):
        _, job = current(context)
        if job is not None and job.state in cls.states:
            return True
        cls.poll_message_set(cls.why)
        return False


class SVRGS_OT_job_pause(CurrentJobOperator):
    bl_idname = "svrgs.job_pause"
    bl_label = "Pause"
    bl_description = "Save what is done so far and stop. Resume goes on"
    states = BUSY

    def work(self, context) -> str:
        current(context)[1].pause()
        return "Pausing: what is done so far is saved"


class SVRGS_OT_job_cancel(CurrentJobOperator):
    bl_idname = "svrgs.job_cancel"
    bl_label = "Cancel"
    bl_description = "Stop at once. What was done since the last checkpoint is lost"
    states = BUSY

    def work(self, context) -> str:
        current(context)[1].cancel()
        return "Cancelled: Resume goes on from the last checkpoint"


class SVRGS_OT_job_resume(CurrentJobOperator):
    bl_idname = "svrgs.job_resume"
    bl_label = "Resume"
    bl_description = "Go on from the last checkpoint"
    states, why = WAITING, "No job waits to go on"

    def work(self, context) -> str:
        obj, job = current(context)
        job.start()
        follow()
        return f"Pruning '{obj.name}' goes on{job.renamed and '. ' + job.renamed}"


class SVRGS_OT_job_discard(CurrentJobOperator):
    bl_idname = "svrgs.job_discard"
    bl_label = "Discard"
    bl_description = "Delete the job's files. The splat stays as it is"
    states, why = (*WAITING, "done"), "No job waits or is done"

    def work(self, context) -> str:
        obj, job = current(context)
        forget_job(obj)
        return f"Discarded the job of '{obj.name}'"


class SVRGS_OT_job_load(CurrentJobOperator):
    bl_idname = "svrgs.job_load"
    bl_label = "Load Result"
    bl_description = "Bring the finished job's result into the scene"
    bl_options = {"REGISTER", "UNDO"}
    states, why = ("done",), "No job is done"

    @classmethod
    def poll(cls, context):
        if not super().poll(context):
            return False
        problem = edit_guard.problem(context, current(context)[0])
        if problem:
            cls.poll_message_set(problem)
        return not problem

    def work(self, context) -> str:
        obj, job = current(context)
        pruned = finish(context, obj, job)
        return f"Loaded {bridge.count(pruned):,} of {bridge.count(obj):,} Gaussians"


def forget_job(obj: bpy.types.Object):
    """Deletes the files of the splat's job, as far as there are any. Raises OSError."""
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
