"""A USD stage that Blender itself exports keeps its splats: they become splats in it, where Blender writes
points."""

from __future__ import annotations

from typing import Any

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.files import usd
from ...svrgs_addon.scene.gaussians import Scene
from ...svrgs_addon.system.errors import SceneError
from ..data import splat_object, visible_splats

# attribute of prims by which Blenders without a map of prims tell them apart
NAME = "userProperties:blender:object_name"
HOOK: Any = getattr(bpy.types, "USDHook", object)  # object: Blender was built without OpenUSD


class SVRGS_USD_splats(HOOK):
    bl_idname = "SVRGS_USD_splats"
    bl_label = "SVR-GS Splats"

    @staticmethod
    def on_export(export_context) -> bool:
        """Called by Blender when its stage is complete, before it is saved. Blender reports errors."""
        graph = export_context.get_depsgraph()
        if not any(True for _ in visible_splats.placed_splats(graph)):
            return True
        usd.module("Usd")  # before the stage, which is an object of this module
        stage = export_context.get_stage()
        scenes: dict[bpy.types.Object, Scene] = {}
        for path, obj in _prims(export_context, stage):
            if splat_object.is_splat(obj):
                scenes[obj] = scenes.get(obj) or visible_splats.visible_scene(obj.evaluated_get(graph))
                usd.replace_points(stage, path, scenes[obj])
        return True


def _prims(export_context, stage) -> list[tuple[Any, bpy.types.Object]]:
    """The path and the object of each prim that has one. Raises SceneError."""
    if hasattr(export_context, "get_prim_map"):
        blocks = [(path, block) for path, found in export_context.get_prim_map().items() for block in found]
        return [(path, block) for path, block in blocks if isinstance(block, bpy.types.Object)]
    named = (prim for prim in stage.TraverseAll() if prim.HasAttribute(NAME))
    names = [(prim.GetPath(), prim.GetAttribute(NAME).Get()) for prim in named]
    if not names:
        text = tr(
            "splats are exported as points, because the stage has no names of Blender's objects: switch on"
            " Custom Properties and Blender Names"
        )
        raise SceneError(text)
    return [(path, bpy.data.objects[name]) for path, name in names if name in bpy.data.objects]
