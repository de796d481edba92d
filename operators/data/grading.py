"""Colour grading of splats: properties of an object that pictures, comparisons and exports apply. The
Gaussians keep their own colours, and pruning measures those."""

from __future__ import annotations

import bpy
from bpy.props import FloatProperty, PointerProperty

from ...svrgs_addon.scene.gaussians import Scene
from ...svrgs_addon.scene.grade import Grade, graded
from . import background_work

NAMES = tuple(Grade.__dataclass_fields__)


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
    """The grade of a splat."""
    return Grade(*(getattr(obj.svrgs_grade, name) for name in NAMES))


def is_graded(obj: bpy.types.Object) -> bool:
    return of(obj) != Grade()


def applied(scene: Scene, obj: bpy.types.Object) -> Scene:
    """The Gaussians with the grade of the splat that they are of."""
    return graded(scene, of(obj))


def reset(obj: bpy.types.Object):
    for name in NAMES:
        obj.svrgs_grade.property_unset(name)


CLASSES = (SVRGS_PG_grade,)


def register():
    bpy.types.Object.svrgs_grade = PointerProperty(type=SVRGS_PG_grade)


def unregister():
    del bpy.types.Object.svrgs_grade
