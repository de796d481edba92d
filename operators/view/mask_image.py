"""Draws the spatial mask F of the scene's camera into an image and a texture, both called NAME, in colours or
as numbers."""

from __future__ import annotations

import contextlib
import time

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.native import library
from ...svrgs_addon.native.rasterizer import Rasterizer, RenderOptions
from ...svrgs_addon.prune.report.pictures import with_color_bar
from ...svrgs_addon.render import color_maps
from ...svrgs_addon.system.errors import NativeError, SceneError, SplatError
from ..data import camera_object, image_pixels, known, visible_splats
from ..data.preferences import threads
from . import scene_cache

NAME = "SVR-GS Spatial Mask"

_rasterizer: list[Rasterizer] = []  # at most one; it keeps its buffers


def refresh(context: bpy.types.Context) -> dict:
    """Draws the mask of all visible splats. Returns camera, mean and largest value. Raises SplatError,
    NativeError."""
    started = time.perf_counter()
    scene, depsgraph = context.scene, context.evaluated_depsgraph_get()
    known.of_scene(scene).mask_inputs = _inputs_now(depsgraph)
    placed = visible_splats.splats(depsgraph, scene_cache.read)
    if placed is None:
        raise SceneError(tr("there is no visible splat: import one"))
    obj = visible_splats.camera(depsgraph)
    camera = placed.seen_by(
        _sized(camera_object.camera_from_object(obj, scene), scene.svrgs_looking.mask_size)
    )
    library.set_threads(threads(context))
    if not _rasterizer:
        _rasterizer.append(Rasterizer())
    options = RenderOptions(antialiased=placed.scene.antialiased, mask_kind="svr", picture_only=True)
    mask = _rasterizer[0].forward(placed.scene, camera, options, outputs=("mask",))["mask"]
    result = {
        "camera": obj.name,
        "mean": float(mask.mean()),
        "largest": float(mask.max(initial=0)),
        "milliseconds": round(1e3 * (time.perf_counter() - started)),
    }
    known.of_scene(scene).mask = mask, result
    _write(scene)
    return result


def is_stale(context: bpy.types.Context) -> bool:
    """Whether the camera or a splat has changed since the last mask. Raises SplatError."""
    return known.of_scene(context.scene).mask_inputs != _inputs_now(context.evaluated_depsgraph_get())


def _inputs_now(depsgraph: bpy.types.Depsgraph) -> tuple:
    """Everything that a mask depends on."""
    camera = camera_object.camera_from_object(visible_splats.camera(depsgraph), depsgraph.scene)
    places = [
        (scene_cache.number(obj), tuple(map(tuple, matrix)))
        for obj, matrix in visible_splats.placed_splats(depsgraph)
    ]
    return camera.key, depsgraph.scene.svrgs_looking.mask_size, *places


def recolor(settings, context):
    """After the user has chosen other colours: colours the last mask again."""
    scene = settings.id_data
    if known.of_scene(scene).mask is not None:
        _write(scene)
    elif figures():  # the image was saved with the file, the mask was not
        with contextlib.suppress(SplatError, NativeError):  # without camera or splat, the saved picture stays
            refresh(context)


def _sized(camera, longer: int):
    scale = longer / max(camera.width, camera.height)
    return camera.resized(max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))


def figures() -> dict:
    """Of the mask in the image: camera, mean, largest value, milliseconds; {} without an image."""
    return image_pixels.figures_of(NAME)


def _write(scene: bpy.types.Scene):
    """Writes image, preview and texture. Blender shows a Non-Color image as if its numbers were linear, so
    colours are stored linear."""
    settings, drawn = scene.svrgs_looking, known.of_scene(scene).mask
    assert drawn is not None
    mask, result = drawn
    top = settings.mask_top or result["largest"]
    name = settings.mask_colors if settings.mask_colors in color_maps.NAMES else "grey"
    rgb = color_maps.colored(mask, top, name)
    pixels = color_maps.pixels(mask, top, settings.mask_colors)
    image = image_pixels.write_image(NAME, pixels, with_color_bar(rgb, name), True, result)
    texture = bpy.data.textures.get(NAME) or bpy.data.textures.new(NAME, "IMAGE")
    texture.image = image


def forget():
    _rasterizer.clear()
