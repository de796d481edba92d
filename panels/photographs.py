"""The photographs of the active splat, with what the last job found about each: below the panel Scene."""

import bpy

from ..operators.data import camera_object, known, splat_object
from ..operators.scene import photographs
from .sidebar import SplatPanel, wrapped_label


class SVRGS_UL_photographs(bpy.types.UIList):
    def draw_item(self, context, layout, data, item, icon, active_data, active_property):
        row = layout.split(factor=0.4)
        row.label(text=item.data[camera_object.IMAGE], icon="OUTLINER_OB_CAMERA", translate=False)
        if text := photographs.about(item):
            row.label(text=text, translate=False)

    def filter_items(self, context, data, prop):
        """Of all objects of the file: the photographs, by the names of their images."""
        objects, shown = getattr(data, prop), photographs.of(splat_object.root_of(context.object))
        wanted = self.filter_name.lower()
        found = {obj for obj in shown if wanted in obj.data[camera_object.IMAGE].lower()}
        flags = [self.bitflag_filter_item if obj in found else 0 for obj in objects]
        places = {obj: place for place, obj in enumerate(shown)}
        order = sorted(range(len(objects)), key=lambda k: places.get(objects[k], len(objects) + k))
        ranks = [0] * len(order)
        for rank, k in enumerate(order):
            ranks[k] = rank
        return flags, ranks


class SVRGS_PT_photographs(SplatPanel):
    bl_label = "Photographs"
    manual = "blender.html#scene"

    @classmethod
    def poll(cls, context):
        return bool(photographs.of(splat_object.root_of(context.object)))

    def draw(self, context):
        layout, settings = self.layout, context.scene.svrgs_view
        layout.template_list("SVRGS_UL_photographs", "", bpy.data, "objects", settings, "photograph", rows=6)
        layout.prop(settings, "show_masks")
        root = splat_object.root_of(context.object)
        if root is not None and (problem := known.of(root).mask_problem):
            wrapped_label(layout, problem, "ERROR")
