"""Step 1: import of splats and cameras, and what the active splat is."""

import bpy

from .wrapped_label import wrapped_label


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
        if context.scene.svrgs_looking.photographs:
            wrapped_label(layout, context.scene.svrgs_looking.photographs, "INFO")
        lost = context.window_manager.svrgs_prune_state.lost_dataset
        if lost:
            wrapped_label(layout, lost, "ERROR")
            layout.operator("svrgs.find_dataset", icon="FILE_FOLDER", text="Find Dataset…")
        about = context.scene.svrgs_looking.about
        if not about:
            layout.label(text="Select a splat, or import one", icon="INFO")
            return
        layout.label(text=context.object.name, icon="OUTLINER_OB_POINTCLOUD")
        layout.label(text=about)


def register():
    bpy.utils.register_class(SVRGS_PT_scene)


def unregister():
    bpy.utils.unregister_class(SVRGS_PT_scene)
