"""Which operating system this is. Only this file asks; a test sets the values to run another branch."""

from __future__ import annotations

import sys

WINDOWS = sys.platform == "win32"
MACOS = sys.platform == "darwin"
# file name of the native library
LIBRARY = "svrgs.dll" if WINDOWS else "libsvrgs.dylib" if MACOS else "libsvrgs.so"
WHEEL = "win" if WINDOWS else "macosx" if MACOS else "manylinux"  # begins the platform in the names of wheels
