"""Measures how much the images of cameras need each Gaussian of a splat, stores it as attributes, and shows
them."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as tr
from bpy.props import EnumProperty

from ...svrgs_addon.finetune.scores import contribution
from ...svrgs_addon.finetune.viewed_scene import ViewedScene
from ...svrgs_addon.prune.selection.measure import RANK, VIEW, measured, summary
from ...svrgs_addon.scene.camera import Camera
from ...svrgs_addon.scene.gaussians import Scene
from ...svrgs_addon.system.errors import SceneError
from ..data import camera_object, edit_guard, splat_object, visible_splats
from ..data.extension import use_threads
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


class CamerasOperator(ReportingOperator):
    """An operator that measures the Gaussians of the active splat in the images of cameras."""

    cameras: cameras_property()
    longest = LONGER_SIDE  # pixels of the longer side of the images

    @classmethod
    def problem(cls, context) -> str:
        if not splat_object.is_splat(context.object):
            return tr("Make a splat the active object first")
        return edit_guard.problem(context, context.object)

    def work(self, context) -> str:
        use_threads(context)
        obj = context.object
        placed = visible_splats.placed([(splat_object.scene_from_object(obj), obj.matrix_world.copy())])
        cameras = views(context, chosen_cameras(context, self.cameras), placed, self.longest)
        return self.measure(context, placed.scene, cameras)

    def measure(self, context, scene: Scene, cameras: list[Camera]) -> str:
        """Stores what was measured with store(). Returns it in words. Raises SceneError."""
        raise NotImplementedError

    @staticmethod
    def store(context, attributes: dict, shown: str):
        """Stores values (N,) by name, and lets the colours of Solid viewports show one of them."""
        for name, values in attributes.items():
            kind = "INT" if values.dtype.kind == "i" else "FLOAT"
            splat_object.set_values(context.object, name, kind, values)
        context.scene.svrgs_view.overlay_shown = shown


class SVRGS_OT_contribution(CamerasOperator):
    bl_label = "Show Contribution"
    bl_description = (
        "Sum for each Gaussian what it adds to the images of the cameras, and store it as the attribute"
        " 'contribution'"
    )

    def measure(self, context, scene, cameras):
        sums, _, hits = contribution(ViewedScene.of(scene, cameras))
        self.store(context, {ATTRIBUTE: sums.astype("float32")}, ATTRIBUTE)
        text = tr("{unseen:,} of {count:,} Gaussians add nothing to {images:,} images")
        return text.format(unseen=int((hits == 0).sum()), count=scene.count, images=len(cameras))


class SVRGS_OT_removal_error(CamerasOperator):
    bl_label = "Show Removal Error"
    bl_description = (
        "Measure for each Gaussian how much the images of the cameras need it, by how many of them that is"
        " decided, and how sure its rank is; stored as attributes"
    )

    longest = 2 * LONGER_SIDE  # they are halved, as pruning does

    def measure(self, context, scene, cameras):
        found = measured(scene, cameras, all_looks=False)
        self.store(context, found, RANK)
        text = tr(
            "{share_of_tenth:.0%} of the removal error is that of a tenth of the Gaussians; a Gaussian is"
            " decided by {deciding_views:.0f} of {images:,} images, and {unseen:,} by none"
        )
        return text.format(**summary(found), images=len(cameras), unseen=int((found[VIEW] < 0).sum()))


def chosen_cameras(context, which: str = "PHOTOGRAPHS") -> list[bpy.types.Object]:
    """Camera objects in name order."""
    if which == "ACTIVE":
        return [context.scene.camera] if context.scene.camera is not None else []
    pool = context.selected_objects if which == "SELECTED" else context.scene.objects
    cameras = sorted((obj for obj in pool if obj.type == "CAMERA"), key=lambda obj: obj.name)
    if which != "PHOTOGRAPHS":
        return cameras
    root = splat_object.root_of(context.object)
    family = cameras if root is None else set(root.children_recursive)
    return camera_object.photographs(obj for obj in cameras if obj in family) or cameras


def views(
    context, cameras: list[bpy.types.Object], placed: visible_splats.PlacedScene, longest: int = LONGER_SIDE
) -> list[Camera]:
    """The views of camera objects, reduced to about the longest side, in the coordinates of the scene. Raises
    SceneError, also if there are none."""
    if not cameras:
        raise SceneError(tr("there is no such camera: import the cameras of the dataset, or choose others"))
    found = [camera_object.camera_from_object(obj, context.scene) for obj in cameras]
    return [placed.seen_by(view.reduced(max(1, max(view.width, view.height) // longest))) for view in found]
