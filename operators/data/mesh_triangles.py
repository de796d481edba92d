"""Blender's meshes -> triangles with normals, base colours and textures.

What an object is in a picture, by its own settings and those of its collection in the view layer: invisible
to the camera (Ray Visibility, or indirect only), a holdout, a shadow catcher, or opaque.
"""

from __future__ import annotations

import bpy
import numpy as np

from ...svrgs_addon.render.meshes import Triangles
from ...svrgs_addon.render.textures import Texture
from . import splat_object, view_layers
from .materials import BaseColor, base_color

SURFACES = {"MESH", "CURVE", "SURFACE", "FONT", "META"}

Arrays = dict[str, np.ndarray]  # of the triangles of one object, as NO_TRIANGLES; without holdout at first
NO_TRIANGLES: Arrays = {
    **{name: np.empty((0, 3, 3), np.float32) for name in ("corners", "normals", "colors")},
    "uvs": np.empty((0, 3, 2), np.float32), "texture": np.empty(0, np.int32), "holdout": np.empty(0, bool),
}  # fmt: skip


class _Read:
    """What was read for one picture: each material and each mesh once, however many objects have it."""

    def __init__(self):
        self.materials: dict[int, BaseColor] = {}  # by the material's address
        self.textures: dict[int, tuple[int, Texture]] = {}  # by id(): number, texture
        self.meshes: dict[tuple, Arrays | None] = {}  # by the addresses of mesh and materials

    def base_color(self, material: bpy.types.Material | None) -> BaseColor:
        key = material.as_pointer() if material is not None else 0
        if key not in self.materials:
            self.materials[key] = base_color(material)
        return self.materials[key]

    def number(self, texture: Texture) -> int:
        return self.textures.setdefault(id(texture), (len(self.textures), texture))[0]

    def triangles(self, obj: bpy.types.Object) -> Arrays | None:
        """The triangles of an evaluated object in its own coordinates; None if it has none."""
        if obj.type != "MESH":
            return _triangles(obj, self)
        materials = (slot.material.as_pointer() if slot.material else 0 for slot in obj.material_slots)
        key = (obj.data.as_pointer(), *materials)
        if key not in self.meshes:
            self.meshes[key] = _triangles(obj, self)
        return self.meshes[key]


def triangles(depsgraph: bpy.types.Depsgraph, cut: bool = False, catchers: bool = False) -> Triangles:
    """All objects that render as surfaces, without splats and their crop boxes, in Blender's world.

    cut: all as holdouts. catchers: only shadow catchers; without it, shadow catchers are left out: they show
    nothing and hide nothing.
    """
    parts, read = [], _Read()
    objects = (one.original for one in depsgraph.ids if isinstance(one, bpy.types.Object))
    boxes = [obj.svrgs_grade.crop for obj in objects if splat_object.is_splat(obj)]
    for instance in depsgraph.object_instances:
        obj = instance.object
        if (
            not instance.show_self
            or obj.type not in SURFACES
            or splat_object.is_splat(obj)
            or obj.original in boxes
            or not obj.visible_camera
            or obj.is_shadow_catcher != catchers
            or view_layers.is_indirect(instance, depsgraph)
        ):
            continue
        if (arrays := read.triangles(obj)) is not None:
            holdout = cut or obj.is_holdout or view_layers.marks(instance, depsgraph, "holdout_get")
            parts.append(_placed(arrays, np.array(instance.matrix_world), holdout))
    joined = {
        name: np.concatenate([none, *(part[name] for part in parts)], dtype=none.dtype)
        for name, none in NO_TRIANGLES.items()
    }
    return Triangles(**joined, textures=tuple(picture for _, picture in read.textures.values()))


def _triangles(obj: bpy.types.Object, read: _Read) -> Arrays | None:
    mesh = obj.to_mesh()
    if mesh is None or not len(mesh.polygons):
        return None
    mesh.calc_loop_triangles()
    count = len(mesh.loop_triangles)
    points, vertices = _get(mesh.vertices, "co", 3), _get(mesh.loop_triangles, "vertices", 3, np.int32)
    corners = _get(mesh.loop_triangles, "loops", 3, np.int32)
    slots = _get(mesh.loop_triangles, "material_index", 1, np.int32)[:, 0]
    materials = [read.base_color(slot.material) for slot in obj.material_slots] or [read.base_color(None)]
    slots = np.clip(slots, 0, len(materials) - 1)
    arrays = {
        "corners": points[vertices], "normals": _get(mesh.corner_normals, "vector", 3)[corners],
        "colors": np.repeat(np.array([material.color for material in materials], np.float32)[slots][:, None],
        3, axis=1),
        "uvs": np.zeros((count, 3, 2), np.float32), "texture": np.full(count, -1, np.int32),
    }  # fmt: skip
    for number, material in enumerate(materials):
        rows = np.flatnonzero(slots == number)
        if len(rows):
            _paint(arrays, rows, mesh, material, vertices[rows], corners[rows], read)
    obj.to_mesh_clear()
    return arrays


def _paint(
    arrays: Arrays,
    rows: np.ndarray,
    mesh: bpy.types.Mesh,
    material: BaseColor,
    vertices: np.ndarray,
    corners: np.ndarray,
    read: _Read,
):
    """Gives some triangles the colours of an attribute (black if the mesh has none of that name, as in
    Blender) or a texture."""
    if material.attribute is not None:
        attribute = (
            mesh.color_attributes.get(material.attribute) if material.attribute else _render_colors(mesh)
        )
        if attribute is None:
            arrays["colors"][rows] = 0
        else:
            arrays["colors"][rows] = _get(attribute.data, "color", 4)[
                vertices if attribute.domain == "POINT" else corners
            ][..., :3]
    if material.texture is None:
        return
    active = next((layer for layer in mesh.uv_layers if layer.active_render), None)
    layer = mesh.uv_layers.get(material.uv_map) if material.uv_map else active
    if layer is None:
        arrays["colors"][rows] = material.texture.mean
        return
    uvs = _get(layer.uv, "vector", 2)[corners]
    if material.mapping is not None:
        matrix = np.array(material.mapping)
        uvs = uvs @ matrix[:2, :2].T + matrix[:2, 3]
    arrays["uvs"][rows] = uvs
    arrays["texture"][rows] = read.number(material.texture)


def _render_colors(mesh: bpy.types.Mesh) -> bpy.types.Attribute | None:
    number = mesh.color_attributes.render_color_index
    return mesh.color_attributes[number] if 0 <= number < len(mesh.color_attributes) else None


def _placed(arrays: Arrays, matrix: np.ndarray, holdout: bool) -> Arrays:
    """The triangles of an object in Blender's world."""
    linear, normals = matrix[:3, :3], arrays["normals"]
    if abs(np.linalg.det(linear)) > 0:
        normals = normals @ np.linalg.inv(linear)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-30)
    placed = arrays | {"corners": arrays["corners"] @ linear.T + matrix[:3, 3], "normals": normals}
    if np.linalg.det(linear) < 0:  # mirrored: corners in the order that fits the normals
        placed = {
            name: values[:, [0, 2, 1]] if values.ndim == 3 else values for name, values in placed.items()
        }
    return placed | {"holdout": np.full(len(placed["corners"]), holdout)}


def _get(items, name: str, width: int, dtype=np.float32) -> np.ndarray:
    """(N, width) values of a property of all items."""
    values = np.empty(len(items) * width, dtype)
    items.foreach_get(name, values)
    return values.reshape(-1, width)
