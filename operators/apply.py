"""Apply and Discard: the two ways to end the comparison of an original with its pruned splat.

Apply keeps the Gaussians that are shown, including those of the original that the slider Keep brought back. The original stays,
hidden, until it is discarded.
"""

from __future__ import annotations

import bpy

from ..svrgs_addon.errors import SplatError
from . import bridge, edit_guard, job_result
from .job import delete_job
from .select import select
from .splat_size import size_text


class SVRGS_OT_apply(bpy.types.Operator):
    bl_idname = "svrgs.apply"
    bl_label = "Apply"
    bl_description = "Keep the Gaussians that are shown and delete the others from the pruned splat. The original stays, hidden"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        _, pruned = job_result.pair_of(context.object)
        undecided = job_result.undecided(pruned)
        problem = edit_guard.problem(context, pruned) if undecided else "Select a pruned splat that was not applied yet"
        if problem:
            cls.poll_message_set(problem)
        return not problem

    def execute(self, context):
        original, pruned = job_result.pair_of(context.object)
        assert pruned is not None  # see poll
        try:
            scene = job_result.shown_gaussians(pruned)
            if not scene.count:
                raise SplatError("no Gaussian would be left: keep more")
            bridge.replace_gaussians(pruned, scene)
        except SplatError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        job_result.unmark(pruned)
        pruned.hide_viewport = pruned.hide_render = False
        before = ""
        if original is not None:
            job_result.unmark(original)
            original.hide_viewport = original.hide_render = True
            before = f" of {bridge.count(original):,}"
        select(context, [pruned])
        self.report({"INFO"}, f"Kept {scene.count:,}{before} Gaussians, {size_text(pruned, scene.count)}")
        return {"FINISHED"}


class SVRGS_OT_discard(bpy.types.Operator):
    bl_idname = "svrgs.discard"
    bl_label = "Discard"
    bl_description = "Delete the original or the pruned splat from the file, and the files of the job"
    bl_options = {"REGISTER", "UNDO"}

    what: bpy.props.EnumProperty(
        name="What", description="The splat to delete",
        items=[("ORIGINAL", "Original", "The splat as it was before pruning"), ("RESULT", "Result", "The pruned splat. The original is as it was")],
    )  # fmt: skip

    @classmethod
    def poll(cls, context):
        original, pruned = job_result.pair_of(context.object)
        if original is not None and pruned is not None and context.mode == "OBJECT":
            return True
        cls.poll_message_set("Select a splat that was pruned, or its original")
        return False

    def execute(self, context):
        original, pruned = job_result.pair_of(context.object)
        assert original is not None and pruned is not None  # see poll
        if self.what == "ORIGINAL" and job_result.undecided(pruned):
            self.report({"ERROR"}, "Apply the result first: it still needs the original")
            return {"CANCELLED"}
        try:
            delete_job(original)
        except OSError as error:
            self.report({"WARNING"}, str(error))
        deleted, left = (original, pruned) if self.what == "ORIGINAL" else (pruned, original)
        message = f"Discarded '{deleted.name}' with {bridge.count(deleted):,} Gaussians; '{left.name}' stays"
        (job_result.discard_result if deleted is pruned else job_result.delete_object)(original)
        select(context, [left])
        self.report({"INFO"}, message)
        return {"FINISHED"}


CLASSES = (SVRGS_OT_apply, SVRGS_OT_discard)


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister():
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
