"""Set Up Rendering and Set Up Compositing: what a render needs to show splats, with one click. Use Standard:
the colours of the training."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as tr

from ..data import camera_object, splat_object
from ..data.reporting import ReportingOperator
from . import compositor_nodes, splat_layer

EEVEE = "BLENDER_EEVEE_NEXT" if bpy.app.version < (5, 0, 0) else "BLENDER_EEVEE"
WITHOUT_MATERIALS = ("SVRGS", "BLENDER_WORKBENCH")


class SVRGS_OT_set_up_rendering(ReportingOperator):
    bl_label = "Set Up Rendering"
    bl_description = (
        "Render with the engine SVR-GS, in the colours of the training and with the resolution of the"
        " camera's photograph"
    )

    @classmethod
    def problem(cls, context) -> str:
        return is_layer(context.scene)

    def work(self, context) -> str:
        scene = context.scene
        splat_layer.remove(scene, context.evaluated_depsgraph_get())
        scene.render.engine = "SVRGS"
        use_standard(scene)
        return ". ".join([tr("The engine is SVR-GS, the view transform Standard"), camera_words(scene)])


class SVRGS_OT_use_standard(ReportingOperator):
    bl_label = "Use Standard (Matches Training)"
    bl_description = "Choose the view transform Standard. Then pictures have the colours of the training"

    def work(self, context) -> str:
        use_standard(context.scene)
        return ""


class SVRGS_OT_set_up_compositing(ReportingOperator):
    bl_label = "Set Up Compositing"
    bl_description = (
        "Render meshes with EEVEE or Cycles and splats with SVR-GS, and put both together by depth. Adds a"
        " scene for the splats and compositing nodes. The film becomes transparent"
    )

    @classmethod
    def problem(cls, context) -> str:
        if not any(splat_object.is_splat(obj) for obj in context.scene.objects):
            return tr("There is no splat in the scene: import one")
        return is_layer(context.scene)

    def work(self, context) -> str:
        scene = context.scene
        if scene.render.engine in WITHOUT_MATERIALS:
            scene.render.engine = EEVEE
        layer = splat_layer.add(scene, context.evaluated_depsgraph_get())
        compositor_nodes.insert(scene, layer)
        text = tr(
            "{engine} renders the meshes with a transparent film, the scene '{scene}' renders the splats. The"
            " compositor puts them together"
        )
        return text.format(engine=splat_layer.engine_name(scene), scene=layer.name)


def use_standard(scene: bpy.types.Scene):
    view = scene.view_settings
    view.view_transform, view.look, view.exposure, view.gamma = "Standard", "None", 0, 1


def camera_words(scene: bpy.types.Scene) -> str:
    """Gives the scene the resolution of its camera's photograph, if it has one. Returns a sentence about
    camera and resolution."""
    if scene.camera is None:
        return tr("The scene has no camera yet: add one")
    camera_object.apply_camera_size(scene)
    width, height = camera_object.render_size(scene)
    text = tr("The camera is '{name}', the resolution {width} x {height}")
    if scene.camera.type == "CAMERA" and camera_object.SIZE in scene.camera.data:
        text = tr("The camera is '{name}', the resolution {width} x {height}, as its photograph")
    return text.format(name=scene.camera.name, width=width, height=height)


def is_layer(scene: bpy.types.Scene) -> str:
    """That the scene renders the splats of another one, in a sentence; '' if it does not."""
    main = scene.svrgs_view.layer_of
    text = tr("This scene renders the splats of '{name}': go to that scene")
    return text.format(name=main.name) if main is not None else ""
