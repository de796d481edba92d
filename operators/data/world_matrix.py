"""Where objects are, also those that Blender does not evaluate."""

from __future__ import annotations

import bpy
from mathutils import Matrix


def world_matrix(obj: bpy.types.Object) -> Matrix:
    """(4, 4) from the coordinates of the object to Blender's world. Of an object in an excluded or disabled
    collection, or in another scene, Blender neither keeps matrix_world up to date nor saves it; its
    constraints do not count."""
    if obj.is_evaluated or _is_up_to_date(obj):
        return obj.matrix_world
    if obj.parent is None:
        return obj.matrix_basis
    return world_matrix(obj.parent) @ obj.matrix_parent_inverse @ obj.matrix_basis


def _is_up_to_date(obj: bpy.types.Object) -> bool:
    if obj.hide_viewport or all(collection.hide_viewport for collection in obj.users_collection):
        return False
    return bpy.context.view_layer.objects.get(obj.name) == obj
