"""The time that enabling the extension takes: `python benchmarks/enabling.py [PYTHON]`, PYTHON being one with
bpy (this one).

Blender installs the extension from dist/ (made by `make zip`) into a temporary user folder. The first start
compiles the Python files; the later ones find them compiled. Blender's own unpacking of the wheels, which
happens once, is shown apart.
"""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
import tempfile
import time

from blender_import import extension_zip

MODULE = "bl_ext.user_default.svrgs"
HEAVY = ("pycolmap", "torch", "OpenImageIO", "scipy")
STARTS = 4


def main():
    python = sys.argv[1] if len(sys.argv) > 1 else sys.executable
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "BLENDER_USER_RESOURCES": folder, "PYTHONDONTWRITEBYTECODE": ""}
        for action in ["install", *["start"] * STARTS]:
            subprocess.run([python, __file__, action], env=environment, check=True)


def install():
    import bpy

    bpy.ops.extensions.package_install_files(
        filepath=str(extension_zip()), repo="user_default", enable_on_install=False
    )


def start():
    import bpy  # before addon_utils, which it brings

    addon_utils = importlib.import_module("addon_utils")
    before = time.perf_counter()
    addon_utils.extensions_refresh(ensure_wheels=True, addon_modules_pending=[MODULE])
    unpacked = time.perf_counter()
    if not addon_utils.enable(MODULE):
        sys.exit("the extension cannot be enabled")
    enabled = time.perf_counter()
    heavy = [name for name in HEAVY if name in sys.modules]
    print(
        f"Blender {bpy.app.version_string}: wheels {unpacked - before:.3f} s, enabled in"
        f" {enabled - unpacked:.3f} s, heavy modules: {heavy or 'none'}"
    )


if __name__ == "__main__":
    {"install": install, "start": start}.get(sys.argv[-1], main)()
