"""Cameras of the .blend as views of a pruning job: the scene's camera over all frames, if it moves, and the
other cameras."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import bpy
import numpy as np
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.scene.affine import UNIFORM, stretch
from ...svrgs_addon.scene.camera import Camera
from ...svrgs_addon.system.errors import SceneError
from . import camera_object
from .world_matrix import world_matrix

ITEMS = [  # the numbers are stored in .blend files
    ("PLACED", "Placed", "Cameras are placed where they see the whole splat", "NONE", 0),
    ("ALSO", "Also This File's", "Cameras are placed, and those of this file count too", "NONE", 1),
    (
        "ONLY",
        "Only This File's",
        "Count only what the cameras of this file see. What they never see may be removed",
        "NONE",
        2,
    ),
]
FRAMES = 64  # of a moving camera, evenly spread over the frames of the scene


def views(context, splat: bpy.types.Object) -> list[Camera]:
    """The views in the coordinates of the splat. Raises SceneError."""
    scene, matrix = context.scene, np.array(splat.matrix_world, np.float64)
    if not np.linalg.det(matrix[:3, :3]) > 0:
        raise SceneError(_uneven(splat))
    refuse_stretched(splat)
    found = [camera.moved(matrix) for camera in (*_of_frames(scene), *_standing(scene))]
    if not found:
        raise SceneError(
            tr("this file has no camera whose views could count: add one, or choose placed cameras")
        )
    return [replace(camera, name=f"{number:04}") for number, camera in enumerate(found)]


def refuse_stretched(splat: bpy.types.Object):
    """Raises SceneError for a splat whose scale along each axis is another one: cameras below it would be
    sheared."""
    if stretch(world_matrix(splat)) - 1 > UNIFORM:
        raise SceneError(_uneven(splat))


def _uneven(splat: bpy.types.Object) -> str:
    text = tr(
        "'{name}' is mirrored or scaled unevenly, which cameras cannot be: apply its scale first (Ctrl A)"
    )
    return text.format(name=splat.name)


def placed(splat: bpy.types.Object) -> list[bpy.types.Object]:
    """The cameras that were placed for a splat and are still in the file."""
    cameras = (obj for obj in splat.children if obj.type == "CAMERA" and obj.users_collection)
    return [obj for obj in cameras if camera_object.PLACED in obj.data]


def place(splat: bpy.types.Object, cameras: list[Camera], collection: bpy.types.Collection):
    """Adds cameras below the splat, in its coordinates, in place of those that were placed before."""
    scene, shown = bpy.context.scene, bpy.context.scene.camera in placed(splat)
    for obj in placed(splat):
        bpy.data.cameras.remove(obj.data)
    middle = np.mean([camera.position for camera in cameras], axis=0)
    extent = max(float(np.linalg.norm(camera.position - middle)) for camera in cameras)
    for camera in cameras:
        obj = camera_object.new_camera(camera, extent or 1.0, collection)
        obj.parent, obj.data[camera_object.PLACED] = splat, True
        if shown and scene.camera is None:
            scene.camera = obj


def _of_frames(scene: bpy.types.Scene) -> Iterator[Camera]:
    """The scene's camera as it is now, and in some frames; once if it does not move. Markers may bind other
    cameras to frames. Frame and objects are then set back, also objects that were moved without a key."""
    if scene.camera is None:
        return
    first, last = scene.frame_start, scene.frame_end
    frames = np.linspace(first, last, min(FRAMES, last - first + 1)).round().astype(int)
    now, subframe, seen, chosen = scene.frame_current, scene.frame_subframe, set[bytes](), scene.camera
    animated = [obj for obj in scene.objects if obj.animation_data is not None]
    places = [(obj, obj.matrix_basis.copy()) for obj in animated]
    try:
        for frame in (None, *np.unique(frames).tolist()):
            if frame is not None:
                scene.frame_set(frame)
            graph = bpy.context.evaluated_depsgraph_get()
            camera = camera_object.camera_from_object(scene.camera.evaluated_get(graph), scene)
            if camera.key not in seen:
                seen.add(camera.key)
                yield camera
    finally:
        scene.frame_set(now, subframe=subframe)
        if scene.camera != chosen:
            scene.camera = chosen
        for obj, place in places:
            if obj.matrix_basis != place:
                obj.matrix_basis = place


def _standing(scene: bpy.types.Scene) -> Iterator[Camera]:
    """The other cameras of the scene, as they are now: those that were placed too, those of photographs
    not."""
    others = (obj for obj in scene.objects if obj.type == "CAMERA" and obj != scene.camera)
    photographs = camera_object.photographs(scene.objects)
    for obj in sorted(others, key=lambda obj: obj.name):
        if obj.data.type in ("PERSP", "ORTHO") and obj not in photographs:
            yield camera_object.camera_from_object(obj, scene)
