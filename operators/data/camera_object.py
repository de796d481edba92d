"""Blender's cameras <-> Camera of svrgs_addon; its panoramic cameras -> Panorama.

A posed photograph is a camera with properties that hold the size and the pixel aspect of its image.
"""

from __future__ import annotations

from collections.abc import Iterable

import bpy
import numpy as np
from bpy.app.translations import pgettext_iface as tr
from mathutils import Matrix

from ...svrgs_addon.render.panorama import Panorama
from ...svrgs_addon.scene.camera import Camera
from ...svrgs_addon.system.errors import SceneError
from ...svrgs_addon.views import lens as lenses
from .world_matrix import world_matrix

MASKED_OUT = "SVR-GS Masked Out"  # the image over the photograph that is looked at
SIZE, ASPECT, IMAGE = "svrgs_size", "svrgs_pixel_aspect", "svrgs_image"  # properties of a photograph's camera
PLACED = "svrgs_placed"  # property of a camera's data: placed for a splat, its parent
DISPLAY_SIZE = 0.05  # of a camera in the viewport, in extents of all cameras
CLIP_END = 100  # in extents of all cameras
FLIP = np.diag((1.0, -1.0, -1.0, 1.0))  # Blender's cameras look along -z with y up, ours along z with y down


def camera_from_object(
    obj: bpy.types.Object, scene: bpy.types.Scene, size: tuple[int, int] | None = None
) -> Camera:
    """The view of a camera object, in Blender's world.

    size: (width, height) in pixels, with the scene's pixel aspect. Default: the size and aspect of the
    photograph, or of the scene's render if the camera has no photograph. obj: an evaluated object if
    animation matters. Raises SceneError if the object is not a camera (Blender accepts any object as the
    scene's camera), and if the camera is neither perspective nor orthographic.
    """
    if obj.type != "CAMERA":
        raise SceneError(
            tr("'{name}' is no camera: choose a camera as the scene's camera").format(name=obj.name)
        )
    data, render = obj.data, scene.render
    if data.type not in ("PERSP", "ORTHO"):
        text = tr(
            "camera '{name}' is neither perspective nor orthographic: splats cannot be drawn from other"
            " cameras"
        )
        raise SceneError(text.format(name=obj.name))
    aspect = (render.pixel_aspect_x, render.pixel_aspect_y)
    if size is None and SIZE in data:
        size, aspect = tuple(data[SIZE]), tuple(data[ASPECT])
    size = size or render_size(scene)
    shift, sensor = (data.shift_x, data.shift_y), (data.sensor_width, data.sensor_height)
    orthographic = data.type == "ORTHO"
    ortho_scale = data.ortho_scale if orthographic else None
    lens = lenses.Lens(*size, data.lens, shift, aspect, sensor, data.sensor_fit, ortho_scale)
    viewmat, name = viewmat_of(world_matrix(obj)), data.get(IMAGE, obj.name)
    return Camera(viewmat, lenses.intrinsics(lens), *size, name, orthographic)


def view_of(obj: bpy.types.Object, scene: bpy.types.Scene) -> Camera | Panorama:
    """The view of the evaluated camera of a render, in Blender's world. Raises SceneError for other objects
    and other panoramas."""
    if obj.type != "CAMERA" or obj.data.type != "PANO":
        return camera_from_object(obj, scene, render_size(scene))
    data = obj.data
    if data.panorama_type != "EQUIRECTANGULAR":
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
    viewmat = viewmat_of(obj.matrix_world)
    return Panorama(viewmat, *render_size(scene), longitude, latitude)


def _shifted(low: float, high: float, shift: float) -> tuple[float, float]:
    """The limits moved by a share of their distance, as Cycles does."""
    return low + shift * (high - low), high + shift * (high - low)


def viewmat_of(matrix: Matrix) -> np.ndarray:
    """(4, 4) float64 from Blender's world to a view. matrix: of its camera, whose scale does not count."""
    pose = np.array(matrix, np.float64)
    pose[:3, :3] /= np.linalg.norm(pose[:3, :3], axis=0)
    return FLIP @ np.linalg.inv(pose)


def photographs(objects: Iterable[bpy.types.Object]) -> list[bpy.types.Object]:
    """The cameras of photographs, or imported, among the objects; not those that were placed. Of a camera and
    its copies below one root, the first alone: a copy may stand where no photograph was taken."""
    found: dict[tuple, bpy.types.Object] = {}
    age = lambda obj: (obj.name != obj.data[IMAGE], obj.session_uid)
    for obj in objects:
        if obj.type == "CAMERA" and SIZE in obj.data and PLACED not in obj.data:
            key = obj.parent or obj, obj.data[IMAGE]
            found[key] = min(found.get(key, obj), obj, key=age)
    return list(found.values())


def backgrounds(obj: bpy.types.Object) -> list[bpy.types.Image]:
    """The photographs behind a camera, without what is laid over them."""
    images = (background.image for background in obj.data.background_images)
    return [image for image in images if image is not None and image.name != MASKED_OUT]


def camera_to_object(camera: Camera, obj: bpy.types.Object):
    """Gives the camera object the lens, the image size and the pose of a view, in the coordinates of the
    object's parent."""
    data, lens = obj.data, lenses.lens_of(camera)
    data.type, data.sensor_fit = "PERSP", lens.fit
    data.sensor_width, data.sensor_height = lens.sensor
    data.lens = lens.lens
    data.shift_x, data.shift_y = lens.shift
    data[SIZE], data[ASPECT], data[IMAGE] = (camera.width, camera.height), lens.aspect, camera.name
    obj.rotation_mode = "QUATERNION"  # Euler angles lose digits near the poles
    obj.matrix_basis = Matrix(np.linalg.inv(camera.viewmat) @ FLIP)


def new_camera(camera: Camera, extent: float, collection: bpy.types.Collection) -> bpy.types.Object:
    """A camera object with a view. extent: of all cameras that belong together, in the view's unit of
    length."""
    data = bpy.data.cameras.new(camera.name)
    obj = bpy.data.objects.new(camera.name, data)
    camera_to_object(camera, obj)
    data.display_size = DISPLAY_SIZE * extent
    data.clip_start, data.clip_end = 1e-3 * extent, CLIP_END * extent
    collection.objects.link(obj)
    return obj


def render_size(scene: bpy.types.Scene) -> tuple[int, int]:
    """(width, height) of a render in pixels."""
    render, sides = scene.render, (scene.render.resolution_x, scene.render.resolution_y)
    return tuple(max(1, side * render.resolution_percentage // 100) for side in sides)


def borders(low: float, high: float, size: int) -> tuple[int, int]:
    """(first pixel, end) of the part of a side of `size` pixels that a border leaves. low, high: 0 to 1.
    In float32, as Blender counts them."""
    return int(np.float32(low) * np.float32(size)), int(np.float32(high) * np.float32(size))


def photograph_size(scene: bpy.types.Scene) -> tuple[int, int] | None:
    """(width, height) of the photograph of the scene's camera, if it has one."""
    data = scene.camera.data if scene.camera is not None and scene.camera.type == "CAMERA" else {}
    return tuple(data[SIZE]) if SIZE in data else None


def apply_camera_size(scene: bpy.types.Scene):
    """Gives the scene the image size and the pixel aspect of its camera's photograph, if it has one."""
    if (size := photograph_size(scene)) is not None:
        scene.render.resolution_x, scene.render.resolution_y = size
        scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = scene.camera.data[ASPECT]
