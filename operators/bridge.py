"""Blender's data <-> the product's: the only place where one becomes the other.

A splat is a point cloud, or a mesh of points where Blender cannot make one (4.2), with the attributes of Blender 5.3's
own splats. Coordinates are the file's; the object's matrix turns them into Blender's. What those attributes cannot hold
bit by bit lies beside them under names of our own, so that a file comes out as it went in.
"""

from __future__ import annotations

import json
import re

import bpy
import numpy as np
from mathutils import Matrix

from ..svrgs_addon import activation
from ..svrgs_addon.errors import SceneError
from ..svrgs_addon.scene import SH_COEFFICIENTS, Scene

POSITION, SCALE, ROTATION, BASE, SH = "position", "scale", "rotation", "radiance:base", "radiance:sh_"
RAW_SCALE, RAW_ROTATION, RAW_OPACITY = "svrgs:log_scale", "svrgs:quaternion", "svrgs:opacity_logit"
RESERVED = re.compile(r"(position|scale|rotation|radius|removed|material_index|id)$|[.]|radiance:|svrgs:|ply:")
NOTES = "svrgs"  # property of the data-block: what the file said beside its numbers, JSON
TYPES = ("MESH", "POINTCLOUD")
AXES = Matrix(((1, 0, 0, 0), (0, 0, 1, 0), (0, -1, 0, 0), (0, 0, 0, 1)))  # 3DGS files have y down, Blender z up
VALUE = {"FLOAT_VECTOR": "vector", "FLOAT2": "vector", "FLOAT_COLOR": "color", "FLOAT4": "vector"}  # others: value
WIDTH = {"FLOAT_VECTOR": 3, "FLOAT_COLOR": 4, "FLOAT4": 4, "QUATERNION": 4, "INT32_2D": 2}  # others: 1
NAME_LIMIT = 60  # of the 63 bytes older versions allow
STORED_AS = {"f4": ("FLOAT", "f4"), "f8": ("INT32_2D", "i4"), "u4": ("INT", "i4")}  # smaller integers as numbers: INT


def is_splat(obj: bpy.types.Object | None) -> bool:
    """Whether the object is a splat: ours, or Blender 5.3's own."""
    return obj is not None and obj.type in TYPES and all(_attribute(obj.data, name) for name in (SCALE, ROTATION, BASE))


def count(obj: bpy.types.Object) -> int:
    """Gaussians of a splat."""
    return len(obj.data.vertices if obj.type == "MESH" else obj.data.points)


# --- Scene -> object


def object_from_scene(name: str, scene: Scene, collection: bpy.types.Collection, matrix: Matrix = AXES) -> bpy.types.Object:
    """A new splat in the collection, its data in the scene's coordinates; matrix: these to Blender's world."""
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(scene.count)
    _fill(mesh, scene)
    obj = bpy.data.objects.new(name, mesh)
    if _can_make_point_clouds():
        _to_point_cloud(obj)
    obj.data[NOTES] = json.dumps(_notes(scene))
    obj.matrix_world = matrix
    collection.objects.link(obj)
    return obj


def _can_make_point_clouds() -> bool:
    return "POINTCLOUD" in bpy.ops.object.convert.get_rna_type().properties["target"].enum_items  # from 4.5 on


def _to_point_cloud(obj: bpy.types.Object):
    """Turns the mesh object into a point cloud, in a scene of its own: selection and mode of the user's stay as they are."""
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
    bpy.data.meshes.remove(mesh)
    obj.data.name = name
    for selection in (".select_vert", ".selection"):
        if selection in obj.data.attributes:
            obj.data.attributes.remove(obj.data.attributes[selection])
    if hasattr(obj.data, "type"):  # Blender 5.3
        obj.data.type = "GAUSSIAN_SPLAT"


def _fill(data: bpy.types.Mesh, scene: Scene):
    base = np.concatenate([scene.sh[:, 0], activation.opacities(scene.opacity_logits)[:, None]], axis=1)
    _set(data, POSITION, "FLOAT_VECTOR", scene.means)
    _set(data, SCALE, "FLOAT_VECTOR", activation.scales(scene.log_scales))
    _set(data, ROTATION, "QUATERNION", activation.rotations(scene.quats))
    _set(data, BASE, _four_floats(), base)
    for k in range(1, scene.sh.shape[1]):
        _set(data, f"{SH}{k - 1}", "FLOAT_VECTOR", scene.sh[:, k])
    _set(data, RAW_SCALE, "FLOAT_VECTOR", scene.log_scales)
    _set(data, RAW_ROTATION, "QUATERNION", scene.quats)
    _set(data, RAW_OPACITY, "FLOAT", scene.opacity_logits)
    for name, (attribute, _) in _further(scene).items():
        column = scene.attributes[name]
        kind, same_bits = STORED_AS.get(column.dtype.str[1:], ("INT", ""))
        _set(data, attribute, kind, column.view(same_bits) if same_bits else column.astype(np.int32))


