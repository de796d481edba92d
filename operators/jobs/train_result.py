"""The splat of a finished training job in the scene: below the root of the cameras it was trained from."""

from __future__ import annotations

import bpy

from ...svrgs_addon.files.registry import read_scene
from ...svrgs_addon.jobs.job_folder import JobFolder
from ..data import splat_object
from ..data.select import in_view_layer, select


def load(context, root: bpy.types.Object, folder: JobFolder) -> bpy.types.Object:
    """Adds the trained splat, and selects it if something of the dataset is active. Raises SceneError,
    FormatError."""
    family = {root, *root.children_recursive}
    splat = splat_object.object_from_scene(
        f"{root.name} splat", read_scene(folder.output), _collection(root), root.matrix_world
    )
    splat_object.parent_to_root(splat, root)
    if context.view_layer.objects.active in family and in_view_layer(context, splat):
        select(context, [splat])
    return splat


def _collection(root: bpy.types.Object) -> bpy.types.Collection:
    """The collection of the cameras; that of the root if they are gone."""
    cameras = (obj for obj in root.children if obj.type == "CAMERA" and obj.users_collection)
    return next(cameras, root).users_collection[0]
