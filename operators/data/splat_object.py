"""Blender's objects <-> Scene of svrgs_addon: splats, and the empties above them. Cameras are in
camera_object.py.

A splat is a point cloud, or a mesh of points in Blender 4.2, which has no point clouds. Its attributes are
those of Blender 5.3's own splats (svrgs_addon/scene/attribute_layout.py):

- The numbers are those of the file. The matrix of the object, or of its root, turns them into Blender's
  coordinates.
- `scale` and opacity are activated and `rotation` is normalised. The raw values lie in attributes
  `svrgs:...`; one is used as long as its activation equals the attribute. After an edit, and in splats of
  Blender's own import, the activation is inverted.
- Each further column of a file is an attribute of its own. Types and order of the columns, and the file's
  comments, are a property of the data-block.
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
from typing import TypeGuard

import bmesh
import bpy
import numpy as np
from bpy.app.translations import pgettext_iface as tr
from mathutils import Euler, Matrix

from ...svrgs_addon.scene.affine import transformed
from ...svrgs_addon.scene.attribute_layout import (
    BASE,
    POSITION,
    RAW_POSITION,
    REQUIRED,
    SH,
    from_attributes,
    notes_of,
    to_attributes,
)
from ...svrgs_addon.scene.gaussians import Scene
from ...svrgs_addon.scene.moved_points import moved_parts
from ...svrgs_addon.system.errors import SceneError, SplatError
from .world_matrix import world_matrix

NOTES = "svrgs"  # property of a splat's data-block: types and order of further columns, comments
# property of a splat without a root: whether its import has turned it from y down to z up (_import_matrix)
Y_DOWN = "svrgs_y_down"
# properties of an imported splat: name of its file's format, bytes of the file
FORMAT, BYTES = "svrgs_format", "svrgs_bytes"
SPZ_COLOR, SPZ_ROUNDING = 0.15, 1e-3  # of SH degree 0, from which the 256 values of a colour are made
OF_GLTF = "COLOR_0"  # attribute of splats of Blender's own import of glTF
GRADE = "svrgs_grade"  # settings of data/grading.py, which Blender before 5.0 keeps among the properties
SAME_PLACE = 1e-6  # difference between matrices in float32 that means nothing
ROOT = "svrgs_root"  # property of an empty: its children share the coordinates of the files
# properties of a root: folder of its dataset, name of the image folder in it
DATASET, IMAGES, MASKS = "svrgs_dataset", "svrgs_images", "svrgs_masks"
POINTS = "svrgs_points"  # property of a root: number of sparse points in its dataset
PLACES = "svrgs_places"  # property of a mesh of sparse points: digest of where they were imported
TYPES = ("MESH", "POINTCLOUD")
BLENDER_HAS_SPLATS = "type" in bpy.types.PointCloud.bl_rna.properties  # from 5.3 on
# 3DGS files have y down, Blender has z up
AXES = Matrix(((1, 0, 0, 0), (0, 0, 1, 0), (0, -1, 0, 0), (0, 0, 0, 1)))
# data type of an attribute -> name of its values, numbers per value, and their type: with another one
# foreach_get takes a thousand times as long
KINDS: dict[str, tuple[str, int, type]] = {
    "FLOAT": ("value", 1, np.float32), "INT": ("value", 1, np.int32), "INT8": ("value", 1, np.int32),
    "BOOLEAN": ("value", 1, bool), "FLOAT_VECTOR": ("vector", 3, np.float32),
    "FLOAT_COLOR": ("color", 4, np.float32), "FLOAT4": ("vector", 4, np.float32),
    "QUATERNION": ("value", 4, np.float32), "INT32_2D": ("value", 2, np.int32),
    "FLOAT2": ("vector", 2, np.float32), "BYTE_COLOR": ("color", 4, np.float32),
    "INT16_2D": ("value", 2, np.int32), "FLOAT4X4": ("value", 16, np.float32),
}  # fmt: skip


# --- splats


def is_splat(obj: bpy.types.Object | None) -> TypeGuard[bpy.types.Object]:
    """Whether the object is a splat: of this extension, or of Blender 5.3's own import."""
    return obj is not None and obj.type in TYPES and all(_attribute(obj.data, name) for name in REQUIRED)


