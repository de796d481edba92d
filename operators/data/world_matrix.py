"""Where objects are, also those that Blender does not evaluate."""

from __future__ import annotations

import bpy
from mathutils import Matrix


def world_matrix(obj: bpy.types.Object) -> Matrix:
    """(4, 4) from the coordinates of the object to Blender's world. Of an object that is not evaluated
    (disabled, in an excluded or disabled collection, or in another scene) Blender neither keeps matrix_world
    up to date nor saves it; its constraints do not count."""
    if obj.is_evaluated or is_evaluated(obj):
        return obj.matrix_world
    if obj.parent is None:
        return obj.matrix_basis
    return world_matrix(obj.parent) @ obj.matrix_parent_inverse @ obj.matrix_basis


def is_evaluated(obj: bpy.types.Object) -> bool:
    """Whether Blender evaluates the object for viewports: so it does one that is hidden by the eye alone."""
    return not obj.hide_viewport and _is_shown(bpy.context.view_layer.layer_collection, obj)


def _is_shown(layer: bpy.types.LayerCollection, obj: bpy.types.Object) -> bool:
    """Whether the collection of a view layer, or one below it, shows the object: a disabled one disables
    those below it, an excluded one does not."""
    if layer.collection.hide_viewport:
        return False
    here = not layer.exclude and layer.collection.objects.get(obj.name) == obj
    return here or any(_is_shown(child, obj) for child in layer.children)
