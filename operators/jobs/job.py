"""Starts jobs: Prune, for the active splat with the settings of the panel; and Fine-Tune, the job of a quick
result once more, for the number of Gaussians that the slider Keep shows."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.finetune.methods import METHODS
from ...svrgs_addon.jobs.job_folder import JobFolder
from ...svrgs_addon.scene.camera import Camera
from ..data import edit_guard, quick_order, splat_object, views_of_file
from ..data.extension import native_problem, threads
from ..data.job_paths import new_folder
from ..data.reporting import ReportingOperator
from ..data.select import select
from ..scene import dataset_paths
from . import efforts, goals, job_queue, job_result, job_state
from .job_watch import begin, delete_job, job_of

SMALLEST = 0.1  # share of a nested result down to which smaller numbers of Gaussians are trained
# options that say how many Gaussians stay
GOALS = ("target", "target_count", "target_size", "target_format", "max_drop", "max_lpips")


def options_of(context, obj: bpy.types.Object) -> dict:
    """The settings of the panel as the options of a job."""
    s, effort = context.scene.svrgs_prune, efforts.chosen(context)
    # of a file size, all bands are kept if the user asks for them
    asked = s.sh_degree < splat_object.sh_degree(obj) or (s.goal == "SIZE" and s.is_property_set("sh_degree"))
    bands = {"sh_degree": s.sh_degree} if asked else {}
    if effort == efforts.QUICK:
        quick = {"quick": True, "seed": s.seed, "threads": threads(context), "force": s.force}
        return quick | bands | goals.options(s, obj, merges=True)
    data, images = dataset_paths.dataset_of(context) if effort == efforts.PHOTOGRAPHS else ("", "")
    options = {
        "data": data, "images": images, "method": "merge" if efforts.merges(context) else s.method,
        "seed": s.seed, "threads": threads(context), "force": s.force,
        "holdout": s.holdout, "visible_mask": s.visible_mask, "views_by_loss": s.views_by_loss,
    }  # fmt: skip
    if effort == efforts.PHOTOGRAPHS:
        options |= dataset_paths.masks_of(context)
        options |= {name: getattr(s, name) for name in ("exposure", "refine_poses", "mask_distractors")}
    options |= {"time": s.time} if s.use_time else {"iterations": s.iterations, "recovery": s.recovery}
    if effort == efforts.TUNED and s.views == "ONLY":
        options["seen_from_only"] = True
    if s.nested and not efforts.merges(context):
        options["nested"] = SMALLEST
    if METHODS[s.method].first_cut:
        options["min_contribution"] = s.min_contribution
    return options | bands | goals.options(s, obj, efforts.merges(context))


def given_views(context, obj: bpy.types.Object) -> list[Camera]:
    """The cameras of the file that count in a job of the splat; mostly none. Raises SceneError."""
    given = efforts.chosen(context) == efforts.TUNED and context.scene.svrgs_prune.views != "PLACED"
    return views_of_file.views(context, obj) if given else []


def start_problem(context) -> str:
    """Why the active object cannot be pruned now; empty if it can."""
    if not splat_object.is_splat(context.object):
        return tr("Select a Gaussian splat first")
    if problem := edit_guard.problem(context, context.object):
        return problem
    job = job_of(context.object)
    if job is not None and job_state.is_busy(job):
        return job_queue.waiting_text(job) or tr("A job is running on this splat")
    if job is not None and job_state.is_resumable(job):
        return tr("Resume or discard this splat's job first")
    _, pruned = job_result.pair_of(context.object)
    if job_result.undecided(pruned):
        return tr("Apply or discard the result first")
    settings = context.scene.svrgs_prune
    if settings.nested and not efforts.merges(context) and not settings.use_time and not settings.recovery:
        return tr("Train Smaller Sizes needs steps of recovery: set Recovery above 0 under Advanced")
    return efforts.problem(context) or goals.problem(settings) or native_problem()


class SVRGS_OT_job_start(ReportingOperator):
    bl_label = "Prune"
    bl_description = (
        "Prune the active splat in the background with the settings of the panel. The original stays"
    )
    # after undo back to it, the splat still knows its job
    bl_options = {"REGISTER", "UNDO"}

    problem = staticmethod(start_problem)

    def work(self, context) -> str:
        obj = context.object
        scene, cameras = splat_object.scene_from_object(obj), given_views(context, obj)
        options, path = options_of(context, obj), new_folder(context, obj.name)
        folder = JobFolder.create(path, scene, options, obj.name, cameras)
        text = tr("Pruning {count:,} Gaussians in the background")
        return begin(obj, folder) or text.format(count=scene.count)


class SVRGS_OT_prune_again(ReportingOperator):
    bl_label = "Fine-Tune"
    bl_description = (
        "Prune the original once more, to the number of Gaussians that is shown, with the steps that win"
        " quality back. It replaces this result"
    )

    @classmethod
    def problem(cls, context) -> str:
        original, pruned = job_result.pair_of(context.object)
        if not job_result.undecided(pruned) or not quick_order.is_shown(pruned) or job_of(original) is None:
            return tr("Choose another number of Gaussians with the slider Keep first")
        return edit_guard.problem(context, original)  # it is there: its job has kept the order

    def work(self, context) -> str:
        original, pruned = job_result.pair_of(context.object)
        former = job_of(original)
        assert original is not None and pruned is not None and former is not None  # see problem()
        count, given = job_result.shown_count(pruned), former.folder.request()["options"]
        options = {name: value for name, value in given.items() if name not in GOALS}
        options["target_count"] = count
        path, scene = new_folder(context, original.name), splat_object.scene_from_object(original)
        folder = JobFolder.create(path, scene, options, original.name)
        job_result.discard_result(original)
        delete_job(former)
        select(context, [original])
        text = tr("Fine-tuning {count:,} Gaussians in the background")
        return begin(original, folder) or text.format(count=count)
