"""Step 4: out of Blender again, with what it will be."""

import bpy

from ..operators import job_result
from ..operators.job import file_size
from .prune import is_splat, lines, size_of


class SVRGS_PT_export(bpy.types.Panel):
    bl_label = "4  Export"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "SVR-GS"
    bl_order = 4

    def draw(self, context):
        layout, obj = self.layout, context.object
        if not is_splat(obj):
            layout.label(text="Select the splat to export", icon="INFO")
            return
        layout.label(text=f"{obj.name}: {size_of(obj):,} Gaussians, {file_size(obj, size_of(obj))}")
        marked = job_result.marked_count(obj)
        if marked:
            lines(layout, f"{marked:,} of them are marked as removed and would be exported: Apply first", "INFO")
        layout.operator("svrgs.export_ply", icon="EXPORT")


def register():
    bpy.utils.register_class(SVRGS_PT_export)


def unregister():
    bpy.utils.unregister_class(SVRGS_PT_export)
