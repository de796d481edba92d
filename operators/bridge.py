"""Blender's data <-> the product's: the only place where one becomes the other.

A splat is a point cloud, or a mesh of points where Blender cannot make one (4.2), with the attributes of Blender 5.3's own
splats (svrgs_addon/attribute_layout.py). Its coordinates are the file's; the object's matrix, or its root's, turns them into
Blender's. A posed photograph is a camera that knows the size of its picture.
"""

from __future__ import annotations

import contextlib
import itertools

import bmesh
import bpy
import numpy as np
from mathutils import Matrix

from ..svrgs_addon.blender import lens as lenses
from ..svrgs_addon.blender.attribute_layout import BASE, REQUIRED, SH, from_attributes, notes_of, to_attributes
from ..svrgs_addon.camera import Camera
from ..svrgs_addon.errors import SceneError
from ..svrgs_addon.scene import Scene

NOTES = "svrgs"  # property of a splat's data-block
SIZE, ASPECT, IMAGE = "svrgs_size", "svrgs_pixel_aspect", "svrgs_image"  # properties of a photograph's camera
ROOT = "svrgs_root"  # property of the empty that holds what shares file coordinates
DATASET, IMAGES = "svrgs_dataset", "svrgs_images"  # properties of a root: where its photographs are, the name of their folder
TYPES = ("MESH", "POINTCLOUD")
AXES = Matrix(((1, 0, 0, 0), (0, 0, 1, 0), (0, -1, 0, 0), (0, 0, 0, 1)))  # 3DGS files have y down, Blender has z up
FLIP = np.diag((1.0, -1.0, -1.0, 1.0))  # Blender's cameras look along -z with y up, ours along z with y down
VALUE = {"FLOAT_VECTOR": "vector", "FLOAT2": "vector", "FLOAT4": "vector", "FLOAT_COLOR": "color"}  # others: value
WIDTH = {"FLOAT_VECTOR": 3, "FLOAT_COLOR": 4, "FLOAT4": 4, "QUATERNION": 4, "INT32_2D": 2}  # others: 1


# --- splats


def is_splat(obj: bpy.types.Object | None) -> bool:
    """Whether the object is a splat: ours, or Blender 5.3's own."""
    return obj is not None and obj.type in TYPES and all(_attribute(obj.data, name) for name in REQUIRED)


def count(obj: bpy.types.Object) -> int:
    """Gaussians of a splat."""
    return len(obj.data.vertices if obj.type == "MESH" else obj.data.points)


def sh_degree(obj: bpy.types.Object) -> int:
    """Degree of the spherical harmonics that a splat's file would have: a band that is not complete ends them."""
    bands = (all(_attribute(obj.data, f"{SH}{k}") for k in range(n * n - 1, (n + 1) ** 2 - 1)) for n in (1, 2, 3))
    return len(list(itertools.takewhile(bool, bands)))


def object_from_scene(name: str, scene: Scene, collection: bpy.types.Collection, matrix: Matrix = AXES) -> bpy.types.Object:
    """A new splat in the collection, its data in the scene's coordinates; matrix: from these to Blender's world."""
    obj = bpy.data.objects.new(name, _mesh(name, scene))
    if "POINTCLOUD" in bpy.ops.object.convert.get_rna_type().properties["target"].enum_items:  # from 4.5 on
        _to_point_cloud(obj)
    obj.matrix_world = matrix
    collection.objects.link(obj)
    return obj


def scene_from_object(obj: bpy.types.Object) -> Scene:
    """The Gaussians of a splat, in its local coordinates: those of the file. Raises SceneError."""
    if not is_splat(obj):
        raise SceneError(f"'{obj.name}' is no Gaussian splat" if obj else "there is no object")
    with _out_of_edit_mode(obj) as data:
        numbers = [a.name for a in data.attributes if a.domain == "POINT" and a.data_type == "FLOAT"]
        return from_attributes(lambda name: _get(data, name), numbers, obj.data.get(NOTES, ""))


def values(obj: bpy.types.Object, name: str) -> np.ndarray | None:
    """(N,) or (N, width) numbers of a splat's further attribute; None where it has none of that name."""
    return _get(obj.data, name)


def set_values(obj: bpy.types.Object, name: str, kind: str, values: np.ndarray):
    """Gives the splat a further attribute of Blender's data type `kind`, one row a Gaussian."""
    _set(obj.data, name, kind, values)
    obj.data.update_tag()


