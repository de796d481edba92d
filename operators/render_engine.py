"""The render engine "SVR-GS": F12, animations, `blender -b -f` and the Rendered viewport through the native rasterizer."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
from mathutils import Color

from ..svrgs_addon import native
from ..svrgs_addon.camera import Camera
from ..svrgs_addon.drawing import Drawing, draw_while, film
from ..svrgs_addon.errors import NativeError, SceneError, SplatError
from ..svrgs_addon.native import Rasterizer
from ..svrgs_addon.surfaces import surface
from . import bridge, gather
from .preferences import threads

# Name, channels and kind of each pass beside Combined.
PASSES = (("Depth", "Z", "VALUE"), ("Alpha", "A", "VALUE"), ("SpatialMask", "X", "VALUE"), ("Count", "X", "VALUE"))


class SVRGS_engine(bpy.types.RenderEngine):
    bl_idname = "SVRGS"
    bl_label = "SVR-GS"
    bl_use_preview = False
    bl_use_eevee_viewport = True  # materials in Material Preview

    def update_render_passes(self, scene=None, renderlayer=None):
        self.register_pass(scene, renderlayer, "Combined", 4, "RGBA", "COLOR")
        for name, channels, kind in PASSES:
            self.register_pass(scene, renderlayer, name, len(channels), channels, kind)

    def render(self, depsgraph):
        x, y, width, height = region(depsgraph.scene.render)
        layers, trouble = empty(width, height), ""
        try:
            native.set_threads(threads(bpy.context))
            layers = self.picture(depsgraph, (x, y, width, height)) or layers
        except (SplatError, NativeError) as error:
            trouble = str(error)
        self.hand_in(layers, width, height)  # in every case: Blender crashes on saving nothing
        if trouble:
            self.error_set(trouble)
            self.report({"ERROR"}, trouble)

    def picture(self, depsgraph, part: tuple[int, int, int, int]) -> dict[str, np.ndarray] | None:
        """The passes of part of the image (x, y from its lower left corner, width, height), rows from the top; None if stopped."""
        scene, x, y, width, height = depsgraph.scene, *part
        self.say("Reading splats", 0.0)
        shown = gather.splats(depsgraph)
        if shown is None:
            raise SceneError("there is no splat to render: import one, and look whether its camera icon in the outliner is on")
        camera = gather.camera(depsgraph, self.camera_override)
        size = bridge.render_size(scene)
        crop = lambda view: cropped(view, x, size[1] - y - height, width, height)  # noqa: E731
        view = crop(bridge.camera_from_object(camera, scene, size, shown.matrix))
        triangles = gather.surfaces(depsgraph)
        hidden_by = None
        if len(triangles.corners):
            self.say("Finding what meshes hide", 0.1)
            found = surface(triangles, crop(bridge.camera_from_object(camera, scene, size)))
            hidden_by = replace(found, depth=found.depth / np.float32(shown.unit))
        self.say(f"Drawing {shown.scene.count:,} Gaussians", 0.2)
        transparent = scene.render.film_transparent
        background = (0.0, 0.0, 0.0) if transparent else tuple(scene.svrgs_background)
        drawing = draw_while(lambda: not self.test_break(), Rasterizer(), shown.scene, view, background, hidden_by)
        return passes(drawing, transparent, shown.unit) if drawing is not None else None

    def say(self, text: str, progress: float):
        self.update_stats("", text)
        self.update_progress(progress)

    def hand_in(self, layers: dict[str, np.ndarray], width: int, height: int):
        for name, channels, _ in PASSES:
            self.add_pass(name, len(channels), channels)
        result = self.begin_result(0, 0, width, height)
        for name, pixels in layers.items():
            result.layers[0].passes[name].rect.foreach_set(np.ascontiguousarray(pixels[::-1], np.float32).reshape(-1))
        self.end_result(result)
        self.update_progress(1.0)


def passes(drawing: Drawing, transparent: bool, unit: float) -> dict[str, np.ndarray]:
    """Pixels of every pass by name, rows from the top; unit: Blender's length of the drawing's."""
    combined = film(drawing, transparent)
    combined[..., :3] = combined[..., :3] @ to_scene_linear()
    depth = np.where(drawing.depth < 1e10, drawing.depth * np.float32(unit), drawing.depth)
    return {"Combined": combined, "Depth": depth, "Alpha": drawing.alpha, "SpatialMask": drawing.mask, "Count": drawing.hits}


def empty(width: int, height: int) -> dict[str, np.ndarray]:
    blank = np.zeros((height, width), np.float32)
    return {"Combined": np.zeros((height, width, 4), np.float32)} | {name: blank for name, *_ in PASSES}


def to_scene_linear() -> np.ndarray:
    """(3, 3): row of linear sRGB @ this = the file's working space."""
    return np.array([Color(axis).from_srgb_to_scene_linear() for axis in np.eye(3)], np.float32)


def region(render: bpy.types.RenderSettings) -> tuple[int, int, int, int]:
    """x, y (from the lower left corner), width and height of what is rendered, in pixels of the whole image."""
    width, height = bridge.render_size(render.id_data)
    if not render.use_border:
        return 0, 0, width, height
    x, y = int(render.border_min_x * width), int(render.border_min_y * height)
    return x, y, int(render.border_max_x * width) - x, int(render.border_max_y * height) - y


def cropped(camera: Camera, left: int, top: int, width: int, height: int) -> Camera:
    """Part of the image, from its upper left corner."""
    K = camera.K.copy()
    K[:2, 2] -= left, top
    return replace(camera, K=K, width=width, height=height)


def register():
    bpy.types.Scene.svrgs_background = bpy.props.FloatVectorProperty(
        name="Background", subtype="COLOR_GAMMA", min=0, max=1, size=3, default=(0, 0, 0),
        description="What shows between the Gaussians; black as in training",
    )  # fmt: skip
    bpy.utils.register_class(SVRGS_engine)


def unregister():
    bpy.utils.unregister_class(SVRGS_engine)
    del bpy.types.Scene.svrgs_background
