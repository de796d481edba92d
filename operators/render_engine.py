"""The render engine "SVR-GS": F12, animations, `blender -b -f` and the Rendered viewport through the native rasterizer."""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

from ..svrgs_addon import native
from ..svrgs_addon.errors import NativeError, SceneError, SplatError
from ..svrgs_addon.native import Rasterizer
from ..svrgs_addon.render.composite import composite_while
from ..svrgs_addon.render.passes import PASSES, blank, passes
from . import bridge, bridge_graph, bridge_images
from .bridge_images import working_space
from .preferences import threads
from .viewport import Viewport


class SVRGS_engine(bpy.types.RenderEngine):
    bl_idname = "SVRGS"
    bl_label = "SVR-GS"
    bl_use_preview = False
    bl_use_eevee_viewport = True  # materials in Material Preview

    _viewport: Viewport | None = None

    def view_update(self, context, depsgraph):
        if self._viewport is None:
            self._viewport = Viewport()
        self._viewport.update(depsgraph)

    def view_draw(self, context, depsgraph):
        self.update_stats("", self._viewport.draw(context, depsgraph.scene))

    def update_render_passes(self, scene=None, renderlayer=None):
        self.register_pass(scene, renderlayer, "Combined", 4, "RGBA", "COLOR")
        for name, channels, kind in PASSES:
            self.register_pass(scene, renderlayer, name, len(channels), channels, kind)

    def render(self, depsgraph):
        rows, columns = region(depsgraph.scene)
        width, height = columns.stop - columns.start, rows.stop - rows.start
        layers, trouble = blank(height, width), ""
        try:
            native.set_threads(threads(bpy.context))
            whole = self.picture(depsgraph)
            layers = {name: pixels[rows, columns] for name, pixels in whole.items()} if whole else layers
        except (SplatError, NativeError) as error:
            trouble = str(error)
        finally:
            self.hand_in(layers, width, height)  # in every case: Blender crashes on saving nothing
        if trouble:
            self.report({"ERROR"}, trouble)

    def picture(self, depsgraph) -> dict | None:
        """The passes of the whole image, rows from the top; None if stopped. (How a Gaussian is projected depends on the size of
        the image, so a border is cut out of it: it then shows the same pixels.)"""
        scene = depsgraph.scene
        self.say("Reading splats", 0.0)
        shown = bridge_graph.splats(depsgraph)
        if shown is None:
            raise SceneError("there is no splat to render: import one, and look whether its camera icon in the outliner is on")
        camera = bridge_graph.camera(depsgraph, self.camera_override)
        view = bridge.camera_from_object(camera, scene, bridge.render_size(scene))
        self.say("Finding what meshes hide", 0.1)
        hidden_by = shown.hidden_by(bridge_graph.surfaces(depsgraph), view)
        self.say(f"Drawing {shown.scene.count:,} Gaussians", 0.2)
        transparent = scene.render.film_transparent
        background = (0.0, 0.0, 0.0) if transparent else tuple(scene.svrgs_looking.background)
        found = composite_while(lambda: not self.test_break(), Rasterizer(), shown.scene, shown.seen_by(view), background, hidden_by)
        return passes(found, transparent, shown.unit, working_space()) if found is not None else None

    def say(self, text: str, progress: float):
        self.update_stats("", text)
        self.update_progress(progress)

    def hand_in(self, layers: dict, width: int, height: int):
        for name, channels, _ in PASSES:
            self.add_pass(name, len(channels), channels)
        result = self.begin_result(0, 0, width, height)
        for name, pixels in layers.items():
            result.layers[0].passes[name].rect.foreach_set(bridge_images.flat(pixels))
        self.end_result(result)
        self.update_progress(1.0)


def region(scene: bpy.types.Scene) -> tuple[slice, slice]:
    """Rows from the top, and columns, of the image that are rendered."""
    width, height = bridge.render_size(scene)
    render = scene.render
    if not render.use_border:
        return slice(0, height), slice(0, width)
    low, high = int(render.border_min_y * height), int(render.border_max_y * height)
    return slice(height - high, height - low), slice(int(render.border_min_x * width), int(render.border_max_x * width))


_dither: dict[int, float] = {}  # session_uid of a scene that is being rendered: its own dither


@persistent
def _without_dither(scene, *_):
    """Saved pictures hold the training's colours, without Blender's noise of up to two levels."""
    if scene.render.engine == SVRGS_engine.bl_idname and scene.session_uid not in _dither:
        _dither[scene.session_uid] = scene.render.dither_intensity
        scene.render.dither_intensity = 0


@persistent
def _with_dither(scene, *_):
    if scene.session_uid in _dither:
        scene.render.dither_intensity = _dither.pop(scene.session_uid)


HANDLERS = (("render_init", _without_dither), ("render_complete", _with_dither), ("render_cancel", _with_dither))


def register():
    bpy.utils.register_class(SVRGS_engine)
    for event, handler in HANDLERS:
        getattr(bpy.app.handlers, event).append(handler)


def unregister():
    for event, handler in HANDLERS:
        getattr(bpy.app.handlers, event).remove(handler)
    _dither.clear()
    bpy.utils.unregister_class(SVRGS_engine)
