"""Splats in Solid and Material Preview viewports.

While the view moves, the graphics card draws quads of some Gaussians, sorted by depth. If a frame takes more
than 0.12 s, the next one has fewer quads and pixels. When the view is at rest, a thread draws the picture
with the native library, first every 2nd pixel and then all, which is then drawn over the viewport. If the
Gaussians change and the view does not, the last picture stays until the new one is there.

Blender draws the points of a splat itself, and they would hide the Gaussians. So splats have the display type
BOUNDS here.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import bpy
import gpu
from bpy.app.handlers import persistent

from ...svrgs_addon.native import library
from ...svrgs_addon.native.library import thresholds
from ...svrgs_addon.native.pictures import depth_order
from ...svrgs_addon.render.live_view import LiveView, Picture
from ...svrgs_addon.render.passes import overlay_rgba
from ...svrgs_addon.render.quads import Quads, colors, highlighted, painted, quads
from ...svrgs_addon.scene.camera import Camera
from ...svrgs_addon.scene.gaussians import Scene
from ...svrgs_addon.system.errors import NativeError, SplatError
from ...svrgs_addon.views.lens import depth_of_projection, step_back
from ..data import gpu_drawing, splat_object, visible_splats
from ..data.preferences import threads
from ..data.selection import SELECTED
from . import viewport_wipe
from .viewport import redraw

SHADING = {"SOLID", "MATERIAL"}
REST_SECONDS = 0.2  # without movement; then the view is at rest
WAIT_SECONDS = 0.02  # between two looks whether a better picture is there
COARSE = 2  # a pixel of the first picture at rest covers 2 x 2 pixels
# seconds; after a slower frame there are fewer quads and pixels, after a faster one more
SLOW_FRAME, FAST_FRAME = 0.12, 0.03
LEVELS = 5  # each has half the quads of the one before, and half its pixels per side, down to a quarter
LARGEST_SCALE = 4.0  # of the size of a Gaussian that is drawn in place of others


@dataclass(frozen=True)
class DrawRequest:
    """A view at rest. The thread that draws it must not use bpy."""

    cloud: Cloud
    camera: Camera  # in the scene's coordinates
    hidden: Any  # (H, W) depth of everything else in the viewport, in units of the scene


def draw_at_rest(rasterizer, request: DrawRequest, reduction: int) -> tuple:
    """(H, W, 4) display sRGB times alpha; with all pixels also the colours (n, 3) of the quads from this
    view, if there are quads; else None."""
    scene, quads_made, camera = request.cloud.scene, request.cloud.quads, request.camera.reduced(reduction)
    hidden = request.hidden[: camera.height * reduction : reduction, : camera.width * reduction : reduction]
    rgba = overlay_rgba(rasterizer, scene, camera, hidden)
    return rgba, colors(scene, quads_made.rows, camera) if quads_made and reduction == 1 else None


class Cloud:
    """The visible splats as one scene. Once the view moves: the quads of some of its Gaussians on the
    graphics card."""

    def __init__(self, key: tuple, placed: visible_splats.PlacedScene, scene: Scene, count: int):
        self.key, self.placed, self.scene, self.count = key, placed, scene, count
        self.quads: Quads | None = None
        self.geometry: gpu.types.GPUTexture | None = None
        self.colors: gpu.types.GPUTexture | None = None

    def with_quads(self, camera: Camera) -> Quads:
        """The quads; if there are none yet, they get the colours that the camera sees."""
        if self.quads is None:
            self.quads = quads(self.scene, self.count)
            self.geometry = gpu_drawing.texture(self.quads.geometry.reshape(-1, 4), "RGBA32F")
        if self.colors is None:
            self.set_colors(colors(self.scene, self.quads.rows, camera))
        return self.quads

    def set_colors(self, rgb):
        self.colors = gpu_drawing.texture(rgb, "RGBA16F")


class View:
    """What is drawn in one viewport."""

    def __init__(self):
        self.live = LiveView(draw_at_rest, reductions=(COARSE, 1))
        self.last_key, self.since, self.level = b"", 0.0, 0
        self.target: gpu_drawing.Target | None = None
        self.texture: tuple[Picture, gpu.types.GPUTexture] | None = None

    def is_at_rest(self, key: bytes) -> bool:
        """key: of what the viewport shows now."""
        if self.last_key != key:
            self.last_key, self.since = key, time.monotonic()
        return time.monotonic() - self.since >= REST_SECONDS

    def adapt(self, seconds: float):
        """Chooses the level of the next frame from the time of the last one."""
        if seconds > SLOW_FRAME:
            self.level = min(self.level + 1, LEVELS - 1)
        elif seconds < FAST_FRAME:
            self.level = max(self.level - 1, 0)


class Overlay:
    """The draw handler and its state. There is one; in background mode there is none."""

    def __init__(self):
        self._shaders: gpu_drawing.Shaders | None = None
        self.views: dict[tuple[int, str], View] = {}  # by region and side
        self.clouds: dict[str, Cloud] = {}  # by side
        # number of changes in the scene: an exact picture depends on the meshes that hide splats
        self.changes = 0
        self.handle = bpy.types.SpaceView3D.draw_handler_add(self.draw, (), "WINDOW", "POST_VIEW")

    def close(self):
        bpy.types.SpaceView3D.draw_handler_remove(self.handle, "WINDOW")
        for view in self.views.values():
            view.live.close()

    def draw(self):
        context, settings = bpy.context, bpy.context.scene.svrgs_view
        if not settings.overlay or context.space_data.shading.type not in SHADING:
            return
        try:
            camera = visible_splats.region_camera(context.region, context.region_data)
            sides = viewport_wipe.sides(
                context.scene,
                viewport_wipe.shown(visible_splats.splats_in_view(context), settings.overlay_shown),
            )
            self.clouds = {side.name: self.cloud_of(side, settings) for side in sides if side.shown}
            self.close_views(context.region)
            depth = (
                gpu_drawing.scene_depth(context.region.width, context.region.height) if self.clouds else None
            )
            if depth is not None:
                library.set_threads(threads(context))
                for side in sides:
                    self.draw_cloud(
                        context,
                        self.clouds[side.name],
                        self.view_of(context.region, side.name),
                        camera,
                        depth,
                        side.columns,
                    )
        except (SplatError, NativeError):  # an object of scale 0, or no native library: the panels report it
            return

    @property
    def shaders(self) -> gpu_drawing.Shaders:
        """Made when something is drawn for the first time: in background mode there is no GPU."""
        if self._shaders is None:
            self._shaders = gpu_drawing.Shaders()
        return self._shaders

    def cloud_of(self, side: viewport_wipe.Side, settings) -> Cloud:
        """The splats of one side of the viewport; the last ones if nothing has changed."""
        key = settings.overlay_shown, settings.overlay_moving, *side.key
        known = self.clouds.get(side.name)
        if known is not None and known.key == key:
            return known
        placed = visible_splats.placed([(part.scene, part.matrix) for part in side.shown])
        values = [part.values for part in side.shown]
        if settings.overlay_shown == SELECTED:
            marked = highlighted(placed.scene, [part.scene.count for part in side.shown], values)
            return Cloud(key, placed, marked, settings.overlay_moving)
        return Cloud(key, placed, painted(placed.scene, values), settings.overlay_moving)

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
        open_now = {
            r.as_pointer()
            for w in bpy.context.window_manager.windows
            for area in w.screen.areas
            for r in area.regions
        }
        for key in list(self.views):
            if key[0] not in open_now or (key[0] == region.as_pointer() and key[1] not in self.clouds):
                self.views.pop(key).live.close()

    def draw_cloud(
        self, context, cloud: Cloud, view: View, camera: Camera, depth, columns: tuple[float, float]
    ):
        """Draws in some columns of the viewport. depth: its depth buffer (H, W)."""
        space, local = context.space_data, cloud.placed.seen_by(camera)
        if view.is_at_rest(local.key):
            key = (
                local.key,
                cloud.key,
                self.changes,
                space.shading.type,
                space.shading.show_xray,
                space.overlay.show_overlays,
            )
            view.live.request(
                key,
                DrawRequest(
                    cloud,
                    local,
                    depth_of_projection(context.region_data.window_matrix, depth) / cloud.placed.unit,
                ),
            )
            picture = view.live.picture()
            if picture is not None and picture.key[0] == local.key and picture.error is None:
                gpu_drawing.draw_over_viewport(
                    self.shaders, self.texture_at_rest(view, cloud, picture), columns
                )
                if view.live.busy:
                    _redraw_in(WAIT_SECONDS)
                return
        _redraw_in(REST_SECONDS / 2)
        started = time.perf_counter()
        gpu_drawing.draw_over_viewport(
            self.shaders, self.draw_quads(context, view, cloud, camera, depth), columns
        )
        view.adapt(time.perf_counter() - started)

    def texture_at_rest(self, view: View, cloud: Cloud, picture: Picture) -> gpu.types.GPUTexture:
        if view.texture is None or view.texture[0] is not picture:
            pixels, quad_colors = picture.result
            view.texture = picture, gpu_drawing.picture_texture(pixels)
            if quad_colors is not None and picture.key[1] == cloud.key:
                cloud.set_colors(quad_colors)
        return view.texture[1]

    def draw_quads(self, context, view: View, cloud: Cloud, camera: Camera, depth) -> gpu.types.GPUTexture:
        modelview = context.region_data.view_matrix @ cloud.placed.matrix
        made = cloud.with_quads(cloud.placed.seen_by(camera))
        count, reduction = max(1, len(made.rows) >> view.level), min(1 << view.level, 4)
        order = depth_order(made.means[:count], -modelview.row[2].xyz)
        width, height = (max(1, side // reduction) for side in (camera.width, camera.height))
        if view.target is None or (view.target.width, view.target.height) != (width, height):
            view.target = gpu_drawing.Target(width, height)
        small, P = camera.resized(width, height), context.region_data.window_matrix
        near, enlarge = (
            thresholds().near * cloud.placed.unit - step_back(P),
            min(cloud.scene.count / count, LARGEST_SCALE**2),
        )
        constants = {
            "modelview": modelview, "lens": (small.K[0, 0], small.K[1, 1], small.K[0, 2], small.K[1, 2]),
            "view": (width, height, near, enlarge),
            "mode": (float(camera.orthographic), float(cloud.scene.antialiased), P[2][2], P[2][3]),
        }  # fmt: skip
        lists = {
            "order": gpu_drawing.texture(order, "R32F"),
            "geometry": cloud.geometry,
            "colors": cloud.colors,
        }
        gpu_drawing.draw_quads(
            self.shaders, view.target, lists, gpu_drawing.depth_texture(depth, reduction), constants, count
        )
        return view.target.texture


_overlay: list[Overlay] = []


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


@persistent
def _after_update(scene, *_):
    """Sets the display type of new splats. The exact pictures are drawn again, because the meshes that hide
    splats may have changed."""
    for overlay in _overlay:
        overlay.changes += 1
    if not bpy.app.background and scene.svrgs_view.overlay:
        for obj in scene.objects:
            if obj.display_type == "TEXTURED" and splat_object.is_splat(obj):
                obj.display_type = "BOUNDS"


HANDLERS = {"depsgraph_update_post": _after_update}
TIMERS = (_redraw_once,)


def register():
    if not bpy.app.background:
        _overlay.append(Overlay())


def unregister():
    while _overlay:
        _overlay.pop().close()
