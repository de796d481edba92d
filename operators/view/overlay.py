"""Splats in Solid and Material Preview viewports.

The native library draws them. While the view moves, each frame has a picture of its own, so that Gaussians
and meshes move together: of every 4th, every 2nd or of all pixels, as many as it draws in SLOW_PICTURE. When
the view is at rest, a thread draws all pixels. If the Gaussians change and the view does not, the last
picture stays until the new one is there.

Blender draws the points of a splat itself, and they would hide the Gaussians. So splats have the display type
BOUNDS here.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import bpy
import gpu

from ...svrgs_addon.native.rasterizer import Rasterizer
from ...svrgs_addon.render.live_view import LiveView, Picture
from ...svrgs_addon.render.painting import highlighted, painted
from ...svrgs_addon.render.passes import overlay_rgba
from ...svrgs_addon.render.thinning import Thinning
from ...svrgs_addon.scene.camera import Camera
from ...svrgs_addon.scene.gaussians import Scene
from ...svrgs_addon.system.errors import NativeError, SplatError
from ...svrgs_addon.views.lens import depth_of_projection
from ..data import background_work, gpu_drawing, splat_object, visible_splats
from ..data.extension import use_threads
from ..data.selection import SELECTED
from . import viewport_wipe
from .viewport import redraw

SHADING = {"SOLID", "MATERIAL"}
REST_SECONDS = 0.2  # without movement; then the view is at rest
WAIT_SECONDS = 0.02  # between two looks whether a better picture is there
# seconds; after a slower picture of a moving view the next one has fewer pixels, after a faster one more
SLOW_PICTURE, FAST_PICTURE = 0.03, 0.015
COARSEST = 4  # a pixel of a picture covers COARSEST x COARSEST pixels of the view at most


@dataclass(frozen=True)
class DrawRequest:
    """A view. A thread that draws it must not use bpy."""

    cloud: Cloud
    camera: Camera  # in the scene's coordinates
    depth: Any  # (H, W) depth buffer of everything else in the viewport
    projection: Any  # OpenGL's, of that buffer


def draw_picture(rasterizer: Rasterizer, request: DrawRequest, reduction: int):
    """(H, W, 4) display sRGB times alpha; each pixel covers reduction x reduction pixels of the view."""
    cloud, camera = request.cloud, request.camera
    scene = cloud.thinning.draws() if reduction > 1 else cloud.scene
    small = camera.resized(max(1, camera.width // reduction), max(1, camera.height // reduction))
    depth = gpu_drawing.farthest(request.depth, reduction)
    hidden = None if depth is None else depth_of_projection(request.projection, depth) / cloud.placed.unit
    rgba = overlay_rgba(rasterizer, scene, small, hidden)
    cloud.thinning.drew(scene, rasterizer)
    return rgba


class Cloud:
    """The visible splats as one scene."""

    def __init__(self, key: tuple, placed: visible_splats.PlacedScene, scene: Scene):
        self.key, self.placed, self.scene, self.thinning = key, placed, scene, Thinning(scene)


class View:
    """What is drawn in one viewport."""

    def __init__(self):
        self.live = LiveView(draw_picture, reductions=(1,))
        self.rasterizer = Rasterizer()  # of pictures while the view moves
        self.last_key, self.since = b"", 0.0
        self.reduction, self.slow = COARSEST, 0  # of the next picture; the last one that was too slow
        self.texture: tuple[Picture, gpu.types.GPUTexture] | None = None

    def is_at_rest(self, key: bytes) -> bool:
        """key: of what the viewport shows now."""
        if self.last_key != key:
            self.last_key, self.since = key, time.monotonic()
        return time.monotonic() - self.since >= REST_SECONDS

    def adapt(self, seconds: float):
        """Chooses the reduction of the next picture from the time of the last one."""
        if seconds > SLOW_PICTURE and self.reduction < COARSEST:
            self.slow, self.reduction = self.reduction, 2 * self.reduction
        elif self.reduction > 1 and seconds < FAST_PICTURE / (2 if self.reduction == 2 * self.slow else 1):
            self.reduction //= 2


class Overlay:
    """What viewports show, and how it is drawn. There is one."""

    def __init__(self):
        self._shader: gpu.types.GPUShader | None = None
        self.views: dict[tuple[int, str], View] = {}  # by region and side
        self.clouds: dict[str, Cloud] = {}  # by side
        # number of changes in the scene: an exact picture depends on the meshes that hide splats
        self.changes = 0

    def close(self):
        while self.views:
            self.views.popitem()[1].live.close()
        self.clouds, self._shader = {}, None  # Blender's GPU ends before Python does

    def draw(self):
        context, settings, region = bpy.context, bpy.context.scene.svrgs_view, bpy.context.region
        if not settings.overlay or context.space_data.shading.type not in SHADING:
            return
        try:
            camera = visible_splats.region_camera(region, context.region_data)
            splats = visible_splats.splats_in_view(context)
            shown = viewport_wipe.shown(splats, settings.overlay_shown)
            sides = viewport_wipe.sides(context.scene, shown)
            self.clouds = {side.name: self.cloud_of(side, settings) for side in sides if side.shown}
            self.close_views(region)
            depth = gpu_drawing.scene_depth(region.width, region.height) if self.clouds else None
            if depth is not None:
                use_threads(context)
                for side in sides:
                    view = self.view_of(region, side.name)
                    self.draw_cloud(context, self.clouds[side.name], view, camera, depth, side.columns)
        except (SplatError, NativeError):  # an object of scale 0, or no native library: the panels report it
            return

    @property
    def shader(self) -> gpu.types.GPUShader:
        """Made when something is drawn for the first time: in background mode there is no GPU."""
        if self._shader is None:
            self._shader = gpu_drawing.picture_shader()
        return self._shader

    def cloud_of(self, side: viewport_wipe.Side, settings) -> Cloud:
        """The splats of one side of the viewport; the last ones if nothing has changed."""
        key = settings.overlay_shown, *side.key
        known = self.clouds.get(side.name)
        if known is not None and known.key == key:
            return known
        placed = visible_splats.placed([(part.scene, part.matrix) for part in side.shown])
        values = [part.values for part in side.shown]
        if settings.overlay_shown == SELECTED:
            counts = [part.scene.count for part in side.shown]
            return Cloud(key, placed, highlighted(placed.scene, counts, values))
        return Cloud(key, placed, painted(placed.scene, values))

    def view_of(self, region: bpy.types.Region, side: str) -> View:
        """The region's view of a side."""
        key = region.as_pointer(), side
        if key not in self.views:
            self.views[key] = View()
        return self.views[key]

    def close_views(self, region: bpy.types.Region):
        """Removes the views of closed regions, and those of sides that this region no longer has."""
        if not [key for key in self.views if key[0] != region.as_pointer() or key[1] not in self.clouds]:
            return
        open_now = {one.as_pointer() for area in background_work.areas() for one in area.regions}
        for key in list(self.views):
            if key[0] not in open_now or (key[0] == region.as_pointer() and key[1] not in self.clouds):
                self.views.pop(key).live.close()

    def draw_cloud(
        self, context, cloud: Cloud, view: View, camera: Camera, depth, columns: tuple[float, float]
    ):
        """Draws in some columns of the viewport. depth: its depth buffer (H, W)."""
        space, local = context.space_data, cloud.placed.seen_by(camera)
        request = DrawRequest(cloud, local, depth, context.region_data.window_matrix.copy())
        if view.is_at_rest(local.key):
            shading = space.shading.type, space.shading.show_xray, space.overlay.show_overlays
            view.live.request((local.key, cloud.key, self.changes, *shading), request)
            picture = view.live.picture()
            if picture is not None and picture.key[0] == local.key and picture.error is None:
                if view.texture is None or view.texture[0] is not picture:
                    view.texture = picture, gpu_drawing.picture_texture(picture.result)
                gpu_drawing.draw_over_viewport(self.shader, view.texture[1], columns)
                if view.live.busy:
                    _redraw_in(WAIT_SECONDS)
                return
        else:
            view.live.cancel()
        _redraw_in(REST_SECONDS / 2)
        started = time.perf_counter()
        moving = draw_picture(view.rasterizer, request, view.reduction)
        view.adapt(time.perf_counter() - started)
        gpu_drawing.draw_over_viewport(self.shader, gpu_drawing.picture_texture(moving), columns)


