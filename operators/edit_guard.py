"""Whether a splat can be given other Gaussians or values now, or a root a splat.

A splat that is linked from another file is refused: Blender accepts what is written to linked data, but
forgets it when the file is saved.
"""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as tr


def problem(context, splat: bpy.types.Object) -> str:
    """What the user must do first, in a sentence; empty if the splat can be changed."""
    if context.mode != "OBJECT" or splat.mode == "EDIT":  # it may be edited in another window's scene
        return tr("Leave Edit Mode first")
    if splat.library or (splat.data is not None and splat.data.library):
        return tr(
            "'{name}' is linked from another file: make it local first (Object > Relations > Make Local)"
        ).format(name=splat.name)
    return ""
