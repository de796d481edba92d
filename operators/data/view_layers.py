"""What a view layer makes of the objects in its collections."""

from __future__ import annotations

import bpy


def is_indirect(instance: bpy.types.DepsgraphObjectInstance, depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether a render leaves the object out because its collection is indirect only."""
    return depsgraph.mode == "RENDER" and marks(instance, depsgraph, "indirect_only_get")


def marks(instance: bpy.types.DepsgraphObjectInstance, depsgraph: bpy.types.Depsgraph, mark: str) -> bool:
    """Whether a collection of the object is marked in the view layer of the graph, or in that of the
    background set. mark: "holdout_get" or "indirect_only_get"."""
    base = (instance.parent if instance.is_instance else instance.object).original
    scene = depsgraph.scene.original
    layers = [scene.view_layers[depsgraph.view_layer.name]]
    while (scene := scene.background_set and scene.background_set.original) is not None:
        layers.append(scene.view_layers[0])
    return any(getattr(base, mark)(view_layer=layer) for layer in layers)
