"""Bakes the grade of a splat into its Gaussians."""

from __future__ import annotations

from bpy.app.translations import pgettext_iface as tr

from ..data import edit_guard, grading, selection, splat_object
from .select_gaussians import SplatOperator


class SVRGS_OT_apply_grade(SplatOperator):
    bl_label = "Apply Color"
    bl_description = "Give the Gaussians of the active splat the colours and opacities that are seen"

    @classmethod
    def problem_of(cls, context, obj) -> str:
        if problem := edit_guard.change_problem(context, [obj]) or edit_guard.shared([obj]):
            return problem
        if grading.is_animated(obj):
            return tr("The colours are animated: remove their keys and drivers first")
        return "" if grading.is_graded(obj) else tr("The colours are as they are stored")

    def work(self, context) -> str:
        obj = context.object
        whole = splat_object.scene_from_object(obj)
        scene = grading.applied(whole, obj)
        if scene.count < whole.count:
            selection.keep(obj, grading.left(whole, obj))
        splat_object.write_gaussians(obj, scene)
        grading.reset(obj)
        return tr("The Gaussians have the colours that are seen")
