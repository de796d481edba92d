"""SVR-GS: makes 3D Gaussian splat scenes several times smaller and reports the loss of quality. This package
does not import bpy."""

__version__ = "0.1.0"