def forget_values(obj: bpy.types.Object, *names: str):
    """Removes further attributes, as far as there are any."""
    for name in names:
        if name in obj.data.attributes:
            obj.data.attributes.remove(obj.data.attributes[name])


def replace_gaussians(obj: bpy.types.Object, scene: Scene):
    """Gives the splat other Gaussians; it stays the same object, with its materials. Objects that share its data keep the former ones."""
    old, name = obj.data, obj.data.name
    new = _mesh(name, scene) if obj.type == "MESH" else _point_cloud(name, scene)
    for material in old.materials:
        new.materials.append(material)
    for key in set(old.keys()) - set(new.keys()):
        new[key] = old[key]
    obj.data = new
    if not old.users:
        bpy.data.batch_remove([old])
        new.name = name


def _mesh(name: str, scene: Scene) -> bpy.types.Mesh:
    """Data of a splat where Blender makes no point clouds."""
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(scene.count)
    for attribute, kind, values in to_attributes(scene):
        _set(mesh, attribute, kind, values)
    mesh[NOTES] = notes_of(scene)
    return mesh


def _point_cloud(name: str, scene: Scene) -> bpy.types.PointCloud:
    """Data of a splat where Blender makes point clouds, without an object."""
    made = object_from_scene(name, scene, bpy.context.scene.collection)
    data = made.data
    bpy.data.objects.remove(made)
    return data


@contextlib.contextmanager
def _out_of_edit_mode(obj: bpy.types.Object):
    """The object's data as it now is: of a mesh in Edit Mode that lies elsewhere."""
    if obj.type != "MESH" or obj.mode != "EDIT":
        yield obj.data
        return
    now = bpy.data.meshes.new("svrgs")
    try:
        bmesh.from_edit_mesh(obj.data).to_mesh(now)
        yield now
    finally:
        bpy.data.meshes.remove(now)


def _to_point_cloud(obj: bpy.types.Object):
    """Turns the mesh object into a point cloud, in a scene of its own: the user's selection and mode stay as they are."""
    mesh, name = obj.data, obj.data.name
    aside = bpy.data.scenes.new("svrgs")
    try:
        aside.collection.objects.link(obj)
        layer = aside.view_layers[0]
        layer.objects.active = obj
        obj.select_set(True, view_layer=layer)
        with bpy.context.temp_override(scene=aside, view_layer=layer, active_object=obj, object=obj, selected_objects=[obj], selected_editable_objects=[obj]):
            bpy.ops.object.convert(target="POINTCLOUD")
        aside.collection.objects.unlink(obj)
    finally:
        bpy.data.scenes.remove(aside)
    obj.data[NOTES] = mesh[NOTES]
    bpy.data.meshes.remove(mesh)
    obj.data.name = name
    for selection in (".select_vert", ".selection"):
        if selection in obj.data.attributes:
            obj.data.attributes.remove(obj.data.attributes[selection])
    if hasattr(obj.data, "type"):  # Blender 5.3
        obj.data.type = "GAUSSIAN_SPLAT"


def _set(data: bpy.types.Mesh, name: str, kind: str, values: np.ndarray):
    if name == BASE and "FLOAT4" in bpy.types.Attribute.bl_rna.properties["data_type"].enum_items:
        kind = "FLOAT4"
    attribute = data.attributes.get(name) or data.attributes.new(name, kind, "POINT")
    attribute.data.foreach_set(VALUE.get(kind, "value"), np.ascontiguousarray(values).reshape(-1))


def _get(data, name: str) -> np.ndarray | None:
    """(N,) or (N, width) values of an attribute; None where there is none."""
    attribute = _attribute(data, name)
    if attribute is None:
        return None
    kind = attribute.data_type
    width = WIDTH.get(kind, 1)
    dtype = bool if kind == "BOOLEAN" else np.int32 if kind.startswith("INT") else np.float32  # of another type it takes a thousand times as long
    values = np.empty(len(attribute.data) * width, dtype)
    attribute.data.foreach_get(VALUE.get(kind, "value"), values)
    return values.reshape(-1, width) if width > 1 else values


def _attribute(data, name: str):
    attribute = data.attributes.get(name)
    return attribute if attribute is not None and attribute.domain == "POINT" else None


# --- cameras