def count(obj: bpy.types.Object) -> int:
    """Number of Gaussians of a splat."""
    return len(obj.data.vertices if obj.type == "MESH" else obj.data.points)


def mask_of(obj: bpy.types.Object, rows: np.ndarray) -> np.ndarray:
    """(N,) bool: whether a Gaussian is in one of these rows."""
    mask = np.zeros(count(obj), bool)
    mask[rows] = True
    return mask


def sh_degree(obj: bpy.types.Object) -> int:
    """SH degree that a file of the splat would have: up to the first band that is not complete."""
    bands = (
        all(_attribute(obj.data, f"{SH}{k}") for k in range(n * n - 1, (n + 1) ** 2 - 1)) for n in (1, 2, 3)
    )
    return len(list(itertools.takewhile(bool, bands)))


def object_from_scene(
    name: str, scene: Scene, collection: bpy.types.Collection, matrix: Matrix = AXES
) -> bpy.types.Object:
    """A new splat in the collection. matrix: from the scene's coordinates to Blender's world."""
    obj = bpy.data.objects.new(name, _mesh(name, scene))
    if "POINTCLOUD" in bpy.ops.object.convert.get_rna_type().properties["target"].enum_items:  # from 4.5 on
        _to_point_cloud(obj)
    obj.matrix_world = matrix
    collection.objects.link(obj)
    return obj


def scene_from_object(obj: bpy.types.Object) -> Scene:
    """The Gaussians of a splat in its local coordinates, which are those of the file. Raises SceneError."""
    if not is_splat(obj):
        raise SceneError(
            tr("'{name}' is not a Gaussian splat").format(name=obj.name) if obj else tr("there is no object")
        )
    with _current_data(obj) as data:
        return from_attributes(lambda name: _get(data, name), _numbers(data), obj.data.get(NOTES, ""))


def sample_scene(obj: bpy.types.Object) -> Scene:
    """A scene of one Gaussian with the columns, comments and order of a splat, which is not read: all values
    are 1."""
    data = obj.data
    return from_attributes(lambda name: _ones(data, name), _numbers(data), data.get(NOTES, ""))


def _numbers(data) -> list[str]:
    """Names of the attributes that are one number per Gaussian."""
    return [a.name for a in data.attributes if a.domain == "POINT" and a.data_type == "FLOAT"]


def values(obj: bpy.types.Object, name: str) -> np.ndarray | None:
    """(N,) or (N, width) values of an attribute of a splat; None if it has no attribute of that name."""
    return _get(obj.data, name)


def stored_values(obj: bpy.types.Object, name: str) -> np.ndarray:
    """As values(), of an attribute that this extension has added. Raises SplatError if it was deleted
    since."""
    found = values(obj, name)
    if found is None:
        text = tr(
            "'{name}' has lost its attribute '{attribute}': undo its deletion, or discard the result and"
            " prune again"
        )
        raise SplatError(text.format(name=obj.name, attribute=name))
    return found


def set_values(obj: bpy.types.Object, name: str, kind: str, values: np.ndarray):
    """Writes an attribute of Blender's data type `kind`, one row per Gaussian."""
    _set(obj.data, name, kind, values)
    obj.data.update_tag()


def remove_values(obj: bpy.types.Object, *names: str):
    """Removes attributes that exist."""
    for name in names:
        if name in obj.data.attributes:
            obj.data.attributes.remove(obj.data.attributes[name])


