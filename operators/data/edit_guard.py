"""Whether a splat can be given other Gaussians or values now, or a root a splat.

A splat that is linked from another file is refused: Blender accepts what is written to linked data, but
forgets it when the file is saved.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

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


def animated(splats: list[bpy.types.Object]) -> str:
    """Why these splats cannot get another place, which their keys would take away; empty if they can."""
    names = ("location", "rotation_", "delta_", "scale")
    for obj in splats:
        if any(curve.data_path.startswith(names) for curve in animation_curves(obj)):
            text = tr("keys or drivers move '{name}': remove them first, or move a parent instead")
            return text.format(name=obj.name)
    return ""


def animation_curves(obj: bpy.types.Object) -> Iterator[bpy.types.FCurve]:
    """Drivers and keys of an object: of its action and of the strips of its NLA tracks; since Blender 4.4, of
    its slot of each action."""
    if (data := obj.animation_data) is None:
        return
    yield from data.drivers
    strips = (strip for track in data.nla_tracks for strip in track.strips)
    for user in filter(lambda user: user.action is not None, (data, *strips)):
        if not hasattr(user.action, "layers"):
            yield from user.action.fcurves
            continue
        for strip in (strip for layer in user.action.layers for strip in layer.strips):
            bag = strip.channelbag(user.action_slot) if user.action_slot else None
            yield from bag.fcurves if bag else ()


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
