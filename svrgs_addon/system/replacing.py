"""Replacing and reading files that other programs have open.

Windows refuses to replace, rename or remove a file while another program has it open: a viewer, a virus
scanner, or a reader of this product. It also refuses to open a file within the moment in which it is
replaced. So both are tried again for a while.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from . import here, windows

PATIENCE_S, PAUSE_S = 1.0, 0.05
Result = TypeVar("Result")


def patiently(action: Callable[[], Result]) -> Result:
    """Calls the action; on Windows, after a PermissionError, again for PATIENCE_S seconds, then raises it."""
    end = time.monotonic() + PATIENCE_S
    while here.WINDOWS:
        try:
            return action()
        except PermissionError:
            if time.monotonic() > end:
                raise
        time.sleep(PAUSE_S)
    return action()


def replace(source: Path, target: Path) -> None:
    """os.replace, patiently. Raises OSError: PermissionError if the target stays open in another program."""
    patiently(lambda: os.replace(source, target))


def may_be_replaced(path: Path) -> bool:
    """Whether no program has the file open in a way that keeps it from being replaced. Always true on systems
    without such a way.

    A program may allow others to rename the file. Whether Windows replaces it then, depends on its version
    and on the file system.
    """
    if not here.WINDOWS or not path.exists():
        return True

    def open_for_removal():
        os.close(windows.create_file(path, windows.DELETE, windows.SHARE_ALL, windows.OPEN_EXISTING))

    try:
        patiently(open_for_removal)
    except PermissionError:
        return False
    return True
