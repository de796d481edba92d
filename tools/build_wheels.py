"""Builds the wheels of every platform in platforms.toml, in dist/wheels/: of the program, and of its native
core alone (native_wheel.py). The core itself lies in build/platforms/TARGET. python tools/build_wheels.py
[PLATFORM...]. Needs the packages of requirements-package.txt.

build/platforms/TARGET also gets the library with debug symbols, svrgs-debug.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import native_wheel
from platforms import BUILT, ROOT, TABLE, VERSION, Variant

OUT = ROOT / "dist/wheels"
PROGRAMS = Path(sys.executable).parent


def build(platform: str) -> Path:
    """Builds the library and the wheel of a platform. Returns the wheel's path. Raises CalledProcessError if
    a step fails."""
    facts = TABLE["platform"][platform]
    folder = BUILT / facts["target"]
    environment = os.environ | {
        "SVRGS_TARGET": facts["target"],
        "SVRGS_PYTHON": sys.executable,
        "PATH": f"{PROGRAMS}{os.pathsep}{os.environ['PATH']}",
    }
    settings = {
        "build-dir": folder,
        "cmake.toolchain-file": ROOT / "native/zig-toolchain.cmake",
        "cmake.args": "-DCMAKE_COMPILE_WARNING_AS_ERROR=ON",
    }
    with tempfile.TemporaryDirectory() as made:
        command = [
            sys.executable,
            "-m",
            "pip",
            "wheel",
            "-q",
            "--no-deps",
            "--no-build-isolation",
            "--disable-pip-version-check",
            "-w",
            made,
            ROOT,
        ]
        subprocess.run(
            [*command, *(f"-C{name}={value}" for name, value in settings.items())],
            env=environment,
            check=True,
        )
        subprocess.run(
            [PROGRAMS / "cmake", "--build", folder, "--target", "svrgs-debug"],
            env=environment,
            check=True,
            stdout=subprocess.DEVNULL,
        )
        (wheel,) = Path(made).glob("*.whl")
        subprocess.run(
            [sys.executable, "-m", "wheel", "tags", "--remove", "--platform-tag", facts["pip"], wheel],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        (wheel,) = Path(made).glob("*.whl")
        native_wheel.write(Variant(platform, "any-python").built_library, platform, OUT)
        return Path(shutil.copy2(wheel, OUT / f"svrgs_addon-{VERSION}-py3-none-{facts['pip']}.whl"))


def runs_on(wheel: Path, platform: str) -> bool:
    """Whether auditwheel finds that a wheel for Linux runs on `platform` (manylinux_2_28_x86_64) and every
    newer one."""
    shown = subprocess.run(
        [sys.executable, "-m", "auditwheel", "show", "--json", wheel],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    found = json.loads(shown)["overall_tag"]
    return _glibc(found) <= _glibc(platform)


def _glibc(platform: str) -> tuple[int, int]:
    major, minor = platform.removeprefix("manylinux_").split("_")[:2]
    return int(major), int(minor)


def main() -> int:
    for platform in sys.argv[1:] or TABLE["platform"]:
        wheel = build(platform)
        print(f"{wheel.stat().st_size / 1e6:6.1f} MB  {wheel.relative_to(ROOT)}", flush=True)
        if platform.startswith("linux") and not runs_on(wheel, TABLE["platform"][platform]["pip"]):
            print(
                f"{wheel.name} needs a newer system than its name says: auditwheel show {wheel}",
                file=sys.stderr,
            )
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
