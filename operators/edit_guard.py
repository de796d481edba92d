"""Why a splat cannot be given other Gaussians or values now."""

from __future__ import annotations

import bpy


def problem(context, splat: bpy.types.Object) -> str:
    """What to do first, in a sentence; empty where the splat can be changed."""
    if context.mode != "OBJECT" or splat.mode == "EDIT":  # it may be edited in another window's scene
        return "Leave Edit Mode first"
    if splat.library or splat.data.library:  # Blender takes what is written there and forgets it
        return f"'{splat.name}' is linked from another file: make it local first (Object > Relations > Make Local)"
    return ""
