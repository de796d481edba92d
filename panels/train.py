"""Step 2 for cameras without a splat: train one from their photographs; and the progress of that."""

import bpy

from ..operators.jobs import train
from .jobs import draw_job
from .sidebar import SidebarPanel, split_column, wrapped_label


class SVRGS_PT_train(SidebarPanel, bpy.types.Panel):
    bl_label = "2  Train"
    bl_order = 1

    @classmethod
    def poll(cls, context):
        return train.is_shown(context)

    def draw(self, context):
        layout, settings = self.layout, context.scene.svrgs_train
        if (found := train.current_job(context)) is not None:
            draw_job(layout, context, *found)
            return
        wrapped_label(layout, train.about(context), "OUTLINER_OB_CAMERA")
        column = split_column(layout)
        column.prop(settings, "use_time")
        column.prop(settings, "time" if settings.use_time else "iterations")
        column.operator("svrgs.train", icon="PLAY", text="Train Splat from Photographs")
        if problem := train.problem(context):
            wrapped_label(layout, problem, "INFO")


CLASSES = (SVRGS_PT_train,)
