"""Step 1: what is there, and how more comes in."""

import bpy


class SVRGS_PT_scene(bpy.types.Panel):
    bl_label = "1  Scene"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "SVR-GS"

    def draw(self, context):
        layout = self.layout
        layout.operator("svrgs.import_ply", icon="IMPORT", text="Import Splat")
        obj = context.object
        attributes = getattr(getattr(obj, "data", None), "attributes", {})
        if "radiance:base" in attributes:
            layout.label(text=f"{obj.name}: {len(attributes['radiance:base'].data):,} Gaussians", icon="OUTLINER_OB_POINTCLOUD")
        else:
            layout.label(text="Select a splat, or import one", icon="INFO")


def register():
    bpy.utils.register_class(SVRGS_PT_scene)


def unregister():
    bpy.utils.unregister_class(SVRGS_PT_scene)
