"""Render: what renders of the scene show of its splats, and what to do. In the 3D View and in the Properties
editor."""

import bpy
from bpy.app.translations import pgettext_iface as tr

from ..operators.scene import splat_layer
from .sidebar import SidebarPanel, wrapped_label


class SVRGS_PT_rendering(SidebarPanel):
    bl_label = "Render"
    manual = "rendering.html"
    bl_order = 6

    def draw(self, context):
        draw_rendering(self.layout, context)


class SVRGS_PT_not_drawn(bpy.types.Panel):
    bl_label = "Splats"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"

    @classmethod
    def poll(cls, context):
        return bool(splat_layer.missing(context.scene) or splat_layer.drawn_by_blender(context.scene))

    def draw(self, context):
        draw_rendering(self.layout, context)


def draw_rendering(layout, context):
    """What is missing, and the buttons that mend it."""
    scene = context.scene
    if missing := splat_layer.missing(scene):
        wrapped_label(layout, missing, "ERROR")
    elif note := splat_layer.drawn_by_blender(scene):
        wrapped_label(layout, note, "INFO")
    column = layout.column(align=True)
    column.operator("svrgs.set_up_rendering", icon="SCENE")
    column.operator("svrgs.set_up_compositing", icon="NODE_COMPOSITING")
    draw_standard(layout, scene)


def draw_standard(layout, scene):
    """A button where the view transform changes the colours of the training."""
    if scene.view_settings.view_transform != "Standard":
        text = tr("The view transform {name} changes the colours of the training")
        wrapped_label(layout, text.format(name=tr(scene.view_settings.view_transform)), "INFO")
        layout.operator("svrgs.use_standard", icon="COLOR")