def camera_from_object(obj: bpy.types.Object, scene: bpy.types.Scene, size: tuple[int, int] | None = None) -> Camera:
    """What a camera object sees, in Blender's world.

    size: (width, height) in pixels of the scene's aspect; default: the photograph's, or of other cameras the scene's render.
    obj: an evaluated one where animation counts. Raises SceneError for objects that are no cameras (Blender makes any the scene's
    camera), and for cameras that are neither perspective nor orthographic.
    """
    if obj.type != "CAMERA":
        raise SceneError(f"'{obj.name}' is no camera: choose another object as the scene's camera")
    data, render = obj.data, scene.render
    if data.type not in ("PERSP", "ORTHO"):
        raise SceneError(f"camera '{obj.name}' is neither perspective nor orthographic; splats are drawn for those alone")
    aspect = (render.pixel_aspect_x, render.pixel_aspect_y)
    if size is None:
        size, aspect = (tuple(data[SIZE]), tuple(data[ASPECT])) if SIZE in data else (render_size(scene), aspect)
    sensor, orthographic = (data.sensor_width, data.sensor_height), data.type == "ORTHO"
    ortho_scale = data.ortho_scale if orthographic else None
    lens = lenses.Lens(*size, data.lens, (data.shift_x, data.shift_y), aspect, sensor, data.sensor_fit, ortho_scale)
    viewmat = FLIP @ np.linalg.inv(_without_scale(obj.matrix_world))
    return Camera(viewmat, lenses.intrinsics(lens), *size, data.get(IMAGE, obj.name), orthographic)


def camera_to_object(camera: Camera, obj: bpy.types.Object):
    """Gives the camera object the view's lens, the size of its picture, and its pose in the coordinates of its parent."""
    data, lens = obj.data, lenses.lens_of(camera)
    data.type, data.sensor_fit = "PERSP", lens.fit
    data.sensor_width, data.sensor_height = lens.sensor
    data.lens = lens.lens
    data.shift_x, data.shift_y = lens.shift
    data[SIZE], data[ASPECT], data[IMAGE] = (camera.width, camera.height), lens.aspect, camera.name
    obj.rotation_mode = "QUATERNION"  # Euler angles lose digits near the poles
    obj.matrix_basis = Matrix(np.linalg.inv(camera.viewmat) @ FLIP)


def render_size(scene: bpy.types.Scene) -> tuple[int, int]:
    """(width, height) of a render, in pixels."""
    render = scene.render
    return tuple(max(1, side * render.resolution_percentage // 100) for side in (render.resolution_x, render.resolution_y))


def apply_camera_size(scene: bpy.types.Scene):
    """Sets the render's size and pixel aspect to those of the active camera's photograph, if it has one."""
    data = scene.camera.data if scene.camera is not None and scene.camera.type == "CAMERA" else {}
    if SIZE in data:
        scene.render.resolution_x, scene.render.resolution_y = data[SIZE]
        scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = data[ASPECT]


def _without_scale(matrix: Matrix) -> np.ndarray:
    pose = np.array(matrix, np.float64)
    pose[:3, :3] /= np.linalg.norm(pose[:3, :3], axis=0)
    return pose


# --- what belongs together


def points_object(name: str, points: np.ndarray, colors: np.ndarray, collection: bpy.types.Collection) -> bpy.types.Object:
    """A mesh of points (P, 3) float32 with colours (P, 3) uint8, display sRGB."""
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(points))
    mesh.vertices.foreach_set("co", points.reshape(-1))
    rgba = np.concatenate([colors / np.float32(255), np.ones((len(colors), 1), np.float32)], axis=1)
    mesh.attributes.new("Color", "BYTE_COLOR", "POINT").data.foreach_set("color_srgb", rgba.reshape(-1))
    obj = bpy.data.objects.new(name, mesh)
    collection.objects.link(obj)
    return obj


def root_of(obj: bpy.types.Object | None) -> bpy.types.Object | None:
    """The empty above the object, or the object itself, in whose coordinates files are."""
    while obj is not None and ROOT not in obj:
        obj = obj.parent
    return obj


def new_root(name: str, collection: bpy.types.Collection, matrix: Matrix = AXES) -> bpy.types.Object:
    root = bpy.data.objects.new(name, None)
    root[ROOT] = True
    root.matrix_world = matrix
    collection.objects.link(root)
    return root


def hang_below(obj: bpy.types.Object, root: bpy.types.Object):
    """Makes the object share the root's coordinates."""
    obj.parent = root
    obj.matrix_parent_inverse.identity()
    obj.matrix_basis.identity()
