"""File > Export: writes the active splat into a file: what is seen of it, or all that is stored.

A splat that was neither edited nor moved since its import is exported byte for byte.
"""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as tr
from bpy.props import BoolProperty, EnumProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from ..svrgs_addon.errors import SceneError, SplatError
from ..svrgs_addon.files.registry import FORMATS, format_to_write, left_out, menu_label, split_name, suffixes, write_scene
from ..svrgs_addon.files.repair import drop_nonfinite
from ..svrgs_addon.geometry.affine import UNIFORM, stretch, transformed
from ..svrgs_addon.geometry.merge import joined
from . import bridge, bridge_graph, job_result
from .splat_transforms import stretch_warning
from .translation import OWN

WHAT_FOR = {  # by the names of the formats
    "ply": "Every value as it is. All programs read it",
    "compressed-ply": "A quarter of the size. Read by SuperSplat, PlayCanvas and Brush",
    "spz": "A tenth of the size. Read by many programs and by web viewers",
    "glb": "Every value as it is, in a scene file. Read by glTF programs that know splats",
    "usd": "Every value as it is, in a stage. Read by Blender 5.3, Omniverse and other programs that know splats",
    "sog": "A fifteenth of the size. Read by SuperSplat and PlayCanvas",
    "splat": "Colours that do not depend on the view. Read by web viewers",
}
KINDS = [(one.name, one.label, WHAT_FOR[one.name]) for one in FORMATS if one.write and one.suffixes]


class SVRGS_OT_export_ply(bpy.types.Operator, ExportHelper):
    bl_idname = "svrgs.export_ply"
    bl_label = "Export 3D Gaussian Splat"
    bl_description = "Write the active splat into a 3DGS file, as it is seen"
    bl_options = {"REGISTER", "PRESET"}

    filename_ext = suffixes(written=True)[0]
    kind: EnumProperty(name="Format", description="Format of the file. It gives the name its suffix", items=KINDS)
    filter_glob: StringProperty(default=";".join(f"*{suffix}" for suffix in suffixes(written=True)), options={"HIDDEN"})
    what: EnumProperty(
        name="Gaussians",
        description="Gaussians to write",
        items=[
            ("SEEN", "As Seen", "What the viewport shows of the splat: with its modifiers and instances, without Gaussians that are hidden as removed"),
            ("STORED", "All Stored", "All Gaussians of the splat, also those hidden as removed, without modifiers"),
        ],
    )
    space: EnumProperty(
        name="Coordinates",
        translation_context=OWN,
        description="Coordinates of the file",
        items=[
            ("FILE", "Imported File", "Those of the imported file or of the dataset. What was moved, rotated or scaled since then is moved in the file"),
            ("LOCAL", "Local", "Those of the object. Its location, rotation and scale are left out"),
            ("WORLD", "World", "Those of Blender's world"),
        ],
    )
    y_down: BoolProperty(name="Y-Down File", default=True, description="World coordinates with y down, as in 3DGS files. Off: z up, as in Blender")

    @classmethod
    def poll(cls, context):
        if bridge.is_splat(context.object):
            return True
        cls.poll_message_set(tr("Select a Gaussian splat first"))
        return False

    def invoke(self, context, event):
        if not self.properties.is_property_set("filepath"):
            self.filepath = str(default_path(context.object))
        self.check(context)
        return super().invoke(context, event)

    def check(self, context):
        """Gives the name the suffix of the format. Returns whether it had another one."""
        (wanted,) = (one.suffixes[0] for one in FORMATS if one.name == self.kind)
        path = Path(self.filepath)
        name, suffix = split_name(path)
        if suffix.lower() == wanted:
            return False
        self.filepath = str(path.with_name((name if suffix.lower() in suffixes() else path.name) + wanted))
        return True

    def draw(self, context):
        self.layout.use_property_split = True
        self.layout.prop(self, "kind")
        self.layout.prop(self, "what")
        self.layout.prop(self, "space")
        row = self.layout.row()
        row.active = self.space == "WORLD"
        row.prop(self, "y_down")

    def execute(self, context):
        obj, path = context.object, Path(bpy.path.abspath(self.filepath))
        try:
            parts = gaussians(context, obj, self.what == "SEEN")
            matrices = [self.to_space(obj, matrix) for _, matrix in parts]
            if any(stretch(matrix) - 1 > 10 * UNIFORM for matrix in matrices):
                self.report({"WARNING"}, stretch_warning(obj))
            placed = [transformed(scene, matrix) for (scene, _), matrix in zip(parts, matrices, strict=True)]
            scene, dropped = drop_nonfinite(joined(placed) if len(placed) > 1 else placed[0])
            write_scene(path, scene)
        except SplatError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        texts = [tr("Exported {count:,} Gaussians to {file}, {size:.1f} MB").format(count=scene.count, file=path.name, size=path.stat().st_size / 1e6)]
        lost = left_out(scene, format_to_write(path))
        self.report({"WARNING" if lost else "INFO"}, "; ".join([*texts, *self.left_out(obj, dropped), *lost]))
        return {"FINISHED"}

    def to_space(self, obj: bpy.types.Object, matrix):
        """(4, 4) from the object's coordinates to those of the file. matrix: from them to Blender's world."""
        if self.space == "FILE":
            return bridge.to_file(obj, matrix)
        return bridge.to_world(matrix, self.y_down) if self.space == "WORLD" else bridge.in_local(obj, matrix)

    def left_out(self, obj: bpy.types.Object, dropped: int) -> list[str]:
        """What the file does not hold, in words."""
        hidden = job_result.marked_count(obj) if self.what == "SEEN" else 0
        texts = [tr("without {count:,} hidden as removed").format(count=hidden)] if hidden else []
        return [*texts, tr("without {count:,} with values that are not finite").format(count=dropped)] if dropped else texts


def default_path(obj: bpy.types.Object) -> Path:
    """A file beside the .blend file, with the name of the splat."""
    folder = Path(bpy.data.filepath).parent if bpy.data.filepath else Path()
    return folder / (bpy.path.clean_name(obj.name) + suffixes(written=True)[0])


def gaussians(context, obj: bpy.types.Object, seen: bool) -> list:
    """[(Scene, matrix to Blender's world)] of a splat: what the viewport shows of it, or all that is stored. Raises SceneError."""
    if not seen:
        return [(bridge.scene_from_object(obj), obj.matrix_world)]
    parts = bridge_graph.shown_by(context.evaluated_depsgraph_get(), obj) if obj.mode != "EDIT" else []
    if parts:
        return parts
    if any(modifier.show_viewport and modifier.name != bridge_graph.HIDE_MODIFIER for modifier in obj.modifiers):
        text = tr("Blender does not apply the modifiers of '{name}' in Edit Mode or while it is hidden: show it, or export All Stored")
        raise SceneError(text.format(name=obj.name))
    scene = bridge.scene_from_object(obj) if obj.mode == "EDIT" else bridge_graph.visible_scene(obj)
    return [(scene, obj.matrix_world)]


def menu(self, context):
    self.layout.operator(SVRGS_OT_export_ply.bl_idname, text=menu_label(written=True))


def register():
    bpy.utils.register_class(SVRGS_OT_export_ply)
    bpy.types.TOPBAR_MT_file_export.append(menu)


def unregister():
    bpy.types.TOPBAR_MT_file_export.remove(menu)
    bpy.utils.unregister_class(SVRGS_OT_export_ply)