_overlay = Overlay()


def switch(settings, context):
    """After the user has switched the drawing on or off: sets the display type of all splats."""
    new, old = ("BOUNDS", "TEXTURED") if settings.overlay else ("TEXTURED", "BOUNDS")
    for obj in settings.id_data.objects:
        if splat_object.is_splat(obj) and obj.display_type == old:
            obj.display_type = new
    redraw(SHADING)


def changed(settings, context):
    """After the user has changed a setting of the drawing."""
    redraw(SHADING)


def _redraw_in(seconds: float):
    if not bpy.app.timers.is_registered(_redraw_once):
        bpy.app.timers.register(_redraw_once, first_interval=seconds)


def _redraw_once():
    redraw(SHADING)


def _after_update(scene, *_):
    """Sets the display type of new splats. The exact pictures are drawn again, because the meshes that hide
    splats may have changed."""
    _overlay.changes += 1
    if not bpy.app.background and scene.svrgs_view.overlay:
        for obj in scene.objects:
            if obj.display_type == "TEXTURED" and splat_object.is_splat(obj):
                obj.display_type = "BOUNDS"


HANDLERS = {"depsgraph_update_post": _after_update}
TIMERS = (_redraw_once,)
DRAWS = {"POST_VIEW": _overlay.draw}
unregister = _overlay.close
