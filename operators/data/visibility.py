"""Hides and shows splats: with the eye of the outliner, in every view layer, and for renders."""

from __future__ import annotations

import contextlib

import bpy


def set_hidden(obj: bpy.types.Object, hidden: bool):
    """Hides the object in viewports and renders, or shows it. A view layer that excludes its collection shows
    neither."""
    obj.hide_render = hidden
    if not hidden:
        obj.hide_viewport = False  # the monitor icon, which earlier versions used
    for layer in (layer for scene in obj.users_scene for layer in scene.view_layers):
        with contextlib.suppress(RuntimeError):  # the layer excludes all its collections
            obj.hide_set(hidden, view_layer=layer)
