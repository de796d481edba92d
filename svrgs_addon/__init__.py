"""SVR-GS: makes 3D Gaussian splat scenes several times smaller and reports the loss of quality. This package does not import bpy."""

import re
from pathlib import Path


def _version() -> str:
    """That of blender_manifest.toml, which lies beside this package in a checkout and in Blender; or that of the installed wheel."""
    try:
        manifest = (Path(__file__).parents[1] / "blender_manifest.toml").read_text(encoding="utf-8")
        return re.findall(r'^version = "(.+)"$', manifest, re.MULTILINE)[0]
    except (OSError, IndexError):
        from importlib.metadata import version

        return version("svrgs-addon")


__version__ = _version()
