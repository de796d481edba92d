"""Builds the Blender extension, dist/svrgs-VERSION.zip, and checks it: python tools/build_extension.py

Both are done by Blender's own builder, a script inside the bpy package. It runs without starting Blender.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DIST = ROOT / "dist"


def builder() -> Path | None:
    """Blender's script that builds extensions, or None where bpy is not installed."""
    spec = importlib.util.find_spec("bpy")
    if spec is None or spec.origin is None:
        return None
    return next(Path(spec.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))


def main() -> int:
    script = builder()
    if script is None:
        print(
            "the extension's builder is part of the Blender module (bpy), which exists for Python 3.11 and 3.13; "
            "Blender itself can build it too: blender --command extension build --output-dir dist",
            file=sys.stderr,
        )
        return 1
    DIST.mkdir(exist_ok=True)
    for old in DIST.glob("*.zip"):
        old.unlink()
    status = subprocess.call([sys.executable, script, "build", "--source-dir", ROOT, "--output-dir", DIST])
    return status or subprocess.call([sys.executable, script, "validate", *DIST.glob("*.zip")])


if __name__ == "__main__":
    sys.exit(main())
