"""View: settings of drawing splats in Solid and Material Preview viewports."""

import bpy

from .wrapped_label import native_library_works


class SVRGS_PT_overlay(bpy.types.Panel):
    bl_label = "View"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "SVR-GS"
    bl_options = {"DEFAULT_CLOSED"}
    bl_order = 9

    def draw_header(self, context):
        self.layout.prop(context.scene.svrgs_looking, "overlay", text="")

    def draw(self, context):
        layout, settings = self.layout, context.scene.svrgs_looking
        if not native_library_works(layout):
            return
        layout.use_property_split = True
        layout.use_property_decorate = False
        column = layout.column()
        column.active = settings.overlay
        column.prop(settings, "overlay_shown")
        column.prop(settings, "overlay_moving")


CLASSES = (SVRGS_PT_overlay,)
