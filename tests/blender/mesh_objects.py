"""Meshes and materials for tests of the render engine, and what colour they have in a picture."""

from __future__ import annotations

import bpy
import numpy as np
from extension import part


def shader_of(material) -> bpy.types.Node:
    return next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")


def material(name: str, color=(0.8, 0.8, 0.8)):
    made = bpy.data.materials.new(name)
    if bpy.app.version < (5, 0, 0):
        made.use_nodes = True
    shader_of(made).inputs["Base Color"].default_value = (*color, 1)
    return made


def wall(camera, depth: float, color=(1.0, 0.0, 0.0), half: float = 99.0) -> bpy.types.Object:
    """A square across the camera's view, seen from its front, with a UV map "UVMap" over its whole area."""
    mesh = bpy.data.meshes.new("wall")
    mesh.from_pydata(
        [(-half, -half, -depth), (half, -half, -depth), (half, half, -depth), (-half, half, -depth)],
        [],
        [(0, 1, 2, 3)],
    )
    mesh.materials.append(material("paint", color))
    mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", [0, 0, 1, 0, 1, 1, 0, 1])
    obj = bpy.data.objects.new("wall", mesh)
    obj.matrix_world = camera.matrix_world
    bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    return obj


def lit(color, normal) -> np.ndarray:
    """Display sRGB of a linear base colour under the engine's light; normal: in Blender's world, of the side
    that is seen."""
    meshes = part("svrgs_addon.render.meshes")
    return part("svrgs_addon.files.images").linear_to_srgb(
        np.array(color) * (meshes.AMBIENT + np.array(normal) @ meshes.LIGHT)
    )


def lit_wall(camera, color=(1.0, 0.0, 0.0)) -> np.ndarray:
    """The colour of wall()."""
    return lit(color, camera.matrix_world.to_3x3().col[2].normalized())
