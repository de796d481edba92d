"""The Rendered viewport: the native picture as a texture, coarse while the view moves, exact when it rests."""

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
from ..svrgs_addon.render.mesh_depth import Triangles
from ..svrgs_addon.render.passes import linear_rgba
from . import bridge_gpu, bridge_graph, scene_cache
from .bridge_images import working_space
from .preferences import threads

REFRESH = 0.05  # seconds between two looks whether a better picture is ready

_open: weakref.WeakSet[Viewport] = weakref.WeakSet()


@dataclass(frozen=True)
class Job:
    """One view; the thread that draws it touches nothing of Blender's."""

    shown: bridge_graph.Shown
    triangles: Triangles
    camera: Camera  # in Blender's world
    background: tuple[float, float, float]
    transparent: bool
    working_space: list


def draw_job(rasterizer, job: Job, reduction: int):
    """(H, W, 4) float32 in the file's working space, times alpha."""
    camera = job.camera.reduced(reduction)
    background = (0.0, 0.0, 0.0) if job.transparent else job.background
    picture = composite(rasterizer, job.shown.scene, job.shown.seen_by(camera), background, job.shown.hidden_by(job.triangles, camera))
    return linear_rgba(picture, job.transparent, job.working_space)


class Viewport:
    """What one Rendered viewport shows."""

    def __init__(self):
        self.live = LiveView(draw_job)
        self.shown: bridge_graph.Shown | None = None
        self.triangles: Triangles | None = None
        self.trouble = ""
        self.version = 0  # of what is shown
        self.texture: tuple[Picture, gpu.types.GPUTexture] | None = None
        _open.add(self)

    def __del__(self):
        self.live.close()

    def update(self, depsgraph: bpy.types.Depsgraph):
        """Reads what has changed."""
        scene_cache.forget_updated(depsgraph)
        self.version += 1
        try:
            self.shown, self.trouble = bridge_graph.splats(depsgraph, scene_cache.read), ""
            self.triangles = bridge_graph.surfaces(depsgraph)
        except SplatError as error:
            self.shown, self.trouble = None, str(error)

    def draw(self, context: bpy.types.Context, scene: bpy.types.Scene) -> str:
        """Draws the newest picture there is; returns what to tell the user."""
        if self.shown is None:
            return self.trouble or "There is no splat to show: import one"
        try:
            native.set_threads(threads(context))
        except NativeError as error:
            return str(error)
        camera = bridge_graph.region_camera(context.region, context.region_data)
        job = Job(self.shown, self.triangles, camera, tuple(scene.svrgs_looking.background), scene.render.film_transparent, working_space())
        key = self.version, camera.key, job.background, job.transparent
        self.live.request(key, job)
        if self.live.busy and not bpy.app.timers.is_registered(_refresh):
            bpy.app.timers.register(_refresh, first_interval=REFRESH)
        picture = self.live.picture()
        if picture is None:
            return "Drawing"
        if picture.error is not None:
            return str(picture.error)
        self._put(picture, context.region)
        return f"{self.shown.scene.count:,} Gaussians" + ", coarse" * (picture.reduction > 1)

    def _put(self, picture: Picture, region: bpy.types.Region):
        if self.texture is None or self.texture[0] is not picture:
            self.texture = picture, bridge_gpu.picture(picture.result)
        gpu.state.blend_set("ALPHA_PREMULT")
        draw_texture_2d(self.texture[1], (0, 0), region.width, region.height)
        gpu.state.blend_set("NONE")


def redraw(shading: set[str]):
    """Has every 3D viewport with such shading drawn again."""
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
