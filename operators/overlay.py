"""Splats in Solid and Material Preview viewports: some of the Gaussians while the view moves, all of them in order when it rests.

Blender's own points of a splat would hide its Gaussians, so splats have the display type BOUNDS while they are drawn here.
"""

from __future__ import annotations

import time
from concurrent.futures import Future, ThreadPoolExecutor

import bpy
import gpu
import numpy as np
from bpy.app.handlers import persistent

from ..svrgs_addon.camera import Camera
from ..svrgs_addon.color_maps import colored
from ..svrgs_addon.errors import SplatError
from ..svrgs_addon.quads import Quads, back_to_front, colors, quads
from ..svrgs_addon.scene import Scene
from . import bridge, gather, overlay_gpu, scene_cache
from .viewport import redraw

SHADING = {"SOLID", "MATERIAL"}
REST = 0.2  # seconds without movement
LARGEST = 4.0  # times its size: a Gaussian that stands for others
TOP = 99.0  # percentile of an attribute that gets the brightest colour


def ordered(scene: Scene, cloud: Quads, direction: np.ndarray, eye: np.ndarray, values: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Everything a view at rest needs, in a thread that touches nothing of Blender's: order (N,) and colours (N, 3)."""
    order = back_to_front(cloud.means, direction)
    if values is None:
        return order, colors(scene, cloud.rows, eye)
    return order, colored(values[cloud.rows], float(np.percentile(values, TOP))).astype(np.float32)


class Cloud:
    """The visible splats on the graphics card."""

    def __init__(self, key: tuple, shown: gather.Shown, values: np.ndarray | None):
        self.key, self.shown, self.values = key, shown, values
        self.quads = quads(shown.scene)
        self.geometry = overlay_gpu.texture(self.quads.geometry.reshape(-1, 4), "RGBA32F")
        self.colors: gpu.types.GPUTexture | None = None
        self.order: tuple[bytes, gpu.types.GPUTexture] | None = None  # of all, for a view
        self.future: tuple[bytes, Future] | None = None

    def take_order(self, view: bytes, executor: ThreadPoolExecutor, direction: np.ndarray, eye: np.ndarray) -> bool:
        """Whether the order for this view is there; has it computed if not."""
        if self.future is not None and self.future[1].done():
            (done, future), self.future = self.future, None
            order, shades = future.result()
            self.order = done, overlay_gpu.texture(order.astype(np.float32)[:, None], "R32F")
            self.colors = overlay_gpu.texture(np.pad(shades, ((0, 0), (0, 1))), "RGBA16F")
        if self.order is not None and self.order[0] == view:
            return True
        if self.future is None:
            self.future = view, executor.submit(ordered, self.shown.scene, self.quads, direction, eye, self.values)
        return False


class Overlay:
    """State of the drawing; there is one, but none in background mode."""

    def __init__(self):
        self.executor = ThreadPoolExecutor(1, "svrgs-order")
        self.shaders: overlay_gpu.Shaders | None = None
        self.targets: dict[int, gpu.types.GPUOffScreen] = {}  # by region
        self.moved: dict[int, tuple[bytes, float]] = {}  # by region: its view, and since when
        self.cloud: Cloud | None = None
        self.handle = bpy.types.SpaceView3D.draw_handler_add(self.draw, (), "WINDOW", "POST_VIEW")

    def close(self):
        bpy.types.SpaceView3D.draw_handler_remove(self.handle, "WINDOW")
        self.executor.shutdown()

    def draw(self):
        context = bpy.context
        space = context.space_data
        if not context.scene.svrgs_looking.overlay or space.shading.type not in SHADING or not space.overlay.show_overlays:
            return
        try:
            camera = gather.region_camera(context.region, context.region_data)
            cloud = self.current(context)
        except SplatError:  # no perspective, or an object without size: the points stay
            return
        if cloud is not None:
            self.draw_cloud(context, cloud, camera)

    def current(self, context) -> Cloud | None:
        """The splats this viewport shows."""
        found = [obj for obj in context.view_layer.objects if bridge.is_splat(obj) and obj.visible_get(viewport=context.space_data)]
        name = context.scene.svrgs_looking.overlay_shown
        scenes = [scene_cache.read(obj) for obj in found]
        key = (name, *((id(scene), tuple(map(tuple, obj.matrix_world))) for scene, obj in zip(scenes, found, strict=True)))
        if not scenes:
            self.cloud = None
        elif self.cloud is None or self.cloud.key != key:
            shown = gather.placed([(scene, obj.matrix_world.copy()) for scene, obj in zip(scenes, found, strict=True)])
            self.cloud = Cloud(key, shown, self.values(found, name))
        return self.cloud

    def values(self, found: list, name: str) -> np.ndarray | None:
        """Numbers to be shown as colours, in the order of the shown scene; None: its own colours."""
        if name == "COLOR":
            return None
        parts = [scene_cache.read_values(obj, name) for obj in found]
        return None if any(part is None for part in parts) else np.concatenate(parts)

    def draw_cloud(self, context, cloud: Cloud, camera: Camera):
        region, view = context.region, context.region_data
        hidden = overlay_gpu.scene_depth(region.width, region.height)
        modelview = np.array(view.view_matrix @ cloud.shown.matrix, np.float64)
        key = modelview.tobytes() + camera.K.tobytes()
        resting = self.resting(region.as_pointer(), key)
        backwards, eye = -modelview[2, :3], -np.linalg.inv(modelview[:3, :3]) @ modelview[:3, 3]
        ready = resting and cloud.take_order(key, self.executor, backwards, eye)
        if not ready:
            _redraw_later()
        count, order = (cloud.shown.scene.count, cloud.order[1]) if ready else self.some(context, cloud, backwards)
        if cloud.colors is None:
            first = colors(cloud.shown.scene, cloud.quads.rows[:count], eye)
            cloud.colors = overlay_gpu.texture(np.pad(first, ((0, 0), (0, 1))), "RGBA16F")
        self.shaders = self.shaders or overlay_gpu.Shaders()
        P, (fx, _, cx), (_, fy, cy) = view.window_matrix, *camera.K[:2]
        constants = {
            "modelview": view.view_matrix @ cloud.shown.matrix, "lens": (fx, fy, cx, cy), "size": (region.width, region.height),
            "depth_scale": P[2][2], "depth_shift": P[2][3], "near": context.space_data.clip_start,
            "enlarge": min(cloud.shown.scene.count / max(count, 1), LARGEST**2), "antialiased": float(cloud.shown.scene.antialiased),
        }  # fmt: skip
        target = self.target(region)
        lists = {"order": order, "geometry": cloud.geometry, "colors": cloud.colors}
        overlay_gpu.draw_quads(self.shaders, target, lists, hidden, constants, count)
        overlay_gpu.lay_over(self.shaders, target)

    def some(self, context, cloud: Cloud, backwards: np.ndarray) -> tuple[int, gpu.types.GPUTexture]:
        """A part of the Gaussians that can be ordered at once."""
        count = min(cloud.shown.scene.count, context.scene.svrgs_looking.overlay_moving)
        order = back_to_front(cloud.quads.means[:count], backwards)
        return count, overlay_gpu.texture(order.astype(np.float32)[:, None], "R32F")

    def resting(self, region: int, view: bytes) -> bool:
        last, since = self.moved.get(region, (b"", 0.0))
        if last != view:
            since = time.monotonic()
            self.moved[region] = view, since
        return time.monotonic() - since >= REST

    def target(self, region: bpy.types.Region) -> gpu.types.GPUOffScreen:
        target = self.targets.get(region.as_pointer())
        if target is None or (target.width, target.height) != (region.width, region.height):
            target = gpu.types.GPUOffScreen(region.width, region.height, format="RGBA16F")
            self.targets[region.as_pointer()] = target
        return target


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


def _redraw_later():
    if not bpy.app.timers.is_registered(_redraw_once):
        bpy.app.timers.register(_redraw_once, first_interval=REST / 2)


def _redraw_once():
    redraw(SHADING)


@persistent
def _after_update(scene, *_):
    """Splats that have come since."""
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
