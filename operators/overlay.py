"""Splats in Solid and Material Preview viewports: quads of some Gaussians while the view moves, the native picture when it rests.

Blender's own points of a splat would hide its Gaussians, so splats have the display type BOUNDS while they are drawn here.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import bpy
import gpu
from bpy.app.handlers import persistent

from ..svrgs_addon import native
from ..svrgs_addon.blender.lens import depth_of_projection, step_back
from ..svrgs_addon.camera import Camera
from ..svrgs_addon.errors import NativeError, SplatError
from ..svrgs_addon.native_library import thresholds
from ..svrgs_addon.render.live_view import LiveView, Picture
from ..svrgs_addon.render.passes import overlay_rgba
from ..svrgs_addon.render.quads import Quads, colors, painted, quads
from ..svrgs_addon.scene import Scene
from . import bridge, bridge_gpu, bridge_graph, scene_cache
from .preferences import threads
from .viewport import redraw

SHADING = {"SOLID", "MATERIAL"}
REST = 0.2  # seconds without movement
SLOW, FAST = 0.12, 0.03  # seconds of a frame beyond which the next has fewer quads and pixels, or more
LEVELS = 5  # each with half the quads of the one before, and half the pixels a side down to a quarter
LARGEST = 4.0  # times its size: a Gaussian that stands for others


@dataclass(frozen=True)
class Job:
    """A view at rest; the thread that draws it touches nothing of Blender's."""

    cloud: Cloud
    camera: Camera  # in the coordinates of the shown scene
    hidden: object  # (H, W) depth of what the viewport shows beside splats, in the same lengths


def draw_job(rasterizer, job: Job, _) -> tuple:
    """(H, W, 4) display sRGB times alpha, and the quads' colours (n, 3) from here."""
    scene, rows = job.cloud.scene, job.cloud.quads.rows
    return overlay_rgba(rasterizer, scene, job.camera, job.hidden), colors(scene, rows, job.camera)


class Cloud:
    """The visible splats, and some of their Gaussians on the graphics card."""

    def __init__(self, key: tuple, shown: bridge_graph.Shown, scene: Scene, count: int):
        self.key, self.shown, self.scene = key, shown, scene
        self.quads: Quads = quads(scene, count)
        self.geometry = bridge_gpu.texture(self.quads.geometry.reshape(-1, 4), "RGBA32F")
        self.colors: gpu.types.GPUTexture | None = None

    def paint(self, rgb):
        self.colors = bridge_gpu.texture(rgb, "RGBA16F")


class View:
    """One viewport's region."""

    def __init__(self):
        self.live = LiveView(draw_job, reductions=(1,))
        self.seen, self.since, self.level = b"", 0.0, 0
        self.target: bridge_gpu.Target | None = None
        self.texture: tuple[Picture, gpu.types.GPUTexture] | None = None

    def resting(self, view: bytes) -> bool:
        if self.seen != view:
            self.seen, self.since = view, time.monotonic()
        return time.monotonic() - self.since >= REST

    def adapt(self, seconds: float):
        if seconds > SLOW:
            self.level = min(self.level + 1, LEVELS - 1)
        elif seconds < FAST:
            self.level = max(self.level - 1, 0)


