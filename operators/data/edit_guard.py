"""Whether a splat can be given other Gaussians or values now, or a root a splat.

A splat that is linked from another file is refused: Blender accepts what is written to linked data, but
forgets it when the file is saved.
"""

from __future__ import annotations

from collections.abc import Callable

import bpy
from bpy.app.translations import pgettext_iface as tr

# what else keeps a splat as it is: functions that return a sentence, or ''; jobs/ adds that of its jobs
reasons: list[Callable[[bpy.types.Object], str]] = []


def change_problem(context, splats: list[bpy.types.Object]) -> str:
    """Why these splats cannot lose, move or join Gaussians now; empty if they can."""
    for obj in splats:
        found = problem(context, obj) or next(filter(None, (reason(obj) for reason in reasons)), "")
        if found:
            return found
    return ""


def problem(context, splat: bpy.types.Object | None) -> str:
    """What the user must do first, in a sentence; empty if the splat can be changed. None: a new one."""
    # it may be edited in another window's scene
    if context.mode != "OBJECT" or (splat is not None and splat.mode == "EDIT"):
        return tr("Leave Edit Mode first")
    if splat is not None and splat.override_library:
        return tr(
            "'{name}' overrides one of another file: make it local first (Object > Relations > Make Local)"
        ).format(name=splat.name)
    if splat is not None and (splat.library or (splat.data is not None and splat.data.library)):
        return tr(
            "'{name}' is linked from another file: make it local first (Object > Relations > Make Local)"
        ).format(name=splat.name)
    return ""


def shared(splats: list[bpy.types.Object]) -> str:
    """Why these splats cannot get other values, which the objects that share them would get, too; empty if
    they can."""
    found = next((obj for obj in splats if obj.data.users > 1), None)
    if found is None:
        return ""
    return tr(
        "other objects share the Gaussians of '{name}': make them single-user first (Object > Relations >"
        " Make Single User)"
    ).format(name=found.name)
