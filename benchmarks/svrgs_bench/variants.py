"""Builds of the native library with other constants. They are used only to measure."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from svrgs_addon.system.errors import NativeError
from svrgs_addon.system.here import LIBRARY

SOURCES = Path(__file__).parents[2] / "native"


def missing_tools() -> str:
    """A sentence on what is missing to build variants; '' if nothing is missing."""
    if not (SOURCES / "CMakeLists.txt").is_file():
        return f"the native sources are not at {SOURCES}"
    missing = [tool for tool in (cmake(), os.environ.get("CXX", "g++")) if not shutil.which(tool)]
    return f"{missing[0]} is not installed" if missing else ""


def cmake() -> str:
    """The program cmake: that of this Python's packages, or else the system's."""
    return shutil.which("cmake", path=str(Path(sys.executable).parent)) or "cmake"


def build(macro: str, folder: Path) -> Path:
    """Builds the library with -D`macro` in a new folder named after the macro. Returns its path. Raises
    NativeError with the last line of the compiler."""
    place = folder / macro.replace("=", "-")
    configure = [cmake(), "-S", str(SOURCES), "-B", str(place), f"-DCMAKE_CXX_FLAGS=-D{macro}"]
    for command in (
        configure,
        [cmake(), "--build", str(place), "--target", "svrgs", "--parallel", str(os.cpu_count())],
    ):
        done = subprocess.run(command, capture_output=True, encoding="utf-8", errors="replace")
        if done.returncode:
            raise NativeError(
                f"building with -D{macro} failed:"
                f" {(done.stderr.strip() or done.stdout.strip()).splitlines()[-1]}"
            )
    return place / LIBRARY
