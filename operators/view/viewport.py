"""The Rendered viewport of the engine SVR-GS.

A thread draws the newest view with the native library: first every 4th pixel, then all pixels
(svrgs_addon/render/live_view.py). The main thread draws the newest finished picture as a texture and never
waits.
"""

from __future__ import annotations

import weakref
from dataclasses import dataclass

import bpy
import gpu
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.render.composite import composite
from ...svrgs_addon.render.live_view import LiveView, Picture
from ...svrgs_addon.render.meshes import Triangles
from ...svrgs_addon.render.passes import linear_rgba
from ...svrgs_addon.scene.camera import Camera
from ...svrgs_addon.system.errors import NativeError, SplatError
from ...svrgs_addon.views.lens import step_back
from ..data import background_work, gpu_drawing, mesh_triangles, visible_splats
from ..data.extension import use_threads
from ..data.image_pixels import working_space
from . import scene_cache, viewport_wipe

REFRESH = 0.05  # seconds between two redraws while a better picture is on its way

_open: weakref.WeakSet[Viewport] = weakref.WeakSet()


@dataclass(frozen=True)
class DrawRequest:
    """One view. The thread that draws it must not use bpy."""

    placed: visible_splats.PlacedScene
    triangles: Triangles
    camera: Camera  # in Blender's world
    background: tuple[float, float, float]
    transparent: bool
    working_space: list


def draw_view(rasterizer, request: DrawRequest, reduction: int):
    """(H, W, 4) float32 times alpha, in the file's working colour space; and depths (H, W) of Gaussians and
    meshes in units of the scene, FAR where one sees through them."""
    camera, placed = request.camera.reduced(reduction), request.placed
    background = (0.0, 0.0, 0.0) if request.transparent else request.background
    scene = placed.thinning.draws() if reduction > 1 else placed.scene
    local, surface = placed.seen_by(camera), placed.hidden_by(request.triangles, camera)
    picture = composite(rasterizer, scene, local, background, surface, passes=("depth",))
    placed.thinning.drew(scene, rasterizer)
    rgba = linear_rgba(picture, request.transparent, request.working_space)
    return rgba, picture.solid_depth


class Pane:
    """A part of a viewport: all of it, or one side of the wipe."""

    def __init__(self):
        self.live = LiveView(draw_view)
        self.key: tuple = ()
        self.placed: visible_splats.PlacedScene | None = None
        self.textures: tuple[Picture, list[gpu.types.GPUTexture]] | None = None

    def place(self, side: viewport_wipe.Side) -> visible_splats.PlacedScene:
        """The splats of the side as one scene; the last one if nothing has changed. Raises SceneError."""
        if self.placed is None or self.key != side.key:
            self.placed = visible_splats.placed([(part.scene, part.matrix) for part in side.shown])
            self.key = side.key
        return self.placed

    def draw(self, region: bpy.types.Region, columns: tuple[float, float]):
        """Draws the newest picture, if there is one without an error."""
        picture = self.live.picture()
        if picture is None or picture.error is not None:
            return
        if self.textures is None or self.textures[0] is not picture:
            self.textures = picture, [gpu_drawing.picture_texture(part) for part in picture.result]
        gpu_drawing.draw_linear(self.textures[1][0], region.width, region.height, columns)

    def hide_lines(self, shader: gpu.types.GPUShader, lines: gpu.types.GPUTexture, P, columns):
        """Takes Blender's lines away where the picture is in front of them. P: the window matrix."""
        if self.textures is not None and self.placed is not None:
            lens, depths = (P[2][2], P[2][3], P[3][2], P[3][3]), (self.placed.unit, step_back(P))
            constants = {"lens": lens, "depths": depths}
            textures = {"depth": self.textures[1][1], "lines": lines}
            gpu_drawing.draw_hiding(shader, textures, constants, columns)


