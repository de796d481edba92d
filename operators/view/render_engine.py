"""The render engine "SVR-GS": F12, animations, `blender -b -f` and the Rendered viewport, drawn by the native
library.

- One splat is drawn in its own coordinates; several splats, or a stretched or mirrored one, in world
  coordinates (visible_splats.py).
- Passes are linear. Dithering is off while rendering. So with the view transform Standard, saved pictures
  have the training's colours.
- A border is cut out of the whole picture, because the limits of the projection depend on the image size. So
  it has the same pixels.
"""

from __future__ import annotations

from functools import partial

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.native.rasterizer import Rasterizer
from ...svrgs_addon.render.composite import composite, composite_while, split
from ...svrgs_addon.render.panorama import composite_view
from ...svrgs_addon.render.passes import BEHIND, PASSES, blank, passes
from ...svrgs_addon.system.errors import NativeError, SceneError, SplatError
from ..data import camera_object, grading, image_pixels, known, mesh_triangles, splat_object, visible_splats
from ..data.extension import use_threads
from ..data.image_pixels import working_space
from .viewport import Viewport


class SVRGS_engine(bpy.types.RenderEngine):
    bl_idname = "SVRGS"
    bl_label = "SVR-GS"
    bl_use_preview = False
    bl_use_eevee_viewport = True  # Material Preview shows the materials of meshes

    _viewport: Viewport | None = None

    def view_update(self, context, depsgraph):
        if self._viewport is None:
            self._viewport = Viewport()
        self._viewport.update(depsgraph)

    def view_draw(self, context, depsgraph):
        if self._viewport is not None:
            self.update_stats("", self._viewport.draw(context, depsgraph.scene))

    def update_render_passes(self, scene=None, renderlayer=None):
        self.register_pass(scene, renderlayer, "Combined", 4, "RGBA", "COLOR")
        for name, channels, kind in kinds(scene):
            self.register_pass(scene, renderlayer, name, len(channels), channels, kind)

    def render(self, depsgraph):
        rows, columns = region(depsgraph.scene)
        width, height = columns.stop - columns.start, rows.stop - rows.start
        layers, problem = blank(height, width, kinds(depsgraph.scene)), ""
        try:
            if depsgraph.scene.render.use_multiview:
                raise SceneError(
                    tr("splats are rendered by one camera at a time: switch Stereoscopy off in Output")
                )
            use_threads(bpy.context)
            whole = self.picture(depsgraph)
            layers |= {name: pixels[rows, columns] for name, pixels in (whole or {}).items()}
        except (SplatError, NativeError) as error:
            problem = str(error)
        finally:
            # also after an error: Blender crashes if it saves a render without a result
            self.hand_in(layers, width, height, depsgraph.view_layer.name)
        if problem:
            self.report({"ERROR"}, problem)

    def picture(self, depsgraph) -> dict | None:
        """The passes of the whole image, rows from the top; None if the user has stopped the render."""
        scene, meshes = depsgraph.scene, depsgraph.scene.svrgs_view.meshes
        self.show_progress(tr("Reading splats"), 0.0)
        placed = visible_splats.splats(depsgraph)
        if placed is None and any(map(splat_object.is_splat, bpy.data.objects)):
            if sum(layer.use for layer in scene.view_layers) > 1:
                placed = visible_splats.nothing()  # the splats may be in another view layer
            elif self.is_animation:  # which an error would end
                text = tr("no splat is shown in frame {frame}").format(frame=scene.frame_current)
                self.report({"WARNING"}, text)
                placed = visible_splats.nothing()
        if placed is None:
            text = tr(
                "there is no splat to render: import one, and check that its camera icon in the Outliner is"
                " on"
            )
            raise SceneError(text)
        if placed.mixed:
            text = tr(
                "some of these splats were trained with antialiasing and some were not: none is drawn with it"
            )
            self.report({"WARNING"}, text)
        for name in visible_splats.holdouts(depsgraph):
            text = tr("'{name}' is set as a holdout, which no splat is: it is drawn").format(name=name)
            self.report({"WARNING"}, text)
        if self.is_animation:
            splats = {obj.original for obj, _ in visible_splats.placed_splats(depsgraph)}
            for text in {grading.still(obj, depsgraph) for obj in splats} - {""}:
                self.report({"WARNING"}, text)
        view = camera_object.view_of(visible_splats.camera(depsgraph, self.camera_override), scene)
        self.show_progress(tr("Reading meshes"), 0.1)
        triangles = mesh_triangles.triangles(depsgraph, cut=meshes == "CUT")
        # elsewhere they show and hide nothing
        catchers = mesh_triangles.triangles(depsgraph, catchers=True) if meshes == "SPLIT" else None
        self.show_progress(tr("Drawing {count:,} Gaussians").format(count=placed.scene.count), 0.2)
        transparent = scene.render.film_transparent or meshes == "CUT"
        background = None if transparent else tuple(scene.svrgs_view.background)

        def draw(rasterizer, camera):  # in a thread, which must not use bpy
            local, surface = placed.seen_by(camera), placed.hidden_by(triangles, camera)
            if meshes == "SPLIT":
                catcher = placed.hidden_by(catchers, camera) if catchers is not None else None
                return split(rasterizer, placed.scene, local, background, surface, catcher)
            return composite(rasterizer, placed.scene, local, background or (0.0, 0.0, 0.0), surface)

        whole = lambda rasterizer: composite_view(partial(draw, rasterizer), view)
        found = composite_while(lambda: not self.test_break(), Rasterizer(), whole)
        if found is None:
            return None
        return passes(found, transparent or meshes == "SPLIT", placed.unit, working_space())

    def show_progress(self, text: str, progress: float):
        self.update_stats("", text)
        self.update_progress(progress)

    def hand_in(self, layers: dict, width: int, height: int, view_layer: str):
        """Gives Blender the passes (H, W) or (H, W, channels) as the result of a view layer."""
        for name, channels, _ in (*PASSES, BEHIND):
            if name in layers:
                self.add_pass(name, len(channels), channels)
        result = self.begin_result(0, 0, width, height, layer=view_layer)
        for name, pixels in layers.items():
            result.layers[0].passes[name].rect.foreach_set(image_pixels.flattened(pixels))
        self.end_result(result)
        self.update_progress(1.0)


