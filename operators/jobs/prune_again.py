"""Fine-Tune: the job of a quick result once more, for the number of Gaussians that the slider Keep shows."""

from __future__ import annotations

from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.jobs.job_folder import JobFolder
from ...svrgs_addon.jobs.job_process import Job
from ..data import edit_guard, quick_order, splat_object
from ..data.reporting import ReportingOperator
from ..data.select import select
from . import job_queue, job_result
from .job import new_folder
from .job_watch import delete_job, job_of, link, start_timer

GOALS = ("target", "target_count", "max_drop")  # options that say how many Gaussians stay


class SVRGS_OT_prune_again(ReportingOperator):
    bl_idname = "svrgs.prune_again"
    bl_label = "Fine-Tune"
    bl_description = (
        "Prune the original once more, to the number of Gaussians that is shown, with the steps that win"
        " quality back. It replaces this result"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        original, pruned = job_result.pair_of(context.object)
        if (
            pruned is None
            or not job_result.undecided(pruned)
            or not quick_order.is_shown(pruned)
            or job_of(original) is None
        ):
            problem = tr("Choose another number of Gaussians with the slider Keep first")
        else:
            problem = edit_guard.problem(context, original)  # it is there: its job has kept the order
        if problem:
            cls.poll_message_set(problem)
        return not problem

    def work(self, context) -> str:
        original, pruned = job_result.pair_of(context.object)
        former = job_of(original)
        assert original is not None and pruned is not None and former is not None  # see poll
        count = job_result.shown_count(pruned)
        options = {
            name: value for name, value in former.folder.request()["options"].items() if name not in GOALS
        } | {"target_count": count}
        folder = JobFolder.create(
            new_folder(context, original.name),
            splat_object.scene_from_object(original),
            options,
            original.name,
        )
        job_result.discard_result(original)
        delete_job(former)
        link(original, str(folder.path))
        select(context, [original])
        waits = job_queue.start(Job(folder))
        start_timer()
        return waits or tr("Fine-tuning {count:,} Gaussians in the background").format(count=count)


CLASSES = (SVRGS_OT_prune_again,)
