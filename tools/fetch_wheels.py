"""Downloads the wheels that travel in the Blender extension, those named in its manifest, into wheels/: python tools/fetch_wheels.py

Wheels that are there already stay as they are.
"""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def pip_options(wheel: str) -> list[str]:
    """What pip needs to find NAME-VERSION-PYTHON-ABI-PLATFORM[.PLATFORM].whl for a Python other than this one."""
    name, version, python, _, platforms = wheel.removesuffix(".whl").split("-")
    return [f"{name}=={version}", "--python-version", python.removeprefix("cp"), "--platform", platforms.split(".")[-1]]


def main() -> int:
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    for wheel in map(Path, manifest["wheels"]):
        if (ROOT / wheel).exists():
            continue
        print(f"downloading {wheel.name}", flush=True)
        command = [sys.executable, "-m", "pip", "download", "-qq", "--disable-pip-version-check", "--no-deps", "--only-binary=:all:"]
        if status := subprocess.call([*command, "--dest", ROOT / wheel.parent, *pip_options(wheel.name)]):
            return status
        if not (ROOT / wheel).exists():
            print(f"pip downloaded another file than {wheel.name}", file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
