"""Where the native library lies. Imports no other package, so that batch.py can ask inside any Blender."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterable
from pathlib import Path

from ..system.errors import NativeError
from ..system.here import LIBRARY as FILE_NAME
from ..system.wheels import NATIVE

LIBRARY_VARIABLE = "SVRGS_LIBRARY"  # environment variable: path of another build of the library


def library_path(other_folders: Iterable[Path] = ()) -> Path:
    """The file of the native library: the one that LIBRARY_VARIABLE names; without the variable the one in
    svrgs_addon/, or else in the package NATIVE, or else in the first of other_folders. Raises NativeError if
    there is none."""
    named, own = os.environ.get(LIBRARY_VARIABLE), Path(__file__).parents[1] / FILE_NAME
    spec = importlib.util.find_spec(NATIVE)
    packages = map(Path, (spec.submodule_search_locations or ()) if spec else ())
    folders = (*packages, *other_folders)
    paths = [Path(named)] if named else [own, *(folder / FILE_NAME for folder in folders)]
    for path in paths:
        if path.exists():
            return path
    raise NativeError(
        f"the native library {paths[0]} is missing: run 'make native' in a checkout, or install the"
        " extension's zip in Blender"
    )
