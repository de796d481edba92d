"""Panels of the Properties editor for the render engine SVR-GS: its background, and those of Blender's panels
that apply to it."""

import bpy

from .rendering import draw_standard
from .sidebar import native_library_works

ENGINE = "SVRGS"
EXCLUDED = {"VIEWLAYER_PT_filter", "VIEWLAYER_PT_layer_passes", "RENDER_PT_simplify"}


class SVRGS_PT_engine(bpy.types.Panel):
    bl_label = "Splats"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    COMPAT_ENGINES = {ENGINE}

    @classmethod
    def poll(cls, context):
        return context.engine in cls.COMPAT_ENGINES

    def draw(self, context):
        layout = self.layout
        if not native_library_works(layout):
            return
        layout.use_property_split = True
        layout.prop(context.scene.svrgs_view, "background")
        layout.prop(context.scene.render, "film_transparent", text="Transparent")
        layout.prop(context.scene.svrgs_view, "meshes")
        draw_standard(layout, context.scene)


def shared_panels():
    """The panels that Blender shows for every engine without panels of its own."""
    panels = (panel for panel in bpy.types.Panel.__subclasses__() if panel.__name__ not in EXCLUDED)
    return [panel for panel in panels if "BLENDER_RENDER" in getattr(panel, "COMPAT_ENGINES", ())]


def register():
    for panel in shared_panels():
        panel.COMPAT_ENGINES.add(ENGINE)


def unregister():
    for panel in shared_panels():
        panel.COMPAT_ENGINES.discard(ENGINE)