def further_values(obj: bpy.types.Object) -> list[tuple[str, str, np.ndarray]]:
    """Name, Blender's data type and values of the attributes that have one value per Gaussian, apart from
    those that Blender hides."""
    found = (a for a in obj.data.attributes if a.domain == "POINT" and not a.name.startswith("."))
    kinds = {a.name: a.data_type for a in found if a.data_type in KINDS}
    return [(name, kind, stored_values(obj, name)) for name, kind in kinds.items()]


def replace_gaussians(obj: bpy.types.Object, scene: Scene):
    """Gives the splat other Gaussians. Object, materials and properties stay. Objects that share its data
    keep the former Gaussians."""
    _keep_upright(obj)
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


def copy_with(obj: bpy.types.Object, name: str, scene: Scene) -> bpy.types.Object:
    """A copy of the splat with other Gaussians, in the same collection: with its place, modifiers and
    constraints; of its properties, those of its import and its grade alone."""
    _keep_upright(obj)
    copy = obj.copy()
    copy.name = name
    kept = (Y_DOWN, FORMAT, GRADE)
    for key in [key for key in copy.keys() if key.startswith("svrgs_") and key not in kept]:
        del copy[key]
    for collection in obj.users_collection:
        if collection.library is None and collection.override_library is None:
            collection.objects.link(copy)
    replace_gaussians(copy, scene)
    return copy


def collection_of(obj: bpy.types.Object) -> bpy.types.Collection:
    """A collection of the object that the scene shows; else the scene's own."""
    scene = bpy.context.scene
    shown = [scene.collection, *scene.collection.children_recursive]
    return next((one for one in obj.users_collection if one in shown), scene.collection)


def delete(obj: bpy.types.Object):
    """Deletes the object and its data from the file."""
    data = obj.data
    bpy.data.objects.remove(obj)
    if not data.users:
        bpy.data.batch_remove([data])


def write_gaussians(obj: bpy.types.Object, scene: Scene):
    """Writes the attributes of a splat with as many Gaussians as the scene has."""
    for attribute, kind, values in to_attributes(scene):
        _set(obj.data, attribute, kind, values)
    obj.data.update_tag()


