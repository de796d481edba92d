"""Functions of the native library on pictures: opaque triangles, panoramas of perspective views, FLIP of two
pictures, convolutions, linear colours, and exposure.

`native/include/svrgs.h` (svrgs_draw_triangles, svrgs_add_view, svrgs_flip, svrgs_convolve, svrgs_linear_rgba,
svrgs_expose, svrgs_expose_vjp) is the manual; names, shapes and units here are the same. All raise TypeError
for arrays of another type or shape, else NativeError. level: SIMD level; None: the fastest of this processor.
Where there is one, arrays are float32, or float64 at that level.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..scene.camera import Camera
from . import library
from .library import call_library, camera_struct, check, check_out

PANEL = 32  # SVRGS_CONVOLVE_PANEL: output channels that stand side by side in the filters of convolved()
VALUES = {"corners": (3, 3), "colors": (3, 3), "light": (3,), "uvs": (3, 2)}  # arrays of a triangle, float32


def draw_triangles(
    arrays: dict[str, np.ndarray], textures: Sequence[Any], ambient: float, camera: Camera
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draws opaque triangles.

    arrays: those of VALUES as (M, ...) float32, `textures` (M,) int32 and `holdout` (M,) uint8. textures:
    objects with `texels` (n, 3) uint8, `width`, `height` and `repeat`. Returns share (H, W), depth (2, H, W)
    and rgba (2, H, W, 4), float32.
    """
    count, (height, width) = len(arrays["corners"]), (camera.height, camera.width)
    addresses = {
        name: check(arrays[name], name, (count, *shape), np.float32) for name, shape in VALUES.items()
    }
    addresses["textures"] = check(arrays["textures"], "textures", (count,), np.int32)
    addresses["holdout"] = check(arrays["holdout"], "holdout", (count,), np.uint8)
    structs = (library.TextureStruct * len(textures))(*(_texture(texture) for texture in textures))
    triangles = library.TrianglesStruct(
        count=count, **addresses, texture=c.addressof(structs), texture_count=len(textures), ambient=ambient
    )
    share, depth, rgba = (
        np.empty(shape, np.float32) for shape in ((height, width), (2, height, width), (2, height, width, 4))
    )
    layers = library.LayersStruct(share.ctypes.data, depth.ctypes.data, rgba.ctypes.data)
    call_library("svrgs_draw_triangles", c.byref(triangles), c.byref(camera_struct(camera)), c.byref(layers))
    return share, depth, rgba


def _texture(texture) -> c.Structure:
    texels, width, height = 0, texture.width, texture.height
    while (texels := texels + width * height) and (width > 1 or height > 1):
        width, height = (width + 1) // 2, (height + 1) // 2
    return library.TextureStruct(
        check(texture.texels, "texels", (texels, 3), np.uint8), texture.width, texture.height, texture.repeat
    )


def add_view(
    image: np.ndarray,
    turn: np.ndarray,
    K: np.ndarray,
    along: int,
    sums: np.ndarray,
    latitudes: np.ndarray,
    longitudes: np.ndarray,
    row_weights: np.ndarray,
    column_weights: np.ndarray,
):
    """Adds a perspective view, times row and column weights, to the panorama `sums` (H, W, L) float32, by
    cubic interpolation.

    image: (h, w, L) float32. turn: rotation (3, 3) from the panorama's frame to that of the view. K: (3, 3)
    with one focal length. along: the channel with values along z, which become values along the ray.
    latitudes, row_weights: (H,) float64, radians; longitudes, column_weights: (W,).
    """
    (height, width, channels), (rows, columns) = image.shape, sums.shape[:2]
    address = check(image, "image", (height, width, channels), np.float32)
    view = library.ViewStruct(
        address, width, height, channels, along, (c.c_double * 9)(*turn.flat), K[0, 0], K[0, 2], K[1, 2]
    )
    panorama = library.PanoramaStruct(
        check_out(sums, "sums", (rows, columns, channels), np.float32),
        columns,
        rows,
        check(latitudes, "latitudes", (rows,), np.float64),
        check(row_weights, "row_weights", (rows,), np.float64),
        check(longitudes, "longitudes", (columns,), np.float64),
        check(column_weights, "column_weights", (columns,), np.float64),
    )
    call_library("svrgs_add_view", c.byref(view), c.byref(panorama))


def flip_errors(
    image: np.ndarray, target: np.ndarray, pixels_per_degree: float, level: str | None = None
) -> np.ndarray:
    """FLIP of each pixel (Andersson et al. 2020), (H, W) in [0, 1]. image, target: (H, W, 3) display sRGB in
    [0, 1]. pixels_per_degree: of the viewer's visual angle, 1 to 400."""
    number, dtype = _level(level)
    errors: np.ndarray = np.empty(image.shape[:2], dtype)
    call_library(
        "svrgs_flip",
        number,
        check(image, "image", (*errors.shape, 3), dtype),
        check(target, "target", (*errors.shape, 3), dtype),
        *errors.shape,
        pixels_per_degree,
        errors.ctypes.data,
    )
    return errors


