"""A scene that renders the splats of another scene, for its compositor: "NAME Splats", with the engine
SVR-GS.

It has the other scene as its background set: so it shows the same objects without holding any, also those
that come later. Camera, resolution and border are those of the other scene at each render.
"""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as tr

from ..data import splat_object, visible_splats
from . import compositor_nodes

# Ray Visibility
RAYS = tuple(
    f"visible_{kind}" for kind in ("camera", "diffuse", "glossy", "transmission", "volume_scatter", "shadow")
)
# engines without a class
BUILT_IN = {"BLENDER_EEVEE_NEXT": "EEVEE", "BLENDER_EEVEE": "EEVEE", "BLENDER_WORKBENCH": "Workbench"}
# Blender 5.3: its own engines draw splats
DRAWS_SPLATS = {*BUILT_IN, "CYCLES"} if splat_object.BLENDER_HAS_SPLATS else set()
FOLLOWED = (
    "resolution_x", "resolution_y", "resolution_percentage", "pixel_aspect_x", "pixel_aspect_y", "use_border",
    "use_crop_to_border",
    "border_min_x", "border_max_x", "border_min_y", "border_max_y",
)  # fmt: skip


def layer_of(scene: bpy.types.Scene) -> bpy.types.Scene | None:
    """The scene that renders the splats of this scene; None if there is none."""
    return next((other for other in bpy.data.scenes if other.svrgs_view.layer_of == scene), None)


def add(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> bpy.types.Scene:
    """Makes the layer of a scene, or sets it right. Other engines do not draw the scene's splats any more.

    Afterwards the scene's film is transparent, as its render belongs between Gaussians. If it was not, the
    layer's background is opaque.
    """
    layer = layer_of(scene)
    if layer is None:
        layer = bpy.data.scenes.new(f"{scene.name} Splats")
        layer.render.film_transparent = scene.render.film_transparent
        layer.svrgs_view.background = scene.svrgs_view.background
    layer.background_set, layer.render.engine = scene, "SVRGS"
    layer.svrgs_view.layer_of = scene
    scene.render.film_transparent = True
    _follow(scene, layer)
    _show_to_other_engines(scene, False, depsgraph)
    return layer


def remove(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph):
    """Removes the layer of a scene and its nodes, if it has them."""
    layer = layer_of(scene)
    if layer is not None:
        compositor_nodes.remove(scene)
        scene.render.film_transparent = layer.render.film_transparent
        bpy.data.scenes.remove(layer)
        _show_to_other_engines(scene, True, depsgraph)


def missing(scene: bpy.types.Scene) -> str:
    """What keeps renders of the scene from showing its splats, in one sentence; empty if they are shown or if
    there is none."""
    splats = [obj for obj in scene.objects if splat_object.is_splat(obj)]
    if not splats or scene.render.engine == "SVRGS" or scene.svrgs_view.layer_of is not None:
        return ""
    engine, layer = engine_name(scene), layer_of(scene)
    if layer is None:
        text = tr("{engine} does not draw splats: a render shows grey dots, or nothing")
        drawn = scene.render.engine in DRAWS_SPLATS and not any(obj.type == "MESH" for obj in splats)
        return "" if drawn else text.format(engine=engine)
    if not compositor_nodes.are_complete(scene, layer):
        return tr("The compositing of the splats is not complete: set it up again")
    new = [obj for obj in splats if obj.visible_camera]
    text = tr("{engine} renders '{name}' as grey dots: set up compositing again")
    return text.format(engine=engine, name=new[0].name) if new else ""


def drawn_by_blender(scene: bpy.types.Scene) -> str:
    """That Blender's own engine draws the scene's splats, and where, in a sentence; empty if it does not, or
    if there is none."""
    if scene.render.engine not in DRAWS_SPLATS or layer_of(scene) is not None:
        return ""
    if not any(splat_object.is_splat(obj) and obj.type != "MESH" for obj in scene.objects):
        return ""
    text = tr(
        "{engine} draws splats itself, more slowly, and not quite in the colours of the training. In Rendered"
        " viewports it does so where View is off"
    )
    return text.format(engine=engine_name(scene))


def engine_name(scene: bpy.types.Scene) -> str:
    """The name of the scene's engine as Blender shows it."""
    engine = scene.render.engine
    engines = bpy.types.RenderEngine.__subclasses__()
    labels = (cls.bl_label for cls in engines if getattr(cls, "bl_idname", "") == engine)
    return BUILT_IN.get(engine) or next(labels, engine)


def _show_to_other_engines(scene: bpy.types.Scene, shown: bool, depsgraph: bpy.types.Depsgraph):
    """Whether EEVEE and Cycles draw the points of the scene's splats. The engine SVR-GS draws splats in any
    case."""
    instanced = {obj.original for obj, _ in visible_splats.placed_splats(depsgraph)}
    for obj in {obj for obj in scene.objects if splat_object.is_splat(obj)} | instanced:
        for name in RAYS:
            setattr(obj, name, shown)


def _follow(scene: bpy.types.Scene, layer: bpy.types.Scene):
    """Gives the layer the scene's camera and size. With a transparent film, the render belongs between the
    Gaussians; else under them."""
    for name in FOLLOWED:
        if getattr(layer.render, name) != getattr(scene.render, name):
            setattr(layer.render, name, getattr(scene.render, name))
    camera = _camera_of_frame(scene)
    if layer.camera != camera:
        layer.camera = camera
    meshes = "SPLIT" if scene.render.film_transparent else "CUT"
    if layer.svrgs_view.meshes != meshes:
        layer.svrgs_view.meshes = meshes


def _camera_of_frame(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """That of the last marker with a camera, before the first one that of this, as Blender chooses it: at the
    beginning of a frame of an animation, the scene still has the camera of the frame before."""
    markers = [one for one in scene.timeline_markers if one.camera and not one.camera.hide_render]
    if not markers:
        return scene.camera
    before = [one for one in markers if one.frame <= scene.frame_current]
    frame = lambda marker: marker.frame
    return (max(before, key=frame) if before else min(markers, key=frame)).camera


def _before_render(scene, *_):
    for layer in bpy.data.scenes:
        if layer.svrgs_view.layer_of == scene:
            _follow(scene, layer)


def _after_load(*_):
    """Blender 5.3 draws splats itself, also those of files of older versions."""
    older = splat_object.BLENDER_HAS_SPLATS and bpy.data.version < (5, 3, 0)
    for cloud in bpy.data.pointclouds if older else ():
        if cloud.library is None and splat_object.NOTES in cloud:
            cloud.type = "GAUSSIAN_SPLAT"


HANDLERS = {"render_pre": _before_render, "load_post": _after_load}