class Overlay:
    """State of the drawing; there is one, but none in background mode."""

    def __init__(self):
        self.shaders: bridge_gpu.Shaders | None = None
        self.views: dict[int, View] = {}  # by region
        self.cloud: Cloud | None = None
        self.changes = 0  # of anything in the scene: an exact picture knows what hides splats
        self.handle = bpy.types.SpaceView3D.draw_handler_add(self.draw, (), "WINDOW", "POST_VIEW")

    def close(self):
        bpy.types.SpaceView3D.draw_handler_remove(self.handle, "WINDOW")
        for view in self.views.values():
            view.live.close()

    def draw(self):
        context, space = bpy.context, bpy.context.space_data
        if not context.scene.svrgs_looking.overlay or space.shading.type not in SHADING or not space.overlay.show_overlays:
            return
        try:
            camera = bridge_graph.region_camera(context.region, context.region_data)
            self.cloud = cloud = self.current(context)
            if cloud is not None:
                native.set_threads(threads(context))
                self.draw_cloud(context, cloud, camera)
        except (SplatError, NativeError):  # an object without size, no library: the panels say so
            return

    def current(self, context) -> Cloud | None:
        """The splats this viewport shows."""
        settings = context.scene.svrgs_looking
        found = bridge_graph.splats_in_view(context)
        key = settings.overlay_shown, settings.overlay_moving, *((scene_cache.number(obj), tuple(map(tuple, matrix))) for obj, matrix in found)
        if not found:
            return None
        if self.cloud is not None and self.cloud.key == key:
            return self.cloud
        shown = bridge_graph.placed([(scene_cache.read(obj), matrix) for obj, matrix in found])
        values = [scene_cache.read_values(obj, settings.overlay_shown) for obj, _ in found]
        return Cloud(key, shown, painted(shown.scene, values), settings.overlay_moving)

    def view(self, region: bpy.types.Region) -> View:
        if region.as_pointer() not in self.views:
            open_now = {r.as_pointer() for w in bpy.context.window_manager.windows for area in w.screen.areas for r in area.regions}
            for closed in self.views.keys() - open_now:
                self.views.pop(closed).live.close()
            self.views[region.as_pointer()] = View()
        return self.views[region.as_pointer()]

    def draw_cloud(self, context, cloud: Cloud, camera: Camera):
        region, space = context.region, context.space_data
        view = self.view(region)
        self.shaders = self.shaders or bridge_gpu.Shaders()
        beside = bridge_gpu.scene_depth(region.width, region.height)
        if beside is None:
            return
        hidden, depth = beside
        local = cloud.shown.seen_by(camera)
        where = local.key + repr(cloud.key).encode()
        if view.resting(where):
            key = where, self.changes, space.shading.type, space.shading.show_xray
            view.live.request(key, Job(cloud, local, depth_of_projection(context.region_data.window_matrix, depth) / cloud.shown.unit))
            picture = view.live.picture()
            if picture is not None and picture.key == key and picture.error is None:
                bridge_gpu.lay_over(self.shaders, self.exact(view, cloud, picture))
                return
        if not bpy.app.timers.is_registered(_redraw_once):
            bpy.app.timers.register(_redraw_once, first_interval=REST / 2)
        started = time.perf_counter()
        self.draw_quads(context, view, cloud, camera, hidden)
        bridge_gpu.lay_over(self.shaders, view.target.texture)
        view.adapt(time.perf_counter() - started)

    def exact(self, view: View, cloud: Cloud, picture: Picture) -> gpu.types.GPUTexture:
        if view.texture is None or view.texture[0] is not picture:
            pixels, shades = picture.result
            view.texture = picture, bridge_gpu.picture(pixels)
            cloud.paint(shades)
        return view.texture[1]

    def draw_quads(self, context, view: View, cloud: Cloud, camera: Camera, hidden: gpu.types.GPUTexture):
        modelview = context.region_data.view_matrix @ cloud.shown.matrix
        if cloud.colors is None:
            cloud.paint(colors(cloud.scene, cloud.quads.rows, cloud.shown.seen_by(camera)))
        count, reduction = max(1, len(cloud.quads.rows) >> view.level), min(1 << view.level, 4)
        order = native.depth_order(cloud.quads.means[:count], -modelview.row[2].xyz)
        width, height = (max(1, side // reduction) for side in (camera.width, camera.height))
        if view.target is None or (view.target.width, view.target.height) != (width, height):
            view.target = bridge_gpu.Target(width, height)
        small, P = camera.resized(width, height), context.region_data.window_matrix
        constants = {
            "modelview": modelview, "lens": (small.K[0, 0], small.K[1, 1], small.K[0, 2], small.K[1, 2]), "size": (width, height),
            "parallel": float(camera.orthographic), "depth_scale": P[2][2], "depth_shift": P[2][3],
            "near": thresholds().near * cloud.shown.unit - step_back(P),
            "enlarge": min(cloud.scene.count / count, LARGEST**2), "antialiased": float(cloud.scene.antialiased), "reduction": reduction,
        }  # fmt: skip
        lists = {"order": bridge_gpu.texture(order, "R32F"), "geometry": cloud.geometry, "colors": cloud.colors}
        bridge_gpu.draw_quads(self.shaders, view.target, lists, hidden, constants, count)


_overlay: list[Overlay] = []


def switch(settings, context):
    """Splats are drawn here from now on, or as points."""
    own, points = ("BOUNDS", "TEXTURED") if settings.overlay else ("TEXTURED", "BOUNDS")
    for obj in settings.id_data.objects:
        if bridge.is_splat(obj) and obj.display_type == points:
            obj.display_type = own
    redraw(SHADING)


def changed(settings, context):
    redraw(SHADING)


def _redraw_once():
    redraw(SHADING)


@persistent
def _after_update(scene, *_):
    """Splats that have come since, and what hides them."""
    for overlay in _overlay:
        overlay.changes += 1
    if not bpy.app.background and scene.svrgs_looking.overlay:
        for obj in scene.objects:
            if obj.display_type == "TEXTURED" and bridge.is_splat(obj):
                obj.display_type = "BOUNDS"


def register():
    bpy.app.handlers.depsgraph_update_post.append(_after_update)
    if not bpy.app.background:
        _overlay.append(Overlay())


def unregister():
    bpy.app.handlers.depsgraph_update_post.remove(_after_update)
    if bpy.app.timers.is_registered(_redraw_once):
        bpy.app.timers.unregister(_redraw_once)
    while _overlay:
        _overlay.pop().close()
