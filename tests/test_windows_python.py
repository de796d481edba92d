"""Tests by Python for Windows, and in Blender's module for it, under Wine, where tools/test_windows.sh has
made them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import build_extension
import platforms
from test_extension import data  # noqa: F401

ROOT = Path(__file__).resolve().parents[1]
MADE = ROOT / "build/windows/.ready", ROOT / "build/platforms/x86_64-windows-gnu/svrgs.dll"
BLENDER = ROOT / "build/windows/blender-4.5.15"
SHORT = ("test_formats.py", "test_job.py", "test_splats.py")


def passes_on_windows(*words: str, **variables: str):
    command = [str(ROOT / "tools/test_windows.sh"), sys.prefix, *words]
    environment = os.environ | variables
    done = subprocess.run(
        command, stdin=subprocess.DEVNULL, capture_output=True, text=True, cwd=ROOT, env=environment
    )
    assert done.returncode == 0 and " passed" in done.stdout, done.stdout[-5000:] + done.stderr[-1000:]
    print(done.stdout)


@pytest.mark.slow
@pytest.mark.skipif(not all(path.exists() for path in MADE), reason="see tools/test_windows.sh")
def test_what_needs_neither_torch_nor_blender_passes_on_windows():
    passes_on_windows(*(ROOT / "tests/portable.txt").read_text().split())


@pytest.mark.slow
@pytest.mark.skipif(not BLENDER.exists(), reason="see tools/test_windows.sh --blender")
def test_the_extension_works_in_blender_for_windows(data, tmp_path):  # noqa: F811
    """SVRGS_BLENDER_TESTS: as in test_extension.py."""
    variant = platforms.Variant("windows-x64", "any-python")
    extension = build_extension.build(variant, variant.built_library, tmp_path)
    (tmp_path / "user").mkdir()
    words = os.environ.get("SVRGS_BLENDER_TESTS", " ".join(SHORT)).split()
    passes_on_windows(
        "--blender",
        *words,
        SVRGS_TEST_ZIP=str(extension),
        SVRGS_TEST_DATA=str(data),
        BLENDER_USER_RESOURCES=str(tmp_path / "user"),
    )