def kinds(scene: bpy.types.Scene) -> tuple:
    """(name, channels, type) of each pass of the scene except Combined."""
    return (*PASSES, BEHIND) if scene.svrgs_view.meshes != "SHOW" else PASSES


def region(scene: bpy.types.Scene) -> tuple[slice, slice]:
    """The rows (from the top) and columns that are rendered: all, or those of the border."""
    width, height = camera_object.render_size(scene)
    render = scene.render
    if not render.use_border:
        return slice(0, height), slice(0, width)
    low, high = camera_object.borders(render.border_min_y, render.border_max_y, height)
    columns = camera_object.borders(render.border_min_x, render.border_max_x, width)
    return slice(height - high, height - low), slice(*columns)


def _dither_off(scene, *_):
    """Switches dithering off: it would add noise of up to two levels of 8 bits."""
    if scene.render.engine == SVRGS_engine.bl_idname and known.of_scene(scene).dither is None:
        known.of_scene(scene).dither = scene.render.dither_intensity
        scene.render.dither_intensity = 0


def _dither_back(scene, *_):
    if (own := known.of_scene(scene).dither) is not None:
        scene.render.dither_intensity, known.of_scene(scene).dither = own, None


def _before_save(*_):
    """A file that is saved while a scene is rendered holds the scene's own dither."""
    for scene in bpy.data.scenes:
        if (own := known.of_scene(scene).dither) is not None:
            scene.render.dither_intensity = own


def _after_save(*_):
    for scene in bpy.data.scenes:
        if known.of_scene(scene).dither is not None:
            scene.render.dither_intensity = 0


HANDLERS = {
    "render_init": _dither_off, "render_complete": _dither_back, "render_cancel": _dither_back,
    "save_pre": _before_save, "save_post": _after_save, "save_post_fail": _after_save,
}  # fmt: skip
