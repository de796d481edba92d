"""Where a viewport has to look: boxes around the mass of splats, and around the cameras and sparse points of a dataset."""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np
from bpy.app.translations import pgettext_iface as tr
from mathutils import Matrix, Vector

from ..svrgs_addon.blender.attribute_layout import BASE, POSITION
from ..svrgs_addon.camera import Camera
from ..svrgs_addon.geometry import bounds
from ..svrgs_addon.geometry.upright import levelled, tilt, up_direction
from . import bridge
from .bridge_graph import REMOVED

SENSOR = 72.0  # millimetres: the longer side of a viewport, in Blender
UNTURNED = 1e-6  # largest difference of a matrix that counts as none
SAID = 0.5  # degrees: a smaller turn is not worth a word


def sphere_of(objects: list[bpy.types.Object]) -> tuple[Vector, float] | None:
    """Centre and radius, in Blender's world, of the mass of the splats among the objects; without one, of the cameras and points."""
    splats = [obj for obj in objects if bridge.is_splat(obj)]
    found = list(_splat_corners(splats)) or list(_dataset_corners(objects))
    if not found:
        return None
    centre, radius = bounds.sphere_around(np.concatenate(found))
    return Vector(centre), max(radius, 1e-6)


def viewing_distance(radius: float, lens: float, width: int, height: int) -> float:
    """The view distance at which a sphere fits into a viewport of width x height pixels. lens: its focal length in millimetres."""
    return bounds.viewing_distance(radius, lens, width, height, SENSOR)


def level(root: bpy.types.Object, cameras: list[Camera]) -> str:
    """Turns a root, and all below it, so that the photographs of the cameras stand upright. Returns what was done, in words.

    Only a root that stands as an import puts it is turned: else the user has placed it, or it is level already.
    """
    matrix = np.array(root.matrix_world, np.float64)
    if min(np.abs(matrix - np.array(start)).max() for start in (bridge.AXES, np.eye(4))) > UNTURNED:
        return ""
    up = up_direction(np.array([camera.viewmat[:3, :3] for camera in cameras]))
    if up is None:
        return tr("not levelled, because the photographs do not agree on what is up")
    angle = tilt(matrix, up)
    root.matrix_world = Matrix(levelled(matrix, up))
    return tr("levelled, by a turn of {angle:.3g}°").format(angle=angle) if angle >= SAID else ""


def _splat_corners(splats: list[bpy.types.Object]) -> Iterator[np.ndarray]:
    """Corners (8, 3) of the robust box of each splat, in Blender's world. Gaussians marked as removed do not count."""
    for obj in splats:
        opacities, removed = bridge.stored_values(obj, BASE)[:, 3], bridge.values(obj, REMOVED)
        box = bounds.robust_box(bridge.stored_values(obj, POSITION), opacities if removed is None else opacities * ~removed)
        if box is not None:
            yield bounds.corners(box, obj.matrix_world)


def _dataset_corners(objects: list[bpy.types.Object]) -> Iterator[np.ndarray]:
    """Corners of the robust boxes of all sparse points, and the places of all cameras, in Blender's world."""
    for obj in objects:
        if obj.type == "CAMERA":
            yield np.array(obj.matrix_world.translation, np.float64)[None]
        elif obj.type == "MESH" and len(obj.data.vertices):
            points = np.empty(3 * len(obj.data.vertices), np.float32)
            obj.data.vertices.foreach_get("co", points)
            box = bounds.robust_box(points.reshape(-1, 3))
            if box is not None:
                yield bounds.corners(box, obj.matrix_world)
