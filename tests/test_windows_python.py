"""Tests by Python for Windows, under Wine, where tools/test_windows.sh has made one."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MADE = ROOT / "build/windows/.ready", ROOT / "build/platforms/x86_64-windows-gnu/svrgs.dll"


@pytest.mark.slow
@pytest.mark.skipif(not all(path.exists() for path in MADE), reason="see tools/test_windows.sh")
def test_what_needs_neither_torch_nor_blender_passes_on_windows():
    words = (ROOT / "tests/portable.txt").read_text().split()
    command = [ROOT / "tools/test_windows.sh", sys.prefix, *words]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0 and " passed" in done.stdout, done.stdout[-5000:] + done.stderr[-1000:]
