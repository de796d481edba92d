"""An original and the splat that was pruned from it: each names the other in a property of its object, and
mostly one of them is hidden."""

from __future__ import annotations

import contextlib

import bpy

ORIGINAL, PRUNED = "svrgs_original", "svrgs_pruned"  # properties of objects: the partner


def join(original: bpy.types.Object, pruned: bpy.types.Object):
    """Stores in each splat that the other is its partner."""
    original[PRUNED], pruned[ORIGINAL] = pruned, original


def pruned_of(obj: bpy.types.Object) -> bpy.types.Object | None:
    """The splat that a job made of this one, if it is still in the file."""
    return in_file(obj.get(PRUNED))


def original_of(pruned: bpy.types.Object) -> bpy.types.Object | None:
    """The splat that this one was pruned from, if it is still in the file."""
    return in_file(pruned.get(ORIGINAL))


def in_file(obj: bpy.types.Object | None) -> bpy.types.Object | None:
    """The object; None if it was deleted and only a pointer keeps it in memory."""
    return obj if obj is not None and obj.users_collection else None


def set_hidden(obj: bpy.types.Object, hidden: bool):
    """Hides the object in viewports and renders, or shows it. A view layer that excludes its collection shows
    neither."""
    obj.hide_render = hidden
    if not hidden:
        obj.hide_viewport = False  # the monitor icon
    for layer in (layer for scene in obj.users_scene for layer in scene.view_layers):
        with contextlib.suppress(RuntimeError):  # the layer excludes all its collections
            obj.hide_set(hidden, view_layer=layer)
