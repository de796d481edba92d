"""What the user sees: one file per panel. Panels know operators and properties by name only."""

from . import export, preferences, prune, scene

MODULES = (preferences, scene, prune, export)


def register():
    for module in MODULES:
        module.register()


def unregister():
    for module in reversed(MODULES):
        module.unregister()
