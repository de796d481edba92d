"""Import of splats and cameras, and what the active splat is."""

from bpy.app.translations import pgettext_iface as tr

from ..operators.data import visible_splats
from ..operators.data.splat_object import is_splat, root_of
from ..operators.data.splat_size import about
from ..operators.io import undistort
from ..operators.io.import_ply import SAMPLE
from ..operators.scene import camera_match, dataset_paths, splat_transforms
from ..operators.scene.frame import in_default_cube
from .sidebar import SidebarPanel, wrapped_label

ROOTS = 3  # sets of cameras that are offered


class SVRGS_PT_scene(SidebarPanel):
    bl_label = "Scene"
    manual = "blender.html#scene"

    def draw(self, context):
        layout = self.layout
        column = layout.column(align=True)
        column.operator("svrgs.import_ply", icon="IMPORT", text="Import Splat")
        column.operator("svrgs.import_colmap", icon="OUTLINER_OB_CAMERA", text="Import Cameras")
        if photographs := undistort.status():
            wrapped_label(layout, photographs, "INFO")
        if lost := dataset_paths.lost(root_of(context.object)):
            wrapped_label(layout, lost, "ERROR")
            layout.operator("svrgs.find_dataset", icon="FILE_FOLDER", text="Find Dataset…")
        row = layout.row()
        if is_splat(context.object):
            row.label(text=context.object.name, icon="OUTLINER_OB_POINTCLOUD", translate=False)
            layout.label(text=about(context.object), translate=False)
        else:
            row.label(text="Select a splat, or import one", icon="INFO")
        row.operator("svrgs.frame", text="", icon="ZOOM_SELECTED")
        if visible_splats.made_by_nodes(context, context.object):
            text = tr(
                "Geometry nodes make the splat of '{name}': to prune it, make it an object with Object ›"
                " Apply › Visual Geometry to Objects"
            )
            wrapped_label(layout, text.format(name=context.object.name), "INFO")
            return
        if not is_splat(context.object):
            if not any(map(is_splat, context.scene.objects)):
                draw_first_steps(layout)
            return
        if in_default_cube(context, context.object):
            text = tr("Blender's default cube may hide a part of the splat: select the cube and press H")
            wrapped_label(layout, text, "INFO")
        draw_cameras(layout, context)
        if moved := splat_transforms.moved_count(context.object):
            text = tr(
                "Blender has moved {count:,} points without their shapes. SVR-GS shows and exports the right"
                " shapes"
            )
            wrapped_label(layout, text.format(count=moved), "INFO")
            layout.operator("svrgs.write_shapes", icon="CHECKMARK")


def draw_first_steps(layout):
    """What to do in a scene without a splat."""
    for sentence in (
        tr("Import a splat, or open the sample"),
        tr("Choose a goal, and press Prune"),
        tr("Compare, and export what you keep"),
    ):
        wrapped_label(layout, sentence)
    row = layout.row()
    row.operator_context = "EXEC_DEFAULT"  # without a dialog
    row.operator("svrgs.import_ply", text="Open Sample", icon="FILE_3D").filepath = str(SAMPLE)


def draw_cameras(layout, context):
    """The cameras of the splat, with a button to part from them; or buttons to use those that there are."""
    if cameras := camera_match.cameras_of(context.object):
        row = layout.row()
        row.label(text=cameras, icon="OUTLINER_OB_CAMERA", translate=False)
        row.operator("svrgs.part_from_cameras", text="", icon="X")
        return
    for name in camera_match.roots(context.scene)[:ROOTS]:
        text, icon = tr("Use Cameras of '{name}'").format(name=name), "OUTLINER_OB_CAMERA"
        layout.operator("svrgs.use_cameras", text=text, icon=icon, translate=False).root = name
