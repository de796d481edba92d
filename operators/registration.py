"""Registers what a module has for Blender: its classes SVRGS_…; PROPERTIES, {(type, name): property};
HANDLERS, {event: function}; MENUS, {menu: function that draws in it}; DRAWS, {"POST_VIEW" or "POST_PIXEL":
function that draws in 3D viewports}; TIMERS, which end with the extension; forget(), which is called when
another file is opened, and at the end; for all else register() and unregister() of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from types import ModuleType

import bpy
from bpy.app.handlers import persistent

_draws: list = []  # what Blender has returned for functions of DRAWS


def register(modules: Iterable[ModuleType]):
    for module in modules:
        for cls in _classes(module):
            bpy.utils.register_class(cls)
        for (kind, name), value in getattr(module, "PROPERTIES", {}).items():
            setattr(getattr(bpy.types, kind), name, value)
        for event, handler in _handlers(module):
            getattr(bpy.app.handlers, event).append(persistent(handler))
        for menu, draw in getattr(module, "MENUS", {}).items():
            getattr(bpy.types, menu).append(draw)
        for stage, draw in getattr(module, "DRAWS", {}).items() if not bpy.app.background else ():
            _draws.append(bpy.types.SpaceView3D.draw_handler_add(draw, (), "WINDOW", stage))
        if hasattr(module, "register"):
            module.register()


def unregister(modules: Iterable[ModuleType]):
    """In the opposite order."""
    while _draws:
        bpy.types.SpaceView3D.draw_handler_remove(_draws.pop(), "WINDOW")
    for module in reversed(tuple(modules)):
        for timer in filter(bpy.app.timers.is_registered, getattr(module, "TIMERS", ())):
            bpy.app.timers.unregister(timer)
        for end in ("unregister", "forget"):
            if hasattr(module, end):
                getattr(module, end)()
        for menu, draw in getattr(module, "MENUS", {}).items():
            getattr(bpy.types, menu).remove(draw)
        for event, handler in _handlers(module):
            getattr(bpy.app.handlers, event).remove(handler)
        for kind, name in getattr(module, "PROPERTIES", {}):
            delattr(getattr(bpy.types, kind), name)
        for cls in reversed(_classes(module)):
            bpy.utils.unregister_class(cls)


def _classes(module: ModuleType) -> list[type]:
    """The classes SVRGS_… that a module defines, in their order, if this Blender knows their kind."""
    named = (one for name, one in vars(module).items() if name.startswith("SVRGS_"))
    own = (one for one in named if one.__module__ == module.__name__)
    return [one for one in own if issubclass(one, bpy.types.bpy_struct)]


def _handlers(module: ModuleType) -> list[tuple[str, Callable]]:
    """(event, function) of a module."""
    forget = [("load_post", module.forget)] if hasattr(module, "forget") else []
    return [*getattr(module, "HANDLERS", {}).items(), *forget]