def filter_panels(filters: np.ndarray) -> np.ndarray:
    """Filters (outputs, inputs, 3, 3), as torch stores them, as convolved() takes them: (outputs / PANEL, 3,
    3, inputs, PANEL). outputs: a multiple of PANEL."""
    outputs, inputs = filters.shape[:2]
    panels = filters.reshape(outputs // PANEL, PANEL, inputs, 3, 3)
    return np.ascontiguousarray(panels.transpose(0, 3, 4, 2, 1))


def convolved(
    image: np.ndarray, panels: np.ndarray, bias: np.ndarray, level: str | None = None
) -> np.ndarray:
    """max(0, image * filters + bias), with zeros around the image: (H, W, outputs), a layer of VGG16. image:
    (H, W, inputs), panels: filter_panels() of the filters, bias: (outputs,)."""
    number, dtype = _level(level)
    height, width, inputs = image.shape
    outputs = len(panels) * PANEL
    out: np.ndarray = np.empty((height, width, outputs), dtype)
    call_library(
        "svrgs_convolve",
        number,
        check(image, "image", image.shape, dtype),
        *image.shape,
        check(panels, "panels", (len(panels), 3, 3, inputs, PANEL), dtype),
        check(bias, "bias", (outputs,), dtype),
        outputs,
        out.ctypes.data,
    )
    return out


def linear_colours(
    rgb: np.ndarray, alpha: np.ndarray, working_space: Sequence, level: str | None = None
) -> np.ndarray:
    """Display sRGB times alpha, rgb (H, W, 3) and alpha (H, W), to linear colours times alpha in a working
    space, and alpha: (H, W, 4). Where alpha is not above 0, colours are 0. working_space: (3, 3), the rows
    are linear red, green and blue of sRGB in it."""
    number, dtype = _level(level)
    rgba: np.ndarray = np.empty((*alpha.shape, 4), dtype)
    space = np.ascontiguousarray(working_space, np.float64)
    call_library(
        "svrgs_linear_rgba",
        number,
        check(rgb, "rgb", (*alpha.shape, 3), dtype),
        check(alpha, "alpha", alpha.shape, dtype),
        alpha.size,
        check(space, "working_space", (3, 3), np.float64),
        rgba.ctypes.data,
    )
    return rgba


def exposed(
    rgb: np.ndarray, matrix: np.ndarray, valid: np.ndarray | None, level: str | None = None
) -> np.ndarray:
    """Rendered colours (H, W, 3) as a photograph of this exposure would show them: A c + b of each pixel,
    where matrix (3, 4) is (A | b); 0 where pixels do not count. valid: (H, W) uint8; None: all count."""
    number, dtype = _level(level)
    seen, rows = np.empty_like(rgb), np.ascontiguousarray(matrix, np.float64)
    call_library(
        "svrgs_expose",
        number,
        check(rgb, "rgb", (*rgb.shape[:2], 3), dtype),
        None if valid is None else check(valid, "valid", rgb.shape[:2], np.uint8),
        rgb.size // 3,
        check(rows, "matrix", (3, 4), np.float64),
        seen.ctypes.data,
    )
    return seen


def exposed_vjp(
    d_seen: np.ndarray,
    rgb: np.ndarray,
    matrix: np.ndarray,
    valid: np.ndarray | None,
    level: str | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """dL/drgb (H, W, 3) and dL/dmatrix (3, 4) float64, of dL/dseen (H, W, 3) of exposed()."""
    number, dtype = _level(level)
    d_rgb, d_matrix, rows = np.empty_like(rgb), np.empty((3, 4)), np.ascontiguousarray(matrix, np.float64)
    call_library(
        "svrgs_expose_vjp",
        number,
        check(d_seen, "d_seen", rgb.shape, dtype),
        check(rgb, "rgb", (*rgb.shape[:2], 3), dtype),
        None if valid is None else check(valid, "valid", rgb.shape[:2], np.uint8),
        rgb.size // 3,
        check(rows, "matrix", (3, 4), np.float64),
        d_rgb.ctypes.data,
        d_matrix.ctypes.data,
    )
    return d_rgb, d_matrix


def _level(name: str | None) -> tuple[int, type]:
    """The number of a SIMD level, and the type of its arrays. None: the fastest."""
    name = name or library.best_level()
    return library.levels()[name], np.float64 if name == "float64" else np.float32
