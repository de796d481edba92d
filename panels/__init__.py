"""What the user sees: one file per panel. Panels know operators and properties by name only."""

from . import preferences, scene

MODULES = (preferences, scene)


def register():
    for module in MODULES:
        module.register()


def unregister():
    for module in reversed(MODULES):
        module.unregister()
