"""Builds of the native library with other constants. They are used only to measure."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

from ..errors import NativeError

SOURCES = Path(__file__).parents[2] / "native"


def missing_tools() -> str:
    """A sentence on what is missing to build variants; '' if nothing is missing."""
    if not (SOURCES / "Makefile").is_file():
        return f"the native sources are not at {SOURCES}"
    missing = [tool for tool in ("make", os.environ.get("CXX", "g++")) if not shutil.which(tool)]
    return f"{missing[0]} is not installed" if missing else ""


def build(macro: str, folder: Path) -> Path:
    """Builds the library with -D`macro` in a new folder named after the macro. Returns its path. Raises NativeError with the last line of the
    compiler."""
    place = folder / macro.replace("=", "-")
    library = place / "libsvrgs.so"
    place.mkdir()
    command = ["make", f"-j{os.cpu_count()}", "-C", str(SOURCES), f"OUT={library}", f"BUILD={place / 'objects'}", f"EXTRA=-D{macro}"]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", errors="replace")
    if done.returncode:
        raise NativeError(f"building with -D{macro} failed: {(done.stderr.strip() or done.stdout.strip()).splitlines()[-1]}")
    return library
