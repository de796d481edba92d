"""Properties editor with the engine SVR-GS: Blender's own panels that apply to it, and its background."""

import bpy

from .wrapped_label import lines, usable

ENGINE = "SVRGS"
NOT_OURS = {"VIEWLAYER_PT_filter", "VIEWLAYER_PT_layer_passes", "RENDER_PT_simplify"}


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
        if not usable(layout, context):
            return
        layout.use_property_split = True
        layout.prop(context.scene.svrgs_looking, "background")
        layout.prop(context.scene.render, "film_transparent", text="Transparent")
        if context.scene.view_settings.view_transform != "Standard":
            lines(layout, "The view transform Standard shows the training colours", "INFO")


def shared_panels():
    """Blender's panels for engines that bring none of their own."""
    panels = (panel for panel in bpy.types.Panel.__subclasses__() if "BLENDER_RENDER" in getattr(panel, "COMPAT_ENGINES", ()))
    return [panel for panel in panels if panel.__name__ not in NOT_OURS]


def register():
    bpy.utils.register_class(SVRGS_PT_engine)
    for panel in shared_panels():
        panel.COMPAT_ENGINES.add(ENGINE)


def unregister():
    for panel in shared_panels():
        panel.COMPAT_ENGINES.discard(ENGINE)
    bpy.utils.unregister_class(SVRGS_PT_engine)
