"""Export Web Page: a folder that any web server shows, with the active splat as it is seen, and the original
to compare it with."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as tr
from bpy.props import BoolProperty

from ...svrgs_addon.scene.camera import Camera
from ...svrgs_addon.viewer.source import Source
from ...svrgs_addon.viewer.web_page import export, program_bytes
from ..data import pairs, splat_object
from ..data.camera_object import camera_from_object
from ..data.extension import native_problem
from ..data.reporting import BackgroundOperator, FolderOperator, Steps, menu
from ..data.world_matrix import world_matrix
from ..jobs import job_result
from .export_space import ExportSpace


class SVRGS_OT_export_page(BackgroundOperator, FolderOperator, ExportSpace):
    bl_label = "Export Web Page"
    bl_description = (
        "Write a folder that any web server shows: the active splat to be turned with mouse or finger, first"
        " seen from the scene's camera"
    )
    bl_options = {"REGISTER", "PRESET"}

    with_original: BoolProperty(
        name="Original",
        default=True,
        description=(
            "Also write the splat that this one was pruned from: a button loads it and wipes between both"
        ),
    )

    @classmethod
    def problem(cls, context) -> str:
        if not splat_object.is_splat(context.object):
            return tr("Select a Gaussian splat first")
        return native_problem()

    def invoke(self, context, event):
        self.in_window = True
        return super().invoke(context, event)

    def draw(self, context):
        self.layout.use_property_split = True
        self.layout.prop(self, "what")
        if pairs.original_of(context.object):
            self.layout.prop(self, "with_original")

    def steps(self, context) -> Steps:
        obj = context.object
        folder = Path(bpy.path.abspath(self.directory)) / bpy.path.clean_name(obj.name)
        self.space, self.y_down = "WORLD", True
        original = pairs.original_of(obj) if self.with_original else None
        shown = [one for one in (original, obj) if one is not None]
        found = [self.chosen(context, obj)]
        if original is not None:
            marked = self.what == "SEEN" and job_result.undecided(obj)  # what the job removed is not seen
            whole = [(job_result.before_pruning(original), world_matrix(original))] if marked else None
            found.insert(0, self.chosen(context, original, whole))
        scenes, dropped = zip(*found, strict=True)
        names, background = tuple(one.name for one in shown), tuple(context.scene.svrgs_view.background)
        left = self.left_out(obj, dropped[-1])
        source = Source(names, scenes, cameras(context.scene), background=background)
        written = yield partial(export, source, folder)
        size = sum(one["bytes"] for one in written) + program_bytes()
        text = tr("Exported a page to {folder}, {size:.1f} MB").format(folder=folder, size=size / 1e6)
        limits = [f"{one['name']}: {sentence}" for one in written for sentence in one["limits"]]
        self.report({"WARNING" if limits else "INFO"}, "; ".join([text, *left, *limits]))
        return ""


def cameras(scene: bpy.types.Scene) -> list[Camera]:
    """The scene's camera, with y down; none where it is missing or orthographic."""
    if scene.camera is None or scene.camera.type != "CAMERA" or scene.camera.data.type != "PERSP":
        return []
    return [camera_from_object(scene.camera, scene).moved(splat_object.AXES)]


MENUS = {"TOPBAR_MT_file_export": menu(SVRGS_OT_export_page, text="Splat Web Page (folder)")}
