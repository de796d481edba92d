"""Show Spatial Mask: draws the spatial mask F of the scene's camera, once, or after every change if Follow
Camera is on."""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.system.errors import NativeError, SplatError
from ..data import known
from ..data.reporting import ReportingOperator
from . import mask_image

DELAY = 0.1  # seconds after the last change


class SVRGS_OT_spatial_mask(ReportingOperator):
    bl_idname = "svrgs.spatial_mask"
    bl_label = "Show Spatial Mask"
    bl_description = (
        "Draw the spatial mask of the scene's camera into an image, for the Image Editor and for materials"
    )
    bl_options = {"REGISTER"}

    @classmethod
    def problem(cls, context) -> str:
        if context.scene.camera is not None:
            return ""
        return tr("There is no camera: add one, or import the cameras of the dataset")

    def work(self, context) -> str:
        result = mask_image.refresh(context)
        show_in_editors(context, bpy.data.images[mask_image.NAME])
        return tr("Spatial mask of {camera}: mean {mean:.3g}, largest {largest:.3g}").format(**result)


def show_in_editors(context, image: bpy.types.Image):
    """Shows the image in every Image Editor that is empty or shows another image of this extension."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            space = area.spaces.active
            if (
                area.type == "IMAGE_EDITOR"
                and space.mode == "VIEW"
                and (space.image is None or space.image.name.startswith("SVR-GS"))
            ):
                space.image = image
                area.tag_redraw()


@persistent
def _after_change(scene, depsgraph=None):
    if scene.svrgs_looking.mask_follow and depsgraph is not None:
        known.of_scene(scene).changed_layer = depsgraph.view_layer.name
        if bpy.app.timers.is_registered(_follow):
            bpy.app.timers.unregister(_follow)
        if not bpy.app.background:
            bpy.app.timers.register(_follow, first_interval=DELAY)


def _follow():
    for scene in bpy.data.scenes:
        layer = scene.view_layers.get(known.of_scene(scene).changed_layer)
        known.of_scene(scene).changed_layer = ""
        if layer is not None:
            with bpy.context.temp_override(scene=scene, view_layer=layer):
                _follow_in(bpy.context)


def _follow_in(context):
    """Draws the mask if it is out of date. After an error the old mask stays, without a message: the user did
    not press a button."""
    try:
        if not mask_image.is_stale(context):  # writing the image is a change of the scene, too
            return
        mask_image.refresh(context)
    except (SplatError, NativeError):
        return
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in {"VIEW_3D", "IMAGE_EDITOR"}:
                area.tag_redraw()


CLASSES = (SVRGS_OT_spatial_mask,)
HANDLERS = {"depsgraph_update_post": _after_change, "frame_change_post": _after_change}
TIMERS = (_follow,)


def unregister():
    mask_image.forget()
