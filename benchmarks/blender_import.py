"""The time that Blender takes to import and export a splat: `python benchmarks/blender_import.py
[GAUSSIANS]`, with the bpy of this Python.

Blender installs the extension from dist/ (made by `make zip`) into a temporary user folder.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tools")]
RUNS = 3


def main():
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    with tempfile.TemporaryDirectory() as folder:
        os.environ["BLENDER_USER_RESOURCES"] = folder
        measure(Path(folder), count)


def measure(folder: Path, count: int):
    import bpy

    bpy.ops.extensions.package_install_files(
        filepath=str(extension_zip()), repo="user_default", enable_on_install=True
    )
    write_scene(folder / "in.ply", count)
    for _ in range(RUNS):
        imported = seconds(lambda: bpy.ops.svrgs.import_ply(filepath=str(folder / "in.ply")))
        exported = seconds(lambda: bpy.ops.svrgs.export_ply(filepath=str(folder / "out.ply")))
        print(
            f"Blender {bpy.app.version_string}: {count:,} Gaussians of degree 3: import {imported:.2f} s,"
            f" export {exported:.2f} s"
        )
        bpy.data.objects.remove(bpy.context.object)
        bpy.data.orphans_purge()


def extension_zip() -> Path:
    """The zip in dist/ for this platform and this Python."""
    import platforms

    variant = platforms.variant_for(f"cp{sys.version_info[0]}{sys.version_info[1]}")
    return ROOT / "dist" / f"{variant.name}.zip"


def write_scene(path: Path, count: int):
    import numpy as np

    from svrgs_addon.files.ply import write_ply
    from svrgs_addon.scene.gaussians import Scene

    rng = np.random.default_rng(0)
    arrays = [
        rng.standard_normal(shape, np.float32)
        for shape in ((count, 3), (count, 3), (count, 4), (count,), (count, 16, 3))
    ]
    write_ply(path, Scene(*arrays))


def seconds(work) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
