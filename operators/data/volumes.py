"""Objects that bound a box."""

from __future__ import annotations

import bpy
import numpy as np
from bpy.app.translations import pgettext_iface as tr
from mathutils import Matrix, Vector

from ...svrgs_addon.system.errors import SceneError
from .world_matrix import world_matrix

CURVES = ("CURVE", "SURFACE", "FONT")


def matrix_of(obj: bpy.types.Object) -> np.ndarray:
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
