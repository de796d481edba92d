"""Frame Splat: turns the 3D viewports to a splat. Blender's own Home shows the box around every last floater.

A splat with cameras is seen as in the scene's photograph, or the first: from outside, the sky and the walls
would hide it. A splat without cameras, and cameras without a splat, are seen as a whole, outliers left out.
"""

from __future__ import annotations

from collections.abc import Iterator

import bpy
from bpy.app.translations import pgettext_iface as tr
from mathutils import Matrix, Vector

from ...svrgs_addon.scene.bounds import clipping, viewing_distance
from ..data import camera_object, splat_object
from ..data.framing import SENSOR, photographed_view, sphere_of
from ..data.reporting import ReportingOperator, menu


class SVRGS_OT_frame(ReportingOperator):
    bl_label = "Frame Splat"
    bl_description = (
        "Show the active splat in the 3D viewports, as in its photograph if it has cameras. Gaussians far"
        " outside are not counted"
    )
    bl_options = set()

    @classmethod
    def problem(cls, context) -> str:
        if splat_object.is_splat(context.object) or splat_object.root_of(context.object) is not None:
            return ""
        return tr("Select a splat, or the cameras of a dataset")

    def execute(self, context):
        return {"FINISHED"} if frame(context, [context.object], through_cameras=True) else {"CANCELLED"}


def frame(context, objects: list[bpy.types.Object], through_cameras: bool = False) -> bool:
    """Shows the objects (splats, or parts of datasets) in every 3D viewport. Returns whether there is
    anything to show.

    through_cameras: whether viewports that look through a camera leave it.
    """
    context.view_layer.update()
    family = _family(objects)
    splats = [obj for obj in objects if splat_object.is_splat(obj)]
    camera = _first_camera(context.scene, family)
    seen = photographed_view(camera, context.scene, splats) if camera is not None else None
    sphere = sphere_of(splats or family)
    if sphere is None:
        return False
    centre, radius = sphere
    for space, view, region in _views(context):
        if view.view_perspective == "CAMERA":
            if not through_cameras:
                continue
            view.view_perspective = "PERSP"
        if seen and view.view_perspective == "PERSP":
            view.view_location, view.view_distance, view.view_rotation = seen
        else:
            distance = viewing_distance(radius, space.lens, region.width, region.height, SENSOR)
            view.view_location, view.view_distance = centre, distance
        space.clip_start, space.clip_end = clipping(view.view_distance, space.clip_start, space.clip_end)
    return True


def in_default_cube(context, splat: bpy.types.Object) -> bool:
    """Whether the visible cube of a new .blend file stands where it was, and the box around the splat reaches
    into it."""
    cubes = [obj for obj in context.visible_objects if obj.type == "MESH" and obj.name == "Cube"]
    if not any(len(obj.data.vertices) == 8 and obj.matrix_world == Matrix() for obj in cubes):
        return False
    corners = [splat.matrix_world @ Vector(corner) for corner in splat.bound_box]
    return all(min(axis) < 1 and max(axis) > -1 for axis in zip(*corners, strict=True))


def _family(objects: list[bpy.types.Object]) -> list[bpy.types.Object]:
    """All objects below the roots of these."""
    roots = {root for obj in objects if (root := splat_object.root_of(obj)) is not None}
    return [child for root in roots for child in root.children_recursive]


def _first_camera(scene: bpy.types.Scene, family: list[bpy.types.Object]) -> bpy.types.Object | None:
    """The scene's camera, if it is among the objects; else the first of their photographs' cameras; None if
    there is none."""
    cameras = [obj for obj in camera_object.photographs(family) if obj.data.type == "PERSP"]
    cameras.sort(key=lambda obj: obj.data[camera_object.IMAGE])
    return scene.camera if scene.camera in cameras else next(iter(cameras), None)


def _views(context) -> Iterator[tuple[bpy.types.SpaceView3D, bpy.types.RegionView3D, bpy.types.Region]]:
    """Every 3D viewport of the window."""
    for area in context.screen.areas if context.screen is not None else ():
        if area.type == "VIEW_3D":
            space = area.spaces.active
            region = next(region for region in area.regions if region.type == "WINDOW")
            yield space, space.region_3d, region


MENUS = {"VIEW3D_MT_view": menu(SVRGS_OT_frame)}
