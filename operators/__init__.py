"""What the user can do: one file per verb. bridge.py turns Blender's data into the product's and back."""

from . import import_ply

MODULES = (import_ply,)


def register():
    for module in MODULES:
        module.register()


def unregister():
    for module in reversed(MODULES):
        module.unregister()
