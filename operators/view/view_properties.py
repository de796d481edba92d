"""Settings of viewing and comparing: scene.svrgs_view, saved with the scene."""

from __future__ import annotations

import bpy
from bpy.props import (
    BoolProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
)

from ...svrgs_addon.render import color_maps
from ..data import splat_object
from ..scene import photographs
from . import overlay, spatial_mask, viewport_wipe

VALUES = "values"
MAPS = [(name, name.title(), "Colours from low to high") for name in color_maps.NAMES] + [
    (VALUES, "Values", "The values of F themselves, for use in materials")
]
MESHES = [
    ("SHOW", "Shown", "Meshes are drawn in their base colours, and hide what is behind them"),
    (
        "CUT",
        "Cut Out",
        "Meshes are holes with alpha 0, as if all were holdouts. For a picture over another render",
    ),
    (
        "SPLIT",
        "Between",
        (
            "Gaussians in front of meshes are the picture, those behind them the pass Behind. Another render"
            " belongs between the two"
        ),
    ),
]
SHOWN = [
    ("COLOR", "Colors", "The colours of the Gaussians"),
    ("svrgs:selected", "Selection", "The colours of the Gaussians; selected ones are orange"),
    ("contribution", "Contribution",
    "What each Gaussian adds to the images of the cameras. Run Show Contribution first"),
    ("removal_rank", "Removal Error",
    "How much the images of the cameras need each Gaussian, as a rank. Run Show Removal Error first"),
    ("deciding_views", "Deciding Views",
    "How many images decide on each Gaussian. Run Show Removal Error first"),
    ("rank_spread_views", "Rank Spread",
    "How far the rank of each Gaussian moves with other images. Run Show Removal Error first"),
    ("svrgs:probability", "Probability", "Probability of existence, learned by a pruning job with masks"),
    ("svrgs:score", "Rank", "The order in which a pruning job removed the Gaussians"),
]  # fmt: skip


def _is_splat(_, obj) -> bool:
    """Not a lambda below: Blender evaluates annotations where this module's names are unknown."""
    return splat_object.is_splat(obj)


class SVRGS_PG_view(bpy.types.PropertyGroup):
    photograph: IntProperty(
        name="Photograph", description="The scene is seen through its camera", update=photographs.look_through
    )  # of the file's objects
    show_masks: BoolProperty(
        name="Show Masks",
        default=True,
        update=photographs.show_mask,
        description="Tint what does not count in the photograph that is looked at",
    )
    select_through: BoolProperty(
        name="Through",
        description="Select also Gaussians that others hide. Off: only those that the viewport shows",
    )
    select_radius: IntProperty(
        name="Radius", default=40, min=1, max=1000, subtype="PIXEL", description="Radius of the brush"
    )
    background: FloatVectorProperty(
        name="Background",
        subtype="COLOR_GAMMA",
        min=0,
        max=1,
        size=3,
        description="Colour behind the Gaussians. Black, as in training",
    )
    meshes: EnumProperty(
        name="Meshes", items=MESHES, description="What renders of the engine SVR-GS show of meshes"
    )

    # the scene whose splats this scene renders (splat_layer.py)
    layer_of: PointerProperty(type=bpy.types.Scene, options={"HIDDEN"})

    mask_colors: EnumProperty(
        name="Colors", items=MAPS, update=spatial_mask.recolor, description="Colours of the spatial mask"
    )
    mask_top: FloatProperty(
        name="Brightest",
        min=0,
        update=spatial_mask.recolor,
        description="Value of F with the brightest colour. 0: the largest value of the image",
    )
    mask_size: IntProperty(
        name="Size",
        default=640,
        min=16,
        max=8192,
        subtype="PIXEL",
        description="Longer side of the image of the spatial mask",
    )
    mask_follow: BoolProperty(
        name="Follow Camera", description="Draw the spatial mask again whenever the camera or a splat changes"
    )

    original: PointerProperty(
        name="Original",
        type=bpy.types.Object,
        poll=_is_splat,
        description="The original splat. Empty: the active splat",
    )
    pruned: PointerProperty(
        name="Pruned", type=bpy.types.Object, poll=_is_splat,
        description="The pruned splat. Empty: the result of the original's job, or the object 'NAME pruned'",
    )  # fmt: skip
    compare_camera: PointerProperty(
        name="Camera",
        type=bpy.types.Object,
        poll=lambda _, obj: obj.type == "CAMERA",
        description="Camera to compare from. Empty: the scene's camera",
    )
    wipe: FloatProperty(
        name="Wipe",
        min=0,
        max=1,
        default=0.5,
        subtype="FACTOR",
        update=viewport_wipe.moved,
        description="Original on the left, pruned on the right",
    )

    overlay: BoolProperty(
        name="Draw Splats",
        default=True,
        update=overlay.switch,
        description="Draw splats in Solid and Material Preview viewports",
    )
    overlay_shown: EnumProperty(
        name="Show",
        items=SHOWN,
        update=overlay.changed,
        description="What the colours of splats show in Solid and Material Preview viewports",
    )


PROPERTIES = {("Scene", "svrgs_view"): PointerProperty(type=SVRGS_PG_view)}
