"""What the user sees: one file per panel. What they know they ask operators/, never the product itself."""

from . import export, preferences, properties, prune, scene

MODULES = (preferences, properties, scene, prune, export)


def register():
    for module in MODULES:
        module.register()


def unregister():
    for module in reversed(MODULES):
        module.unregister()
