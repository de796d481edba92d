"""What the user chooses for looking at splats: properties of Blender's scene, scene.svrgs_looking."""

from __future__ import annotations

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, FloatVectorProperty, IntProperty, PointerProperty, StringProperty

from ..svrgs_addon.render import color_maps
from . import bridge, comparison_images, mask_image, overlay, undistort

VALUES = "values"
MAPS = [(name, name.title(), "Colours from low to high") for name in color_maps.NAMES] + [(VALUES, "Values", "The numbers themselves, for materials")]
SHOWN = [
    ("COLOR", "Colors", "The Gaussians as they are"), ("contribution", "Contribution", "Share of the pictures: run Show Contribution first"),
    ("svrgs:probability", "Probability", "Of existence, as a pruning job with masks has learned it"),
    ("svrgs:score", "Rank", "The order in which a pruning job let the Gaussians go"),
]  # fmt: skip


def _about(_) -> str:
    obj = bpy.context.object
    return f"{bridge.count(obj):,} Gaussians, SH degree {bridge.sh_degree(obj)}" if bridge.is_splat(obj) else ""


def _is_splat(_, obj) -> bool:  # a lambda below would not find `bridge`: Blender evaluates annotations with other names around them
    return bridge.is_splat(obj)


def _photographs(_) -> str:
    return undistort.said()


class SVRGS_PG_looking(bpy.types.PropertyGroup):
    about: StringProperty(get=_about, options={"HIDDEN"})  # the active splat in a line; empty where there is none
    photographs: StringProperty(get=_photographs, options={"HIDDEN"})  # how undistorting them goes on; mostly empty
    background: FloatVectorProperty(
        name="Background", subtype="COLOR_GAMMA", min=0, max=1, size=3, description="What shows between the Gaussians; black as in training"
    )

    mask_colors: EnumProperty(name="Colors", items=MAPS, update=mask_image.recolor, description="Colours of the spatial mask")
    mask_top: FloatProperty(name="Brightest", min=0, update=mask_image.recolor, description="Value of the brightest colour. 0: the largest of the picture")
    mask_size: IntProperty(name="Size", default=640, min=16, max=8192, subtype="PIXEL", description="Longer side of the spatial mask's picture")
    mask_follow: BoolProperty(name="Follow Camera", description="Draw the spatial mask anew whenever the camera or a splat changes")
    mask_result: StringProperty(options={"HIDDEN"})  # JSON: camera, low, mean, top, milliseconds

    original: PointerProperty(name="Original", type=bpy.types.Object, poll=_is_splat, description="Empty: the active splat")
    pruned: PointerProperty(
        name="Pruned", type=bpy.types.Object, poll=_is_splat,
        description="Empty: the original without what is marked as removed, or 'NAME pruned'",
    )  # fmt: skip
    compare_camera: PointerProperty(name="Camera", type=bpy.types.Object, poll=lambda _, obj: obj.type == "CAMERA", description="Empty: the scene's camera")
    wipe: FloatProperty(
        name="Wipe", min=0, max=1, default=0.5, subtype="FACTOR", update=comparison_images.redraw, description="Original on the left, pruned on the right"
    )
    compare_result: StringProperty(options={"HIDDEN"})  # JSON: camera, original, pruned

    overlay: BoolProperty(name="Draw Splats", default=True, update=overlay.switch, description="Draw splats in Solid and Material Preview viewports")
    overlay_shown: EnumProperty(name="Show", items=SHOWN, update=overlay.changed, description="What the colours of splats in these viewports stand for")
    overlay_moving: IntProperty(
        name="While Moving", default=200_000, min=1000, soft_max=2_000_000, update=overlay.changed, description="Gaussians drawn while the view moves"
    )


def register():
    bpy.utils.register_class(SVRGS_PG_looking)
    bpy.types.Scene.svrgs_looking = PointerProperty(type=SVRGS_PG_looking)


def unregister():
    del bpy.types.Scene.svrgs_looking
    bpy.utils.unregister_class(SVRGS_PG_looking)
