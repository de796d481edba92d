"""SVR-GS for Blender: imports, shows, prunes and exports 3D Gaussian splats. The code is in operators/ and
panels/."""


def register():
    from . import operators, panels
    from .operators import registration

    registration.register((*operators.MODULES, *panels.MODULES))


def unregister():
    from . import operators, panels
    from .operators import registration

    registration.unregister((*operators.MODULES, *panels.MODULES))
