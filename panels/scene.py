"""Step 1: what is there, and how more comes in."""

import bpy

SPLAT = ("scale", "rotation", "radiance:base")  # attributes of a splat


class SVRGS_PT_scene(bpy.types.Panel):
    bl_label = "1  Scene"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "SVR-GS"

    def draw(self, context):
        layout = self.layout
        column = layout.column(align=True)
        column.operator("svrgs.import_ply", icon="IMPORT", text="Import Splat")
        column.operator("svrgs.import_colmap", icon="OUTLINER_OB_CAMERA", text="Import Cameras")
        obj = context.object
        attributes = getattr(getattr(obj, "data", None), "attributes", {})
        if not all(name in attributes for name in SPLAT):
            layout.label(text="Select a splat, or import one", icon="INFO")
            return
        points = obj.data.vertices if obj.type == "MESH" else obj.data.points
        layout.label(text=obj.name, icon="OUTLINER_OB_POINTCLOUD")
        layout.label(text=f"{len(points):,} Gaussians, SH degree {sh_degree(attributes)}")


def sh_degree(attributes) -> int:
    return sum(f"radiance:sh_{last}" in attributes for last in (2, 7, 14))


def register():
    bpy.utils.register_class(SVRGS_PT_scene)


def unregister():
    bpy.utils.unregister_class(SVRGS_PT_scene)
