"""The installed extension under test, and the data that the tests use."""

from __future__ import annotations

import importlib
import os
from pathlib import Path
from types import ModuleType

PACKAGE = "bl_ext.user_default.svrgs"
DATA = Path(os.environ["SVRGS_TEST_DATA"])


def part(name: str) -> ModuleType:
    """A module of the installed extension."""
    return importlib.import_module(f"{PACKAGE}.{name}")
