"""The spatial mask F of the scene's camera, on demand or whenever something moves."""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

from ..svrgs_addon.errors import NativeError, SplatError
from . import mask_image

PAUSE = 0.1  # seconds after the last change


class SVRGS_OT_spatial_mask(bpy.types.Operator):
    bl_idname = "svrgs.spatial_mask"
    bl_label = "Show Spatial Mask"
    bl_description = "Draw the spatial mask of the scene's camera into an image, for the Image Editor and for materials"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context):
        if context.scene.camera is not None:
            return True
        cls.poll_message_set("The scene has no camera: add one, or import the dataset's")
        return False

    def execute(self, context):
        try:
            result = mask_image.refresh(context)
        except (SplatError, NativeError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        show_in_editors(context, bpy.data.images[mask_image.NAME])
        self.report({"INFO"}, f"Spatial mask of {result['camera']}: mean {result['mean']:.3g}, largest {result['largest']:.3g}")
        return {"FINISHED"}


def show_in_editors(context, image: bpy.types.Image):
    """Image Editors that show nothing, or another of our pictures, show this one."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            space = area.spaces.active
            if area.type == "IMAGE_EDITOR" and space.mode == "VIEW" and (space.image is None or space.image.name.startswith("SVR-GS")):
                space.image = image
                area.tag_redraw()


@persistent
def _after_change(scene, *_):
    if scene.svrgs_looking.mask_follow and not bpy.app.background:
        if bpy.app.timers.is_registered(_follow):
            bpy.app.timers.unregister(_follow)
        bpy.app.timers.register(_follow, first_interval=PAUSE)


def _follow():
    """What cannot be drawn now stays as it was: the user did not ask for it at this moment."""
    try:
        if not mask_image.is_stale(bpy.context):  # drawing it is a change, too
            return
        mask_image.refresh(bpy.context)
    except (SplatError, NativeError):
        return
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in {"VIEW_3D", "IMAGE_EDITOR"}:
                area.tag_redraw()


HANDLERS = (("depsgraph_update_post", _after_change), ("frame_change_post", _after_change))


def register():
    bpy.utils.register_class(SVRGS_OT_spatial_mask)
    for event, handler in HANDLERS:
        getattr(bpy.app.handlers, event).append(handler)


def unregister():
    for event, handler in HANDLERS:
        getattr(bpy.app.handlers, event).remove(handler)
    if bpy.app.timers.is_registered(_follow):
        bpy.app.timers.unregister(_follow)
    mask_image.forget()
    bpy.utils.unregister_class(SVRGS_OT_spatial_mask)
