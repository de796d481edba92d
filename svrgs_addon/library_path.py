"""Where the native library lies. Imports no other package, so that batch.py can ask inside any Blender."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from pathlib import Path

from .errors import NativeError

LIBRARY_VARIABLE = "SVRGS_LIBRARY"  # environment variable: path of another build of the library
FILE_NAME = {"win32": "svrgs.dll", "darwin": "libsvrgs.dylib"}.get(sys.platform, "libsvrgs.so")


def library_path(other_folders: Iterable[Path] = ()) -> Path:
    """The file of the native library: the one that LIBRARY_VARIABLE names, or the one in this folder, or the first of other_folders.

    Raises NativeError if there is none.
    """
    path = Path(os.environ.get(LIBRARY_VARIABLE) or Path(__file__).with_name(FILE_NAME))
    for found in (path, *(folder / FILE_NAME for folder in other_folders)):
        if found.exists():
            return found
    raise NativeError(f"the native library {path} is missing: run 'make native' in a checkout, or install the extension's zip in Blender")
