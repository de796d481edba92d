"""Where objects are, also those that Blender does not evaluate, and the boxes that they bound."""

from __future__ import annotations

import bpy
import numpy as np
from bpy.app.translations import pgettext_iface as tr
from mathutils import Matrix, Vector

from ...svrgs_addon.system.errors import SceneError

CURVES = ("CURVE", "SURFACE", "FONT")


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


def volume_matrix(obj: bpy.types.Object) -> np.ndarray:
    """(4, 4) float64, from the cube of -1 to 1 to Blender's world: the bounding box of an object, or the size
    of an empty."""
    # Blender's box of an evaluated curve is that of its control points with their radius
    corners = np.array((obj.original if obj.type in CURVES else obj).bound_box, np.float64)
    if obj.type == "LATTICE":  # of which Blender knows the box of the evaluated one alone
        corners = np.array([point.co_deform for point in obj.data.points], np.float64)
    if obj.type == "EMPTY":
        corners = obj.empty_display_size * np.array([(-1.0,) * 3, (1.0,) * 3])
    low, high = corners.min(axis=0), corners.max(axis=0)
    place = Matrix.Translation(Vector((low + high) / 2)) @ Matrix.Diagonal((*(high - low) / 2, 1.0))
    matrix = np.array(world_matrix(obj) @ place, np.float64)
    if not abs(np.linalg.det(matrix)) > 0:
        text = tr("'{name}' has no volume: choose an empty, or an object with a height, a width and a depth")
        raise SceneError(text.format(name=obj.name))
    return matrix
