"""View: settings of drawing splats in Solid and Material Preview viewports."""

from .sidebar import SidebarPanel, native_library_works, split_column


class SVRGS_PT_overlay(SidebarPanel):
    bl_label = "View"
    manual = "blender.html#in-the-view-and-in-renders"
    bl_options = {"DEFAULT_CLOSED"}
    bl_order = 9

    def draw_header(self, context):
        self.layout.prop(context.scene.svrgs_view, "overlay", text="")

    def draw(self, context):
        layout, settings = self.layout, context.scene.svrgs_view
        if not native_library_works(layout):
            return
        column = split_column(layout)
        column.active = settings.overlay
        column.prop(settings, "overlay_shown")
