"""Color: the grade of the active splat, below the panel Scene."""

from bpy.app.translations import pgettext_iface as tr

from ..operators.data import grading
from .sidebar import SplatPanel, split_column, wrapped_label


class SVRGS_PT_color(SplatPanel):
    bl_label = "Color"
    manual = "blender.html#color"

    def draw(self, context):
        obj = context.object
        column = split_column(self.layout)
        for name in grading.NAMES:
            column.prop(obj.svrgs_grade, name)
        column.prop(obj.svrgs_grade, "crop")
        row = column.row()
        row.active = obj.svrgs_grade.crop is not None
        row.prop(obj.svrgs_grade, "softness")
        if problem := grading.problem(obj) or grading.still(obj, context.view_layer.depsgraph):
            wrapped_label(self.layout, problem, "ERROR")
        if not grading.is_graded(obj):
            return
        text = tr("Seen and exported so. Pruning takes the splat as it is stored")
        wrapped_label(self.layout, text, "INFO")
        self.layout.operator("svrgs.apply_grade", icon="CHECKMARK")
