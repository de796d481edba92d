"""Writes the attribute "contribution" of a splat: for each Gaussian, the sum of its weights αT over all
pixels of the cameras."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as tr
from bpy.props import EnumProperty

from ...svrgs_addon.finetune.scores import contribution
from ...svrgs_addon.native import library
from ...svrgs_addon.native.rasterizer import Rasterizer
from ...svrgs_addon.render.metrics.evaluate import render_options
from ...svrgs_addon.scene.camera import Camera
from ...svrgs_addon.system.errors import SceneError
from ..data import camera_object, edit_guard, splat_object, visible_splats
from ..data.preferences import threads
from ..data.reporting import ReportingOperator

ATTRIBUTE = "contribution"
LONGER_SIDE = 640  # pixels, about: images are reduced to this size


def cameras_property():
    """The menu of the cameras whose images count."""
    return EnumProperty(
        name="Cameras", description="The cameras whose images count",
        items=[
            ("PHOTOGRAPHS", "Photographs", "All imported cameras; all cameras if none was imported"),
            ("SELECTED", "Selected", "The selected cameras"),
            ("ACTIVE", "Scene Camera", "The scene's camera"),
        ],
    )  # fmt: skip


class SVRGS_OT_contribution(ReportingOperator):
    bl_idname = "svrgs.contribution"
    bl_label = "Show Contribution"
    bl_description = (
        "Sum for each Gaussian what it adds to the images of the cameras, and store it as the attribute"
        " 'contribution'"
    )
    bl_options = {"REGISTER", "UNDO"}

    cameras: cameras_property()

    @classmethod
    def problem(cls, context) -> str:
        if not splat_object.is_splat(context.object):
            return tr("Make a splat the active object first")
        return edit_guard.problem(context, context.object)

    def work(self, context) -> str:
        obj = context.object
        library.set_threads(threads(context))
        scene = splat_object.scene_from_object(obj)
        placed = visible_splats.placed([(scene, obj.matrix_world.copy())])
        cameras = views(context, chosen_cameras(context, self.cameras), placed)
        sums, _, hits = contribution(placed.scene, cameras, Rasterizer(), render_options(scene))
        splat_object.set_values(obj, ATTRIBUTE, "FLOAT", sums.astype("float32"))
        text = tr("{unseen:,} of {count:,} Gaussians add nothing to {images:,} images")
        return text.format(unseen=int((hits == 0).sum()), count=scene.count, images=len(cameras))


def chosen_cameras(context, which: str = "PHOTOGRAPHS") -> list[bpy.types.Object]:
    """Camera objects in name order."""
    if which == "ACTIVE":
        return [context.scene.camera] if context.scene.camera is not None else []
    pool = context.selected_objects if which == "SELECTED" else context.scene.objects
    cameras = sorted((obj for obj in pool if obj.type == "CAMERA"), key=lambda obj: obj.name)
    imported = [obj for obj in cameras if camera_object.SIZE in obj.data]
    return imported if imported and which == "PHOTOGRAPHS" else cameras


def views(context, cameras: list[bpy.types.Object], placed: visible_splats.PlacedScene) -> list[Camera]:
    """The views of camera objects, reduced, in the coordinates of the scene. Raises SceneError, also if there
    are none."""
    if not cameras:
        raise SceneError(tr("there is no such camera: import the cameras of the dataset, or choose others"))
    found = [camera_object.camera_from_object(obj, context.scene) for obj in cameras]
    return [
        placed.seen_by(view.reduced(max(1, max(view.width, view.height) // LONGER_SIDE))) for view in found
    ]


CLASSES = (SVRGS_OT_contribution,)
