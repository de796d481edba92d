"""Colour grading of splats: properties of an object that pictures, comparisons and exports apply. The
Gaussians keep their own colours, and pruning measures those."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
from bpy.props import FloatProperty, PointerProperty

from ...svrgs_addon.scene.gaussians import Scene
from ...svrgs_addon.scene.grade import Grade, graded, inside
from ...svrgs_addon.system.errors import SceneError
from . import background_work, volumes

NAMES = ("exposure", "warmth", "tint", "saturation", "contrast", "opacity")


def _changed(self, context):
    self.id_data.update_tag()
    background_work.redraw_panels()


class SVRGS_PG_grade(bpy.types.PropertyGroup):
    exposure: FloatProperty(
        name="Exposure", soft_min=-5, soft_max=5, update=_changed, description="Stops of light, about"
    )
    warmth: FloatProperty(
        name="Warmth",
        soft_min=-2,
        soft_max=2,
        update=_changed,
        description="Stops of red over blue: above 0 for warmer colours",
    )
    tint: FloatProperty(
        name="Tint", soft_min=-2, soft_max=2, update=_changed, description="Stops of magenta over green"
    )
    saturation: FloatProperty(
        name="Saturation", min=0, default=1, soft_max=2, update=_changed, description="0: grey. 1: as it is"
    )
    contrast: FloatProperty(
        name="Contrast",
        min=0,
        default=1,
        soft_max=2,
        update=_changed,
        description="Around middle grey. 1: as it is",
    )
    crop: PointerProperty(
        name="Crop Box",
        type=bpy.types.Object,
        update=_changed,
        description="Only what is inside the bounding box of this object stays; an empty is a cube",
    )
    softness: FloatProperty(
        name="Softness",
        min=0,
        max=1,
        subtype="FACTOR",
        update=_changed,
        description="Over what share of the way from the faces of the box to its middle opacity grows",
    )
    opacity: FloatProperty(
        name="Opacity",
        min=0,
        max=1,
        default=1,
        subtype="FACTOR",
        update=_changed,
        description="Factor on the opacity of every Gaussian",
    )


def of(obj: bpy.types.Object) -> Grade:
    """The grade of a splat. A crop box without volume crops nothing; see problem()."""
    settings = obj.svrgs_grade
    grade = Grade(*(getattr(settings, name) for name in NAMES))
    if settings.crop is None or problem(obj):
        return grade
    to_box = np.linalg.solve(volumes.matrix_of(settings.crop), np.array(obj.matrix_world, np.float64))
    return replace(grade, crop=tuple(map(tuple, to_box.tolist())), softness=settings.softness)


def problem(obj: bpy.types.Object) -> str:
    """What is wrong with the crop box of a splat, in a sentence; '' if nothing is."""
    try:
        if obj.svrgs_grade.crop is not None:
            volumes.matrix_of(obj.svrgs_grade.crop)
    except SceneError as error:
        return str(error)
    return ""


def is_graded(obj: bpy.types.Object) -> bool:
    return of(obj) != Grade()


def left(scene: Scene, obj: bpy.types.Object) -> np.ndarray:
    """(N,) bool: the Gaussians that the crop box leaves."""
    return inside(scene.means, of(obj)) > 0


def applied(scene: Scene, obj: bpy.types.Object) -> Scene:
    """The Gaussians with the grade of the splat that they are of."""
    return graded(scene, of(obj))


def reset(obj: bpy.types.Object):
    for name in (*NAMES, "crop", "softness"):
        obj.svrgs_grade.property_unset(name)


CLASSES = (SVRGS_PG_grade,)
PROPERTIES = {("Object", "svrgs_grade"): PointerProperty(type=SVRGS_PG_grade)}
