"""What Blender renders, what the rasterizer draws of the same view, and marks of removed Gaussians."""

from __future__ import annotations

import bpy
import numpy as np
from extension import part

LEVEL = 1 / 255 + 1e-6


def f12(path) -> np.ndarray:
    """(H, W, 4) of the saved PNG, rows from the top."""
    bpy.context.scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path), check_existing=False)
    return pixels(image)


def pixels(image) -> np.ndarray:
    width, height = image.size
    values = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(height, width, image.channels)[::-1]


def view_of(camera: bpy.types.Object, scene: bpy.types.Scene):
    """The view that a render of the scene has."""
    cameras = part("operators.data.camera_object")
    return cameras.camera_from_object(camera, scene, cameras.render_size(scene))


def drawn(scene, camera, matrix, outputs=("rgb",), **options) -> dict:
    """What the rasterizer makes of a scene under a matrix, seen by Blender's camera; rgb as 8 bits show
    it."""
    bpy.context.view_layer.update()
    native = part("svrgs_addon.native.rasterizer")
    view = view_of(camera, bpy.context.scene).moved(matrix)
    images = native.Rasterizer().forward(scene, view, native.RenderOptions(**options), outputs=outputs)
    return images | {"rgb": np.round(np.clip(images["rgb"], 0, 1) * 255) / 255} if "rgb" in images else images


def add_geometry_nodes(obj, build):
    """build(group, geometry) makes the nodes that change it, and returns what they give."""
    group = bpy.data.node_groups.new("test", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    given, out = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    group.links.new(build(group, given.outputs[0]), out.inputs[0])
    obj.modifiers.new("test", "NODES").node_group = group


def mark_removed(obj, removed: np.ndarray):
    obj.data.attributes.new("removed", "INT8", "POINT").data.foreach_set("value", removed.astype(np.int8))
    obj.data.update_tag()
    bpy.context.view_layer.update()
