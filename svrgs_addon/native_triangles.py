"""Triangles drawn by the native library: two layers per pixel, with smooth edges, textures and a fixed light.

`native/include/svrgs.h` (svrgs_draw_triangles) is the manual; names, shapes and units here are the same.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Sequence
from typing import Any

import numpy as np

from .camera import Camera
from .native_library import LayersStruct, TextureStruct, TrianglesStruct, call_library, camera_struct, check

VALUES = {"corners": (3, 3), "colors": (3, 3), "light": (3,), "uvs": (3, 2)}  # arrays of a triangle, float32


def draw_triangles(arrays: dict[str, np.ndarray], textures: Sequence[Any], ambient: float, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draws opaque triangles.

    arrays: those of VALUES as (M, ...) float32, `textures` (M,) int32 and `holdout` (M,) uint8. textures: objects with `texels` (n, 3)
    uint8, `width`, `height` and `repeat`. Returns share (H, W), depth (2, H, W) and rgba (2, H, W, 4), float32. Raises NativeError, and
    TypeError for arrays of another type or shape.
    """
    count, (height, width) = len(arrays["corners"]), (camera.height, camera.width)
    addresses = {name: check(arrays[name], name, (count, *shape), np.float32) for name, shape in VALUES.items()}
    addresses["textures"] = check(arrays["textures"], "textures", (count,), np.int32)
    addresses["holdout"] = check(arrays["holdout"], "holdout", (count,), np.uint8)
    structs = (TextureStruct * len(textures))(*(_texture(texture) for texture in textures))
    triangles = TrianglesStruct(count=count, **addresses, texture=c.addressof(structs), texture_count=len(textures), ambient=ambient)
    share, depth, rgba = (np.empty(shape, np.float32) for shape in ((height, width), (2, height, width), (2, height, width, 4)))
    layers = LayersStruct(share.ctypes.data, depth.ctypes.data, rgba.ctypes.data)
    call_library("svrgs_draw_triangles", c.byref(triangles), c.byref(camera_struct(camera)), c.byref(layers))
    return share, depth, rgba


def _texture(texture) -> c.Structure:
    texels, width, height = 0, texture.width, texture.height
    while (texels := texels + width * height) and (width > 1 or height > 1):
        width, height = (width + 1) // 2, (height + 1) // 2
    return TextureStruct(check(texture.texels, "texels", (texels, 3), np.uint8), texture.width, texture.height, texture.repeat)
