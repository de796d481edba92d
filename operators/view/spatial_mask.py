"""The spatial mask F of the scene's camera, drawn into an image and a texture, both called NAME, in colours
or as numbers: once, or after every change if Follow Camera is on."""

from __future__ import annotations

import contextlib
import time

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.native.rasterizer import Rasterizer, RenderOptions
from ...svrgs_addon.prune.report.pictures import with_color_bar
from ...svrgs_addon.render import color_maps
from ...svrgs_addon.system.errors import NativeError, SceneError, SplatError
from ..data import background_work, camera_object, image_pixels, known, visible_splats
from ..data.extension import use_threads
from ..data.reporting import ReportingOperator
from . import scene_cache

NAME = "SVR-GS Spatial Mask"
DELAY = 0.1  # seconds after the last change

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
    view = camera_object.camera_from_object(obj, scene)
    scale = scene.svrgs_view.mask_size / max(view.width, view.height)
    width, height = (max(1, round(side * scale)) for side in (view.width, view.height))
    camera = placed.seen_by(view.resized(width, height))
    use_threads(context)
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
    return camera.key, depsgraph.scene.svrgs_view.mask_size, *places


def recolor(settings, context):
    """After the user has chosen other colours: colours the last mask again."""
    scene = settings.id_data
    if known.of_scene(scene).mask is not None:
        _write(scene)
    elif figures():  # the image was saved with the file, the mask was not
        with contextlib.suppress(SplatError, NativeError):  # without camera or splat, the saved picture stays
            refresh(context)


def figures() -> dict:
    """Of the mask in the image: camera, mean, largest value, milliseconds; {} without an image."""
    return image_pixels.figures_of(NAME)


def _write(scene: bpy.types.Scene):
    """Writes image, preview and texture. Blender shows a Non-Color image as if its numbers were linear, so
    colours are stored linear."""
    settings, drawn = scene.svrgs_view, known.of_scene(scene).mask
    assert drawn is not None
    mask, result = drawn
    top = settings.mask_top or result["largest"]
    name = settings.mask_colors if settings.mask_colors in color_maps.NAMES else "grey"
    rgb = color_maps.colored(mask, top, name)
    pixels = color_maps.pixels(mask, top, settings.mask_colors)
    image = image_pixels.write_image(NAME, pixels, with_color_bar(rgb, name), True, result)
    texture = bpy.data.textures.get(NAME) or bpy.data.textures.new(NAME, "IMAGE")
    texture.image = image


class SVRGS_OT_spatial_mask(ReportingOperator):
    bl_label = "Show Spatial Mask"
    bl_description = (
        "Draw the spatial mask of the scene's camera into an image, for the Image Editor and for materials"
    )
    bl_options = {"REGISTER"}

    @classmethod
    def problem(cls, context) -> str:
        if context.scene.camera is not None:
            return ""
        return tr("There is no camera: add one, or import the cameras of the dataset")

    def work(self, context) -> str:
        result = refresh(context)
        show_in_editors(bpy.data.images[NAME])
        return tr("Spatial mask of {camera}: mean {mean:.3g}, largest {largest:.3g}").format(**result)


def show_in_editors(image: bpy.types.Image):
    """Shows the image in every Image Editor that is empty or shows another image of this extension."""
    for area in (area for area in background_work.areas() if area.type == "IMAGE_EDITOR"):
        space = area.spaces.active
        if space.mode == "VIEW" and (space.image is None or space.image.name.startswith("SVR-GS")):
            space.image = image
            area.tag_redraw()


def _after_change(scene, depsgraph):
    if scene.svrgs_view.mask_follow:
        known.of_scene(scene).changed_layer = depsgraph.view_layer.name
        if bpy.app.timers.is_registered(_follow):
            bpy.app.timers.unregister(_follow)
        if not bpy.app.background:
            bpy.app.timers.register(_follow, first_interval=DELAY)


def _follow():
    """Draws the masks that are out of date. After an error the old mask stays, without a message: the user
    did not press a button."""
    for scene in bpy.data.scenes:
        layer = scene.view_layers.get(known.of_scene(scene).changed_layer)
        known.of_scene(scene).changed_layer = ""
        if layer is not None:
            with (
                bpy.context.temp_override(scene=scene, view_layer=layer),
                contextlib.suppress(SplatError, NativeError),
            ):
                if is_stale(bpy.context):  # writing the image is a change of the scene, too
                    refresh(bpy.context)
                    background_work.redraw_panels()


HANDLERS = {"depsgraph_update_post": _after_change, "frame_change_post": _after_change}
TIMERS = (_follow,)


def unregister():
    _rasterizer.clear()
