"""Registers what a module has for Blender: CLASSES; HANDLERS, {event: function}; MENUS, {menu: function that
draws in it}; TIMERS, which end with the extension; for all else register() and unregister() of its own."""

from __future__ import annotations

from collections.abc import Iterable
from types import ModuleType

import bpy


def register(modules: Iterable[ModuleType]):
    for module in modules:
        for cls in getattr(module, "CLASSES", ()):
            bpy.utils.register_class(cls)
        for event, handler in getattr(module, "HANDLERS", {}).items():
            getattr(bpy.app.handlers, event).append(handler)
        for menu, draw in getattr(module, "MENUS", {}).items():
            getattr(bpy.types, menu).append(draw)
        if hasattr(module, "register"):
            module.register()


def unregister(modules: Iterable[ModuleType]):
    """In the opposite order."""
    for module in reversed(tuple(modules)):
        for timer in filter(bpy.app.timers.is_registered, getattr(module, "TIMERS", ())):
            bpy.app.timers.unregister(timer)
        if hasattr(module, "unregister"):
            module.unregister()
        for menu, draw in getattr(module, "MENUS", {}).items():
            getattr(bpy.types, menu).remove(draw)
        for event, handler in getattr(module, "HANDLERS", {}).items():
            getattr(bpy.app.handlers, event).remove(handler)
        for cls in reversed(getattr(module, "CLASSES", ())):
            bpy.utils.unregister_class(cls)
