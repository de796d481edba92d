"""Training of a splat from imported cameras, for a dataset that has none yet: a background job of their root.

Progress, stop and resume are those of every job (job.py); the panel Train shows them. The splat is placed
below the root (job_result.py).
"""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as tr
from bpy.props import IntProperty, PointerProperty

from ...svrgs_addon.jobs.job_folder import TRAIN, JobFolder
from ...svrgs_addon.jobs.job_process import Job
from ...svrgs_addon.prune.options import ITERATIONS
from ..data import camera_object, splat_object
from ..data.extension import native_problem, threads
from ..data.job_paths import new_folder
from ..data.option_properties import limited_time_property, time_property
from ..data.reporting import ReportingOperator
from ..scene import dataset_paths
from . import job_queue, job_state
from .job_watch import begin, current, job_of

QUICK = 7_000  # steps: a usable splat in a quarter of the time


def root_to_train(context) -> bpy.types.Object | None:
    """The root with a dataset that the active object belongs to, or the only one of the scene; None with a
    splat or an own object active."""
    if splat_object.is_splat(context.object):
        return None
    root = splat_object.root_of(context.object)
    if root is not None:
        return root if splat_object.DATASET in root else None
    roots = [obj for obj in context.scene.objects if splat_object.ROOT in obj and splat_object.DATASET in obj]
    return roots[0] if len(roots) == 1 else None


def problem(context) -> str:
    """Why no splat can be trained now; empty if it can."""
    root = root_to_train(context)
    if root is None:
        return tr("Import cameras first, and select one of them")
    job = job_of(root)
    if job is not None and job_state.is_busy(job):
        return job_queue.waiting_text(job) or tr("A job is running on these cameras")
    if job is not None and job_state.is_resumable(job):
        return tr("Resume or discard the job of these cameras first")
    if context.mode != "OBJECT":
        return tr("Leave Edit Mode first")
    if root.get(splat_object.POINTS) == 0:
        return tr(
            "The dataset has no sparse points to start from: run COLMAP's mapper again, or export the sparse"
            " points with the cameras"
        )
    return dataset_paths.lost(root) or native_problem()


def current_job(context) -> tuple[bpy.types.Object, Job] | None:
    """As job_watch.current(), if the job is one of training."""
    found = current(context)
    return found if found is not None and found[1].kind == TRAIN else None


def is_shown(context) -> bool:
    """Whether there is a splat to train: it is being trained, or cameras without a splat are active."""
    return current_job(context) is not None or bool(about(context))


class SVRGS_OT_train(ReportingOperator):
    bl_label = "Train Splat"
    bl_description = (
        "Train a splat in the background from the photographs and the sparse points of the imported cameras."
        " It is placed with the cameras"
    )

    problem = staticmethod(problem)

    def work(self, context) -> str:
        root, settings, common = root_to_train(context), context.scene.svrgs_train, context.scene.svrgs_prune
        assert root is not None
        limit = "time" if settings.use_time else "iterations"
        options = {
            "data": dataset_paths.dataset_of_root(root), "images": root.get(splat_object.IMAGES, ""),
            "threads": threads(context), limit: getattr(settings, limit), **dataset_paths.masks_of(context),
            **{name: getattr(common, name) for name in ("holdout", "exposure", "refine_poses")},
        }  # fmt: skip
        folder = JobFolder.create_training(new_folder(context, root.name), options, root.name)
        text = tr("Training a splat from the photographs of '{name}' in the background")
        return begin(root, folder) or text.format(name=root.name)


def about(context) -> str:
    """What a splat would be trained from; empty if that makes no sense now."""
    root = root_to_train(context)
    job = job_of(root)
    if root is None or (job is not None and (job_state.is_busy(job) or job_state.is_resumable(job))):
        return ""
    photographs = len(camera_object.photographs(root.children_recursive))
    points = root.get(splat_object.POINTS)
    text = tr("'{name}': {photographs:,} photographs, {points:,} sparse points")
    if points is None:
        text = tr("'{name}': {photographs:,} photographs")
    return text.format(name=root.name, photographs=photographs, points=points)


class SVRGS_PG_train(bpy.types.PropertyGroup):
    iterations: IntProperty(
        name="Iterations", min=1, soft_max=ITERATIONS, default=QUICK,
        description=(
            f"Number of training steps. {QUICK:,} give a usable splat, {ITERATIONS:,} one as in papers"
        ),
    )  # fmt: skip
    use_time: limited_time_property()
    time: time_property(default=600)


PROPERTIES = {("Scene", "svrgs_train"): PointerProperty(type=SVRGS_PG_train)}
