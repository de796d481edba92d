"""Where a viewport has to look, and how a dataset is levelled."""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np
from bpy.app.translations import pgettext_iface as tr
from mathutils import Matrix, Quaternion, Vector

from ...svrgs_addon.scene import bounds
from ...svrgs_addon.scene.attribute_layout import BASE, POSITION
from ...svrgs_addon.scene.camera import Camera
from ...svrgs_addon.scene.upright import levelled, tilt, up_direction
from . import camera_object, splat_object
from .visible_splats import marked

SENSOR = 72.0  # millimetres: the longer side of a viewport, in Blender
UNTURNED = 1e-6  # largest difference of a matrix that counts as none
NEARER = 0.8  # distance of a view over the distance of the camera whose photograph it shows
SAID = 0.5  # degrees: a smaller turn is not worth a word


def photographed_view(
    obj: bpy.types.Object, scene: bpy.types.Scene, objects: list[bpy.types.Object]
) -> tuple[Vector, float, Quaternion] | None:
    """Centre, distance and rotation of a view that shows what the camera `obj` shows of the objects, with the
    horizon level.

    Its eye is a little in front of the camera, so that the camera itself is not in the picture. None if the
    camera shows none of them.
    """
    camera, parts = camera_object.camera_from_object(obj, scene), list(_points(objects))
    if not parts:
        return None
    points, opacities = map(np.concatenate, zip(*parts, strict=True))
    if (depth := bounds.median_depth(camera, points, opacities)) is None:
        return None
    forward = Vector(camera.viewmat[2, :3])
    return Vector(camera.position) + depth * forward, NEARER * depth, forward.to_track_quat("-Z", "Y")


def sphere_of(objects: list[bpy.types.Object]) -> tuple[Vector, float] | None:
    """Centre and radius, in Blender's world, of the mass of the splats among the objects; without a splat, of
    their cameras and points.

    None if there is nothing of the kind.
    """
    boxes = (bounds.body_box(points, weights) for points, weights in _points(objects))
    found = [bounds.corners(box, np.eye(4)) for box in boxes if box is not None]
    if not any(map(splat_object.is_splat, objects)):
        found += [
            np.array([obj.matrix_world.translation], np.float64) for obj in objects if obj.type == "CAMERA"
        ]
    if not found:
        return None
    centre, radius = bounds.sphere_around(np.concatenate(found))
    return Vector(centre), max(radius, 1e-6)


def level(root: bpy.types.Object, cameras: list[Camera]) -> str:
    """Turns a root, and all below it, so that the photographs of the cameras stand upright. Returns what was
    done, in words.

    Only a root that stands as an import puts it is turned: else the user has placed it, or it is level
    already.
    """
    matrix = np.array(root.matrix_world, np.float64)
    if min(np.abs(matrix - np.array(start)).max() for start in (splat_object.AXES, np.eye(4))) > UNTURNED:
        return ""
    up = up_direction(np.array([camera.viewmat[:3, :3] for camera in cameras]))
    if up is None:
        return tr("not levelled, because the photographs do not agree on what is up")
    angle = tilt(matrix, up)
    root.matrix_world = Matrix(levelled(matrix, up))
    return tr("levelled, by a turn of {angle:.3g}°").format(angle=angle) if angle >= SAID else ""


def _points(objects: list[bpy.types.Object]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Means (N, 3) in Blender's world and opacities (N,) of each splat; without a splat, the points of each
    mesh, and ones.

    Gaussians marked as removed, or hidden, have the opacity 0.
    """
    splats = [obj for obj in objects if splat_object.is_splat(obj)]
    for obj in splats:
        opacities = splat_object.stored_values(obj, BASE)[:, 3] * ~marked(obj)
        yield _in_world(obj, splat_object.stored_values(obj, POSITION)), opacities
    for obj in () if splats else objects:
        if obj.type == "MESH":
            points = np.empty(3 * len(obj.data.vertices), np.float32)
            obj.data.vertices.foreach_get("co", points)
            yield _in_world(obj, points.reshape(-1, 3)), np.ones(len(points) // 3, np.float32)


def _in_world(obj: bpy.types.Object, points: np.ndarray) -> np.ndarray:
    matrix = np.array(obj.matrix_world, np.float32)
    return points @ matrix[:3, :3].T + matrix[:3, 3]
