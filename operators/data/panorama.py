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
        text = tr("camera '{name}' is a panorama of the type {type}: choose the type Equirectangular")
        raise SceneError(text.format(name=obj.name, type=tr(kind)))
    longitude = _shifted(data.longitude_min, data.longitude_max, data.shift_x)
    latitude = _shifted(data.latitude_min, data.latitude_max, data.shift_y)
    if longitude[0] == longitude[1] or latitude[0] == latitude[1]:
        text = tr("camera '{name}' sees nothing: its longitudes or its latitudes begin where they end")
        raise SceneError(text.format(name=obj.name))
    if max(map(abs, latitude)) > np.pi / 2 + 1e-6:
        text = tr(
            "camera '{name}' looks beyond a pole: set its latitudes and its vertical shift so that they are"
            " within 90°"
        )
        raise SceneError(text.format(name=obj.name))
    viewmat = camera_object.viewmat_of(obj.matrix_world)
    return Panorama(viewmat, *camera_object.render_size(scene), longitude, latitude)


def _shifted(low: float, high: float, shift: float) -> tuple[float, float]:
    """The limits moved by a share of their distance, as Cycles does."""
    return low + shift * (high - low), high + shift * (high - low)
