"""File > Import: splat files, also by drag and drop. Each file becomes an object."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as tr
from bpy.props import BoolProperty, CollectionProperty, StringProperty
from bpy_extras.io_utils import ImportHelper
from mathutils import Matrix

from ...svrgs_addon.files import registry
from ...svrgs_addon.files.repair import bake_filter, drop_nonfinite
from ...svrgs_addon.system.errors import SplatError
from ..data import splat_object
from ..data.reporting import ReportingOperator, menu
from ..data.select import open_collection, select
from ..scene.frame import frame
from ..translation import OWN

SAMPLE = Path(__file__).resolve().parents[2] / "svrgs_addon/sample.spz"  # of the generated scene demo


class SVRGS_OT_import_ply(ReportingOperator, ImportHelper):
    bl_label = "Import 3D Gaussian Splat"
    bl_description = "Import splat files. Each becomes an object of points that keeps every value of its file"
    bl_options = {"REGISTER", "UNDO", "PRESET"}

    filename_ext = registry.suffixes()[0]
    filter_glob: StringProperty(
        default=";".join([*(f"*{suffix}" for suffix in registry.suffixes()), *registry.INDEXES]),
        options={"HIDDEN"},
    )
    directory: StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"})
    files: CollectionProperty(type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"})
    y_down: BoolProperty(
        name="Turn Upright (Y-Down File)",
        default=True,
        description="The file's y axis points down, as in 3DGS files. The object is turned upright",
    )
    frame: BoolProperty(
        name="Frame",
        translation_context=OWN,
        default=True,
        description="Turn the 3D viewports to the splat. Gaussians far outside are not counted",
    )

    def work(self, context) -> str:
        paths, texts = self.paths(), []
        objects: list[bpy.types.Object] = []
        for path in paths:
            try:
                scene, filtered = bake_filter(registry.read_scene(path))
                scene, dropped = drop_nonfinite(scene)
            except SplatError as error:
                if path == paths[-1] and not objects:
                    raise
                self.report({"WARNING"}, str(error))
                continue
            objects.append(self.add(context, registry.split_name(path)[0], scene))
            objects[-1][splat_object.FORMAT] = registry.format_to_read(path).name
            objects[-1][splat_object.BYTES] = float(registry.size_on_disk(path))
            root = splat_object.root_of(objects[-1])
            text = tr("{file}: {count:,} Gaussians")
            texts.append(text.format(file="".join(registry.split_name(path)), count=scene.count))
            if dropped:
                text = tr("{count:,} with values that are not finite were left out")
                texts.append(text.format(count=dropped))
            if filtered:
                texts.append(tr("3D filter of Mip-Splatting baked in"))
            if root is not None:
                texts.append(tr("joined to the cameras of '{name}'").format(name=root.name))
        select(context, objects)
        if self.frame:
            frame(context, objects)
        return tr("Imported {splats}").format(splats="; ".join(texts))

    def add(self, context, name, scene) -> bpy.types.Object:
        """Adds the splat as an object; with the cameras below one root if the active object belongs to a
        dataset."""
        obj = splat_object.object_from_scene(
            name, scene, open_collection(context), splat_object.AXES if self.y_down else Matrix()
        )
        obj[splat_object.Y_DOWN] = self.y_down
        root = splat_object.root_of(context.object)
        if root is not None and self.y_down:
            splat_object.parent_to_root(obj, root)
        return obj

    def paths(self) -> list[Path]:
        folder = Path(bpy.path.abspath(self.directory))
        return [folder / file.name for file in self.files if file.name] or [
            Path(bpy.path.abspath(self.filepath))
        ]

    def invoke(self, context, event):
        """Opens the file browser; for dropped files a dialog, or an error if one of them is not a splat."""
        if self.properties.is_property_set("filepath"):
            try:
                for path in self.paths():
                    registry.check_readable(path)
            except SplatError as error:
                self.report({"ERROR"}, str(error))
                return {"CANCELLED"}
        return self.invoke_popup(context)


class SVRGS_FH_ply(bpy.types.FileHandler):
    """Drag and drop. Blender has a handler for .ply of its own, so it asks whether to import a mesh or a
    splat."""

    bl_idname = "SVRGS_FH_ply"
    bl_label = "3D Gaussian Splat"
    bl_import_operator = SVRGS_OT_import_ply.bl_idname
    bl_file_extensions = ";".join(registry.suffixes())

    @classmethod
    def poll_drop(cls, context):
        return context.area is not None and context.area.type in {"VIEW_3D", "OUTLINER"}


MENUS = {"TOPBAR_MT_file_import": menu(SVRGS_OT_import_ply, text=registry.menu_label())}
