"""Downloads the wheels that travel in the extension into wheels/: python tools/fetch_wheels.py [--all]

Without --all, those for this platform and all Pythons. Wheels that are there already stay as they are.
"""

from __future__ import annotations

import subprocess
import sys

from platforms import TABLE, WHEELS, Variant, this_platform, variants


def pip_options(variant: Variant) -> list[str]:
    """What pip needs to find the packages of a variant for a platform and a Python other than its own."""
    options = ["--python-version", variant.facts["python"].removeprefix("cp"), "--implementation", "cp"]
    for name in TABLE["platform"][variant.platform]["wheels"]:
        options += ["--platform", name]
    return [*options, *variant.facts["packages"]]


def missing(variant: Variant) -> bool:
    try:
        variant.wheels()
    except FileNotFoundError:
        return True
    return False


def main() -> int:
    command = [
        sys.executable,
        "-m",
        "pip",
        "download",
        "-qq",
        "--disable-pip-version-check",
        "--no-deps",
        "--only-binary=:all:",
        "--dest",
        str(WHEELS),
    ]
    for variant in variants():
        if "--all" not in sys.argv and variant.platform != this_platform() or not missing(variant):
            continue
        print(f"downloading wheels for {variant.platform}, Blender {variant.blender}", flush=True)
        if status := subprocess.call([*command, *pip_options(variant)]):
            return status
        variant.wheels()
    return 0


if __name__ == "__main__":
    sys.exit(main())
