"""SVR-GS for Blender: imports, shows, prunes and exports 3D Gaussian splats. The code is in operators/ and
panels/."""


def register():
    from . import operators, panels

    operators.register()
    panels.register()


def unregister():
    from . import operators, panels

    panels.unregister()
    operators.unregister()
