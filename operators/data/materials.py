"""Blender's materials -> the base colour of meshes: a colour, a colour attribute of the mesh, or an image on
a UV map.

Read is what feeds "Base Color" (or "Color") of the first shader: an Image Texture, a Color Attribute, or the
socket's own colour. If other nodes lie between, the first image or attribute among them counts. What cannot
be read that way has the viewport's colour.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from dataclasses import dataclass

import bpy
from mathutils import Euler, Matrix

from ...svrgs_addon.files.images import linear_to_srgb
from ...svrgs_addon.render.textures import Texture, texture
from .image_pixels import stored_pixels

PLAIN = (0.8, 0.8, 0.8)  # linear colour of a mesh without a material
WHITE = (1.0, 1.0, 1.0)
COLOR_SOCKETS = ("Base Color", "Color")  # of shaders
# type of a node -> property with the name of its attribute
ATTRIBUTES = {"VERTEX_COLOR": "layer_name", "ATTRIBUTE": "attribute_name"}


@dataclass(frozen=True)
class BaseColor:
    """What a surface shows: `color`, times the attribute or the texture if it has one."""

    color: tuple[float, float, float]  # linear
    attribute: str | None = None  # name of a colour attribute; empty: the mesh's active one for renders
    texture: Texture | None = None
    uv_map: str = ""  # empty: the mesh's active one for renders
    mapping: Matrix | None = None  # of the texture coordinates


def base_color(material: bpy.types.Material | None) -> BaseColor:
    """The base colour of a material; None: of a mesh without one."""
    if material is None:
        return BaseColor(PLAIN)
    fallback = BaseColor(tuple(material.diffuse_color)[:3])
    if material.node_tree is None or (bpy.app.version < (5, 0, 0) and not material.use_nodes):
        return fallback
    output = material.node_tree.get_output_node("ALL")
    shaders = _before(output.inputs["Surface"]) if output is not None else ()
    socket = next((socket for node in shaders if (socket := _color_socket(node)) is not None), None)
    if socket is None:
        return fallback
    if not socket.is_linked:
        return BaseColor(tuple(socket.default_value)[:3])
    return next((found for node in _before(socket) if (found := _source(node)) is not None), fallback)


def _color_socket(node: bpy.types.Node) -> bpy.types.NodeSocket | None:
    """The colour of a shader node; None for other nodes."""
    if not any(socket.type == "SHADER" for socket in node.outputs):
        return None
    return next((node.inputs[name] for name in COLOR_SOCKETS if name in node.inputs), None)


def _before(socket: bpy.types.NodeSocket) -> Iterator[bpy.types.Node]:
    """The nodes that feed a socket, nearest first along each branch; of a group also the nodes in it."""
    todo, seen = [link.from_node for link in socket.links], set()
    while todo:
        node = todo.pop(0)
        if node.as_pointer() in seen:
            continue
        seen.add(node.as_pointer())
        yield node
        todo[:0] = [link.from_node for into in node.inputs for link in into.links]
        if node.type == "GROUP" and node.node_tree is not None:
            todo[:0] = list(node.node_tree.nodes)


def _source(node: bpy.types.Node) -> BaseColor | None:
    """The base colour that a node gives; None if it is no source of colours."""
    if node.type == "TEX_IMAGE" and node.image is not None:
        return _image_color(node)
    if node.type in ATTRIBUTES and getattr(node, "attribute_type", "GEOMETRY") == "GEOMETRY":
        return BaseColor(WHITE, attribute=getattr(node, ATTRIBUTES[node.type]))
    if node.type == "RGB":
        return BaseColor(tuple(node.outputs[0].default_value)[:3])
    return None


def _image_color(node: bpy.types.Node) -> BaseColor | None:
    """The image of a node on its UV map; its mean colour if it does not lie on a UV map. None if its file is
    missing."""
    picture = _texture(node.image, node.extension == "REPEAT")
    if picture is None:
        return None
    vector = node.inputs["Vector"]
    coordinates = list(_before(vector))
    maps = [
        feeding.uv_map if feeding.type == "UVMAP" else feeding.attribute_name
        for feeding in coordinates
        if feeding.type in ("UVMAP", "ATTRIBUTE")
    ]
    sockets = [socket.name for feeding in coordinates for socket in feeding.outputs if socket.is_linked]
    on_uv = not vector.is_linked or maps or "UV" in sockets
    if node.projection != "FLAT" or not on_uv:
        return BaseColor(tuple(picture.mean))
    mapping = next((_matrix(feeding) for feeding in coordinates if feeding.type == "MAPPING"), None)
    return BaseColor(WHITE, texture=picture, uv_map=maps[0] if maps else "", mapping=mapping)


def _matrix(node: bpy.types.Node) -> Matrix:
    """What a Mapping node of type Point or Texture does."""
    location, rotation, scale = (
        node.inputs[name].default_value if name in node.inputs else (0, 0, 0)
        for name in ("Location", "Rotation", "Scale")
    )
    matrix = Matrix.LocRotScale(location, Euler(rotation), scale)
    return matrix.inverted_safe() if node.vector_type == "TEXTURE" else matrix


# --- images


# (session_uid of an image, repeat) -> what its pixels depend on, and its texture
_textures: dict[tuple, tuple[tuple, Texture | None]] = {}


def _texture(image: bpy.types.Image, repeat: bool) -> Texture | None:
    """The image as a texture; None if its file is missing."""
    image = image.original
    key, version = (image.session_uid, repeat), _version(image)
    known, made = _textures.get(key, (None, None))
    if made is None or known != version or image.is_dirty or image.source != "FILE":
        made = _read(image, repeat)
        _textures[key] = version, made
    return made


def _version(image: bpy.types.Image) -> tuple:
    """Differs after the image was saved, packed, or loaded again from a changed file."""
    path = bpy.path.abspath(image.filepath, library=image.library)
    file: tuple = ()
    with contextlib.suppress(OSError, ValueError):
        status = os.stat(path)
        file = status.st_mtime_ns, status.st_size
    packed = image.packed_file.size if image.packed_file is not None else 0
    return tuple(image.size), image.colorspace_settings.name, path, file, packed


def _read(image: bpy.types.Image, repeat: bool) -> Texture | None:
    values, space = stored_pixels(image), image.colorspace_settings
    if values is None:
        return None
    linear = image.is_float or space.is_data or "Linear" in space.name
    rgb = values[..., :3]
    return texture(linear_to_srgb(rgb) if linear else rgb, repeat)


def forget(*_):
    _textures.clear()
