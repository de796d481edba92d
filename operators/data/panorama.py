"""Blender's panoramic cameras -> equirectangular panoramas."""

from __future__ import annotations

import bpy
import numpy as np
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.render.panorama import Panorama
from ...svrgs_addon.scene.camera import Camera
from ...svrgs_addon.system.errors import SceneError
from . import camera_object

KIND = "EQUIRECTANGULAR"


def view_of(obj: bpy.types.Object, scene: bpy.types.Scene) -> Camera | Panorama:
    """The view of the evaluated camera of a render, in Blender's world. Raises SceneError for other objects
    and other panoramas."""
    if obj.type != "CAMERA" or obj.data.type != "PANO":
        return camera_object.camera_from_object(obj, scene, camera_object.render_size(scene))
    data = obj.data
    if data.panorama_type != KIND:
        kind = data.bl_rna.properties["panorama_type"].enum_items[data.panorama_type].name
        raise SceneError(
            tr("camera '{name}' is a panorama of the type {type}: choose the type Equirectangular").format(
                name=obj.name, type=tr(kind)
            )
        )
    longitude, latitude = (
        (low, high)
        for low, high in ((data.longitude_min, data.longitude_max), (data.latitude_min, data.latitude_max))
    )
    if longitude[0] == longitude[1] or latitude[0] == latitude[1]:
        raise SceneError(
            tr("camera '{name}' sees nothing: its longitudes or its latitudes begin where they end").format(
                name=obj.name
            )
        )
    longitude, latitude = (
        _shifted(limits, shift) for limits, shift in ((longitude, data.shift_x), (latitude, data.shift_y))
    )
    if max(map(abs, latitude)) > np.pi / 2 + 1e-6:
        text = tr(
            "camera '{name}' looks beyond a pole: set its latitudes and its vertical shift so that they are"
            " within 90°"
        )
        raise SceneError(text.format(name=obj.name))
    pose = np.array(obj.matrix_world, np.float64)
    pose[:3, :3] /= np.linalg.norm(pose[:3, :3], axis=0)
    return Panorama(
        camera_object.FLIP @ np.linalg.inv(pose), *camera_object.render_size(scene), longitude, latitude
    )


def _shifted(limits: tuple[float, float], shift: float) -> tuple[float, float]:
    """The limits moved by a share of their distance, as Cycles does."""
    low, high = limits
    return low + shift * (high - low), high + shift * (high - low)
