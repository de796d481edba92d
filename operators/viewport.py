"""The Rendered viewport of the engine SVR-GS.

A thread draws the newest view with the native library: first every 4th pixel, then all pixels (svrgs_addon/render/live_view.py). The
main thread draws the newest finished picture as a texture and never waits.
"""

from __future__ import annotations

import weakref
from dataclasses import dataclass

import bpy
import gpu
from gpu_extras.presets import draw_texture_2d

from ..svrgs_addon import native
from ..svrgs_addon.camera import Camera
from ..svrgs_addon.errors import NativeError, SplatError
from ..svrgs_addon.render.composite import composite
from ..svrgs_addon.render.live_view import LiveView, Picture
from ..svrgs_addon.render.meshes import Triangles
from ..svrgs_addon.render.passes import linear_rgba
from . import bridge_gpu, bridge_graph, bridge_meshes, scene_cache
from .bridge_images import working_space
from .preferences import threads

REFRESH = 0.05  # seconds between two redraws while a better picture is on its way

_open: weakref.WeakSet[Viewport] = weakref.WeakSet()


@dataclass(frozen=True)
class DrawRequest:
    """One view. The thread that draws it must not use bpy."""

    placed: bridge_graph.PlacedScene
    triangles: Triangles
    camera: Camera  # in Blender's world
    background: tuple[float, float, float]
    transparent: bool
    working_space: list


def draw_view(rasterizer, request: DrawRequest, reduction: int):
    """(H, W, 4) float32 times alpha, in the file's working colour space."""
    camera, placed = request.camera.reduced(reduction), request.placed
    background = (0.0, 0.0, 0.0) if request.transparent else request.background
    picture = composite(rasterizer, placed.scene, placed.seen_by(camera), background, placed.hidden_by(request.triangles, camera))
    return linear_rgba(picture, request.transparent, request.working_space)


class Viewport:
    """One Rendered viewport: its scene, and the picture that it shows."""

    def __init__(self):
        self.live = LiveView(draw_view)
        self.placed: bridge_graph.PlacedScene | None = None
        self.triangles: Triangles | None = None
        self.problem = ""
        self.version = 0  # raised by every change of the scene
        self.texture: tuple[Picture, gpu.types.GPUTexture] | None = None
        _open.add(self)

    def __del__(self):
        self.live.close()

    def update(self, depsgraph: bpy.types.Depsgraph):
        """Reads the scene after a change."""
        scene_cache.forget_updated(depsgraph)
        self.version += 1
        try:
            self.placed, self.problem = bridge_graph.splats(depsgraph, scene_cache.read), ""
            self.triangles = bridge_meshes.triangles(depsgraph)
        except SplatError as error:
            self.placed, self.problem = None, str(error)

    def draw(self, context: bpy.types.Context, scene: bpy.types.Scene) -> str:
        """Draws the newest picture, and asks for a better one. Returns a line for the user."""
        if self.placed is None or self.triangles is None:
            return self.problem or "There is no visible splat: import one"
        try:
            native.set_threads(threads(context))
        except NativeError as error:
            return str(error)
        camera = bridge_graph.region_camera(context.region, context.region_data)
        request = DrawRequest(self.placed, self.triangles, camera, tuple(scene.svrgs_looking.background), scene.render.film_transparent, working_space())
        key = self.version, camera.key, request.background, request.transparent
        self.live.request(key, request)
        if self.live.busy and not bpy.app.timers.is_registered(_refresh):
            bpy.app.timers.register(_refresh, first_interval=REFRESH)
        picture = self.live.picture()
        if picture is None:
            return "Drawing"
        if picture.error is not None:
            return str(picture.error)
        self._draw_picture(picture, context.region)
        return f"{self.placed.scene.count:,} Gaussians" + ", coarse" * (picture.reduction > 1)

    def _draw_picture(self, picture: Picture, region: bpy.types.Region):
        if self.texture is None or self.texture[0] is not picture:
            self.texture = picture, bridge_gpu.picture_texture(picture.result)
        gpu.state.blend_set("ALPHA_PREMULT")
        draw_texture_2d(self.texture[1], (0, 0), region.width, region.height)
        gpu.state.blend_set("NONE")


def redraw(shading: set[str]):
    """Redraws every 3D viewport whose shading type is in `shading`."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D" and area.spaces.active.shading.type in shading:
                area.tag_redraw()


def _refresh() -> float | None:
    redraw({"RENDERED"})
    return REFRESH if any(viewport.live.busy for viewport in _open) else None


def register():
    pass


def unregister():
    if bpy.app.timers.is_registered(_refresh):
        bpy.app.timers.unregister(_refresh)