def _notes(scene: Scene) -> dict:
    return {"antialiased": scene.antialiased, "comments": scene.comments, "order": scene.property_order, "further": _further(scene)}


def _further(scene: Scene) -> dict[str, tuple[str, str]]:
    """Name in the file: name of the attribute, and the type in the file."""
    free = lambda name: len(name.encode()) <= NAME_LIMIT and not RESERVED.match(name)  # noqa: E731
    return {name: (name if free(name) else f"ply:{i}", column.dtype.str[1:]) for i, (name, column) in enumerate(scene.attributes.items())}


def _four_floats() -> str:
    kinds = bpy.types.Attribute.bl_rna.properties["data_type"].enum_items
    return "FLOAT4" if "FLOAT4" in kinds else "FLOAT_COLOR"


def _set(data, name: str, kind: str, values: np.ndarray):
    attribute = data.attributes.get(name) or data.attributes.new(name, kind, "POINT")
    if attribute.name != name:
        raise SceneError(f"Blender does not take '{name}' as the name of an attribute")
    attribute.data.foreach_set(VALUE.get(kind, "value"), np.ascontiguousarray(values).reshape(-1))


# --- object -> Scene


def scene_from_object(obj: bpy.types.Object) -> Scene:
    """The Gaussians of a splat, in its local coordinates: those of the file. Raises SceneError."""
    if not is_splat(obj):
        raise SceneError(f"'{obj.name}' is no Gaussian splat" if obj else "there is no object")
    if obj.mode == "EDIT":
        obj.update_from_editmode()
    data = obj.data
    base = _get(data, BASE)
    notes = json.loads(data.get(NOTES) or "{}")
    return Scene(
        means=_get(data, POSITION),
        log_scales=activation.raw_scales(_get(data, SCALE), _get(data, RAW_SCALE)),
        quats=activation.raw_rotations(_get(data, ROTATION), _get(data, RAW_ROTATION)),
        opacity_logits=activation.raw_opacities(base[:, 3], _get(data, RAW_OPACITY)),
        sh=_harmonics(data, base),
        antialiased=notes.get("antialiased", False),
        attributes=_columns(data, notes["further"]) if notes else _float_columns(data),
        comments=tuple(notes.get("comments", ())),
        property_order=tuple(notes.get("order", ())),
    )


def _harmonics(data, base: np.ndarray) -> np.ndarray:
    """(N, K, 3); bands that are not complete, and those above degree 3, are left out."""
    rest = 0
    while rest + 1 < max(SH_COEFFICIENTS) and _attribute(data, f"{SH}{rest}"):
        rest += 1
    coefficients = max(k for k in SH_COEFFICIENTS if k <= rest + 1)
    sh = np.empty((len(base), coefficients, 3), np.float32)
    sh[:, 0] = base[:, :3]
    for k in range(1, coefficients):
        sh[:, k] = _get(data, f"{SH}{k - 1}")
    return sh


def _columns(data, further: dict) -> dict[str, np.ndarray]:
    """Columns of the file that are no Gaussian's, as they were; those deleted since are left out."""
    columns = {}
    for name, (attribute, code) in further.items():
        values = _get(data, attribute)
        if values is not None:
            columns[name] = values.reshape(-1).view(code) if code in STORED_AS else values.astype(code)
    return columns


def _float_columns(data) -> dict[str, np.ndarray]:
    """Further numbers of a splat that Blender itself imported."""
    names = [a.name for a in data.attributes if a.domain == "POINT" and a.data_type == "FLOAT" and not RESERVED.match(a.name)]
    return {name: _get(data, name) for name in names if re.fullmatch("[!-~]+", name)}


def _attribute(data, name: str):
    attribute = data.attributes.get(name)
    return attribute if attribute is not None and attribute.domain == "POINT" else None


def _get(data, name: str) -> np.ndarray | None:
    """(N,) or (N, width) values of an attribute; None where there is none."""
    attribute = _attribute(data, name)
    if attribute is None:
        return None
    kind = attribute.data_type
    width = WIDTH.get(kind, 1)
    values = np.empty(len(attribute.data) * width, np.int32 if kind.startswith("INT") else np.float32)
    attribute.data.foreach_get(VALUE.get(kind, "value"), values)
    return values.reshape(-1, width) if width > 1 else values
