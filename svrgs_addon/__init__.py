"""SVR-GS: makes 3D Gaussian splat scenes several times smaller and shows what it cost. No bpy in here."""

__version__ = "0.1.0"
