"""Apply and Discard: the two ways to end the comparison of an original with its pruned splat.

Apply keeps the Gaussians that are shown, including those of the original that the slider Keep brought back.
The original stays, hidden, until it is discarded. Both are ordinary splats from then on. The job's files go
when the file is saved (applied_jobs.py).
"""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.system.errors import SplatError
from ..data import edit_guard, splat_object
from ..data.select import select
from ..data.splat_size import size_text
from . import applied_jobs, job_result
from .job_watch import delete_job, is_busy, job_of


class SVRGS_OT_apply(bpy.types.Operator):
    bl_idname = "svrgs.apply"
    bl_label = "Apply"
    bl_description = (
        "Keep the Gaussians that are shown and delete the others from the pruned splat. The original stays,"
        " hidden. The files of the job are deleted when the .blend file is saved"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        _, pruned = job_result.pair_of(context.object)
        undecided = job_result.undecided(pruned)
        problem = (
            edit_guard.problem(context, pruned)
            if undecided
            else tr("Select a pruned splat that was not applied yet")
        )
        if problem:
            cls.poll_message_set(problem)
        return not problem

    def execute(self, context):
        original, pruned = job_result.pair_of(context.object)
        assert pruned is not None  # see poll
        try:
            scene = job_result.shown_gaussians(pruned)
            if not scene.count:
                raise SplatError(tr("no Gaussian would be left: keep more"))
            splat_object.replace_gaussians(pruned, scene)
        except SplatError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        job_result.settle(original, pruned)
        applied_jobs.note(original, pruned)
        select(context, [pruned])
        text = (
            tr("Kept {kept:,} Gaussians, {size}")
            if original is None
            else tr("Kept {kept:,} of {count:,} Gaussians, {size}")
        )
        total = splat_object.count(original) if original is not None else 0
        self.report({"INFO"}, text.format(kept=scene.count, count=total, size=size_text(pruned, scene.count)))
        return {"FINISHED"}


class SVRGS_OT_discard(bpy.types.Operator):
    bl_idname = "svrgs.discard"
    bl_label = "Discard"
    bl_description = "Delete the original or the pruned splat from the file"
    bl_options = {"REGISTER", "UNDO"}

    what: bpy.props.EnumProperty(
        name="What", description="The splat to delete",
        items=[
            ("ORIGINAL", "Original", "The splat as it was before pruning. The pruned splat stays"),
            ("RESULT", "Result", "The pruned splat and the files of its job. The original is as it was"),
        ],
    )  # fmt: skip

    @classmethod
    def poll(cls, context):
        original, pruned = job_result.pair_of(context.object)
        if original is not None and pruned is not None and context.mode == "OBJECT":
            return True
        cls.poll_message_set(tr("Select a splat that was pruned, or its original"))
        return False

    def execute(self, context):
        original, pruned = job_result.pair_of(context.object)
        assert original is not None and pruned is not None  # see poll
        job = job_of(original)
        problem = (
            tr("Apply the result first: it still needs the original") if job_result.undecided(pruned) else ""
        )
        if not problem and job is not None and is_busy(job):
            problem = tr("A job is running on '{name}': stop it first").format(name=original.name)
        if self.what == "ORIGINAL" and problem:
            self.report({"ERROR"}, problem)
            return {"CANCELLED"}
        deleted, left = (original, pruned) if self.what == "ORIGINAL" else (pruned, original)
        text = tr("Discarded '{deleted}' with {count:,} Gaussians; '{left}' stays")
        message = text.format(deleted=deleted.name, count=splat_object.count(deleted), left=left.name)
        if deleted is original:
            job_result.discard_original(original, pruned)
        else:
            self.discard_result(original)
        select(context, [left])
        self.report({"INFO"}, message)
        return {"FINISHED"}

    def discard_result(self, original: bpy.types.Object):
        """With the files of its job."""
        job = job_of(original)
        try:
            if job is not None and job.state == "done":
                delete_job(job)
        except OSError as error:
            self.report({"WARNING"}, str(error))
        job_result.discard_result(original)


CLASSES = (SVRGS_OT_apply, SVRGS_OT_discard)
