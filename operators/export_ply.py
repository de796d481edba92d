"""File > Export: writes the active splat into a file. A splat that was not edited is exported byte for byte."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from ..svrgs_addon.errors import SplatError
from ..svrgs_addon.files.registry import labels, suffixes, write_scene
from ..svrgs_addon.geometry.affine import UNIFORM, stretch, transformed
from . import bridge


class SVRGS_OT_export_ply(bpy.types.Operator, ExportHelper):
    bl_idname = "svrgs.export_ply"
    bl_label = "Export 3D Gaussian Splat"
    bl_description = "Write the active splat into a 3DGS file"
    bl_options = {"REGISTER", "PRESET"}

    filename_ext = suffixes(written=True)[0]
    filter_glob: StringProperty(default=";".join(f"*{suffix}" for suffix in suffixes(written=True)), options={"HIDDEN"})
    space: EnumProperty(
        name="Coordinates",
        description="Coordinates of the file",
        items=[
            ("LOCAL", "Local", "As imported, without the object's transform. Values that were not edited keep their bits"),
            ("WORLD", "World", "With the object's transform, applied to positions, shapes and view-dependent colours"),
        ],
    )
    y_down: BoolProperty(name="Y Is Down", default=True, description="World coordinates with y down, as in 3DGS files. Off: z up, as in Blender")

    @classmethod
    def poll(cls, context):
        if bridge.is_splat(context.object):
            return True
        cls.poll_message_set("Select a Gaussian splat first")
        return False

    def draw(self, context):
        self.layout.use_property_split = True
        self.layout.prop(self, "space")
        row = self.layout.row()
        row.active = self.space == "WORLD"
        row.prop(self, "y_down")

    def execute(self, context):
        obj, path = context.object, Path(bpy.path.abspath(self.filepath))
        try:
            scene = bridge.scene_from_object(obj)
            if self.space == "WORLD":
                matrix = bridge.AXES.inverted() @ obj.matrix_world if self.y_down else obj.matrix_world
                if stretch(matrix) - 1 > 10 * UNIFORM:
                    self.report({"WARNING"}, f"'{obj.name}' is scaled differently along its axes: view-dependent colours are only rotated, and so not exact")
                scene = transformed(scene, matrix)
            write_scene(path, scene)
        except SplatError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"Exported {scene.count:,} Gaussians to {path.name}, {path.stat().st_size / 1e6:.1f} MB, in {self.space.lower()} coordinates")
        return {"FINISHED"}


def menu(self, context):
    self.layout.operator(SVRGS_OT_export_ply.bl_idname, text=", ".join(labels(written=True)))


def register():
    bpy.utils.register_class(SVRGS_OT_export_ply)
    bpy.types.TOPBAR_MT_file_export.append(menu)


def unregister():
    bpy.types.TOPBAR_MT_file_export.remove(menu)
    bpy.utils.unregister_class(SVRGS_OT_export_ply)
