"""Colour grading of splats: properties of an object that pictures, comparisons and exports apply. The
Gaussians keep their own colours, and pruning measures those."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
from bpy.app.translations import pgettext_iface as tr
from bpy.props import FloatProperty, PointerProperty

from ...svrgs_addon.scene.gaussians import Scene
from ...svrgs_addon.scene.grade import Grade, graded, inside
from ...svrgs_addon.system.errors import SceneError
from . import background_work
from .edit_guard import animation_curves
from .world_matrix import is_evaluated, volume_matrix, world_matrix

OVERRIDABLE = {"LIBRARY_OVERRIDABLE"}
NAMES = ("exposure", "warmth", "tint", "saturation", "contrast", "opacity")


def _changed(self, context):
    override = self.id_data.override_library
    if override is not None and override.reference is not None:
        # Blender 5 stores overrides of a group only if the linked object has that group, which this makes
        linked = override.reference.svrgs_grade
        linked.opacity = linked.opacity
    self.id_data.update_tag()
    background_work.redraw_panels()


def _number(name: str, description: str, **limits):
    return FloatProperty(name=name, description=description, update=_changed, override=OVERRIDABLE, **limits)


SHARE = {"min": 0, "max": 1, "subtype": "FACTOR"}


class SVRGS_PG_grade(bpy.types.PropertyGroup):
    exposure: _number("Exposure", "Stops of light, about", soft_min=-5, soft_max=5)
    warmth: _number("Warmth", "Stops of red over blue: above 0 for warmer colours", soft_min=-2, soft_max=2)
    tint: _number("Tint", "Stops of magenta over green", soft_min=-2, soft_max=2)
    saturation: _number("Saturation", "0: grey. 1: as it is", min=0, default=1, soft_max=2)
    contrast: _number("Contrast", "Around middle grey. 1: as it is", min=0, default=1, soft_max=2)
    crop: PointerProperty(
        name="Crop Box",
        type=bpy.types.Object,
        update=_changed,
        override=OVERRIDABLE,
        description="Only what is inside the bounding box of this object stays; an empty is a cube",
    )
    softness: _number(
        "Softness",
        "Over what share of the way from the faces of the box to its middle opacity grows",
        **SHARE,
    )
    opacity: _number("Opacity", "Factor on the opacity of every Gaussian", default=1, **SHARE)


def of(obj: bpy.types.Object) -> Grade:
    """The grade of a splat. A crop box without volume crops nothing; see problem()."""
    settings = obj.svrgs_grade
    grade = Grade(*(getattr(settings, name) for name in NAMES))
    box = _crop_box(obj)
    if box is None or problem(obj):
        return grade
    to_box = np.linalg.solve(volume_matrix(box), np.array(world_matrix(obj), np.float64))
    return replace(grade, crop=tuple(map(tuple, to_box.tolist())), softness=settings.softness)


def settings_of(obj: bpy.types.Object) -> tuple:
    """What the grade of a splat is made of: its numbers, and the crop box, wherever that is."""
    settings, box = obj.svrgs_grade, _crop_box(obj)
    cut = () if box is None else (box.session_uid, settings.softness)
    return *(getattr(settings, name) for name in NAMES), *cut


def problem(obj: bpy.types.Object) -> str:
    """What is wrong with the crop box of a splat, in a sentence; '' if nothing is."""
    try:
        if (box := _crop_box(obj)) is not None:
            volume_matrix(box)
    except SceneError as error:
        return str(error)
    return ""


def still(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> str:
    """A sentence if the crop box of a splat is animated but stands still, because it is not in this graph;
    else ''."""
    box = _crop_box(obj)
    if box is None or not _moves(box.original):
        return ""
    if depsgraph.mode == "VIEWPORT" and is_evaluated(box.original):
        return ""
    if any(one.object.original == box.original for one in depsgraph.object_instances):
        return ""
    text = tr("'{name}' is disabled in viewports or renders, so it stands still there: take a visible empty")
    return text.format(name=box.name)


def _moves(obj: bpy.types.Object | None) -> bool:
    """Whether the object, or one above it, is animated or constrained."""
    if obj is None:
        return False
    return any(animation_curves(obj)) or len(obj.constraints) > 0 or _moves(obj.parent)


def _crop_box(obj: bpy.types.Object) -> bpy.types.Object | None:
    """None also for one that was deleted, which Blender keeps until the file is closed. One that was linked
    along with its splat is in no collection."""
    box = obj.svrgs_grade.crop
    return box if box is not None and (box.original.users_collection or box.library) else None


def is_graded(obj: bpy.types.Object) -> bool:
    return of(obj) != Grade()


def is_animated(obj: bpy.types.Object) -> bool:
    """Whether keys or drivers set the grade."""
    return any(curve.data_path.startswith("svrgs_grade") for curve in animation_curves(obj))


def left(scene: Scene, obj: bpy.types.Object) -> np.ndarray:
    """(N,) bool: the Gaussians that the crop box leaves."""
    return inside(scene.means, of(obj)) > 0


def applied(scene: Scene, obj: bpy.types.Object) -> Scene:
    """The Gaussians with the grade of the splat that they are of."""
    return graded(scene, of(obj))


def reset(obj: bpy.types.Object):
    for name in (*NAMES, "crop", "softness"):
        obj.svrgs_grade.property_unset(name)


PROPERTIES = {("Object", "svrgs_grade"): PointerProperty(type=SVRGS_PG_grade, override=OVERRIDABLE)}
