"""Step 1: import of splats and cameras, and what the active splat is."""

import bpy
from bpy.app.translations import pgettext_iface as tr

from .wrapped_label import wrapped_label

ROOTS = 3  # sets of cameras that are offered


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
        row = layout.row()
        if about:
            row.label(text=context.object.name, icon="OUTLINER_OB_POINTCLOUD", translate=False)
            layout.label(text=about, translate=False)
        else:
            row.label(text="Select a splat, or import one", icon="INFO")
        row.operator("svrgs.frame", text="", icon="ZOOM_SELECTED")
        if not about:
            return
        draw_cameras(layout, context.scene.svrgs_looking)
        moved = context.scene.svrgs_looking.moved
        if moved:
            text = tr(
                "Blender has moved {count:,} points without their shapes. SVR-GS shows and exports the right"
                " shapes"
            )
            wrapped_label(layout, text.format(count=moved), "INFO")
            layout.operator("svrgs.write_shapes", icon="CHECKMARK")


def draw_cameras(layout, looking):
    """The cameras of the splat, with a button to part from them; or buttons to use those that there are."""
    if looking.cameras:
        row = layout.row()
        row.label(text=looking.cameras, icon="OUTLINER_OB_CAMERA", translate=False)
        row.operator("svrgs.part_from_cameras", text="", icon="X")
        return
    for name in looking.roots.splitlines()[:ROOTS]:
        layout.operator(
            "svrgs.use_cameras",
            text=tr("Use Cameras of '{name}'").format(name=name),
            icon="OUTLINER_OB_CAMERA",
            translate=False,
        ).root = name


def register():
    bpy.utils.register_class(SVRGS_PT_scene)


def unregister():
    bpy.utils.unregister_class(SVRGS_PT_scene)
