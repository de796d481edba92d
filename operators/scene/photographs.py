"""The cameras of a dataset as a list of photographs, with what the last job found about each."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as tr

from ..data import camera_object, splat_object

FOUND = "svrgs_photograph"  # property of a photograph's camera: figures of the last job, by name


def of(root: bpy.types.Object | None) -> list[bpy.types.Object]:
    """The cameras of photographs below a root, in the order of their images' names."""
    below = root.children_recursive if root is not None else ()
    cameras = [obj for obj in below if obj.type == "CAMERA" and camera_object.IMAGE in obj.data]
    return sorted(cameras, key=lambda obj: obj.data[camera_object.IMAGE])


def store(root: bpy.types.Object | None, found: dict[str, dict[str, float]]):
    """What a job found about each photograph, by the name of its image. Those that it has nothing about lose
    what an earlier job found."""
    for obj in of(root):
        obj.data.pop(FOUND, None)
        if figures := found.get(obj.data[camera_object.IMAGE]):
            obj.data[FOUND] = figures


def about(obj: bpy.types.Object) -> str:
    """What the last job found about a photograph: its exposure, by how many pixels its camera was moved, and
    what share of it is hidden; '' for nothing."""
    found = obj.data.get(FOUND, {})
    texts = {"exposure_ev": "{:+.2f} EV", "moved_pixels": "{:.1f} px", "hidden": tr("{:.0%} hidden")}
    return ", ".join(text.format(found[name]) for name, text in texts.items() if name in found)


def look_through(settings, context):
    """Makes the chosen photograph's camera the scene's camera, and looks through it in the 3D view in which
    it was chosen."""
    row, shown = settings.photograph, of(splat_object.root_of(context.object))
    if not 0 <= row < len(bpy.data.objects) or bpy.data.objects[row] not in shown:
        return
    context.scene.camera = bpy.data.objects[row]
    if getattr(context.space_data, "region_3d", None) is not None:
        context.space_data.region_3d.view_perspective = "CAMERA"
