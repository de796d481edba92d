"""What the system of the tests can do: Windows has no pipes with a name, and not everywhere links."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import pytest


def _makes_links() -> bool:
    with tempfile.TemporaryDirectory() as folder:
        link = Path(folder) / "link"
        try:
            link.symlink_to(folder)
        except OSError:
            return False
        return link.is_symlink()


with_links = pytest.mark.skipif(not _makes_links(), reason="this system makes no symbolic links")
with_pipes = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes with a name")