class Viewport:
    """One Rendered viewport: its scene, and the pictures that it shows."""

    def __init__(self):
        self.panes: dict[str, Pane] = {}  # by name of the side
        self.columns: dict[str, tuple[float, float]] = {}  # of each side that was drawn
        self.region = 0  # address of the region that was drawn
        self.shader: gpu.types.GPUShader | None = None  # made in a drawing context
        self.shown: list[viewport_wipe.Shown] = []
        self.triangles: Triangles | None = None
        self.problem = ""
        self.version = 0  # raised by every change of the scene
        _open.add(self)

    def __del__(self):
        for pane in self.panes.values():
            pane.live.close()

    @property
    def busy(self) -> bool:
        """Whether a better picture is on its way."""
        return any(pane.live.busy for pane in self.panes.values())

    def update(self, depsgraph: bpy.types.Depsgraph):
        """Reads the scene after a change."""
        scene_cache.forget_updated(depsgraph)
        self.version += 1
        try:
            self.shown, self.problem = viewport_wipe.shown(visible_splats.placed_splats(depsgraph)), ""
            self.triangles = mesh_triangles.triangles(depsgraph)
        except SplatError as error:
            self.shown, self.problem = [], str(error)

    def hide_lines(self, context: bpy.types.Context):
        """After Blender has drawn its overlays: takes away those that Gaussians hide. While an object is set
        In Front, all stay: its lines cannot be told from others."""
        if shows_in_front(context):
            return
        lines = gpu_drawing.scene_depth(context.region.width, context.region.height)
        if lines is None:
            return
        self.shader = self.shader or gpu_drawing.hiding_shader()
        texture = gpu_drawing.picture_texture(lines)
        for side, columns in self.columns.items():
            self.panes[side].hide_lines(self.shader, texture, context.region_data.window_matrix, columns)

    def draw(self, context: bpy.types.Context, scene: bpy.types.Scene) -> str:
        """Draws the newest pictures, and asks for better ones. Returns a line for the user."""
        self.region, self.columns = context.region.as_pointer(), {}
        if not self.shown or self.triangles is None:
            return self.problem or tr("there is no visible splat: import one")
        try:
            use_threads(context)
            sides = viewport_wipe.sides(context.scene, self.shown)
            for closed in self.panes.keys() - {side.name for side in sides}:
                self.panes.pop(closed).live.close()
            texts = [self._draw_side(context, scene, side) for side in sides]
        except (SplatError, NativeError) as error:
            return str(error)
        if self.busy and not bpy.app.timers.is_registered(_refresh):
            bpy.app.timers.register(_refresh, first_interval=REFRESH)
        return " | ".join(texts)

    def _draw_side(self, context: bpy.types.Context, scene: bpy.types.Scene, side: viewport_wipe.Side) -> str:
        if side.name not in self.panes:
            self.panes[side.name] = Pane()
        pane = self.panes[side.name]
        assert self.triangles is not None  # see draw()
        placed, camera = pane.place(side), visible_splats.region_camera(context.region, context.region_data)
        background, transparent = tuple(scene.svrgs_view.background), scene.render.film_transparent
        key = self.version, side.key, camera.key, background, transparent
        pane.live.request(
            key, DrawRequest(placed, self.triangles, camera, background, transparent, working_space())
        )
        self.columns[side.name] = side.columns
        pane.draw(context.region, side.columns)
        picture = pane.live.picture()
        if picture is None:
            return tr("Drawing")
        if picture.error is not None:
            return str(picture.error)
        text = tr("{count:,} Gaussians, coarse") if picture.reduction > 1 else tr("{count:,} Gaussians")
        return text.format(count=placed.scene.count)


def shows_in_front(context: bpy.types.Context) -> bool:
    """Whether the viewport shows an object that is set In Front."""
    objects = (obj for obj in context.view_layer.objects if obj.show_in_front)
    return any(obj.visible_get(viewport=context.space_data) for obj in objects)


def redraw(shading: set[str]):
    """Redraws every 3D viewport whose shading type is in `shading`."""
    for area in background_work.areas():
        if area.type == "VIEW_3D" and area.spaces.active.shading.type in shading:
            area.tag_redraw()


def _refresh() -> float | None:
    redraw({"RENDERED"})
    return REFRESH if any(viewport.busy for viewport in _open) else None


def _after_overlays():
    context = bpy.context
    if context.space_data.shading.type == "RENDERED" and context.space_data.overlay.show_overlays:
        for viewport in _open:
            if viewport.region == context.region.as_pointer() and context.scene.render.engine == "SVRGS":
                viewport.hide_lines(context)


TIMERS = (_refresh,)
DRAWS = {"POST_VIEW": _after_overlays}
