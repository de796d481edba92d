"""Frame Splat: turns the 3D viewports to the mass of a splat. Blender's own Home shows the box around every last floater."""

from __future__ import annotations

from collections.abc import Iterator

import bpy
from bpy.app.translations import pgettext_iface as tr

from ..svrgs_addon.geometry.bounds import clipping
from . import bridge
from .bridge_framing import sphere_of, viewing_distance


class SVRGS_OT_frame(bpy.types.Operator):
    bl_idname = "svrgs.frame"
    bl_label = "Frame Splat"
    bl_description = "Show the active splat, or the cameras of its dataset, in the 3D viewports. Gaussians far outside are not counted"

    @classmethod
    def poll(cls, context):
        if _subject(context.object):
            return True
        cls.poll_message_set(tr("Select a splat, or the cameras of a dataset"))
        return False

    def execute(self, context):
        return {"FINISHED"} if frame(context, _subject(context.object), through_cameras=True) else {"CANCELLED"}


def frame(context, objects: list[bpy.types.Object], through_cameras: bool = False) -> bool:
    """Shows the splats among the objects, or else the cameras and points, in every 3D viewport. Returns whether there is anything to show.

    through_cameras: whether viewports that look through a camera leave it.
    """
    context.view_layer.update()
    sphere = sphere_of(objects)
    if sphere is None:
        return False
    for space, view, region in _views(context):
        if view.view_perspective == "CAMERA":
            if not through_cameras:
                continue
            view.view_perspective = "PERSP"
        view.view_location = sphere[0]
        view.view_distance = viewing_distance(sphere[1], space.lens, region.width, region.height)
        space.clip_start, space.clip_end = clipping(view.view_distance, space.clip_start, space.clip_end)
    return True


def _subject(obj: bpy.types.Object | None) -> list[bpy.types.Object]:
    """What to show: the splat, or everything below the root of its dataset."""
    if bridge.is_splat(obj):
        return [obj]
    root = bridge.root_of(obj)
    return list(root.children_recursive) if root is not None else []


def _views(context) -> Iterator[tuple[bpy.types.SpaceView3D, bpy.types.RegionView3D, bpy.types.Region]]:
    """Every view of every 3D viewport in the window; four of a viewport in Quad View."""
    for area in context.screen.areas if context.screen is not None else ():
        if area.type == "VIEW_3D":
            space = area.spaces.active
            region = next(region for region in area.regions if region.type == "WINDOW")
            for view in space.region_quadviews or [space.region_3d]:
                yield space, view, region


def register():
    bpy.utils.register_class(SVRGS_OT_frame)


def unregister():
    bpy.utils.unregister_class(SVRGS_OT_frame)