def some_positions(obj: bpy.types.Object) -> tuple[float, ...]:
    """Coordinates of a few points, to see at once whether the points were moved."""
    attribute = _attribute(obj.data, POSITION)
    points = attribute.data if attribute is not None else ()
    step = max(1, len(points) // 16)
    return tuple(value for row in range(0, len(points), step) for value in points[row].vector)


def record_positions(obj: bpy.types.Object) -> bool:
    """Stores where the points of a splat are now, if that was never stored. Returns whether it was stored
    now."""
    if _attribute(obj.data, RAW_POSITION):
        return False
    _set(obj.data, RAW_POSITION, "FLOAT_VECTOR", stored_values(obj, POSITION))
    return True


def count_moved(obj: bpy.types.Object) -> int:
    """Number of Gaussians whose points Blender has rotated or scaled without their shapes."""
    before, after = values(obj, RAW_POSITION), values(obj, POSITION)
    if before is None or after is None or np.array_equal(before, after):
        return 0
    return sum(len(rows) for rows, _ in moved_parts(before, after))


def _mesh(name: str, scene: Scene) -> bpy.types.Mesh:
    """A mesh of points with the attributes of a splat."""
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(scene.count)
    for attribute, kind, values in to_attributes(scene):
        _set(mesh, attribute, kind, values)
    mesh[NOTES] = notes_of(scene)
    return mesh


def _point_cloud(name: str, scene: Scene) -> bpy.types.PointCloud:
    """A point cloud with the attributes of a splat; Blender makes one only by converting an object."""
    made = object_from_scene(name, scene, bpy.context.scene.collection)
    data = made.data
    bpy.data.objects.remove(made)
    return data


@contextlib.contextmanager
def _current_data(obj: bpy.types.Object):
    """The object's data with all edits: Blender keeps those of a mesh in Edit Mode apart."""
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
    """Converts the mesh object to a point cloud, in a temporary scene: the user's selection and mode do not
    change."""
    mesh, name = obj.data, obj.data.name
    temp_scene = bpy.data.scenes.new("svrgs")
    try:
        temp_scene.collection.objects.link(obj)
        layer = temp_scene.view_layers[0]
        layer.objects.active = obj
        obj.select_set(True, view_layer=layer)
        active = {"active_object": obj, "object": obj}
        selected = {"selected_objects": [obj], "selected_editable_objects": [obj]}
        with bpy.context.temp_override(scene=temp_scene, view_layer=layer, **active, **selected):
            bpy.ops.object.convert(target="POINTCLOUD")
        temp_scene.collection.objects.unlink(obj)
    finally:
        bpy.data.scenes.remove(temp_scene)
    obj.data[NOTES] = mesh[NOTES]
    bpy.data.meshes.remove(mesh)
    obj.data.name = name
    remove_values(obj, ".select_vert", ".selection")
    if BLENDER_HAS_SPLATS:
        obj.data.type = "GAUSSIAN_SPLAT"


def _set(data: bpy.types.Mesh, name: str, kind: str, values: np.ndarray):
    if name == BASE and "FLOAT4" in bpy.types.Attribute.bl_rna.properties["data_type"].enum_items:
        kind = "FLOAT4"
    attribute = data.attributes.get(name) or data.attributes.new(name, kind, "POINT")
    attribute.data.foreach_set(KINDS[kind][0], np.ascontiguousarray(values).reshape(-1))


def _get(data, name: str) -> np.ndarray | None:
    """(N,) or (N, width) values of an attribute; None if there is none, and of a mesh in Edit Mode, where
    Blender 4.2 keeps them apart."""
    attribute = _attribute(data, name)
    if attribute is None or (isinstance(data, bpy.types.Mesh) and len(attribute.data) < len(data.vertices)):
        return None
    name_of_values, width, dtype = KINDS[attribute.data_type]
    values: np.ndarray = np.empty(len(attribute.data) * width, dtype)
    attribute.data.foreach_get(name_of_values, values)
    return values.reshape(-1, width) if width > 1 else values


def _ones(data, name: str) -> np.ndarray | None:
    """As _get, with one row of 1."""
    attribute = _attribute(data, name)
    if attribute is None:
        return np.ones((1, 3), np.float32) if name == POSITION else None  # in Edit Mode it is kept apart
    _, width, dtype = KINDS[attribute.data_type]
    return np.ones((1, width) if width > 1 else 1, dtype)


def _attribute(data, name: str):
    attribute = data.attributes.get(name)
    return attribute if attribute is not None and attribute.domain == "POINT" else None


# --- places


def to_file(obj: bpy.types.Object, matrix: Matrix) -> np.ndarray:
    """(4, 4) float64 from local coordinates to those of the file that the splat was imported from, or of its
    dataset.

    matrix: from local coordinates to Blender's world. Whatever the user has moved since is part of the
    result; if nothing was moved, it is exactly the identity.
    """
    root = root_of(obj)
    return relative(world_matrix(root) if root is not None else _import_matrix(obj), matrix)


def move_below(obj: bpy.types.Object, root: bpy.types.Object | None):
    """Puts a splat below a root, or below nothing, where its file's coordinates are those of the root, or y
    down as after an import."""
    in_file_coordinates(obj)
    place = Matrix(to_file(obj, world_matrix(obj)))
    if root is not None:
        parent_to_root(obj, root)
        obj.matrix_basis = place
    else:
        obj.parent = None
        obj.matrix_world = _import_matrix(obj) @ place


def _import_matrix(obj: bpy.types.Object) -> Matrix:
    """From the coordinates of the file to Blender's world, as a splat without a root was imported: y down
    becomes z up. Blender's own import of PLY leaves y down; until the splat is rotated by hand."""
    return AXES if _is_upright(obj) else Matrix()


def _is_upright(obj: bpy.types.Object) -> bool:
    if Y_DOWN in obj:
        return bool(obj[Y_DOWN])
    return NOTES in obj.data or turned_by_blender(obj) or world_matrix(obj).to_euler() != Euler()


def _keep_upright(obj: bpy.types.Object):
    """Before the splat gets other Gaussians, which no longer tell it."""
    if Y_DOWN not in obj and obj.library is None:
        obj[Y_DOWN] = _is_upright(obj)


def turned_by_blender(obj: bpy.types.Object) -> bool:
    """Whether Blender's own import has turned the numbers of the splat from y down to z up: those of glTF,
    which have a further attribute, and those of SPZ, which have 256 values of each colour."""
    base = None if NOTES in obj.data else values(obj, BASE)
    if base is None or not len(base):
        return False
    levels = (base[:, :3] * SPZ_COLOR + np.float32(0.5)) * 255
    of_spz = np.abs(levels - np.rint(levels)).max() < SPZ_ROUNDING
    return bool(of_spz or _attribute(obj.data, OF_GLTF))


def in_file_coordinates(obj: bpy.types.Object):
    """Gives a splat that Blender's own import has turned the numbers of its file, in the same place."""
    if turned_by_blender(obj):
        obj.matrix_world, back = world_matrix(obj) @ AXES, np.array(AXES.inverted())
        replace_gaussians(obj, transformed(scene_from_object(obj), back))


def relative(target: Matrix, source: Matrix) -> np.ndarray:
    """(4, 4) float64: target⁻¹ · source, from the coordinates of one object to those of another, whose
    matrices to Blender's world these are; exactly the identity where only rounding is between them."""
    matrix = np.linalg.solve(np.array(target, np.float64), np.array(source, np.float64))
    if np.abs(matrix - np.eye(4)).max() < SAME_PLACE * max(1.0, np.abs(matrix[:3, 3]).max()):
        return np.eye(4)
    return matrix


# --- roots: empties whose children share the coordinates of the files


def points_object(
    name: str, points: np.ndarray, colors: np.ndarray, collection: bpy.types.Collection
) -> bpy.types.Object:
    """A mesh of points (P, 3) float32 with colours (P, 3) uint8, display sRGB."""
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(points))
    mesh.vertices.foreach_set("co", points.reshape(-1))
    rgba = np.concatenate([colors / np.float32(255), np.ones((len(colors), 1), np.float32)], axis=1)
    mesh.attributes.new("Color", "BYTE_COLOR", "POINT").data.foreach_set("color_srgb", rgba.reshape(-1))
    mesh[PLACES] = _places(mesh)
    obj = bpy.data.objects.new(name, mesh)
    collection.objects.link(obj)
    return obj


def has_its_points(obj: bpy.types.Object) -> bool:
    """Whether it is a points_object() none of whose points was moved, added or deleted."""
    return obj.type == "MESH" and PLACES in obj.data and obj.data[PLACES] == _places(obj.data)


def _places(mesh: bpy.types.Mesh) -> str:
    """A digest of where the points of a mesh are."""
    co: np.ndarray = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", co)
    return hashlib.sha256(co.tobytes()).hexdigest()


def root_of(obj: bpy.types.Object | None) -> bpy.types.Object | None:
    """The root above the object, or the object itself if it is one; None if there is none."""
    while obj is not None and ROOT not in obj:
        obj = obj.parent
    return obj


def new_root(name: str, collection: bpy.types.Collection, matrix: Matrix = AXES) -> bpy.types.Object:
    """matrix: from the coordinates of the files to Blender's world."""
    root = bpy.data.objects.new(name, None)
    root[ROOT] = True
    root.matrix_world = matrix
    collection.objects.link(root)
    return root


def parent_to_root(obj: bpy.types.Object, root: bpy.types.Object):
    """Makes the object a child of the root, in the coordinates of the files."""
    obj.parent = root
    obj.matrix_parent_inverse.identity()
    obj.matrix_basis.identity()
